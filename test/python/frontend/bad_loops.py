"""Programs with wrong statements, loops, levels and derivatives; see bad_expressions.py."""

# ruff: noqa: B018, F821, F841, E712, SIM102, RET503, B007, B011, E711, A001, F632, E713, E714

import tai as ti

from bad_register import bad, fields

# Statements


@bad(
    ti.TaiSyntaxError,
    "kernels have no 'del'",
    "a name ends with the block that it was assigned in",
)
def deletion():
    @ti.kernel
    def kernel(a: ti.f32):
        b = a
        del b  # BAD

    kernel(1.0)


@bad(
    ti.TaiSyntaxError,
    "kernels have no class definitions",
    "do it in Python, outside of the kernel",
)
def class_in_a_kernel():
    @ti.kernel
    def kernel():
        class A:  # BAD
            pass

    kernel()


@bad(ti.TaiSyntaxError, "kernels have no 'nonlocal'", "use a field to change what others see")
def nonlocal_statement():
    count = 0

    @ti.kernel
    def kernel():
        nonlocal count  # BAD
        count = 1

    kernel()


@bad(ti.TaiSyntaxError, "'kernel' is an 'async def', and kernels have no coroutines", "write def")
def await_expression():
    @ti.kernel
    async def kernel(a: ti.f32):  # BAD
        pass

    kernel(1.0)


@bad(
    ti.TaiSyntaxError,
    "'*' in the target of an assignment is not supported in kernels",
    "name each target",
)
def starred_target():
    @ti.kernel
    def kernel():
        a, *b = 1, 2, 3  # BAD

    kernel()


@bad(
    ti.TaiSyntaxError,
    "'continue' of a ti.static loop depends on what is known only when the kernel runs",
    "loop with range(…) instead of ti.static(range(…))",
)
def continue_of_a_static_loop():
    @ti.kernel
    def kernel(n: ti.i32):
        for i in ti.static(range(3)):
            if n > i:
                continue  # BAD

    kernel(1)


@bad(
    ti.TaiNameError,
    "name 'total' is not defined",
    "assign it first, or define it above the kernel",
)
def augmented_assignment_of_an_unknown_name():
    @ti.kernel
    def kernel():
        total += 1  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "a vector of 2 f32 cannot be stored where one number of type f32 is",
    "take one component, such as v[0] or v.x",
)
def vector_added_to_a_variable():
    @ti.kernel
    def kernel():
        a = 1.0
        a += ti.Vector([1.0, 2.0])  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "block_dim is a number of threads, but got 'many'",
    "give a whole number, such as block_dim=128",
)
def loop_config_with_a_value_of_no_use():
    @ti.kernel
    def kernel():
        ti.loop_config(block_dim="many")  # BAD
        for i in range(3):
            pass

    kernel()


@bad(
    ti.TaiSyntaxError,
    "range takes 1 to 3 arguments, but got 4",
    "write range(end), range(begin, end) or range(begin, end, step)",
)
def range_of_four():
    @ti.kernel
    def kernel():
        for i in range(0, 1, 2, 3):  # BAD
            pass

    kernel()


@bad(
    ti.TaiSyntaxError,
    "the step of a range must not be 0",
    "count up by a positive step, or down by a negative one",
)
def range_with_a_step_of_zero():
    @ti.kernel
    def kernel():
        for i in range(0, 3, 0):  # BAD
            pass

    kernel()


@bad(
    ti.TaiTypeError,
    "the bounds of a loop are whole numbers, but got vector of 2 f32",
    "convert it: int(…)",
)
def range_of_a_vector():
    _, _, v, _ = fields()

    @ti.kernel
    def kernel():
        for i in range(v[0]):  # BAD
            pass

    kernel()


@bad(ti.TaiTypeError, "the bounds of a loop are whole numbers, but got 1.5", "convert it: int(…)")
def ndrange_of_floats():
    @ti.kernel
    def kernel():
        for i, j in ti.ndrange(1.5, 2.5):  # BAD
            pass

    kernel()


@bad(
    ti.TaiTypeError,
    "field 'x' is no list: Python looks at it while the kernel is compiled",
    "loop over its indices: for i in x",
)
def enumerate_of_a_field():
    x, _, _, _ = fields()

    @ti.kernel
    def kernel():
        for i, v in enumerate(x):  # BAD
            pass

    kernel()


@bad(
    ti.TaiSyntaxError,
    "more than 65,536 iterations would be unrolled",
    "loop with range(…) instead, or raise the limit: ti.init(unrolling_limit=…)",
)
def static_loop_that_is_huge():
    @ti.kernel
    def kernel():
        for i in ti.static(range(10**9)):  # BAD
            pass

    kernel()


@bad(
    ti.TaiSyntaxError,
    "a loop over 'v[0]' is unrolled by the compiler and must say so",
    "for … in ti.static(v[0])",
)
def loop_over_a_vector():
    _, _, v, _ = fields()

    @ti.kernel
    def kernel():
        for a in v[0]:  # BAD
            pass

    kernel()


@bad(ti.TaiTypeError, "one is less", "ti.static_assert is judged at compile time")
def static_assertion_that_fails():
    @ti.kernel
    def kernel():
        ti.static_assert(1 > 2, "one is less")  # BAD

    kernel()


# Levels


@bad(
    ti.TaiIndexError,
    "the 'pointer' level over i has 1 indices, but got 2",
    "give one index for each of its axes",
)
def deactivation_with_too_many_indices():
    x = ti.field(ti.f32, name="x")
    level = ti.root.pointer(ti.i, 8)
    level.place(x)

    @ti.kernel
    def kernel():
        ti.deactivate(level, [0, 1])  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "ti.is_active takes a level of a layout, but got <f32 of a kernel>",
    "keep what ti.root.pointer(…) returns, or write x.parent()",
)
def activity_of_a_number():
    @ti.kernel
    def kernel(a: ti.f32) -> ti.i32:
        return ti.is_active(a, 0)  # BAD

    kernel(1.0)


@bad(
    ti.TaiTypeError,
    "field 'x' has no attribute 'append'",
    "lists grow in kernels, by x[i].append(value) or ti.append(level, i, value)",
)
def append_to_a_dense_field():
    x, _, _, _ = fields()

    @ti.kernel
    def kernel():
        x.append(1.0)  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "a vector of 2 i32 cannot be stored where one number of type i32 is",
    "take one component, such as v[0] or v.x",
)
def append_of_a_vector_to_a_list_of_numbers():
    x = ti.field(ti.i32, name="x")
    ti.root.dynamic(ti.i, 8).place(x)

    @ti.kernel
    def kernel():
        x.append(ti.Vector([1, 2]))  # BAD

    kernel()


# Derivatives


@bad(
    ti.TaiAutodiffError,
    "'n' holds whole numbers, which have no gradient",
    "a field of floats, such as ti.f32, has one with needs_grad=True",
)
def gradient_of_a_whole_field():
    n = ti.field(ti.i32, shape=4, name="n")

    @ti.kernel
    def kernel():
        n.grad[0] = 1  # BAD

    kernel()


@bad(
    ti.TaiAutodiffError,
    "field 'x' has no dual",
    "make it with needs_dual=True, or call ti.root.lazy_dual() after placing it",
)
def dual_of_a_field_without_one():
    x, _, _, _ = fields()

    @ti.kernel
    def kernel():
        x.dual[0] = 1.0  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "an element of field 'field' is read here by one iteration of a parallel loop, while another "
    "one updates it",
)
def sum_that_is_read_too_early():
    x = ti.field(ti.f32, shape=4, needs_grad=True, name="x")
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def kernel():
        for i in x:
            loss[None] += x[i]
            x[i] = ti.sqrt(loss[None]) * x[i]  # BAD

    with ti.ad.Tape(loss):
        kernel()


@bad(ti.TaiTypeError, "the truth of a vector of 2 u1 is not one answer", "use .any() or .all()")
def chain_of_comparisons_of_vectors():
    _, _, v, _ = fields()

    @ti.kernel
    def kernel():
        if v[0] < v[1] < v[2]:  # BAD
            pass

    kernel()


@bad(ti.TaiTypeError, "the truth of a vector of 2 f32 is not one answer", "use .any() or .all()")
def vector_as_a_bound_of_a_while():
    _, _, v, _ = fields()

    @ti.kernel
    def kernel():
        while v[0]:  # BAD
            pass

    kernel()


@bad(
    ti.TaiTypeError,
    "'not' takes truth values or whole numbers, but got vector of 2 f32",
    "compare it: x == 0",
)
def negated_vector_in_not():
    _, _, v, _ = fields()

    @ti.kernel
    def kernel():
        a = not v[0]  # BAD

    kernel()


@bad(ti.TaiTypeError, "the truth of a vector of 2 f32 is not one answer", "use .any() or .all()")
def vector_in_and():
    _, _, v, _ = fields()

    @ti.kernel
    def kernel():
        a = v[0] and True  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "a 2×2 matrix of f32 and a vector of 2 f32 do not go together",
    "both must have one shape; '@' multiplies matrices",
)
def power_of_a_matrix():
    _, _, _, m = fields()

    @ti.kernel
    def kernel():
        a = m[0] ** ti.Vector([1.0, 2.0])  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "object of type 'number of a kernel' has no len()",
    "x.shape[0] is the extent of a field, v.n that of a vector",
)
def length_of_a_number():
    @ti.kernel
    def kernel(a: ti.f32) -> ti.i32:
        return len(a)  # BAD

    kernel(1.0)
