"""Arrays of the launches that a tape records: on the host, and on a GPU.

A launch may overwrite what an earlier one has read. What was there is kept where the array is,
and put back in the reverse sweep. On a GPU that is a copy in the order of the launches, and a
part of the sequence that a sweep or a replay queues at once.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from . import _interop
from .errors import TaiAutodiffError, TaiRuntimeError
from .program import get_program


class _HostCopy:
    """What an array of the host held."""

    def __init__(self, array: np.ndarray):
        self._array, self._kept = array, array.copy()

    def save(self) -> None:
        np.copyto(self._kept, self._array)

    def restore(self) -> None:
        np.copyto(self._array, self._kept)


class _DeviceCopy:
    """What an array of a GPU held."""

    def __init__(self, array: _interop.DeviceArray):
        from . import _core

        self._array = array
        self._memory = _core.DeviceMemory(get_program().context, array.nbytes)
        self.save()

    def save(self) -> None:
        self._memory.save(self._array.ctypes.data)

    def restore(self) -> None:
        self._memory.restore(self._array.ctypes.data)


def _copy_of(array: Any) -> Any:
    on_device = isinstance(array, _interop.DeviceArray)
    return _DeviceCopy(array) if on_device else _HostCopy(array)


def overlap(one: Any, other: Any) -> bool:
    """Whether two arrays share memory."""
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        return np.may_share_memory(one, other)
    begin, end = one.ctypes.data, other.ctypes.data
    return begin < end + other.nbytes and end < begin + one.nbytes


def _version(tensor: Any) -> int | None:
    """How often torch has changed a tensor in place; None where nobody counts."""
    try:
        return tensor._version
    except (AttributeError, RuntimeError):  # of an inference tensor
        return None


class TapeArrays:
    """What a tape knows of the arrays of its launches."""

    def __init__(self, core: Any, runs_again: bool):
        from . import _core

        self._core, self._runs_again, self._launcher = core, runs_again, _core
        # By address and size: a part of an array may start where the array does.
        self._used: dict[tuple[int, int], Any] = {}
        self._restored: dict[tuple[int, int], Any] = {}
        # Arrays of a GPU, one for each library that says on which stream it works.
        self._streams: dict[Any, _interop.DeviceArray] = {}
        # Tensors with their versions, and those with a gradient.
        self._tensors: dict[int, list] = {}
        self._gradients: dict[int, tuple[Any, Any]] = {}

    def use(self, value: Any, array: Any, is_read: bool, is_written: bool) -> None:
        """An array of the launch that comes next.

        Args:
            value: what the kernel was given.
            array: its memory.
            is_read, is_written: what the kernel does with it.

        Raises:
            TaiRuntimeError: its library has changed it since an earlier launch.
            TaiAutodiffError: a tape that runs kernels again would not find what it held.
        """
        self._core.keep(array)
        if isinstance(array, _interop.DeviceArray):
            self._streams.setdefault(array.library, array)
        version = _version(value)
        if version is not None:
            known = self._tensors.setdefault(id(value), [value, version])
            if known[1] != version:
                raise TaiRuntimeError(
                    "a tensor that the tape has recorded launches on was changed by its library",
                    "change it in a kernel, or before the tape begins",
                )
        key = (array.ctypes.data, array.nbytes)
        overwrites = is_written and any(overlap(array, a) for a in self._used.values())
        if self._runs_again and (overwrites or (is_read and is_written)):
            raise TaiAutodiffError(
                "a tape with checkpoints runs kernels again, and does not keep what an array held "
                "that they change",
                "keep it in a field, or leave out checkpoint and memory_budget",
            )
        if overwrites:
            saved = _copy_of(array)
            self._restored[key] = array
            self._core.record(saved.save, saved.restore)
        self._used[key] = array
        # The next launch that reads it need not come here.
        self._launcher.note_taped_array(value, *key, -1 if version is None else version)

    def use_gradient(self, value: Any, buffer: Any) -> None:
        """The memory to which the gradient of an argument is added."""
        self._core.keep(buffer)
        self._launcher.note_taped_gradient(value, buffer.ctypes.data)
        if hasattr(value, "requires_grad"):
            self._gradients.setdefault(id(value), (value, value.grad))

    def end(self) -> None:
        """The tape records no more."""
        self._launcher.forget_taped_arrays()

    def uses(self, array: np.ndarray) -> bool:
        return any(address == array.ctypes.data for address, _ in self._used)

    @property
    def restores(self) -> bool:
        """Whether a sweep puts back contents of arrays."""
        return bool(self._restored)

    @contextlib.contextmanager
    def ordered(self) -> Iterator[None]:
        """What is queued meanwhile comes after what the libraries of the arrays have queued, and
        before what they queue then."""
        streams = _interop.order_before(list(self._streams.values()))
        try:
            yield
        finally:
            _interop.order_after(streams)

    @contextlib.contextmanager
    def sweep(self) -> Iterator[None]:
        """Around a reverse sweep: puts arrays back afterwards."""
        self._check_gradients()
        with self.ordered():
            final = [_copy_of(array) for array in self._restored.values()]
            try:
                yield
            finally:
                for copy in final:
                    copy.restore()

    def check_versions(self) -> None:
        """Before a sweep over what was recorded: the tensors must hold what they held.

        Raises:
            TaiRuntimeError: torch has changed one since.
        """
        for tensor, version in self._tensors.values():
            if _version(tensor) != version:
                raise TaiRuntimeError(
                    "a tensor was changed by its library after the tape had recorded, and the "
                    "gradient needs what it held",
                    "replay the tape forward and backward: tape.replay()",
                )

    def take_versions(self) -> None:
        """The launches run forward again, on what the tensors hold now."""
        for entry in self._tensors.values():
            entry[1] = _version(entry[0])

    def _check_gradients(self) -> None:
        """Each tensor must still have the gradient that the launches add to.

        One that torch has forgotten, as its optimisers do, begins with zeros again.
        """
        for tensor, gradient in self._gradients.values():
            now = tensor.grad
            if now is None:
                gradient.detach().zero_()
                tensor.grad = gradient
            elif now.data_ptr() != gradient.data_ptr():
                raise TaiRuntimeError(
                    "a tensor that the tape has recorded launches on has another gradient now",
                    "change the one it has: t.grad.copy_(…) or t.grad.zero_()",
                )
