"""`ti.lang.matrix`."""

from ..matrix import Matrix, Vector

__all__ = ["Matrix", "Vector"]
