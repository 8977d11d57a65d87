"""Programs with wrong calls, statements and fields, each in one way.

Each function sets up a program and runs into its mistake, whose line is marked `# BAD`. The
argument of the decorator is the expected error.
"""

# ruff: noqa: B018, F821, F841, E712, SIM102, RET503, B007, B011, E711, A001

import tai as ti

from bad_register import bad, fields

# Calls


@bad(ti.TaiTypeError, "function 'twice' takes 1 arguments, but got 2")
def too_many_arguments_of_a_function():
    @ti.func
    def twice(a):
        return 2 * a

    @ti.kernel
    def kernel() -> ti.i32:
        return twice(1, 2)  # BAD

    kernel()


@bad(ti.TaiTypeError, "function 'twice' needs an argument 'a'")
def missing_argument_of_a_function():
    @ti.func
    def twice(a):
        return 2 * a

    @ti.kernel
    def kernel() -> ti.i32:
        return twice()  # BAD

    kernel()


@bad(ti.TaiSyntaxError, "calls itself more than 50 times", "loop")
def recursion():
    @ti.kernel
    def kernel(n: ti.i32) -> ti.i32:
        return endless(n)

    kernel(3)


@ti.func
def endless(n):
    return endless(n - 1)  # BAD-RECURSION


@bad(ti.TaiSyntaxError, "cannot be called from a kernel", "@ti.func")
def kernel_in_a_kernel():
    @ti.kernel
    def inner():
        pass

    @ti.kernel
    def kernel():
        inner()  # BAD

    kernel()


@bad(ti.TaiTypeError, "is not a function")
def call_of_a_number():
    @ti.kernel
    def kernel(a: ti.f32) -> ti.f32:
        return a(2)  # BAD

    kernel(1.0)


@bad(ti.TaiTypeError, "ti.length takes a dynamic level, but this is the 'dense' level over i")
def length_of_a_dense_level():
    x, _, _, _ = fields()

    @ti.kernel
    def kernel():
        for i in x:
            x[i] = ti.length(x.parent(), [])  # BAD

    kernel()


@bad(ti.TaiTypeError, "ti.static needs what is known at compile time", "drop ti.static")
def static_of_a_value():
    @ti.kernel
    def kernel(n: ti.i32) -> ti.i32:
        return ti.static(n + 1)  # BAD

    kernel(1)


@bad(ti.TaiTypeError, "'if ti.static(…)' is known only when the kernel runs")
def static_if_of_a_value():
    @ti.kernel
    def kernel(n: ti.i32):
        if ti.static(n > 1):  # BAD
            pass

    kernel(1)


@bad(ti.TaiSyntaxError, "known only when the kernel runs", "without ti.static")
def static_range_of_a_value():
    @ti.kernel
    def kernel(n: ti.i32):
        for i in ti.static(range(n)):  # BAD
            pass

    kernel(1)


# Statements


@bad(ti.TaiSyntaxError, "runs in parallel and cannot be left by 'break'", "serialize")
def break_of_the_parallel_loop():
    x, _, _, _ = fields()

    @ti.kernel
    def kernel():
        for i in x:
            if i > 3:
                break  # BAD

    kernel()


@bad(ti.TaiSyntaxError, "depends on what is known only when the kernel runs", "range")
def dynamic_break_of_a_static_loop():
    @ti.kernel
    def kernel(n: ti.i32):
        for i in ti.static(range(3)):
            if n > i:
                break  # BAD

    kernel(1)


@bad(ti.TaiSyntaxError, "cannot be left by 'return'", "serialize=True")
def return_from_a_parallel_loop():
    @ti.kernel
    def kernel():
        for i in range(8):
            if i > 3:
                return  # BAD

    kernel()


@bad(ti.TaiSyntaxError, "can end without a return", "at its end")
def return_in_one_branch_only():
    @ti.kernel
    def kernel(n: ti.i32) -> ti.i32:  # BAD
        if n > 1:
            return 3

    kernel(1)


@bad(ti.TaiSyntaxError, "can end without a return", "at its end")
def function_that_returns_in_one_branch_only():
    @ti.func
    def maybe_three(n):  # BAD
        if n > 1:
            return 3

    @ti.kernel
    def kernel(n: ti.i32) -> ti.i32:
        return maybe_three(n)

    kernel(1)


@bad(ti.TaiTypeError, "1 value and another 2 values", "everywhere")
def returns_of_different_length():
    @ti.func
    def one_or_two(n):
        if n > 1:
            return 3
        return 1, 2  # BAD

    @ti.kernel
    def kernel(n: ti.i32) -> ti.i32:
        return one_or_two(n)

    kernel(1)


@bad(ti.TaiTypeError, "gives numbers, vectors or matrices")
def return_of_a_field_in_a_branch():
    x = ti.field(ti.f32, shape=4)

    @ti.func
    def first_of(x: ti.template(), n):
        if n > 1:
            return x  # BAD
        return x

    @ti.kernel
    def kernel(n: ti.i32) -> ti.f32:
        return first_of(x, n)

    kernel(1)


@bad(ti.TaiSyntaxError, "needs a return type", "->")
def return_early_without_a_type():
    @ti.kernel
    def kernel(n: ti.i32):
        if n > 1:
            return n  # BAD

    kernel(1)


@bad(ti.TaiSyntaxError, "needs a return type", "->")
def return_without_a_type():
    @ti.kernel
    def kernel(n: ti.i32):
        return n  # BAD

    kernel(1)


@bad(ti.TaiSyntaxError, "has a return type, but no return")
def missing_return():
    @ti.kernel
    def kernel(n: ti.i32) -> ti.i32:  # BAD
        pass

    kernel(1)


@bad(ti.TaiSyntaxError, "kernel argument 'n' cannot be changed", "copy it")
def assignment_to_an_argument():
    @ti.kernel
    def kernel(n: ti.i32) -> ti.i32:
        n = n + 1  # BAD
        return n

    kernel(1)


@bad(ti.TaiSyntaxError, "loop variable 'i' cannot be changed")
def assignment_to_a_loop_variable():
    x, _, _, _ = fields()

    @ti.kernel
    def kernel():
        for i in x:
            i += 1  # BAD

    kernel()


@bad(ti.TaiTypeError, "the loop has 1 variable, but runs over 2 dimensions", "ti.grouped")
def too_few_loop_variables():
    _, y, _, _ = fields()

    @ti.kernel
    def kernel():
        for i in y:  # BAD
            pass

    kernel()


@bad(ti.TaiTypeError, "the loop has 3 variables, but runs over 2 dimensions")
def too_many_loop_variables():
    @ti.kernel
    def kernel():
        for i, j, k in ti.ndrange(2, 3):  # BAD
            pass

    kernel()


@bad(ti.TaiSyntaxError, "must say so", "ti.static")
def loop_over_a_list():
    @ti.kernel
    def kernel():
        for i in [1, 2, 3]:  # BAD
            pass

    kernel()


@bad(ti.TaiTypeError, "a number cannot be looped over", "range(n)")
def loop_over_a_number():
    @ti.kernel
    def kernel(n: ti.i32):
        for i in n:  # BAD
            pass

    kernel(1)


@bad(ti.TaiSyntaxError, "must stand at the top of a kernel", "ti.ndrange")
def nested_loop_over_a_field():
    x, y, _, _ = fields()

    @ti.kernel
    def kernel():
        for i in x:
            for j, k in y:  # BAD
                pass

    kernel()


@bad(ti.TaiSyntaxError, "kernels have no 'try'")
def try_statement():
    @ti.kernel
    def kernel():
        try:  # BAD
            pass
        except ValueError:
            pass

    kernel()


@bad(ti.TaiSyntaxError, "kernels have no 'with'")
def with_statement():
    x, _, _, _ = fields()

    @ti.kernel
    def kernel():
        with ti.ad.Tape(x):  # BAD
            pass

    kernel()


@bad(ti.TaiSyntaxError, "kernels have no 'raise'", "assert")
def raise_statement():
    @ti.kernel
    def kernel():
        raise ValueError  # BAD

    kernel()


@bad(ti.TaiSyntaxError, "kernels have no function definitions", "@ti.func")
def nested_function():
    @ti.kernel
    def kernel():
        def inner():  # BAD
            pass

    kernel()


@bad(ti.TaiSyntaxError, "kernels have no lambda", "@ti.func")
def lambda_expression():
    @ti.kernel
    def kernel() -> ti.i32:
        f = lambda a: a + 1  # BAD # noqa: E731
        return f(1)

    kernel()


@bad(ti.TaiSyntaxError, "kernels have no 'import'", "top of the file")
def import_statement():
    @ti.kernel
    def kernel():
        import math  # BAD # noqa: F401

    kernel()


@bad(ti.TaiSyntaxError, "kernels have no 'global'", "field")
def global_statement():
    @ti.kernel
    def kernel():
        global counter  # BAD # noqa: PLW0604

    kernel()


@bad(ti.TaiSyntaxError, "kernels have no coroutines and generators")
def yield_expression():
    @ti.kernel
    def kernel():
        yield 1  # BAD

    kernel()


@bad(ti.TaiSyntaxError, "kernels have no sets", "list")
def set_expression():
    @ti.kernel
    def kernel(n: ti.i32) -> ti.i32:
        return n in {1, 2}  # BAD

    kernel(1)


@bad(ti.TaiTypeError, "'d' is no format for a f32", "{x:8.3f}")
def format_of_another_type():
    @ti.kernel
    def kernel(a: ti.f32):
        print(f"{a:d}")  # BAD

    kernel(1.0)


@bad(ti.TaiTypeError, "'_d' is no format for a i32: kernels have no such format", "{n:04d}")
def format_with_groups():
    @ti.kernel
    def kernel(a: ti.i32):
        print(f"{a:_d}")  # BAD

    kernel(1)


@bad(ti.TaiTypeError, "ti.loop_config has no option 'serialise'", "serialize")
def unknown_loop_option():
    @ti.kernel
    def kernel():
        ti.loop_config(serialise=True)  # BAD
        for i in range(3):
            pass

    kernel()


@bad(ti.TaiTypeError, "the assertion never holds")
def assertion_that_never_holds():
    @ti.kernel
    def kernel():
        assert 1 > 2  # BAD

    kernel()


@bad(ti.TaiSyntaxError, "parameter 'a' of kernel 'kernel' has no type", "ti.f32")
def parameter_without_a_type():
    @ti.kernel
    def kernel(a):  # BAD
        pass


@bad(ti.TaiSyntaxError, "has a type that kernels do not know")
def parameter_of_an_unknown_type():
    @ti.kernel
    def kernel(a: dict):  # BAD
        pass

    kernel({})


@bad(ti.TaiSyntaxError, "cannot have *args")
def variadic_kernel():
    @ti.kernel
    def kernel(*args):  # BAD
        pass


# Fields


@bad(ti.TaiRuntimeError, "field 'z' is not placed", "shape")
def field_without_a_place():
    z = ti.field(ti.f32, name="z")

    @ti.kernel
    def kernel():
        z[0] = 1.0  # BAD

    kernel()


@bad(ti.TaiAutodiffError, "field 'v' has no gradient", "needs_grad")
def gradient_of_a_field_without_one():
    _, _, v, _ = fields()

    @ti.kernel
    def kernel():
        for i in v:
            v.grad[i] = [0.0, 0.0]  # BAD

    kernel()


@bad(ti.TaiRuntimeError, "made before the last ti.init", "after ti.init")
def field_of_an_earlier_program():
    x, _, _, _ = fields()
    x[0] = 1.0
    ti.init(offline_cache=False)

    @ti.kernel
    def kernel():
        for i in x:  # BAD
            x[i] = 1.0

    kernel()
