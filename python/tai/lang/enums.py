"""`ti.lang.enums`: names of modes and kinds that programs compare with."""

from enum import Enum

from .._impl.fields.snode import Layout


class AutodiffMode(Enum):
    """The way in which a kernel takes part in differentiation."""

    NONE = 0
    VALIDATION = 1
    FORWARD = 2
    REVERSE = 3


class SNodeGradType(Enum):
    """The contents of a place in a tree: values, or derivatives."""

    PRIMAL = 0
    ADJOINT = 1
    DUAL = 2
    ADJOINT_CHECKBIT = 3


__all__ = ["AutodiffMode", "Layout", "SNodeGradType"]
