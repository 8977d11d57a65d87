"""Copies between fields and arrays as kernels, which tapes and forward mode see.

Elsewhere the host copies: that needs no code for each pair of fields.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from ...errors import TaiRuntimeTypeError
from ..base import state


def is_followed(*values: Any) -> bool:
    """Whether a copy between these is a step of what is differentiated or recorded."""
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
    """Copies a scalar, vector or matrix field."""
    check_shapes(target, source)
    for field in (target, source):
        _materialize(field)
    kernels = _kernels()
    if not target.shape:
        kernels.copy_number(target, source, target.dtype)
        return
    # Offsets are of the program; elements are counted from the first.
    shift = tuple(s - t for s, t in zip(_offset(source), _offset(target), strict=True))
    if _is_sparse(target):
        # Where the target is inactive, cells become active that get something else than zero.
        back = tuple(-s for s in shift)
        is_number = not target.element_shape
        kernels.activate_by(target, source, target.dtype, is_number, back, any(shift))
    kernels.copy_elements(target, source, target.dtype, shift, any(shift))


def copy_array(target: Any, source: Any) -> None:
    """Copies a `ti.ndarray`, or a field, into a `ti.ndarray`."""
    kernels = _kernels()
    is_field = not hasattr(source, "array")
    if is_field:
        _materialize(source)
    if not target.shape:
        (kernels.number_to_array if is_field else kernels.array_number)(target, source)
    elif is_field:
        shift = _offset(source)
        kernels.field_to_array(target, source, shift, any(shift))
    else:
        kernels.array_elements(target, source)


def store_component(target: Any, value: Any) -> bool:
    """Stores numbers of Python to a component of a vector field, and only there.

    Returns:
        False where nobody follows: the whole field may be written.
    """
    if not is_followed(target) or not target.dtype.is_float:
        return False
    from ..history.origins import check_write

    check_write(target, value)
    _materialize(target)
    if np.ndim(value) == 0 or not target.shape:
        kernels = _kernels()
        number = float(np.asarray(value).item())
        (kernels.fill_elements if target.shape else kernels.fill_number)(target, number)
    else:
        _kernels().array_to_field(target, np.array(value), _offset(target))
    return True


def _materialize(field: Any) -> None:
    (field._whole if getattr(field, "is_window", False) else field).materialize()


def _offset(field: Any) -> tuple[int, ...]:
    return tuple(field.offset or (0,) * len(field.shape))


def _is_sparse(field: Any) -> bool:
    return field.level.nearest_sparse() is not None


@functools.cache
def _kernels() -> Any:
    import tai as ti

    class Kernels:
        @staticmethod
        @ti.kernel
        def copy_number(target: ti.template(), source: ti.template(), dtype: ti.template()):
            target[None] = ti.cast(source[None], dtype)

        @staticmethod
        @ti.kernel
        def copy_elements(
            target: ti.template(), source: ti.template(), dtype: ti.template(),
            shift: ti.template(), is_shifted: ti.template(),
        ):  # fmt: skip
            for at in ti.grouped(target):
                if ti.static(is_shifted):
                    target[at] = ti.cast(source[at + ti.Vector(shift)], dtype)
                else:
                    target[at] = ti.cast(source[at], dtype)

        @staticmethod
        @ti.kernel
        def activate_by(
            target: ti.template(), source: ti.template(), dtype: ti.template(),
            is_number: ti.template(), shift: ti.template(), is_shifted: ti.template(),
        ):  # fmt: skip
            for at in ti.grouped(source):
                value = ti.cast(source[at], dtype)
                found = False
                if ti.static(is_number):
                    found = value != 0
                else:
                    found = (value != 0).any()
                if found:
                    if ti.static(is_shifted):
                        target[at + ti.Vector(shift)] = value
                    else:
                        target[at] = value

        @staticmethod
        @ti.kernel
        def fill_number(target: ti.template(), value: ti.f64):
            target[None] = ti.cast(value, ti.f64)

        @staticmethod
        @ti.kernel
        def fill_elements(target: ti.template(), value: ti.f64):
            for at in ti.grouped(target):
                target[at] = value

        @staticmethod
        @ti.kernel
        def array_to_field(
            target: ti.template(), source: ti.types.ndarray(), offset: ti.template()
        ):
            for at in ti.grouped(target):
                target[at] = source[at - ti.Vector(offset)]

        @staticmethod
        @ti.kernel
        def array_number(target: ti.types.ndarray(), source: ti.types.ndarray()):
            target[None] = ti.cast(source[None], target.dtype)

        @staticmethod
        @ti.kernel
        def array_elements(target: ti.types.ndarray(), source: ti.types.ndarray()):
            for at in ti.grouped(ti.ndrange(*target.shape)):
                target[at] = ti.cast(source[at], target.dtype)

        @staticmethod
        @ti.kernel
        def number_to_array(target: ti.types.ndarray(), source: ti.template()):
            target[None] = ti.cast(source[None], target.dtype)

        @staticmethod
        @ti.kernel
        def field_to_array(
            target: ti.types.ndarray(), source: ti.template(), shift: ti.template(),
            is_shifted: ti.template(),
        ):  # fmt: skip
            for at in ti.grouped(ti.ndrange(*target.shape)):
                if ti.static(is_shifted):
                    target[at] = ti.cast(source[at + ti.Vector(shift)], target.dtype)
                else:
                    target[at] = ti.cast(source[at], target.dtype)

    return Kernels
