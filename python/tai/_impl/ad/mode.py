"""The context manager of forward mode, and the fields that have tangents in it."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ...errors import (
    TaiAutodiffError,
    TaiGradientWarning,
    TaiRuntimeError,
    TaiRuntimeTypeError,
    as_written,
)
from ..base import native, state
from ..base.callers import calling_frame, calling_level
from ..base.locks import Lock, snapshot
from ..base.program import get_program
from ..fields.root import materialize
from ..history import origins
from . import library as library
from .seeds import as_float_field, as_numbers, parts_of


def check_dual(field: Any, what: str) -> Any:
    """Returns the field if memory holds its dual (its tangents); raises an error otherwise.

    Raises:
        TaiRuntimeTypeError: it is not a field, or one of structs.
        TaiAutodiffError: it is not of a float type, or has no dual.
    """
    dual = as_float_field(field, what).dual
    if dual is None or dual.snode is None:
        raise TaiAutodiffError(
            f"{what} '{field.name}' has no dual",
            "make it with needs_dual=True, or call ti.root.lazy_dual() after placing it",
        )
    return field


def check_tangent(field: Any, tangent: Any) -> np.ndarray:
    """Returns a tangent as an array of shape `field.shape + field.element_shape`.

    Raises:
        TaiRuntimeTypeError: it is not made of numbers, or has another shape.
    """
    wanted = field.shape + field.element_shape
    array = as_numbers(field, "the tangent of field", tangent, field.dtype.numpy, wanted)
    # As in Taichi, a flat list of all components in order is accepted, too.
    if array.shape != wanted and array.shape != (int(np.prod(wanted, dtype=int)),):
        raise TaiRuntimeTypeError(
            f"the tangent of field '{field.name}' must have shape {wanted}, but got {array.shape}"
        )
    return array.reshape(wanted)


def clear_duals() -> None:
    """Sets the duals of all fields to zero, except duals that another thread has computed."""
    get_program().context.clear_tangents()


# Only one thread at a time is in forward mode, because the duals of a field that two threads use
# would mix two runs.
one_thread = Lock()


def _cores_of(fields: Sequence[Any]) -> list[Any]:
    """Returns the C++ objects of the scalar fields that make up `fields`."""
    return [part.core for field in fields for part, _ in parts_of(field)]


def follow(inputs: Sequence[Any], all_others: bool) -> None:
    """Follows the tangents of fields, so that warnings can say where tangents get lost."""
    program = get_program()
    if all_others:
        duals = (f for f in snapshot(program.fields.values()) if f.role == "dual")
        inputs = [*inputs, *(d.primal for d in duals if d.snode is not None)]
    program.context.follow_tangents(_cores_of(inputs))


def find_lost(outputs: Sequence[Any]) -> list[str]:
    """Finds tangents that got lost on the way to the outputs; to be called in forward mode."""
    return get_program().context.lost_tangents(_cores_of(outputs)).splitlines()


def warn_of_lost(lines: list[str]) -> None:
    for line in lines:
        warnings.warn(as_written(line), TaiGradientWarning, stacklevel=calling_level())


class ForwardMode(native.WithBlock):
    """Launches kernels with their tangents while its `with` block runs.

    Another thread that wants that waits for the end of the block.

    Raises:
        TaiRuntimeError: forward mode is on already.
    """

    _lock = one_thread

    def __init__(self) -> None:
        self._program: Any = None

    def _enter(self) -> None:
        if state.forward:
            raise TaiRuntimeError("forward mode is on already", "leave its `with` block first")
        self._program = get_program()
        self._program.context.set_option("forward_mode", "true")
        state.of_thread.forward = True
        native.set_forward_mode(True)

    def _end(self) -> None:
        if self._program is None:
            return
        state.of_thread.forward = False
        native.set_forward_mode(False)
        if state.tape is None:
            origins.end()
        self._program.context.set_option("forward_mode", "false")
        self._program = None


class suspended(native.WithBlock):
    """Launches kernels without their tangents while its block runs, if forward mode is on."""

    def __init__(self) -> None:
        self._was_on = False

    def _enter(self) -> None:
        self._was_on = state.forward
        if self._was_on:
            self._set(False)

    def _end(self) -> None:
        if self._was_on:
            self._set(True)

    def _set(self, on: bool) -> None:
        get_program().context.set_option("forward_mode", "true" if on else "false")
        state.of_thread.forward = on
        native.set_forward_mode(on)


def prepare(pairs: Sequence[tuple[Any, Any]], what: str) -> list[tuple[Any, np.ndarray]]:
    """Allocates the fields of pairs of a field and a tangent, and converts the tangents to
    arrays.
    """
    checked = [(check_dual(field, what), tangent) for field, tangent in pairs]
    materialize(get_program(), caller_names())
    return [(field, check_tangent(field, tangent)) for field, tangent in checked]


def derivatives_of_gradients(
    run: Callable[[], Any], loss: Any, pairs: Sequence[tuple[Any, Any]]
) -> list[np.ndarray]:
    """Runs a program and its reverse sweep in forward mode.

    Args:
        run: computes the loss and the gradients.
        pairs: the inputs, each with its tangent.

    Returns:
        For each input the derivative of its gradient along the tangents.

    Raises:
        TaiAutodiffError: a field lacks a gradient or a dual, or something has no rule.
    """
    checked = prepare(pairs, "the input")
    check_dual(loss, "the loss")
    # A field with a gradient takes part in the second derivative. If it had no dual, its share
    # would be missing without notice.
    for field in get_program().fields.values():
        if field.role == "grad" and getattr(field.dual, "snode", None) is None:
            raise TaiAutodiffError(
                f"field '{field.primal.name}' has a gradient but no dual, and the derivative of "
                "a gradient passes through both",
                "make it with needs_dual=True too, or call ti.root.lazy_dual()",
            )
    with one_thread:
        clear_duals()
        for field, tangent in checked:
            field.placed_grad()  # raises
            field.dual.from_numpy(tangent)
        with ForwardMode():
            run()
        return [field.grad.dual.to_numpy() for field, _ in checked]


def caller_names() -> dict[str, Any]:
    """Returns the local and global variables of the program that called into the package."""
    frame = calling_frame()
    return {} if frame is None else frame.f_globals
