"""Fields that are pickled or copied: their types, levels and contents, and how to make them anew.

A field that is loaded or copied has memory of its own, in a tree of its own. `x.grad` is that of
the field that is made for `x`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import TaiRuntimeTypeError
from ..base.program import get_program
from . import active
from .matrix_field import MatrixField
from .root import open_root
from .scalar import ScalarField


def describe(field: Any) -> tuple:
    """Returns the function that makes a pickled field anew, and its arguments.

    Raises:
        TaiRuntimeTypeError: a field in lists, whose lengths are not kept.
    """
    if field.primal is not None:
        return companion_of, (field.primal, field.role)
    whole = getattr(field, "_whole", None)
    if whole is not None:
        return _component_of, (whole, field._index)
    state: dict[str, Any] = {
        "dtype": field.dtype, "element_shape": field.element_shape, "name": field._name,
        "needs": (field.needs_grad, field.needs_dual), "levels": None,
    }  # fmt: skip
    if field.level is None:
        return make, (state,)
    path = field.level.path()
    if any(level.kind == "dynamic" for level in path):
        raise TaiRuntimeTypeError(
            f"field '{field.name}' cannot be copied or pickled: it lies in lists (ti.root.dynamic)",
            "to_numpy() copies its values",
        )
    state["levels"] = [
        (level.kind, (level.shard_axis,) if level.kind == "shard" else level.axes, level.extents)
        for level in path
    ]
    state["offset"], state["is_split"] = tuple(field.offset or ()), is_split(field)
    placed = {w: c for w, c in field._companions.items() if c.level is not None}
    state["companions"] = {w: None if _is_sparse(field) else c.to_numpy()
                           for w, c in placed.items()}  # fmt: skip
    if _is_sparse(field):
        state["active"] = [_active_part(part) for part in getattr(field, "parts", [field])]
    else:
        state["values"] = field.to_numpy()
    return make, (state,)


def is_split(field: Any) -> bool:
    return bool(getattr(field, "is_split", False))


def _is_sparse(field: Any) -> bool:
    return field.level.nearest_sparse() is not None


def _active_part(part: Any) -> tuple[np.ndarray, np.ndarray]:
    """Returns the indices of the active elements of a sparse field, and their values."""
    part.materialize()
    where = active.active_elements(part)
    assert where is not None
    values = np.empty((len(where), *part.element_shape), part.dtype.numpy)
    part.core.read_elements(where, values)
    return where, values


def make(state: dict[str, Any]) -> Any:
    """Makes a field from a pickled description, in the current program."""
    if state["element_shape"]:
        made: Any = MatrixField(state["element_shape"], state["dtype"], state["name"])
    else:
        made = ScalarField(state["dtype"], state["name"])
    made.needs_grad, made.needs_dual = state["needs"]
    if state["levels"] is None:
        return made
    program = get_program()
    offset = state["offset"] or None
    with program.layout:
        node: Any = open_root(program)
        for kind, axes, extents in state["levels"]:
            if kind != "shard":
                node = node._add(kind, axes, extents)
            elif program.options.mesh is not None:
                node = node.shard(axes)
        parts = made.components if state["is_split"] else [made]
        for part in parts:
            node.place(part, offset=offset)
        for which in state["companions"]:
            node.place(getattr(made, which), offset=offset)
    if "values" in state:
        made.from_numpy(state["values"])
        for which, values in state["companions"].items():
            getattr(made, which).from_numpy(values)
    else:
        for part, (where, values) in zip(getattr(made, "parts", [made]), state["active"]):
            part.materialize()
            if len(where):
                active.write_elements(part, where, values)
    return made


def companion_of(field: Any, which: str) -> Any:
    """Returns the gradient or dual of a field."""
    return getattr(field, which)


def _component_of(whole: Any, number: int) -> Any:
    return whole.components[number]
