"""Programs with wrong names, indices and types, each in one way.

Each function sets up a program and runs into its mistake, whose line is marked `# BAD`. The
argument of the decorator is the expected error.
"""

# ruff: noqa: B018, F821, F841, E712, SIM102, RET503, B007, B011, E711, A001

import numpy as np
import tai as ti

from bad_register import bad, fields

# Names


@bad(ti.TaiNameError, "name 'velocty' is not defined", "velocity")
def unknown_name():
    @ti.kernel
    def kernel(velocity: ti.f32) -> ti.f32:
        return velocty * 2  # BAD

    kernel(1.0)


@bad(ti.TaiNameError, "name 'a' is not defined here", "before the block")
def name_of_a_block():
    @ti.kernel
    def kernel(n: ti.i32) -> ti.i32:
        if n > 1:
            a = 3
        return a  # BAD

    kernel(1)


@bad(ti.TaiNameError, "name 'j' is not defined here", "before the block")
def name_of_a_loop():
    @ti.kernel
    def kernel(n: ti.i32) -> ti.i32:
        for i in range(n):
            j = i
        return j  # BAD

    kernel(1)


@bad(ti.TaiNameError, "no attribute 'sine'", "sin")
def unknown_function():
    @ti.kernel
    def kernel(a: ti.f32) -> ti.f32:
        return ti.sine(a)  # BAD

    kernel(1.0)


@bad(ti.TaiTypeError, "field 'x' has no attribute 'gradient'", None)
def unknown_attribute_of_a_field():
    x, _, _, _ = fields()

    @ti.kernel
    def kernel():
        for i in x:
            x.gradient[i] = 0.0  # BAD

    kernel()


@bad(ti.TaiTypeError, "vector of 2 f32 has no attribute 'normalised'", "normalized")
def unknown_method_of_a_vector():
    _, _, v, _ = fields()

    @ti.kernel
    def kernel():
        for i in v:
            v[i] = v[i].normalised()  # BAD

    kernel()


@bad(ti.TaiTypeError, "has no attribute 'z'")
def swizzle_of_a_short_vector():
    _, _, v, _ = fields()

    @ti.kernel
    def kernel():
        for i in v:
            v[i].z = 1.0  # BAD

    kernel()


@bad(ti.TaiTypeError, "number of type f32 has no attribute 'norm'")
def method_of_a_number():
    x, _, _, _ = fields()

    @ti.kernel
    def kernel():
        for i in x:
            x[i] = x[i].norm()  # BAD

    kernel()


# Indices


@bad(ti.TaiIndexError, "field 'y' takes 2 indices, but got 1")
def too_few_indices():
    _, y, _, _ = fields()

    @ti.kernel
    def kernel():
        for i in range(4):
            y[i] = 1.0  # BAD

    kernel()


@bad(ti.TaiIndexError, "field 'x' takes 1 index, but got 2")
def too_many_indices():
    x, _, _, _ = fields()

    @ti.kernel
    def kernel():
        for i in range(4):
            x[i, 0] = 1.0  # BAD

    kernel()


@bad(ti.TaiIndexError, "takes 0 indices", "loss[None]")
def index_of_a_field_without_dimensions():
    loss = ti.field(ti.f32, shape=(), name="loss")

    @ti.kernel
    def kernel():
        loss[0] = 1.0  # BAD

    kernel()


@bad(ti.TaiTypeError, "an index must be a whole number, but got f32", "int(")
def float_index():
    x, _, _, _ = fields()

    @ti.kernel
    def kernel(a: ti.f32):
        x[a] = 1.0  # BAD

    kernel(1.0)


@bad(ti.TaiIndexError, "index 8 is out of range")
def constant_index_out_of_range():
    x, _, _, _ = fields()

    @ti.kernel
    def kernel():
        x[8] = 1.0  # BAD

    kernel()


@bad(ti.TaiIndexError, "index -1 is out of range")
def negative_constant_index():
    x, _, _, _ = fields()

    @ti.kernel
    def kernel() -> ti.f32:
        return x[-1]  # BAD

    kernel()


@bad(ti.TaiIndexError, "index 2 is out of range")
def component_out_of_range():
    _, _, v, _ = fields()

    @ti.kernel
    def kernel():
        for i in v:
            v[i][2] = 1.0  # BAD

    kernel()


@bad(ti.TaiIndexError, "takes 2 indices, but got 3")
def too_many_components():
    _, _, _, m = fields()

    @ti.kernel
    def kernel():
        for i in m:
            m[i][0, 0, 0] = 1.0  # BAD

    kernel()


@bad(ti.TaiTypeError, "has no elements")
def component_of_a_number():
    x, _, _, _ = fields()

    @ti.kernel
    def kernel():
        for i in x:
            x[i] = x[i][0]  # BAD

    kernel()


@bad(ti.TaiTypeError, "fields have no slices")
def slice_of_a_field():
    x, _, _, _ = fields()

    @ti.kernel
    def kernel() -> ti.f32:
        return x[0:2]  # BAD

    kernel()


@bad(ti.TaiTypeError, "takes an index that is known at compile time", "ti.static")
def dynamic_index_of_a_list():
    @ti.kernel
    def kernel(n: ti.i32) -> ti.i32:
        a = [1, 2, 3]
        return a[n]  # BAD

    kernel(1)


@bad(ti.TaiAssertionError, "out of")
def index_out_of_range_at_run_time():
    ti.init(debug=True, offline_cache=False)
    x, _, _, _ = fields()

    @ti.kernel
    def kernel(n: ti.i32):
        for i in range(n):
            x[i] = 1.0  # BAD

    kernel(20)


# Types and shapes


@bad(ti.TaiTypeError, "field 'x' stands where a number is needed", "x[i]")
def field_as_a_number():
    x, _, _, _ = fields()

    @ti.kernel
    def kernel(a: ti.f32) -> ti.f32:
        return x + a  # BAD

    kernel(1.0)


@bad(ti.TaiTypeError, "field 'x' stands where a number is needed", "x[i]")
def field_in_a_function():
    x, _, _, _ = fields()

    @ti.kernel
    def kernel() -> ti.f32:
        return ti.sin(x)  # BAD

    kernel()


@bad(ti.TaiTypeError, "field 'x' stands where a number is needed", "x[i]")
def field_as_a_condition():
    x, _, _, _ = fields()

    @ti.kernel
    def kernel():
        if x:  # BAD
            pass

    kernel()


@bad(ti.TaiTypeError, "function 'floor' stands where a number is needed", "parentheses")
def function_as_a_number():
    @ti.kernel
    def kernel(a: ti.f32) -> ti.f32:
        return a + ti.floor  # BAD

    kernel(1.0)


@bad(ti.TaiTypeError, "None stands where a number is needed")
def none_as_a_number():
    @ti.func
    def nothing(a):
        a + 1

    @ti.kernel
    def kernel(a: ti.f32) -> ti.f32:
        return 2 * nothing(a)  # BAD

    kernel(1.0)


@bad(ti.TaiTypeError, "'abc' stands where a number is needed")
def string_as_a_number():
    @ti.kernel
    def kernel(a: ti.f32) -> ti.f32:
        return a + "abc"  # BAD

    kernel(1.0)


@bad(ti.TaiTypeError, "vector of 2 f32 and a vector of 3")
def shapes_that_differ():
    _, _, v, _ = fields()

    @ti.kernel
    def kernel():
        for i in v:
            v[i] = v[i] + ti.Vector([1.0, 2.0, 3.0])  # BAD

    kernel()


@bad(ti.TaiTypeError, "cannot be multiplied by '@'", "columns")
def matrix_product_of_wrong_shapes():
    _, _, _, m = fields()

    @ti.kernel
    def kernel():
        for i in m:
            m[i] = m[i] @ ti.Matrix([[1.0, 2.0]])  # BAD

    kernel()


@bad(ti.TaiTypeError, "cannot be stored where one number")
def vector_into_a_scalar_field():
    x, _, v, _ = fields()

    @ti.kernel
    def kernel():
        for i in x:
            x[i] = v[i]  # BAD

    kernel()


@bad(ti.TaiTypeError, "cannot be stored in a vector of 2 f32")
def long_vector_into_a_field():
    _, _, v, _ = fields()

    @ti.kernel
    def kernel():
        for i in v:
            v[i] = ti.Vector([1.0, 2.0, 3.0])  # BAD

    kernel()


@bad(ti.TaiTypeError, "cannot be stored where one number")
def variable_changes_from_number_to_vector():
    @ti.kernel
    def kernel() -> ti.f32:
        a = 1.0
        a = ti.Vector([1.0, 2.0])  # BAD
        return a

    kernel()


@bad(ti.TaiTypeError, "different lengths")
def ragged_matrix():
    @ti.kernel
    def kernel() -> ti.f32:
        a = ti.Matrix([[1.0, 2.0], [3.0]])  # BAD
        return a[0, 0]

    kernel()


@bad(ti.TaiTypeError, "needs a square matrix")
def inverse_of_a_rectangle():
    @ti.kernel
    def kernel() -> ti.f32:
        a = ti.Matrix([[1.0, 2.0, 3.0], [3.0, 4.0, 5.0]])
        return a.inverse()[0, 0]  # BAD

    kernel()


@bad(ti.TaiTypeError, "takes a 2×2 or 3×3 matrix")
def polar_of_a_vector():
    _, _, v, _ = fields()

    @ti.kernel
    def kernel():
        for i in v:
            r, s = ti.polar_decompose(v[i])  # BAD

    kernel()


@bad(ti.TaiTypeError, "dot product of a vector of 2 f32 and a vector of 3")
def dot_of_wrong_shapes():
    _, _, v, _ = fields()

    @ti.kernel
    def kernel() -> ti.f32:
        return v[0].dot(ti.Vector([1, 2, 3]))  # BAD

    kernel()


@bad(ti.TaiTypeError, "is not one answer", ".any()")
def vector_as_a_condition():
    _, _, v, _ = fields()

    @ti.kernel
    def kernel():
        for i in v:
            if v[i] > 0.0:  # BAD
                v[i] = v[i] * 2

    kernel()


@bad(ti.TaiTypeError, "takes whole numbers, but got f32", "int(")
def bits_of_a_float():
    @ti.kernel
    def kernel(a: ti.f32) -> ti.f32:
        return a & 3  # BAD

    kernel(1.0)


@bad(ti.TaiTypeError, "'not' takes truth values", "==")
def not_of_a_float():
    @ti.kernel
    def kernel(a: ti.f32) -> ti.i32:
        return not a  # BAD

    kernel(1.0)


@bad(ti.TaiTypeError, "does not fit i32", "ti.i64(")
def literal_too_large():
    @ti.kernel
    def kernel() -> ti.i32:
        a = 5_000_000_000  # BAD
        return a

    kernel()


@bad(ti.TaiTypeError, "no negative powers", "float")
def negative_power_of_a_whole_number():
    @ti.kernel
    def kernel(n: ti.i32) -> ti.i32:
        return n**-1  # BAD

    kernel(3)


@bad(ti.TaiTypeError, "a whole number is divided by zero")
def division_by_zero():
    @ti.kernel
    def kernel(n: ti.i32) -> ti.i32:
        return n // 0  # BAD

    kernel(3)


@bad(ti.TaiTypeError, "a whole number is divided by zero", "static")
def remainder_by_zero():
    zero = 0

    @ti.kernel
    def kernel(n: ti.i64) -> ti.i64:
        return ti.raw_mod(n, zero)  # BAD

    kernel(3)


@bad(ti.TaiTypeError, "the smallest i32 is divided by -1", "wider")
def quotient_that_does_not_fit():
    @ti.kernel
    def kernel() -> ti.i32:
        return ti.i32(-(2**31)) // -1  # BAD

    kernel()


@bad(ti.TaiTypeError, "no complex numbers")
def complex_number():
    @ti.kernel
    def kernel() -> ti.f32:
        return 1.0 + 2j  # BAD

    kernel()


@bad(ti.TaiTypeError, "is not a type of numbers")
def cast_to_nothing():
    @ti.kernel
    def kernel(a: ti.f32) -> ti.i32:
        return ti.cast(a, "int")  # BAD

    kernel(1.0)


@bad(ti.TaiTypeError, "np.sin cannot take values of a kernel", "ti.sin")
def numpy_function():
    @ti.kernel
    def kernel(a: ti.f32) -> ti.f32:
        return np.sin(a)  # BAD

    kernel(1.0)


@bad(ti.TaiTypeError, "bounds of a loop are whole numbers", "int(")
def float_bound():
    @ti.kernel
    def kernel(a: ti.f32):
        for i in range(a):  # BAD
            pass

    kernel(1.0)


@bad(ti.TaiTypeError, "3 targets cannot take 2 values")
def unpacking():
    _, _, v, _ = fields()

    @ti.kernel
    def kernel() -> ti.f32:
        a, b, c = v[0]  # BAD
        return a

    kernel()


@bad(ti.TaiTypeError, "is not an element of a field or a variable")
def atomic_of_a_number():
    @ti.kernel
    def kernel():
        ti.atomic_add(3, 4)  # BAD

    kernel()


@bad(ti.TaiTypeError, "cannot change the Python object", "field")
def assignment_to_a_python_object():
    data = np.zeros(3)

    @ti.kernel
    def kernel():
        data[0] = 1.0  # BAD

    kernel()


@bad(ti.TaiTypeError, "array 'a' stands where a number is needed", "read an element: a[i]")
def array_as_a_number():
    @ti.kernel
    def kernel(a: ti.types.ndarray(ti.f32, ndim=1)) -> ti.f32:
        return a[0] + a  # BAD

    kernel(np.zeros(3, np.float32))


@bad(ti.TaiTypeError, "array 'a' stands where a number is needed", "read an element: a[i, j]")
def array_that_is_printed():
    @ti.kernel
    def kernel(a: ti.types.ndarray(ti.f32, ndim=2)):
        print("all of it:", a)  # BAD

    kernel(np.zeros((3, 2), np.float32))


@bad(ti.TaiTypeError, "the type f32 stands where a number is needed", "ti.cast(x, ti.f32)")
def type_as_a_number():
    x, _, _, _ = fields()

    @ti.kernel
    def kernel() -> ti.f32:
        return x.dtype  # BAD

    kernel()


@bad(ti.TaiTypeError, "structs have no arithmetic", "compute with their members")
def sum_of_structs():
    pair = ti.types.struct(a=ti.i32, b=ti.f32)

    @ti.kernel
    def kernel():
        s = pair(1, 2.0) + pair(3, 4.0)  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "a text stands where a number is needed",
    "kernels compute with numbers; text is for print and assert",
)
def text_with_a_number_stored():
    x = ti.field(ti.f32, shape=1)

    @ti.kernel
    def kernel(a: ti.f32):
        s = f"{a}"
        x[0] = s  # BAD

    kernel(1.0)


@bad(
    ti.TaiTypeError,
    "an ndarray takes an index that is known at compile time",
    "loop with ti.static(range(…)), or pass it as an argument: x: ti.types.ndarray()",
)
def index_into_an_array_of_numpy():
    weights = np.ones(4, np.float32)

    @ti.kernel
    def kernel(i: ti.i32) -> ti.f32:
        return weights[i]  # BAD

    kernel(1)


@bad(ti.TaiTypeError, "field 'x' stands where a number is needed", "x[i]")
def field_as_the_condition_of_an_expression():
    x, *_ = fields()

    @ti.kernel
    def kernel() -> ti.f32:
        return 1.0 if x else 2.0  # BAD

    kernel()


@bad(ti.TaiTypeError, "the truth of a struct is not one answer", "compare its members")
def struct_as_the_condition_of_an_expression():
    pair = ti.types.struct(a=ti.f32, b=ti.f32)

    @ti.kernel
    def kernel() -> ti.f32:
        p = pair(1.0, 2.0)
        return 1.0 if p else 2.0  # BAD

    kernel()
