"""Copies between fields and arrays as kernels, recorded by tapes and forward mode.

Outside of both the host copies, which needs no compiled code per pair of fields.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import TaiRuntimeTypeError
from ..base import state
from ..history import origins

# A function that returns the kernels for differentiated copies; module `ad.library` sets this
# variable when it is loaded.
get_kernels: Any = None


def is_followed(*values: Any) -> bool:
    """Whether a copy between these values must be differentiated or recorded."""
    if state.tape is None and not state.forward:
        return False
    return all(getattr(value, "role", "primal") == "primal" for value in values)


def check_shapes(target: Any, source: Any) -> None:
    """Refuses a copy between fields that do not have the same elements."""
    given = tuple(source.shape) + tuple(source.element_shape)
    wanted = tuple(target.shape) + tuple(target.element_shape)
    if given != wanted:
        raise TaiRuntimeTypeError(
            f"field '{target.name}' expects an array of shape {wanted}, but field "
            f"'{source.name}' has {given}",
            "copy_from takes a field of the same shape",
        )


def copy_field(target: Any, source: Any) -> None:
    """Copies a scalar, vector or matrix field to another field."""
    check_shapes(target, source)
    for field in (target, source):
        _materialize(field)
    if not target.shape:
        get_kernels().copy_number(target, source, target.dtype)
        return
    # Offsets belong to the program's indices; elements are counted from the first one.
    shift = tuple(s - t for s, t in zip(_offset(source), _offset(target), strict=True))
    if _is_sparse(target):
        # If the target is inactive where the source is not zero, its cells become active.
        back = tuple(-s for s in shift)
        is_number = not target.element_shape
        get_kernels().activate_by(target, source, target.dtype, is_number, back, any(shift))
    get_kernels().copy_elements(target, source, target.dtype, shift, any(shift))


def copy_array(target: Any, source: Any) -> None:
    """Copies a `ti.ndarray`, or a field, to a `ti.ndarray`."""
    is_field = not hasattr(source, "array")
    if is_field:
        _materialize(source)
    if not target.shape:
        (get_kernels().number_to_array if is_field else get_kernels().array_number)(target, source)
    elif is_field:
        shift = _offset(source)
        get_kernels().field_to_array(target, source, shift, any(shift))
    else:
        get_kernels().array_elements(target, source)


def store_component(target: Any, value: Any) -> bool:
    """Stores numbers of Python to a component of a vector field, and only there.

    Returns:
        False if the copy is not followed: the whole field may be written.
    """
    if not is_followed(target) or not target.dtype.is_float:
        return False
    origins.check_write(target, value)
    _materialize(target)
    if np.ndim(value) == 0 or not target.shape:
        number = float(np.asarray(value).item())
        (get_kernels().fill_elements if target.shape else get_kernels().fill_number)(target, number)
    else:
        get_kernels().array_to_field(target, np.array(value), _offset(target))
    return True


def _materialize(field: Any) -> None:
    (field._whole if getattr(field, "is_window", False) else field).materialize()


def _offset(field: Any) -> tuple[int, ...]:
    return tuple(field.offset or (0,) * len(field.shape))


def _is_sparse(field: Any) -> bool:
    return field.level.nearest_sparse() is not None
