"""SciPy, which the package imports where it is used."""

from __future__ import annotations

from typing import Any

from ...errors import TaiRuntimeError


def get_scipy(user: str = "sparse matrices need", instead: str = "") -> tuple[Any, Any]:
    """Returns SciPy's modules of sparse matrices and of their solvers.

    Args:
        user: begins the message where SciPy is missing.
        instead: names a way without it.

    Raises:
        TaiRuntimeError: SciPy is not installed.
    """
    try:
        import scipy.sparse
        import scipy.sparse.linalg
    except ImportError:
        raise TaiRuntimeError(
            f"{user} SciPy, which is not installed",
            "pip install scipy" + (f", or {instead}" if instead else ""),
        ) from None
    return scipy.sparse, scipy.sparse.linalg
