"""Incomplete Cholesky factors, IC(0), by kernels of one thread."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from ...errors import TaiRuntimeError, TaiRuntimeTypeError
from ..base.dtypes import cast, f64, i32
from ..launch.kernels import kernel
from ..values import types
from ..values.ops import loop_config, sqrt
from ..values.types import template

_REALS, _WHOLES = types.ndarray(dtype=f64, ndim=1), types.ndarray(dtype=i32, ndim=1)
# The first part of the diagonal that is added where a pivot is not positive, and how often it is
# doubled before the matrix is refused.
_FIRST_SHIFT = 1e-3
_SHIFTS = 12


@functools.cache
def _kernels() -> Any:
    class Kernels:
        @staticmethod
        @kernel
        def factorize(
            starts: _WHOLES, columns: _WHOLES, values: _REALS, factor: _REALS, shift: f64, n: i32
        ) -> i32:
            # Rows of the lower triangle, each with its diagonal at the end.
            failed = -1
            loop_config(serialize=True)
            for i in range(n):
                if failed < 0:
                    end = starts[i + 1] - 1
                    for k in range(starts[i], end):
                        j = columns[k]
                        total = values[k]
                        one, other = starts[i], starts[j]
                        while one < k and other < starts[j + 1] - 1:
                            if columns[one] == columns[other]:
                                total -= factor[one] * factor[other]
                                one += 1
                                other += 1
                            elif columns[one] < columns[other]:
                                one += 1
                            else:
                                other += 1
                        factor[k] = total / factor[starts[j + 1] - 1]
                    pivot = values[end] * (1 + shift)
                    for k in range(starts[i], end):
                        pivot -= factor[k] * factor[k]
                    if pivot > 1e-14 * values[end]:
                        factor[end] = sqrt(pivot)
                    else:
                        failed = i
            return failed

        @staticmethod
        @kernel
        def solve(
            starts: _WHOLES, columns: _WHOLES, factor: _REALS, r: template(), z: template(),
            y: _REALS, n: i32, low: i32,
        ):  # fmt: skip
            loop_config(serialize=True)
            for i in range(n):
                total = cast(r[i + low], f64)
                for k in range(starts[i], starts[i + 1] - 1):
                    total -= factor[k] * y[columns[k]]
                y[i] = total / factor[starts[i + 1] - 1]
            loop_config(serialize=True)
            for back in range(n):
                i = n - 1 - back
                value = y[i] / factor[starts[i + 1] - 1]
                z[i + low] = cast(value, z.dtype)
                for k in range(starts[i], starts[i + 1] - 1):
                    y[columns[k]] -= factor[k] * value

    return Kernels


class Factors:
    """L of A ≈ L Lᵀ, where A is symmetric positive definite and L has its pattern.

    Args:
        matrix: an array of `scipy.sparse`.
        solver: the name that errors call it by.

    Raises:
        TaiRuntimeTypeError: the matrix is not square, not symmetric, or not finite.
        TaiRuntimeError: no pivots are positive even with a greater diagonal.
    """

    def __init__(self, matrix: Any, solver: str):
        n, columns = matrix.shape
        if n != columns:
            raise TaiRuntimeTypeError(f"{solver} takes a square matrix, but got {n}×{columns}")
        a = matrix.astype(np.float64).tocsr()
        a.sum_duplicates()
        if not np.isfinite(a.data).all():
            raise TaiRuntimeTypeError(f"{solver}: the matrix holds NaN or infinity")
        if a.nnz and abs(a - a.T).max() > 1e-5 * max(abs(a).max(), 1e-300):
            raise TaiRuntimeTypeError(
                f"{solver} takes a symmetric matrix", "ti.linalg.Jacobi is for others"
            )
        diagonal = a.diagonal()
        if (diagonal <= 0).any():
            at = int(np.flatnonzero(diagonal <= 0)[0])
            raise TaiRuntimeError(
                f"{solver}: the matrix is not positive definite: element [{at}, {at}] is "
                f"{diagonal[at]:g}",
                "ti.linalg.minres and gmres take a ti.linalg.Jacobi",
            )
        whole = a.tocoo()
        rows, cols = whole.coords
        below = rows >= cols
        from scipy.sparse import coo_array

        lower = coo_array((whole.data[below], (rows[below], cols[below])), a.shape).tocsr()
        lower.sort_indices()
        self.size = n
        self._starts = lower.indptr.astype(np.int32)
        self._columns = lower.indices.astype(np.int32)
        self._factor = np.zeros(len(lower.data))
        self._between = np.zeros(n)
        self.shift = 0.0
        for _ in range(_SHIFTS + 1):
            failed = _kernels().factorize(
                self._starts, self._columns, lower.data, self._factor, self.shift, n
            )
            if failed < 0:
                return
            self.shift = 2 * self.shift or _FIRST_SHIFT
        raise TaiRuntimeError(
            f"{solver}: the matrix is not positive definite: pivot {failed} stays below zero with "
            f"a diagonal {self.shift:.2g} times greater",
            "ti.linalg.minres takes indefinite matrices, and a ti.linalg.Jacobi",
        )

    def solve(self, r: Any, z: Any) -> None:
        """Computes z = (L Lᵀ)⁻¹ r for fields of numbers."""
        low = (getattr(r, "offset", ()) or (0,))[0]
        _kernels().solve(
            self._starts, self._columns, self._factor, r, z, self._between, self.size, int(low)
        )
