"""Refusals that no other test meets: each has its words, and comes as an error of the package.

Each kernel is refused at the line that ends with the mark.
"""

# ruff: noqa: F841, F842, B007, F507, UP031

import inspect

import pytest
import tai as ti


def f32_field(*shape):
    return ti.field(ti.f32, shape or 4)


def no_value():
    def kernel():
        x: ti.f32  # BAD

    return kernel


def an_annotated_element():
    x = f32_field()

    def kernel():
        x[0]: ti.f32 = 1.0  # BAD

    return kernel


def two_types():
    def kernel():
        y = 1
        y: ti.f32 = 2.0  # BAD

    return kernel


def keywords_of_a_level():
    x = f32_field()

    def kernel():
        ti.activate(snode=x, indices=[0])  # BAD

    return kernel


def int_of_two():
    x = f32_field()

    def kernel():
        x[0] = int(x[1], x[2])  # BAD

    return kernel


def static_of_nothing():
    def kernel():
        for i in ti.static():  # BAD
            pass

    return kernel


def three_of_two():
    def kernel():
        for a, b, c in ti.static(((1, 2), (3, 4))):  # BAD
            pass

    return kernel


def a_condition_at_run_time():
    x = f32_field()

    def kernel():
        y = [k for k in ti.static(range(3)) if x[0] > 0]  # BAD

    return kernel


def keywords_of_range():
    def kernel():
        for i in range(stop=3):  # BAD
            pass

    return kernel


def grouped_of_two():
    x = f32_field()

    def kernel():
        for i in ti.grouped(x, x):  # BAD
            pass

    return kernel


def keywords_of_grouped():
    x = f32_field()

    def kernel():
        ti.loop_config(8)  # BAD
        for i in x:
            x[i] = 0

    return kernel


def too_few_places():
    x = f32_field()

    def kernel():
        print("%f" % (x[0], x[1]))  # BAD

    return kernel


def a_format_of_a_list():
    x = f32_field()

    def kernel():
        print(f"{[x[0], x[1]]:.3f}")  # BAD

    return kernel


def a_place_beside_values():
    x = f32_field()

    def kernel():
        print("{}", x[0])  # BAD

    return kernel


def unequal_returns():
    x = f32_field()

    @ti.func
    def parts(a):
        if a > 0:
            return a, a
        return a

    def kernel():
        y = parts(x[0])  # BAD

    return kernel


def a_dense_level_is_deactivated():
    block = ti.root.dense(ti.i, 4)
    x = ti.field(ti.f32)
    block.place(x)

    def kernel():
        ti.deactivate(block, [0])  # BAD

    return kernel


def an_address_of_nothing():
    x = f32_field()

    def kernel():
        y = ti.get_addr(x)  # BAD

    return kernel


def rescaled_to_nothing():
    block = ti.root.dense(ti.i, 4)
    x = ti.field(ti.f32)
    block.place(x)

    def kernel():
        y = ti.rescale_index(block, [0])  # BAD

    return kernel


def rescaled_to_other_axes():
    one, two = ti.root.dense(ti.i, 4), ti.root.dense(ti.ij, 4)
    x, y = ti.field(ti.f32), ti.field(ti.f32)
    one.place(x), two.place(y)

    def kernel():
        z = ti.rescale_index(one, two, [0])  # BAD

    return kernel


def selection_of_other_shapes():
    def kernel():
        c = ti.Vector([1, 0, 1])
        y = ti.select(c, ti.Vector([1.0, 2.0]), ti.Vector([3.0, 4.0]))  # BAD

    return kernel


def random_bits():
    def kernel():
        y = ti.random(ti.u1)  # BAD

    return kernel


def an_empty_slice():
    def kernel():
        v = ti.Vector([1.0, 2.0, 3.0])
        y = v[2:1]  # BAD

    return kernel


def a_negative_shift():
    x = ti.field(ti.i32, 4)

    def kernel():
        x[0] = x[1] << -1  # BAD

    return kernel


def no_such_unit_vector():
    def kernel():
        y = ti.Vector.unit(3, 3)  # BAD

    return kernel


KERNELS = {
    no_value: "a variable needs a value",
    an_annotated_element: "only variables are annotated",
    two_types: "variable 'y' has its type already",
    keywords_of_a_level: "ti.activate takes no keywords",
    int_of_two: "int takes one argument",
    static_of_nothing: "ti.static takes one argument",
    three_of_two: "3 variables cannot take 2 values",
    a_condition_at_run_time: "the conditions of a comprehension are compile-time",
    keywords_of_range: "range takes no keywords",
    grouped_of_two: "ti.grouped takes one argument",
    keywords_of_grouped: "ti.loop_config takes keywords only",
    too_few_places: "the text has places for 1 values, but got 2",
    a_format_of_a_list: "the format '.3f' is for numbers and vectors",
    a_place_beside_values: "a text with '{}' is printed beside values",
    unequal_returns: "one return gives 2 values and another 1 value",
    a_dense_level_is_deactivated: "are always active",
    an_address_of_nothing: r"ti.get_addr takes \(field, indices\)",
    rescaled_to_nothing: r"ti.rescale_index takes \(from level, to level, indices\)",
    rescaled_to_other_axes: "levels and indices of the same axes",
    selection_of_other_shapes: "cannot select among",
    random_bits: "ti.random makes floats and whole numbers",
    an_empty_slice: "the slice is empty",
    a_negative_shift: "by the negative number -1",
    no_such_unit_vector: "a vector of 3 components has no unit vector 3",
}


@pytest.mark.parametrize("make", KERNELS, ids=lambda make: make.__name__)
def test_rare_mistakes_in_kernels(make):
    kernel = make()
    lines, first = inspect.getsourcelines(make)
    bad = first + next(number for number, line in enumerate(lines) if line.endswith("# BAD\n"))
    with pytest.raises(ti.TaiError, match=KERNELS[make]) as caught:
        ti.kernel(kernel)()
    assert f"{bad}" in str(caught.value) and "^" in str(caught.value)
    assert "Traceback" not in str(caught.value)


def placed_twice():
    x = ti.field(ti.f32)
    ti.root.dense(ti.i, 4).place(x)
    ti.root.dense(ti.i, 8).place(x)


def a_matrix_placed_twice():
    x = ti.Vector.field(2, ti.f32)
    ti.root.dense(ti.i, 4).place(x)
    ti.root.dense(ti.i, 8).place(x)


def a_component_placed_twice():
    x = ti.Vector.field(2, ti.f32)
    ti.root.dense(ti.i, 4).place(x)
    ti.root.dense(ti.i, 8).place(x.get_scalar_field(0))


def a_class_below_a_struct():
    @ti.dataclass
    class Cell:
        a: ti.f32

    class Wide(Cell):
        pass

    Wide(a=1.0)


def solver_without_dimensions():
    b, x = ti.Vector.field(2, ti.f32, ()), ti.Vector.field(2, ti.f32, ())

    @ti.kernel
    def apply(p: ti.template(), q: ti.template()):
        q[None] = p[None]

    ti.linalg.cg(apply, b, x)


def solver_with_other_offsets():
    b, x = ti.field(ti.f32, 4, offset=1), ti.field(ti.f32, 4)

    @ti.kernel
    def apply(p: ti.template(), q: ti.template()):
        for i in p:
            q[i] = p[i]

    ti.linalg.cg(apply, b, x)


def twice_in_no_grad():
    block = ti.ad.no_grad()
    with ti.ad.Tape(ti.field(ti.f32, (), needs_grad=True)), block, block:
        pass


def a_tape_without_a_record():
    ti.ad.Tape(ti.field(ti.f32, (), needs_grad=True)).stats()


def a_matrix_of_another_shape():
    @ti.kernel
    def kernel(m: ti.types.matrix(2, 3, ti.f32)) -> ti.f32:
        return m[0, 0]

    kernel(ti.Matrix([[1.0, 2.0], [3.0, 4.0]]))


def a_static_kernel_the_wrong_way():
    class Scene:
        @ti.kernel
        @staticmethod
        def step():
            pass


def axes_twice():
    ti.root.dense((ti.i, ti.i), 4)


def a_mode_of_fields():
    @ti.kernel(adjoints="f64")
    def kernel():
        pass


def an_endless_template():
    endless = []
    endless.append(endless)

    @ti.kernel
    def kernel(a: ti.template()):
        pass

    kernel(endless)


HOST = {
    placed_twice: "is placed already",
    a_matrix_placed_twice: "is placed already",
    a_component_placed_twice: "is placed already",
    a_class_below_a_struct: "derives from a struct type, and is none itself",
    solver_without_dimensions: "has no dimensions",
    solver_with_other_offsets: r"start at \(1,\), those of",
    twice_in_no_grad: "entered already",
    a_tape_without_a_record: "the tape holds nothing yet",
    a_matrix_of_another_shape: r"expects matrix\(2, 3, f32\), but got shape \(2, 2\)",
    a_static_kernel_the_wrong_way: "put @staticmethod above @ti.kernel",
    axes_twice: "an axis stands twice in one level",
    a_mode_of_fields: "kernel 'kernel' has no mode 'adjoints'",
    an_endless_template: "contains itself, or is nested too deeply",
}


@pytest.mark.parametrize("run", HOST, ids=lambda run: run.__name__)
def test_rare_mistakes_on_the_host(run):
    with pytest.raises(ti.TaiError, match=HOST[run]):
        run()


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: ti.field(ti.f32, offset=2), "offset needs a shape"),
        (lambda: ti.field(ti.f32, order="ji"), "order needs a shape"),
        (lambda: ti.field(ti.f32, (2, 3), order="ii"), "order must hold each of 'ij' once"),
        (lambda: ti.field(ti.f32, (1,) * 30), "a field has at most"),
        (lambda: ti.root.dense("i", 4), "expects axes such as ti.ij"),
        (lambda: ti.linalg.SparseSolver(dtype=ti.i32), "holds ti.f32 or ti.f64"),
        (lambda: ti.Matrix([[1, 2], [3, 4]]) @ ti.Vector([1, 2, 3]), "do not chain"),
    ],
)  # fmt: skip
def test_rare_mistakes_of_one_call(make, message):
    with pytest.raises(ti.TaiError, match=message):
        make()
