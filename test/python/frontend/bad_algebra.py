"""Programs with wrong vectors, matrices and operators; see bad_expressions.py."""

# ruff: noqa: B018, F821, F841, E712, SIM102, RET503, B007, B011, E711, A001, F632, E713, E714

import tai as ti

from bad_register import bad, fields

# Vectors and matrices


@bad(
    ti.TaiTypeError,
    "cross product of a vector of 4 f32: it takes 2 or 3 components",
    "both need the same number of components",
)
def cross_of_four():
    @ti.kernel
    def kernel() -> ti.f32:
        a = ti.Vector([1.0, 2.0, 3.0, 4.0])
        return a.cross(a)[0]  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "cross product of a vector of 3 f32 and a f32",
    "both need the same number of components",
)
def cross_of_a_number():
    @ti.kernel
    def kernel() -> ti.f32:
        a = ti.Vector([1.0, 2.0, 3.0])
        return a.cross(1.0)[0]  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "the outer product takes two vectors",
    "a column times a row: v.outer_product(w), of two ti.Vector",
)
def outer_product_of_a_matrix():
    _, _, _, m = fields()

    @ti.kernel
    def kernel():
        for i in m:
            m[i] = m[i].outer_product(m[i])  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "the determinant needs a square matrix, but got a vector of 2 f32",
    "a matrix has as many rows as columns then",
)
def determinant_of_a_vector():
    _, _, v, _ = fields()

    @ti.kernel
    def kernel() -> ti.f32:
        return v[0].determinant()  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "the trace needs a square matrix, but got a vector of 2 f32",
    "a matrix has as many rows as columns then",
)
def trace_of_a_vector():
    _, _, v, _ = fields()

    @ti.kernel
    def kernel() -> ti.f32:
        return v[0].trace()  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "the determinant of a 9×9 matrix of f32: at most 4×4",
    "solve larger systems in Python, or by iterations of a kernel",
)
def determinant_of_a_large_matrix():
    @ti.kernel
    def kernel() -> ti.f32:
        return ti.Matrix.identity(ti.f32, 9).determinant()  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "ti.svd takes a 2×2 or 3×3 matrix, but got a vector of 2 f32",
    "make it by ti.Matrix([[…], […]])",
)
def svd_of_a_vector():
    _, _, v, _ = fields()

    @ti.kernel
    def kernel():
        u, s, w = ti.svd(v[0])  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "ti.sym_eig takes a 2×2 or 3×3 matrix, but got a 2×3 matrix of f32",
    "make it by ti.Matrix([[…], […]])",
)
def eigenvalues_of_a_rectangle():
    @ti.kernel
    def kernel():
        a = ti.Matrix([[1.0, 2.0, 3.0], [1.0, 2.0, 3.0]])
        e, w = ti.sym_eig(a)  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "solve takes a square matrix and a vector",
    "a matrix has as many rows as columns then",
)
def solve_of_wrong_sizes():
    @ti.kernel
    def kernel() -> ti.f32:
        a = ti.Matrix([[1.0, 0.0], [0.0, 1.0]])
        return ti.solve(a, ti.Vector([1.0, 2.0, 3.0]))[0]  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "a matrix is made of a list of numbers, but got an empty list",
    "write ti.Vector([a, b]) or ti.Matrix([[a, b], [c, d]])",
)
def empty_vector():
    @ti.kernel
    def kernel():
        a = ti.Vector([])  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "a matrix is made of a list of numbers, but got float",
    "write ti.Vector([a, b]) or ti.Matrix([[a, b], [c, d]])",
)
def vector_of_a_number():
    @ti.kernel
    def kernel():
        a = ti.Vector(3.0)  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "'a' stands where a number is needed",
    "kernels compute with numbers; text is for print and assert",
)
def vector_of_strings():
    @ti.kernel
    def kernel():
        a = ti.Vector(["a", "b"])  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "the rows of a matrix have different lengths",
    "each row must hold the same number of components",
)
def matrix_of_vectors_and_numbers():
    @ti.kernel
    def kernel():
        a = ti.Matrix([[1.0, 2.0], 3.0])  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "a value that is known only when the kernel runs stands where Python needs a number",
    "ti.static needs values that are known when the kernel is compiled",
)
def size_that_is_not_constant():
    @ti.kernel
    def kernel(n: ti.i32):
        a = ti.Vector.zero(ti.f32, n)  # BAD

    kernel(3)


@bad(
    ti.TaiIndexError,
    "index -1 is out of range: a vector of 2 f32 has 2 components here",
    "indices count from 0; negative ones have no meaning",
)
def negative_component():
    _, _, v, _ = fields()

    @ti.kernel
    def kernel() -> ti.f32:
        return v[0][-1]  # BAD

    kernel()


@bad(ti.TaiTypeError, "an index must be a whole number, but got float", "convert it: int(…)")
def component_by_a_float():
    _, _, v, _ = fields()

    @ti.kernel
    def kernel() -> ti.f32:
        return v[0][0.5]  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "a vector of 2 f32 has no attribute 'xg'",
    "components are .x, .y, .z, .w, or v[0]",
)
def swizzle_of_mixed_letters():
    _, _, v, _ = fields()

    @ti.kernel
    def kernel() -> ti.f32:
        return v[0].xg[0]  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "a vector of 3 f32 cannot be stored in a vector of 2 f32",
    "make a vector of that shape",
)
def swizzle_that_takes_too_many_values():
    _, _, v, _ = fields()

    @ti.kernel
    def kernel():
        v[0].xy = ti.Vector([1.0, 2.0, 3.0])  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "a 2×2 matrix of f32 and a vector of 3 f32 cannot be multiplied by '@'",
    "the columns of the left one must be as many as the rows of the right one",
)
def matrix_times_a_long_vector():
    _, _, _, m = fields()

    @ti.kernel
    def kernel() -> ti.f32:
        return (m[0] @ ti.Vector([1.0, 2.0, 3.0]))[0]  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "a 2×2 matrix of f32 and a vector of 2 f32 do not go together",
    "both must have one shape; '@' multiplies matrices",
)
def sum_of_a_matrix_and_a_vector():
    _, _, v, m = fields()

    @ti.kernel
    def kernel():
        a = m[0] + v[0]  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "the branches give a vector of 2 f32 and a vector of 3 f32",
    "give both branches one shape",
)
def choice_of_different_shapes():
    _, _, v, _ = fields()

    @ti.kernel
    def kernel(n: ti.i32):
        a = v[0] if n > 0 else ti.Vector([1.0, 2.0, 3.0])  # BAD

    kernel(1)


@bad(
    ti.TaiTypeError,
    "the rows of a matrix have different lengths",
    "each row must hold the same number of components",
)
def rows_of_different_vectors():
    @ti.kernel
    def kernel():
        a = ti.Matrix.rows([ti.Vector([1.0, 2.0]), ti.Vector([1.0])])  # BAD

    kernel()


@bad(ti.TaiIndexError, "field 'x' takes 1 index, but got 2", "write x[i]")
def whole_vector_as_an_index():
    x, _, v, _ = fields()

    @ti.kernel
    def kernel():
        x[v[0]] = 1.0  # BAD

    kernel()


# Operators


@bad(ti.TaiTypeError, "'<<' takes whole numbers, but got f32", "convert it: int(…)")
def shift_of_a_float():
    @ti.kernel
    def kernel(a: ti.f32) -> ti.f32:
        return a << 1  # BAD

    kernel(1.0)


@bad(ti.TaiTypeError, "'<<' takes whole numbers, but got f32", "convert it: int(…)")
def shift_by_a_float():
    @ti.kernel
    def kernel(a: ti.i32) -> ti.i32:
        return a << 1.5  # BAD

    kernel(1)


@bad(ti.TaiTypeError, "'<<' by 40, but the i32 has 32 bits", "convert it first: ti.i64(x) << 40")
def shift_by_too_much():
    @ti.kernel
    def kernel(a: ti.i32) -> ti.i32:
        return a << 40  # BAD

    kernel(1)


@bad(ti.TaiTypeError, "'~' takes whole numbers, but got f32", "convert it: int(…)")
def inversion_of_a_float():
    @ti.kernel
    def kernel(a: ti.f32) -> ti.f32:
        return ~a  # BAD

    kernel(1.0)


@bad(
    ti.TaiTypeError,
    "field 'x' cannot be iterated at compile time",
    "loop over it at the top of a kernel: for i in x",
)
def membership_in_a_field():
    x, _, _, _ = fields()

    @ti.kernel
    def kernel(a: ti.f32):
        if a in x:  # BAD
            pass

    kernel(1.0)


@bad(ti.TaiTypeError, "'is' compares Python objects, not values", "use == or !=")
def identity_of_numbers():
    @ti.kernel
    def kernel(a: ti.f32, b: ti.f32):
        if a is b:  # BAD
            pass

    kernel(1.0, 2.0)


@bad(ti.TaiTypeError, "'one' stands where a number is needed", 'to print it: print(f"… {x}")')
def comparison_with_a_string():
    @ti.kernel
    def kernel(a: ti.f32):
        if a == "one":  # BAD
            pass

    kernel(1.0)


@bad(ti.TaiTypeError, "'a' stands where a number is needed", 'to print it: print(f"… {x}")')
def addition_to_a_string():
    @ti.kernel
    def kernel(a: ti.f32):
        b = "a" + a  # BAD

    kernel(1.0)


@bad(
    ti.TaiTypeError,
    "a list is repeated a number of times that is known only when the kernel runs",
    "to multiply each component, write ti.Vector([…]) * n",
)
def list_that_is_repeated_at_run_time():
    @ti.kernel
    def kernel(n: ti.i32):
        b = [1.0, 2.0] * n  # BAD

    kernel(3)


@bad(
    ti.TaiTypeError,
    "a f32 and a f32 cannot be multiplied by '@'",
    "the columns of the left one must be as many as the rows of the right one",
)
def matrix_product_of_numbers():
    @ti.kernel
    def kernel(a: ti.f32):
        b = a @ a  # BAD

    kernel(1.0)


@bad(
    ti.TaiTypeError,
    "fill takes one number, but got a vector of 2 f32",
    "assign it: v = …",
)
def fill_with_a_vector():
    @ti.kernel
    def kernel():
        v = ti.Vector([1.0, 2.0])
        v.fill(v)  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "fill() missing 1 required positional argument: 'value'",
    "help(fill) says what it takes",
)
def fill_with_nothing():
    @ti.kernel
    def kernel():
        v = ti.Vector([1.0, 2.0])
        v.fill()  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "a vector of 2 f32 without a place cannot be filled",
    "give it a name: b = …; b.fill(…)",
)
def fill_of_a_sum():
    @ti.kernel
    def kernel():
        v = ti.Vector([1.0, 2.0])
        (v + 1).fill(0)  # BAD

    kernel()


@bad(
    ti.TaiSyntaxError,
    "a vector or matrix from outside the kernel is a constant in it",
    "copy it first: v = …; v.fill(…)",
)
def fill_of_a_constant():
    gravity = ti.Vector([0.0, -9.8])

    @ti.kernel
    def kernel():
        gravity.fill(0)  # BAD

    kernel()
