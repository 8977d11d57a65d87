"""Values that a tape or forward mode follows: fields, numbers and arrays that depend on them."""

from __future__ import annotations

from typing import Any

from ..base import state
from ..base.elements import Elements
from . import marks


def has_history(field: Any) -> bool:
    """Whether the values of a field or `ti.ndarray` have a gradient in the tape, or a tangent in
    forward mode."""
    if hasattr(field, "array"):
        return field.grad is not None and state.tape is not None
    if getattr(field, "role", None) != "primal" or not field.dtype.is_float:
        return False
    which = "grad" if state.tape is not None else "dual"
    companion = field._companions.get(which)
    return companion is not None and companion.level is not None and not _is_internal(field)


def _leaves_of(field: Any) -> list[Any]:
    """Returns the field as a list, or the fields of all members of a struct."""
    members = getattr(field, "members", None)
    if members is None:
        return [field]
    return [leaf for member in members.values() for leaf in _leaves_of(member)]


def _is_internal(field: Any) -> bool:
    program = state.program
    return program is not None and any(pool.field is field for pool in program.pools)


def carries_history(value: Any) -> bool:
    """Whether numbers that Python reads from a value depend on values with a gradient."""
    if is_followed(value):
        return True
    if isinstance(value, Elements) and any(map(has_history, _leaves_of(value))):
        return True
    return not marks.is_empty() and is_marked(value)


def is_marked(value: Any) -> bool:
    if marks.mark_of(value) is not None:
        return True
    field = marks.field_behind(value)
    return field is not None and has_history(field)


def is_followed(value: Any) -> bool:
    """Whether kernels see the value as one with a gradient or a tangent."""
    return (
        getattr(value, "_gradient", None) is not None or getattr(value, "_cell", None) is not None
    )
