"""Many small systems, solved in one launch."""

from __future__ import annotations

import functools
import math
from typing import Any

from ...errors import TaiRuntimeTypeError
from ..base.dtypes import cast, f64
from ..launch.kernels import func, kernel
from ..values.matrix import Vector
from ..values.ops import abs, atomic_max, grouped, max, sqrt, static, zero
from ..values.types import template, vector
from . import recorded
from .operators import Operator, check_alike, check_unknown, scratch
from .recorded import Adjoint
from .report import Caller, SolveInfo
from .system import Progress

inf = math.inf
_THREE = vector(3, f64)
# A pivot that is less than this many rounding units counts as zero; rows and columns are scaled to
# one.
_ROUNDINGS = 4


def solve_batch(A: Any, b: Any, x: Any) -> SolveInfo:
    """Solves A[i] x[i] = b[i] for many small matrices in one launch, by elimination with pivots.

    Gradients pass to A and b. It runs where kernels run.

    Args:
        A: a field of n×n matrices.
        b, x: fields of n-vectors of the same shape: the right-hand sides, and the solutions.

    Returns:
        How it ended; `residual` and `backward_error` are the greatest of all systems. Matrices
        without an inverse give zero, and a `TaiConvergenceWarning`.
    """
    solver = "ti.linalg.solve_batch"
    check_unknown(x, "the solutions", solver)
    check_unknown(b, "the right-hand sides", solver)
    check_alike(b, x, solver)
    check_unknown(A, "the matrices", solver)
    size = x.element_shape
    if len(size) != 1 or (A.shape, A.element_shape, A.dtype) != (x.shape, size * 2, x.dtype):
        raise TaiRuntimeTypeError(
            f"{solver}: matrices of {A.element_shape} {A.dtype} in shape {A.shape} do not fit "
            f"vectors of {size} {x.dtype} in shape {x.shape}",
            "A is ti.Matrix.field(n, n, …), b and x are ti.Vector.field(n, …), of one shape",
        )
    caller = Caller(solver, None, 1, x.dtype.name, has_tangents=True)
    k = _kernels()
    operator = Operator(solver, k.multiply, x, (A,))
    epsilon = 2.0**-52 if x.dtype.name == "f64" else 2.0**-23

    def run(right: Any, field: Any, transposed: bool) -> Progress:
        work = scratch(x, "elimination", columns=size[0])
        singular = k.eliminate(work, A, right, field, _ROUNDINGS * epsilon, transposed)
        residual, error, norm = k.inspect(A, right, field, transposed)
        reason = "singular" if singular else ""
        if not math.isfinite(residual):
            reason = "not finite"
        return Progress(1, residual, reason, error, norm)

    def solve_adjoint(g: Any, adjoint: Any) -> Adjoint:
        return Adjoint(run(g, adjoint, True))

    def solve_tangent(rest: Any, tangent: Any) -> Progress:
        recorded.subtract_from_tangent(b, rest)
        return run(rest, tangent, False)

    return recorded.run(
        caller, operator, lambda field: run(b, field, False), solve_adjoint, -1.0, b, solve_tangent
    )


@functools.cache
def _kernels() -> Any:
    @func
    def place(at, i, j):
        return Vector([*[at[d] for d in static(range(at.n))], i, j])

    class Kernels:
        @staticmethod
        @kernel
        def multiply(p: template(), q: template(), A: template()):
            for at in grouped(q):
                q[at] = A[at] @ p[at]

        @staticmethod
        @kernel
        def eliminate(
            work: template(), A: template(), b: template(), x: template(), least: f64,
            transposed: template(),
        ) -> f64:  # fmt: skip
            singular = cast(0.0, f64)
            for at in grouped(x):
                n = static(x.n)
                matrix, right = A[at], b[at]
                if static(transposed):
                    matrix = matrix.transpose()
                # The last column is the right-hand side. Rows, and then columns, are divided by
                # their greatest number.
                for i in static(range(n)):
                    largest = abs(matrix[i, 0])
                    for j in static(range(1, n)):
                        largest = max(largest, abs(matrix[i, j]))
                    scale = 1.0 / largest if largest > 0 else 1.0 * (largest == largest)
                    for j in static(range(n)):
                        work[place(at, i, j)] = matrix[i, j] * scale
                    work[place(at, i, n)] = right[i] * scale
                columns = zero(right)
                for j in static(range(n)):
                    largest = abs(work[place(at, 0, j)])
                    for i in static(range(1, n)):
                        largest = max(largest, abs(work[place(at, i, j)]))
                    columns[j] = 1.0 / largest if largest > 0 else 1.0 * (largest == largest)
                    for i in static(range(n)):
                        work[place(at, i, j)] *= columns[j]
                is_regular = True
                for c in range(n):
                    pivot, row = cast(-1.0, x.dtype), c
                    for i in range(c, n):
                        if abs(work[place(at, i, c)]) > pivot:
                            pivot, row = abs(work[place(at, i, c)]), i
                    if pivot > least:
                        for j in range(c, n + 1):
                            one, other = work[place(at, c, j)], work[place(at, row, j)]
                            work[place(at, c, j)] = other
                            work[place(at, row, j)] = one
                        for i in range(c + 1, n):
                            factor = work[place(at, i, c)] / work[place(at, c, c)]
                            for j in range(c + 1, n + 1):
                                work[place(at, i, j)] -= factor * work[place(at, c, j)]
                    else:
                        is_regular = False
                result = zero(right)
                if is_regular:
                    for back in range(n):
                        i = n - 1 - back
                        total = work[place(at, i, n)]
                        for j in range(i + 1, n):
                            total -= work[place(at, i, j)] * work[place(at, j, n)]
                        work[place(at, i, n)] = total / work[place(at, i, i)]
                    for i in static(range(n)):
                        result[i] = work[place(at, i, n)] * columns[i]
                else:
                    singular += 1.0
                x[at] = result
            return singular

        @staticmethod
        @kernel
        def inspect(A: template(), b: template(), x: template(), transposed: template()) -> _THREE:
            residual, error, norm = cast(0.0, f64), cast(0.0, f64), cast(0.0, f64)
            for at in grouped(x):
                matrix, right, found = cast(A[at], f64), cast(b[at], f64), cast(x[at], f64)
                if static(transposed):
                    matrix = matrix.transpose()
                rest, size = (right - matrix @ found).norm(), right.norm()
                own = cast(0.0, f64)
                for j in static(range(matrix.m)):
                    column = cast(0.0, f64)
                    for i in static(range(matrix.n)):
                        column += matrix[i, j] * matrix[i, j]
                    own = max(own, sqrt(column))
                atomic_max(norm, own)
                if size > 0:
                    atomic_max(residual, rest / size)
                    atomic_max(error, rest / (own * found.norm() + size))
                if not rest < inf:
                    atomic_max(residual, inf)
            return Vector([residual, error, norm])

    return Kernels
