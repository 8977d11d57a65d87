"""Preconditioners: z ≈ A⁻¹ r, which change how fast a method converges, and never the solution."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...errors import TaiRuntimeError, TaiRuntimeTypeError
from ..base import state
from ..base.program import get_program
from ..fields.field import Field
from ..fields.make import make_field
from ..launch.bound_kernel import BoundKernel
from ..launch.kernels import Kernel
from .factors import Factors
from .operators import check_alike, check_unknown
from .sparse_matrix import SparseMatrix
from .vectors import get_kernels

Apply = Callable[[Any, Any], None]


class Preconditioner:
    """Base of preconditioners, which compute z ≈ A⁻¹ r for fields r and z."""

    def bind(self, solver: str, x: Any, transposed: bool) -> Apply:
        """Returns the function that applies the preconditioner, or its transpose, to fields like x.

        Raises:
            TaiRuntimeTypeError: it is of another shape.
        """
        raise NotImplementedError


class Jacobi(Preconditioner):
    """The Jacobi preconditioner: division by the diagonal of A.

    Args:
        diagonal: a field like the solution. Where it is zero, nothing is divided.
    """

    def __init__(self, diagonal: Any):
        check_unknown(diagonal, "the diagonal", "ti.linalg.Jacobi")
        self.diagonal = diagonal

    def bind(self, solver: str, x: Any, transposed: bool) -> Apply:
        check_alike(self.diagonal, x, solver)
        return lambda r, z: get_kernels().divide(z, r, self.diagonal)


class BlockJacobi(Preconditioner):
    """Products with the inverses of the blocks on the diagonal of A, one for each vector.

    Args:
        blocks: a field of n×n matrices in the shape of the solution, a field of n-vectors. They
            are inverted when the preconditioner is made, on the host; one without an inverse is
            replaced by its pseudo-inverse.
    """

    def __init__(self, blocks: Any):
        shape: tuple[int, ...] = getattr(blocks, "element_shape", ())
        if not isinstance(blocks, Field) or len(shape) != 2 or shape[0] != shape[1]:
            raise TaiRuntimeTypeError(
                f"ti.linalg.BlockJacobi takes a field of square matrices, but got {blocks!r}"
            )
        check_unknown(blocks, "the blocks", "ti.linalg.BlockJacobi")
        values = blocks.to_numpy().astype(np.float64).reshape(*blocks.shape, *shape)
        if not np.isfinite(values).all():
            raise TaiRuntimeTypeError(
                f"ti.linalg.BlockJacobi: field '{blocks.name}' holds NaN or infinity"
            )
        offset = tuple(getattr(blocks, "offset", ()) or ())
        made: Any = make_field(
            shape, blocks.dtype, blocks.shape, None, "inverse_blocks",
            offset if any(offset) else None, False, False,
        )  # fmt: skip
        made.from_numpy(np.linalg.pinv(values).astype(blocks.dtype.numpy))
        self._inverses = made

    def bind(self, solver: str, x: Any, transposed: bool) -> Apply:
        inverses = self._inverses
        size = inverses.element_shape[0]
        wanted = (inverses.shape, (size,), inverses.dtype)
        if (x.shape, x.element_shape, x.dtype) != wanted:
            raise TaiRuntimeTypeError(
                f"{solver}: blocks of {size}×{size} {inverses.dtype} in shape {inverses.shape} "
                f"are for vectors of {size} in that shape, but field '{x.name}' is "
                f"{x.shape} of {x.element_shape} {x.dtype}"
            )
        return lambda r, z: get_kernels().multiply(z, inverses, r, transposed)


class IncompleteCholesky(Preconditioner):
    """The factor of A ≈ L Lᵀ with the pattern of A, IC(0), for symmetric positive definite A.

    Where a pivot is not positive, the factorisation begins again with a greater diagonal. It is
    made, and applied, by one thread of the CPU.

    Args:
        matrix: a `ti.linalg.SparseMatrix`, or an `AssembledMatrix` of numbers with the values
            that it has now.

    Raises:
        TaiRuntimeError: the program runs on a GPU, or the matrix is not positive definite.
    """

    def __init__(self, matrix: Any):
        solver = "ti.linalg.IncompleteCholesky"
        get_program()
        if state.options.arch == "cuda":
            raise TaiRuntimeError(
                f"{solver} is there on the CPU only", "ti.linalg.Jacobi runs on a GPU"
            )
        if not isinstance(matrix, SparseMatrix) and not hasattr(matrix, "to_scipy"):
            raise TaiRuntimeTypeError(f"{solver} takes a sparse matrix, but got {matrix!r}")
        self._factors = Factors(matrix.to_scipy(), solver)

    def bind(self, solver: str, x: Any, transposed: bool) -> Apply:
        if x.shape != (self._factors.size,) or x.element_shape:
            raise TaiRuntimeTypeError(
                f"{solver}: an incomplete factor of {self._factors.size} rows is for a field of "
                f"as many numbers, but field '{x.name}' is {x.shape} of {x.element_shape}"
            )
        return self._factors.solve


class _Hook(Preconditioner):
    """A kernel or function of two fields, such as a cycle of multigrid."""

    def __init__(self, apply: Any):
        self._apply = apply

    def bind(self, solver: str, x: Any, transposed: bool) -> Apply:
        return self._apply


def bind(solver: str, given: Any, x: Any, transposed: bool = False) -> Apply | None:
    """Returns the function that the argument `preconditioner` of a solver stands for.

    Raises:
        TaiRuntimeTypeError: it is none.
    """
    if given is None:
        return None
    if isinstance(given, (Kernel, BoundKernel)) or (
        callable(given) and not isinstance(given, type)
    ):
        given = _Hook(given)
    if not isinstance(given, Preconditioner):
        raise TaiRuntimeTypeError(
            f"{solver}: a preconditioner is a kernel or function `apply(r, z)`, or one of "
            f"ti.linalg.Jacobi, BlockJacobi and IncompleteCholesky, but got {given!r}"
        )
    return given.bind(solver, x, transposed)
