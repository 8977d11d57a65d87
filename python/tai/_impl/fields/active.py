"""Fields below sparse levels: their active elements, and fills of those only."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import TaiRuntimeTypeError
from ..base import fitting, state
from ..history import origins


def active_elements(field: Any) -> np.ndarray | None:
    """The indices of the elements in active cells, one row for each; None if all are."""
    level = field.level
    sparse = level.nearest_sparse()
    if sparse is None:
        return None
    cells = sparse.active_cells()
    extents, own = level.axis_extents(), sparse.axis_extents()
    spans = [extent // own.get(axis, 1) for axis, extent in extents.items()]
    first = np.zeros((len(cells), len(spans)), np.int64)
    for column, axis in enumerate(own):
        dimension = list(extents).index(axis)
        first[:, dimension] = cells[:, column] * spans[dimension]
    inside = np.indices(spans).reshape(len(spans), -1).T
    found = (first[:, None, :] + inside[None, :, :]).reshape(-1, len(spans))
    return np.ascontiguousarray(found + np.array(field.offset or (0,) * len(spans)))


def write_elements(place: Any, where: np.ndarray, values: np.ndarray) -> None:
    """Writes some elements from Python. In forward mode, their tangents become zero."""
    place.core.write_elements(where, values)
    dual = origins.dual_of_written(place) if state.forward else None
    if dual is not None:
        dual.write_elements(where, np.zeros_like(values))


def fill_component(field: Any, component: int, value: Any) -> bool:
    """Fills a component of a vector field in active cells; returns False if the field is not
    sparse.
    """
    at = active_elements(field)
    if at is None:
        return False
    values = np.empty((len(at), *field.element_shape), field.dtype.numpy)
    field.core.read_elements(at, values)
    values.reshape(len(at), -1)[:, component] = fitting.stored(value, field.dtype, field)
    field.core.write_elements(at, values)
    dual = origins.dual_of_written(field) if state.forward else None
    if dual is not None:
        dual.read_elements(at, values)
        values.reshape(len(at), -1)[:, component] = 0
        dual.write_elements(at, values)
    return True


def fill_matrices(field: Any, value: Any) -> None:
    """Fills a vector or matrix field with a number or an element, in active cells only."""
    values = np.asarray(value.to_numpy() if hasattr(value, "to_numpy") else value)
    single = field.single
    if values.ndim == 0 and single is not None:
        single.fill(values.item())
        return
    if values.ndim > len(field.element_shape) and (
        values.shape == field.shape + field.element_shape
    ):
        field.from_numpy(values)
        return
    values = fitting.stored_array(values, field.dtype, field)
    try:
        whole = np.broadcast_to(values, field.element_shape)
    except ValueError:
        if values.ndim > len(field.element_shape):
            raise TaiRuntimeTypeError(
                f"field '{field.name}' has shape {field.shape + field.element_shape} with its "
                f"elements, but the array that fills it {values.shape}",
                "fill it with an element, or with an array of its shape",
            ) from None
        raise TaiRuntimeTypeError(
            f"field '{field.name}' is filled by a number or by an element of shape "
            f"{field.element_shape}, not by {value!r}"
        ) from None
    if single is None:
        for component, number in zip(field.components, whole.ravel().tolist(), strict=True):
            component.fill(number)
        return
    at = active_elements(single)
    if at is None:
        field.from_numpy(np.broadcast_to(whole, field.shape + field.element_shape))
    else:
        if state.tape is not None or state.forward:
            origins.check_write(single, value)
        single.core.write_elements(at, np.tile(whole.ravel(), (len(at), 1)))
        origins.end_tangent(single)
