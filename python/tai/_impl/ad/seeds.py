"""Losses, and the seeds of their gradients, from which a reverse sweep starts."""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np

from ...errors import TaiAutodiffError, TaiGradientWarning, TaiRuntimeTypeError, as_written
from ..base.callers import calling_level
from ..fields.field import Field
from ..fields.structs import StructField, leaves_of

_DECLARE = "loss = ti.field(ti.f32, shape=(), needs_grad=True)"


def as_float_field(field: Any, what: str) -> Any:
    """Returns a field of floats that one differentiates by, or whose derivatives are wanted.

    Raises:
        TaiRuntimeTypeError: it is not a field, or one of structs.
        TaiAutodiffError: it is of integers.
    """
    if not isinstance(field, Field):
        hint = "copy the array to a field" if hasattr(field, "__array__") else None
        got = "nothing" if field is None else repr(field)
        raise TaiRuntimeTypeError(f"{what} must be a field, but got {got}", hint)
    if isinstance(field, StructField):
        members = ", ".join(f"{field.name}.{name}" for name in field.members)
        raise TaiRuntimeTypeError(
            f"{what} '{field.name}' is a field of structs", f"name its members: [{members}]"
        )
    if not field.dtype.is_float:
        raise TaiAutodiffError(f"{what} '{field.name}' is of type {field.dtype}, not a float")
    return field


def as_numbers(field: Any, what: str, values: Any, dtype: Any, shape: tuple[int, ...]) -> Any:
    """Returns values of a field's elements, such as a tangent or a seed, as an array.

    Raises:
        TaiRuntimeTypeError: they are no real numbers, or rows of several lengths.
    """
    try:
        array = np.asarray(values)
        # NumPy makes numbers of these without a word: the real part, NaN, what the text says.
        if array.dtype.kind in "cSU" or (array.dtype.kind == "O" and None in array.ravel()):
            raise TypeError
        return np.asarray(array, dtype)
    except (TypeError, ValueError):
        raise TaiRuntimeTypeError(
            f"{what} '{field.name}' must be numbers of shape {shape}, but got {values!r}"
        ) from None


def as_losses(loss: Any) -> list[Any]:
    """Returns the fields of the losses, from the argument of `ti.ad.Tape`.

    Raises:
        TaiRuntimeTypeError: something that is no field.
        TaiAutodiffError: a field of integers.
    """
    if loss is None:
        return []
    losses = list(loss) if isinstance(loss, (list, tuple)) else [loss]
    for field in losses:
        if not isinstance(field, Field):
            raise TaiRuntimeTypeError(
                f"ti.ad.Tape takes the field of the loss, but got {field!r}", _DECLARE
            )
        as_float_field(field, "the loss")
    if len({id(field) for field in losses}) < len(losses):
        raise TaiRuntimeTypeError("a loss is given twice")
    return losses


def as_wanted(wrt: Any) -> list[Any]:
    """Checks the fields whose gradients are wanted, and replaces struct fields by their members;
    empty means all fields.

    Raises:
        TaiRuntimeTypeError: something that is no field, or no field at all.
        TaiAutodiffError: a field of integers.
    """
    if wrt is None:
        return []
    fields = []
    for field in wrt if isinstance(wrt, (list, tuple)) else [wrt]:
        if isinstance(field, StructField):
            fields += [leaf for leaf in leaves_of(field) if leaf.dtype.is_float]
            continue
        if not isinstance(field, Field):
            raise TaiRuntimeTypeError(
                f"wrt takes fields, but got {field!r}",
                "the gradients of arrays and returned values are always computed",
            )
        if not field.dtype.is_float:
            raise TaiAutodiffError(f"field '{field.name}' is of type {field.dtype}, not a float")
        fields.append(field)
    if not fields:
        raise TaiRuntimeTypeError(
            "wrt names no field that could have a gradient", "leave wrt out to get all gradients"
        )
    return list({id(field): field for field in fields}.values())


def is_number(field: Any) -> bool:
    """Whether the field holds one number: its shape is () or (1,)."""
    return math.prod(field.shape) == 1 and field.element_shape in ((), (1,))


def number_of(field: Any) -> float:
    """Returns the number that the field of a loss holds."""
    if field.shape == () and field.element_shape == ():
        return field[None]
    return field.to_numpy().item()


def require_grad(field: Any, frame: Any) -> None:
    """Allocates a field and its gradient; raises an error if there is no gradient."""
    field.materialize(frame)
    field.placed_grad()  # raises


def parts_of(field: Any) -> list[tuple[Any, Any]]:
    """The storage places of a field, and for each of them its index in arrays of the whole
    field.
    """
    parts = getattr(field, "parts", None)
    if parts is None or len(parts) == 1:
        return [(field if parts is None else parts[0], ...)]
    indices = np.ndindex(*field.element_shape)
    return [(part, (..., *index)) for part, index in zip(parts, indices, strict=True)]


def as_seed(field: Any, seed: Any) -> np.ndarray:
    """Returns the seed of one field as an array of the field's shape.

    Raises:
        TaiRuntimeTypeError: a seed of the wrong shape, or none of numbers.
    """
    if hasattr(seed, "to_numpy"):
        seed = seed.to_numpy()
    wanted = tuple(field.shape) + tuple(field.element_shape)
    array = as_numbers(field, "the seed of", seed, field.grad.dtype.numpy, wanted)
    if array.size == 1 and math.prod(wanted) == 1:
        array = array.reshape(wanted)
    if array.shape != wanted:
        raise TaiRuntimeTypeError(
            f"the seed of '{field.name}' has shape {array.shape}, but the field has {wanted}",
            f"np.ones({wanted}) gives all elements the same weight",
        )
    return array.copy(order="C")


def as_seeds(losses: list[Any], seed: Any) -> list[np.ndarray]:
    """The seeds of all losses: one array for a single loss, otherwise an array for each loss."""
    if len(losses) == 1 and not (isinstance(seed, (list, tuple)) and len(seed) == 1):
        return [as_seed(losses[0], seed)]
    if not isinstance(seed, (list, tuple)) or len(seed) != len(losses):
        names = ", ".join(f"'{field.name}'" for field in losses)
        raise TaiRuntimeTypeError(
            f"the tape has the losses {names}, so it takes a list of {len(losses)} seeds"
        )
    return [as_seed(field, one) for field, one in zip(losses, seed, strict=True)]


def set_seeds(core: Any, losses: list[Any], seeds: list[np.ndarray]) -> None:
    """Passes the seeds of the losses to the tape in C++."""
    for field, seed in zip(losses, seeds, strict=True):
        for part, index in parts_of(field):
            core.set_seed(part.core, np.ascontiguousarray(seed[index]))


def warn(core: Any) -> None:
    """Shows the warnings of the last sweep of the tape."""
    for line in core.warnings():
        warnings.warn(as_written(line), TaiGradientWarning, stacklevel=calling_level())
