"""`ti.lang.matrix`."""

from .._impl.values.matrix import Matrix, Vector

__all__ = ["Matrix", "Vector"]
