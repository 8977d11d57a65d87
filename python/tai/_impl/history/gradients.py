"""Accumulators for the gradients of numbers, matrices and arrays that Python owns."""

from __future__ import annotations

import threading
import weakref
from typing import Any

import numpy as np

from ..base import state
from ..base.dtypes import DataType
from ..base.locks import Lock, snapshot


class Gradient:
    """The gradient of one value of Python, to which kernels add.

    Attributes:
        shape: that of the value.
        dt: the type in which a kernel returned the value; None for variables and for values that
            Python computed.
        parts: for a value that Python computed, the values it was computed from: their
            gradients, a component or None, and the partial derivative.
    """

    __slots__ = ("__weakref__", "buffers", "dt", "owner", "parts", "shape", "user")

    def __init__(self, shape: tuple[int, ...], dt: DataType | None = None, parts: Any = None):
        self.shape, self.dt, self.parts = shape, dt, parts
        # The thread to which the value belongs, and the tape that has used it last; see
        # `tracked.TapeValues.take`.
        self.owner, self.user = state.thread, None
        self.buffers: dict[DataType, np.ndarray] = {}

    @property
    def is_variable(self) -> bool:
        return self.dt is None and self.parts is None

    def buffer(self, dt: DataType) -> np.ndarray:
        """Returns the memory to which kernels with values of type `dt` add the gradient."""
        found = self.buffers.get(dt)
        if found is None:
            found = self.buffers[dt] = np.zeros(self.shape, dt.numpy)
        return found

    def total(self) -> np.ndarray:
        """The gradient, in f64."""
        total = np.zeros(self.shape)
        for buffer in self.buffers.values():
            total += buffer
        return total

    def clear(self) -> None:
        for buffer in self.buffers.values():
            buffer[...] = 0

    def add(self, amount: Any, component: int | None = None) -> None:
        """Adds a number to the gradient of the value, or to the gradients of the values from which
        it was computed.
        """
        if self.parts is not None:
            for gradient, part, partial in self.parts:
                gradient.add(partial * amount, part)
            return
        buffer = self.buffer(self.dt or state.options.default_fp)
        if component is None:
            buffer += amount
        else:
            buffer.reshape(-1)[component] += amount

    def pass_on(self) -> None:
        """In a reverse sweep: passes the accumulated gradient on to the value from which this one
        was made.
        """
        kept = self.buffers.get(self.dt) if self.dt is not None else None
        for buffer in self.buffers.values():
            if buffer is not kept and buffer.any():
                amount = buffer.astype(np.float64)
                buffer[...] = 0
                self.add(amount)


# All variables, and all arrays with a gradient, which clearing gradients clears.
_variables: weakref.WeakSet = weakref.WeakSet()
_arrays: weakref.WeakSet = weakref.WeakSet()
# Guards the set, which must not grow while another thread iterates over it.
_lock = Lock()


class ArrayGradient:
    """The gradient of a `ti.ndarray`, in the form that a tape takes."""

    def __init__(self, array: np.ndarray):
        self.array = array
        self.owner, self.user = state.thread, None

    def clear(self) -> None:
        self.array[...] = 0


def clear_gradients(all_threads: bool = True) -> None:
    """Sets the gradients of variables and arrays to zero.

    Args:
        all_threads: or only of those that no other thread has computed.
    """
    # Most programs have neither, and the snapshots take a twentieth of the smallest tape.
    if not _variables and not _arrays:
        return
    with _lock:
        things = [*snapshot(_variables), *snapshot(_arrays)]
    for thing in things:
        if all_threads or thing.owner is state.thread:
            thing.clear()


def note_variable(gradient: Gradient) -> None:
    with _lock:
        _variables.add(gradient)


def note_gradient_array(array: Any) -> ArrayGradient:
    """Registers the gradient of an array, for as long as the caller keeps the returned object."""
    gradient = ArrayGradient(array.array)
    with _lock:
        _arrays.add(gradient)
    return gradient


class _OfThread(threading.local):
    # The values of the tape that records in this thread, or None; see `tracked.TapeValues`.
    active: Any = None


of_thread = _OfThread()


def recorded_as(array: np.ndarray, has_gradient: bool) -> str | None:
    """The name that the recording tape gives an array that it has recorded, or None."""
    active = of_thread.active
    if active is None or active.core is not state.tape:
        return None
    return active.arrays.find(array, has_gradient)
