"""`ti.lang.snode`: nodes of layouts."""

from ..snode import SNode

__all__ = ["SNode"]
