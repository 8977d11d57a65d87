"""`ti.lang.snode`: nodes of layouts."""

from .._impl.fields.snode import SNode

__all__ = ["SNode"]
