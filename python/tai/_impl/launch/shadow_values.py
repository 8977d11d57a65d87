"""Values with the digits of their shadows: `ti.tools.shadow_values`."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from ...errors import TaiRuntimeTypeError
from ..base.shadows import context
from ..values.ops import grouped
from ..values.types import ndarray, template
from .kernels import kernel


@functools.cache
def _copier() -> Any:
    @kernel
    def copy(source: template(), to: ndarray()) -> None:  # type: ignore
        for at in grouped(source):
            to[at] = source[at]

    return copy


def shadow_values(field: Any) -> np.ndarray:
    """The values of a dense field with the digits of its shadows.

    The array is of f64 for a field of f32, and of `np.longdouble` for one of f64. An element that
    a kernel did not store last has the digits of its own type.

    Raises:
        TaiRuntimeError: the context has no shadows.
        TaiRuntimeTypeError: the field is not of f32 or f64.
    """
    shadows = context()
    plain = field.to_numpy()
    if plain.dtype not in (np.float32, np.float64):
        raise TaiRuntimeTypeError(
            f"fields of f32 and f64 have shadows in memory, but got one of {plain.dtype}"
        )
    wide = plain.astype(np.float64 if plain.dtype == np.float32 else np.longdouble)
    element = wide.shape[len(field.shape) :]
    for part in np.ndindex(element):
        own = field.get_scalar_field(*part) if element else field
        # A copy by a kernel also copies the shadow values of the floats.
        copied = np.zeros(field.shape, plain.dtype)
        _copier()(own, copied)
        errors = np.zeros(field.shape)
        shadows.shadow_errors(copied, errors)
        wide[(..., *part)] += errors
    return wide
