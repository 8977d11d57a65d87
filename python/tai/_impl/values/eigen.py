"""`ti.eig`: eigenvalues and eigenvectors of 2×2 matrices that need not be symmetric."""

from __future__ import annotations

from typing import Any

from ..base import dtypes
from . import ops


def eig(a: Any, dt: Any = None) -> Any:
    """Eigenvalues and eigenvectors of a 2×2 matrix, which may be complex.

    Equal eigenvalues with one eigenvector, as of [[1, 1], [0, 1]], give this vector twice; there
    the derivatives are infinite.

    Args:
        a: a 2×2 matrix of floats.
        dt: the type to compute in; that of `a` if None.

    Returns:
        The eigenvalues as a 2×2 matrix, of which each row holds the real and the imaginary part of
        one, real ones with the greater one first; and the eigenvectors, of norm 1, as the columns
        of a 4×2 matrix: real and imaginary part of the first component, then of the second.
    """
    hint = "use ti.sym_eig for symmetric 3×3 matrices"
    matrix = ops.square_matrix("eig", a, (2,), hint)
    emitter = matrix.emitter
    if dt is not None or not matrix.dt.is_float:
        matrix = emitter.cast(
            matrix, dtypes.to_dtype(dt) if dt is not None else dtypes.default_fp()
        )
    a00, a01, a10, a11 = matrix.scalars()
    zero, one = emitter.constant(0.0, matrix.dt), emitter.constant(1.0, matrix.dt)
    middle, half = 0.5 * (a00 + a11), 0.5 * (a00 - a11)
    square = half * half + a01 * a10
    is_real = square >= 0
    root = ops.sqrt(abs(square))
    real_root, imaginary_root = ops.select(is_real, root, zero), ops.select(is_real, zero, root)

    # Two multiples of a real eigenvector are the rows of A - λ; this takes the one without
    # cancellation.
    far = root + abs(half)
    leans = half >= 0
    first = _choose(leans, [far, a10], [a01, far])
    second = _choose(leans, [a01, -far], [-far, a10])
    # If far = 0, both rows are zero or have one entry, and an axis is an eigenvector.
    apart = far > 0
    axes = [one, zero], [zero, one]
    first = _choose(apart, first, _choose(a10 == 0, *axes))
    second = _choose(apart, second, _choose(a01 != 0, *axes))
    first, second = (_normalized(emitter, parts) for parts in (first, second))

    # The eigenvectors are a pair of complex vectors: (half ± i root, a10).
    pair = _normalized(emitter, [half, root, a10])
    columns = []
    for vector, sign in ((first, 1.0), (second, -1.0)):
        complex_parts = [pair[0], sign * pair[1], pair[2], zero]
        real_parts = [vector[0], zero, vector[1], zero]
        columns.append(_choose(is_real, real_parts, complex_parts))
    values = [middle + real_root, imaginary_root, middle - real_root, zero - imaginary_root]
    vectors = [part for row in zip(*columns, strict=True) for part in row]
    return (
        emitter.matrix(values, matrix.dt, (2, 2)),
        emitter.matrix(vectors, matrix.dt, (4, 2)),
    )


def _choose(condition: Any, these: list[Any], others: list[Any]) -> list[Any]:
    """`ti.select` of each component."""
    return [ops.select(condition, x, y) for x, y in zip(these, others, strict=True)]


def _normalized(emitter: Any, parts: list[Any]) -> list[Any]:
    vector = emitter.vector(parts, parts[0].dt).normalized()
    return vector.scalars()
