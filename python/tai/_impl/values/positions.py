"""Components of vectors and matrices at an index that is known when the kernel runs."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from ..base import state
from ..base.dtypes import i32, promote
from ..base.options import bounds_of
from .builder import FAIL_INDEX, UNSIGNED
from .domains import require
from .value import MatrixValue, Value

if TYPE_CHECKING:
    from .emitter import Emitter

# If a matrix has at most this many components, an index known only at run time is compiled to a
# chain of selects; the pass `tai-vectors-to-memory` decides about larger matrices.
_MAX_SELECTS = 6


def flat(emitter: Emitter, component: Any, shape: tuple[int, ...]) -> Any:
    """Converts an index that may be a pair of row and column to the number of the component,
    counted by rows.
    """
    if not isinstance(component, tuple):
        return component
    row, column = component
    return emitter.binary("+", emitter.binary("*", row, shape[1]), column)


def in_range(emitter: Emitter, component: Any, matrix: Any) -> Any:
    """Returns a component number that is in range; `ti.init(bounds=…)` decides what happens to
    others.

    Elements of fields and of arrays are checked as their indices are.
    """
    bounds = bounds_of(state.options)
    if bounds == "off" or isinstance(component, int):
        return component
    keys = component if isinstance(component, tuple) else (component,)
    pairs = list(zip(keys, matrix.shape, strict=True))
    if bounds == "clamp":
        keys = tuple(
            emitter.binary("max", emitter.binary("min", key, extent - 1), 0)
            for key, extent in pairs
        )
        return keys if isinstance(component, tuple) else keys[0]
    for key, extent in pairs:
        if isinstance(key, Value):
            shown = ", ".join("{}" if isinstance(k, Value) else str(k) for k in keys)
            require(
                emitter, _is_below(emitter, key, extent)[1],
                f"index [{shown}] is out of range for a {matrix.kind_name}",
                [k for k in keys if isinstance(k, Value)], FAIL_INDEX,
            )  # fmt: skip
    return component


def _is_below(emitter: Emitter, index: Value, count: int) -> tuple[Value, Value]:
    """Converts the index to a type that holds `count`, and tests whether the index is from 0 to
    `count` - 1.
    """
    index = emitter.cast(index, promote(index.dt, i32))
    limit = emitter.constant(count, index.dt)
    return index, emitter.compare_by(UNSIGNED["<"], index, limit)


def read(emitter: Emitter, matrix: MatrixValue, component: Value) -> Any:
    """Reads the component of a matrix by its number; out of range, the last component."""
    if math.prod(matrix.shape) > _MAX_SELECTS:
        vector, index, _ = _locate(emitter, matrix, component)
        return _extract(emitter, vector, index, matrix)
    scalars = matrix.scalars()
    result = scalars[-1]
    for number in range(len(scalars) - 2, -1, -1):
        result = emitter.select(emitter.compare("==", component, number), scalars[number], result)
    return result


def replace(emitter: Emitter, matrix: MatrixValue, component: Value, value: Value) -> MatrixValue:
    """The matrix with the component of that number replaced; out of range, the same one."""
    if math.prod(matrix.shape) > _MAX_SELECTS:
        return _insert(emitter, matrix, component, value)
    scalars = list(matrix.scalars())
    for number, old in enumerate(scalars):
        here = emitter.compare("==", component, number)
        scalars[number] = _choose(emitter, here, value, old, matrix)
    return emitter.matrix(scalars, matrix.dt, matrix.shape)


def _choose(emitter: Emitter, holds: Value, new: Value, old: Value, matrix: MatrixValue) -> Any:
    """Selects one of two components, converted to the stored type of the matrix, since a select
    computes 16-bit floats in f32.
    """
    return emitter.cast(emitter.select(holds, new, old), matrix.dt)


def _locate(emitter: Emitter, matrix: MatrixValue, component: Value) -> tuple[Any, Any, Value]:
    """Returns the components as one vector, an index that is always in range, and whether the given
    index was in range.
    """
    count = math.prod(matrix.shape)
    component, holds = _is_below(emitter, component, count)
    index = emitter.to_index(emitter.select(holds, component, count - 1))
    vector = matrix.handle
    if len(matrix.shape) == 2:
        flat_type = emitter.type_of(matrix.dt, (count,))
        vector = emitter.builder.apply("vector.shape_cast", [vector], flat_type)
    return vector, index, holds


def _extract(emitter: Emitter, vector: Any, index: Any, matrix: MatrixValue) -> Value:
    handle = emitter.builder.extract_at(vector, index, emitter.type_of(matrix.dt))
    return Value(emitter, handle, matrix.dt)


def _insert(emitter: Emitter, matrix: MatrixValue, component: Value, value: Value) -> MatrixValue:
    vector, index, holds = _locate(emitter, matrix, component)
    # If the index is out of range, another component is chosen instead, and keeps its value.
    kept = _choose(emitter, holds, value, _extract(emitter, vector, index, matrix), matrix)
    flat_type = emitter.type_of(matrix.dt, (math.prod(matrix.shape),))
    vector = emitter.builder.insert_at(kept.handle, vector, index, flat_type)
    if len(matrix.shape) == 2:
        type_ = emitter.type_of(matrix.dt, matrix.shape)
        vector = emitter.builder.apply("vector.shape_cast", [vector], type_)
    return MatrixValue(emitter, vector, matrix.dt, matrix.shape)
