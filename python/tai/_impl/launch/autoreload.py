"""IPython's `%autoreload`: objects that a program imported from a module loaded again.

It changes the functions and classes that a program holds to those that the module defines now, by
a list of rules for kinds of objects. Kernels and struct types are neither; here are their rules.
"""

from __future__ import annotations

import sys
from typing import Any

from ..fields.structs import StructType

# The name of the class that IPython puts around a method which it compiles alone.
CLASS_OF_A_METHOD = "__autoreload_class__"


def follow() -> None:
    """Adds rules for kernels to those of IPython, if it reloads modules."""
    rules = getattr(sys.modules.get("IPython.extensions.autoreload"), "UPDATE_RULES", None)
    if rules is not None and _RULE not in rules:
        rules.append(_RULE)


def _can_adopt(old: Any, new: Any) -> bool:
    if isinstance(old, StructType) and isinstance(new, StructType):
        # A struct type is taken over only if it has the same members; else fields keep the old
        # type.
        return repr(old) == repr(new)
    return type(old) is type(new) and getattr(old, "_tai_kernel", False) and hasattr(old, "adopt")


_RULE = (_can_adopt, lambda old, new: old.adopt(new))
