"""Conjugate gradients of an assembled sparse matrix; SciPy's."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import TaiRuntimeTypeError
from ..history import origins
from .sparse_matrix import SparseMatrix, as_numpy, get_scipy, like


class SparseCG:
    """Solves A x = b by conjugate gradients, for a sparse matrix that is positive definite.

    Args:
        A: the matrix.
        b: the right-hand side: a field, a `ti.ndarray` or an array of NumPy.
        x0: where it begins; at zero if None.
        max_iter: maximum of iterations.
        atol: bound of ‖b - A x‖.
    """

    def __init__(
        self, A: SparseMatrix, b: Any, x0: Any = None, max_iter: int = 50, atol: float = 1e-6
    ):
        if not isinstance(A, SparseMatrix) or A.n != A.m:
            raise TaiRuntimeTypeError(f"SparseCG takes a square sparse matrix, but got {A!r}")
        self.matrix, self.b, self.x0, self.max_iter, self.atol = A, b, x0, max_iter, atol

    def solve(self) -> tuple[Any, bool]:
        """The solution, as a `ti.ndarray` where b is one, and whether it is within `atol`."""
        _, solvers = get_scipy()
        a = self.matrix.to_scipy().astype(np.float64)
        b = as_numpy(self.b).astype(np.float64)
        x0 = None if self.x0 is None else as_numpy(self.x0).astype(np.float64)
        x, ended = solvers.cg(a, b, x0, rtol=0.0, atol=self.atol, maxiter=self.max_iter)
        result = like(self.b, x.astype(self.matrix.dtype.numpy))
        return origins.note_computed(result, self.matrix, self.b, self.x0), ended == 0
