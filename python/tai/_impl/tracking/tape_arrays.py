"""Arrays of the launches that a tape records: on the host, and on a GPU.

A launch may overwrite elements that an earlier one has read. The old contents are saved in the
same memory space, and restored in the reverse sweep. On a GPU the copies are queued in the order
of the launches, as parts of the sequence that a sweep or a replay queues at once.

Python may change an array at any time. Where the gradient of a launch reads an array of the
host, the launch gets a copy of it, as long as no recorded kernel writes to the array; the copy
serves all launches until the contents of the array change. Recorded kernels write to the array
itself: a digest detects changes by others.
"""

from __future__ import annotations

import math
import weakref
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ...errors import TaiAutodiffError, TaiRuntimeError, TaiRuntimeTypeError
from ..base import native, pieces
from ..base.handlers import is_of_a_handler
from ..base.program import get_program
from ..interop import device_arrays


class _HostCopy:
    """A copy of the former contents of an array in host memory."""

    def __init__(self, array: np.ndarray):
        self._array, self._kept = array, pieces.copied(array)

    def save(self) -> None:
        pieces.copy(self._kept, self._array)

    def restore(self) -> None:
        np.copyto(self._array, self._kept)


class _DeviceCopy:
    """A copy of the former contents of an array in GPU memory."""

    def __init__(self, array: device_arrays.DeviceArray):
        self._array = array
        self._memory = native.DeviceMemory(get_program().context, array.nbytes)
        self.save()

    def save(self) -> None:
        self._memory.save(self._array.ctypes.data)

    def restore(self) -> None:
        self._memory.restore(self._array.ctypes.data)


def _copy_of(array: Any) -> Any:
    on_device = isinstance(array, device_arrays.DeviceArray)
    return _DeviceCopy(array) if on_device else _HostCopy(array)


# The greatest number of steps of the search for a common element of two arrays with strides.
_MOST_WORK = 100_000


def overlap(one: Any, other: Any) -> bool:
    """Whether two arrays share elements; true if that is too hard to tell."""
    if one.nbytes == 0 or other.nbytes == 0:
        return False
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        if not np.may_share_memory(one, other):
            return False
        try:
            return np.shares_memory(one, other, max_work=_MOST_WORK)  # type: ignore[arg-type]
        except RuntimeError as error:  # TooHardError, whose place depends on the version of NumPy
            if is_of_a_handler(error.__traceback__):
                raise
            return True
    begin, end = one.ctypes.data, other.ctypes.data
    return begin < end + other.nbytes and end < begin + one.nbytes


def overlaps_itself(array: Any) -> bool:
    """Whether two elements of an array share memory; true if that is too hard to tell."""
    if not isinstance(array, np.ndarray) or array.flags.c_contiguous or array.nbytes == 0:
        return False
    part = array
    while part.ndim:
        # Compares the subarray at index 0 of this dimension with all later subarrays.
        if overlap(part[:1], part[1:]):
            return True
        part = part[0]
    return False


def check_written_view(kernel: str, name: str, value: Any, array: Any) -> None:
    """Raises an error if a kernel stores to a view whose elements share memory.

    Args:
        kernel, name: which parameter it is for.
        value: the argument.
        array: the memory of the argument, as an array.

    Raises:
        TaiRuntimeTypeError: a store to one element would change another one.
    """
    if overlaps_itself(array):
        copy = "clone" if hasattr(value, "detach") else "copy"
        raise TaiRuntimeTypeError(
            f"elements of array '{name}' of kernel '{kernel}' share memory, and the kernel writes "
            "to it",
            f"pass a copy, in which each element has memory of its own: {name}.{copy}()",
        )


def is_same_array(one: Any, other: Any) -> bool:
    """Whether two arrays consist of the same elements in memory, in the same order."""
    if type(one) is not type(other) or one.dtype != other.dtype:
        return False
    same = one.ctypes.data == other.ctypes.data and one.shape == other.shape
    return same and getattr(one, "strides", None) == getattr(other, "strides", None)


def _is_equal(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two arrays hold the same bits."""
    a, b = (pieces.row_major(x).reshape(-1).view(np.uint8) for x in (one, other))
    return len(a) == len(b) and all(
        np.array_equal(a[first : first + pieces.PIECE], b[first : first + pieces.PIECE])
        for first in range(0, len(a), pieces.PIECE)
    )


def _digest_of(array: Any) -> int:
    return native.digest(array.ctypes.data, array.nbytes)


class HeldArray(NamedTuple):
    """An array that is passed to a launch.

    Attributes:
        name: the parameter.
        kernel: the name of the kernel.
        value: the argument of the kernel.
        array: the memory of the argument, as an array.
        launched: the memory that the kernel gets: the array, or a contiguous copy of it.
        slot: where its address is among the slots of the launch.
        is_read, is_written: whether the kernel reads or writes it.
        has_gradient: whether the kernel is differentiated by it.
        is_read_in_reverse: whether the gradient reads its elements.
        ends_gradients: whether the kernel stores differentiable values there, and it has no
            gradient.
    """

    name: str
    kernel: str
    value: Any
    array: Any
    launched: Any
    slot: int
    is_read: bool
    is_written: bool
    has_gradient: bool = False
    is_read_in_reverse: bool = False
    ends_gradients: bool = False

    @property
    def what(self) -> str:
        return f"array '{self.name}' of kernel '{self.kernel}'"


def check_overlaps(held: list[HeldArray], tracks: bool) -> None:
    """Refuses arrays that share elements if the kernel writes one of them.

    The same array for two parameters is changed in place, but a gradient cannot tell.
    """
    for number, one in enumerate(held):
        for other in held[:number]:
            if not (one.is_written or other.is_written):
                continue
            if is_same_array(one.array, other.array) and not tracks:
                continue
            if overlap(one.array, other.array):
                written = one if one.is_written else other
                raise TaiRuntimeTypeError(
                    f"arrays '{other.name}' and '{one.name}' of kernel '{one.kernel}' overlap, "
                    f"and it writes to '{written.name}'",
                    f"pass a copy of one of them: {other.name}.copy()",
                )


class _Frozen:
    """Copies of an array's contents as its launches have read them: one copy for each change of the
    array.
    """

    def __init__(self, held: HeldArray):
        self.held = held
        self.versions: list[np.ndarray] = []

    def take(self, array: np.ndarray) -> np.ndarray:
        """Returns the kept copy that equals the present contents of the array."""
        if not self.versions or not _is_equal(self.versions[-1], array):
            self.versions.append(pieces.copied(array))
        return self.versions[-1]

    def renew(self) -> None:
        """Called before the launches run forward again, which use the present contents of the
        array.
        """
        if len(self.versions) == 1:
            pieces.copy(self.versions[0], self.held.array)
        elif not _is_equal(self.versions[-1], self.held.array):
            raise TaiRuntimeError(
                f"{self.held.what} was changed by Python while the tape recorded, and again since: "
                "the tape cannot tell which launches are to read what it holds now",
                "record the program again, or pass each launch an array of its own",
            )


def _range_of(array: Any) -> tuple[int, int, int, int]:
    """The first byte, the byte behind the last, a divisor of the distances between elements, and
    the bytes of an element."""
    address, size = array.ctypes.data, array.dtype.itemsize
    if not isinstance(array, np.ndarray):
        return address, address + array.nbytes, size, size
    steps = [
        (n - 1, step) for n, step in zip(array.shape, array.strides, strict=True) if n > 1 and step
    ]
    begin = address + sum(n * step for n, step in steps if step < 0)
    end = address + size + sum(n * step for n, step in steps if step > 0)
    divisor = math.gcd(*(step for _, step in steps)) if steps else size
    return begin, end, divisor, size


class _Sampled:
    """An array without a gradient that recorded kernels write differentiable values to.

    Whether Python has written to it since is seen by a few of its elements.
    """

    def __init__(self, held: HeldArray):
        self.held = held
        self._sample: int | None = None

    def renew(self, contents: Any) -> None:
        self._sample = _sample_of(contents)
        native.note_array_sample(self.held.value, self._sample)

    def is_changed(self, contents: Any) -> bool:
        return self._sample is not None and _sample_of(contents) != self._sample


def _sample_of(array: Any) -> int:
    return native.sample(array.ctypes.data, array.nbytes)


class _Watched:
    """An array that recorded kernels write and gradients read."""

    def __init__(self, held: HeldArray):
        self.held = held
        self.renew()

    def renew(self) -> None:
        self.digest = _digest_of(self.held.array)
        native.note_array_digest(self.held.value, self.digest)

    def check(self) -> None:
        if _digest_of(self.held.array) != self.digest:
            raise TaiRuntimeError(
                f"{self.held.what} was changed after the tape had recorded the launch, by Python "
                "or by a kernel that was not recorded, and the gradient needs what it held",
                "change it in a recorded kernel, or before the tape begins",
            )


def _version(tensor: Any) -> int | None:
    """The number of in-place changes of a tensor by torch; None if they are not counted."""
    try:
        return tensor._version
    except (AttributeError, RuntimeError):  # of an inference tensor
        return None


class Ordered(native.WithBlock):
    """Work queued within the block runs after all work that the libraries of a tape's arrays have
    queued before it, and before their later work."""

    def __init__(self, arrays: TapeArrays):
        self._arrays = arrays
        self._streams: Any = None

    def _enter(self) -> None:
        self._streams = device_arrays.order_before(self._arrays.of_streams())

    def _end(self) -> None:
        if self._streams is not None:
            device_arrays.order_after(self._streams)
            self._streams = None


class ArraySweep(Ordered):
    """Surrounds a reverse sweep, and restores the arrays afterwards."""

    _final: Sequence[Any] = ()

    def _enter(self) -> None:
        self._arrays.check_gradients()
        super()._enter()
        self._final = self._arrays.copy_restored()

    def _end(self) -> None:
        for copy in self._final:
            copy.restore()
        self._final = ()
        super()._end()


class TapeArrays:
    """The arrays that the launches of a tape use."""

    def __init__(self, core: Any, runs_again: bool, take: weakref.WeakMethod):
        self._core, self._runs_again, self._launcher = core, runs_again, native
        # Tensors of launches without Python, until `_learn` is called; see
        # python/src/TapedArrays.h.
        self._noted = None if runs_again else native.note_tensors(core)
        # A callback for the gradient of each array that a launch uses. The reference is weak
        # because the callback is a method of the tape.
        self._take = take
        # Arrays are identified by address and size, since a view may start at the address of the
        # whole array.
        self._used: dict[tuple, Any] = {}
        self._names: dict[tuple, HeldArray] = {}
        self._restored: dict[tuple, Any] = {}
        # Three sets of arrays: arrays that recorded kernels write, arrays that were copied for
        # launches, and arrays that gradients read.
        self._written: dict[tuple, Any] = {}
        self._frozen: dict[tuple, _Frozen] = {}
        self._watched: dict[tuple, _Watched] = {}
        self._sampled: dict[tuple, _Sampled] = {}
        # Copies that the next launch writes back to their arrays, and arrays that the next launch
        # changes.
        self._staged: list[HeldArray] = []
        self._changing: list[HeldArray] = []
        # One GPU array for each library, which tells the stream on which its library works.
        self.streams: dict[Any, device_arrays.DeviceArray] = {}
        # The tensors with their numbers of changes, and the tensors that have a gradient.
        self._tensors: dict[int, list] = {}
        self._gradients: dict[int, tuple[Any, Any]] = {}

    def follow(self) -> None:
        """Lets launches of this thread use new tensors without Python. Called when it records."""
        if self._noted is not None:
            native.follow_tensors(self._noted)

    def _take_noted(self) -> list:
        return [] if self._noted is None else native.take_noted(self._noted)

    def _learn(self) -> None:
        """Takes over what launches without Python have noted."""
        for tensor, memory, gradient, version, *launch in self._take_noted():
            kernel, number, is_written, is_restored = launch
            array: Any = device_arrays.as_device_array(memory)
            if array is None:
                array = device_arrays.host_view(memory)
            else:
                self.streams.setdefault(array.library, array)
            name, has_gradient = kernel.parameter_name(number), gradient is not None
            held = HeldArray(name, kernel.__name__, tensor, array, array, 0, True, is_written,
                             has_gradient)  # fmt: skip
            key = (array.ctypes.data, array.nbytes, getattr(array, "strides", None))
            self._core.keep(array)
            self._tensors.setdefault(id(tensor), [tensor, version])
            self._used[key] = array
            self._names.setdefault(key, held)
            if has_gradient:
                self._gradients.setdefault(id(tensor), (tensor, gradient))
            if is_written:
                self._written[key] = array
            if is_restored:
                self._restored[key] = array

    def _learn_changes(self) -> None:
        """Takes over what launches without Python have noted, unless a sweep can do without."""
        if self._noted is not None and not native.are_noted_unchanged(self._noted):
            self._learn()

    def use(self, held: HeldArray) -> Any:
        """Notes an array of the launch that comes next; returns the array to pass.

        Returns:
            The memory that the kernel gets.

        Raises:
            TaiRuntimeError: its library, or Python, has changed it since an earlier launch.
            TaiAutodiffError: a tape that runs kernels again would not find its former contents.
        """
        self._learn()
        value, array = held.value, held.array
        self._core.keep(array)
        if isinstance(array, device_arrays.DeviceArray):
            self.streams.setdefault(array.library, array)
        version = self._check_version(value)
        strides = getattr(array, "strides", None)
        key = (array.ctypes.data, array.nbytes, strides)
        for watched in self._watched.values():
            if overlap(array, watched.held.array):
                watched.check()
        overwrites = held.is_written and any(overlap(array, a) for a in self._used.values())
        changes = overwrites or (held.is_written and held.is_read)
        if held.is_written and self._runs_again:
            changes |= any(overlap(array, f.held.array) for f in self._frozen.values())
        if self._runs_again and changes:
            raise TaiAutodiffError(
                "a tape with checkpoints runs kernels again, and does not keep what an array held "
                "that they change",
                "keep it in a field, or leave out checkpoint and memory_budget",
            )
        if overwrites:
            saved = _copy_of(array)
            self._restored[key] = array
            self._core.record(saved.save, saved.restore)
        is_state = held.is_written or any(overlap(array, a) for a in self._written.values())
        is_copied = held.launched is not held.array
        on_host = isinstance(array, np.ndarray) and version is None
        self._launcher.note_taped_array(value, key[0], key[1], -1 if version is None else version)
        if isinstance(array, np.ndarray) and not array.flags.c_contiguous:
            self._launcher.note_taped_memory(*_range_of(array)[:2])
        if on_host:
            self._look_at_sample(key, held)
        if held.is_written:
            self._written[key] = array
            self._changing.append(held)
        if on_host and not is_state and (is_copied or held.is_read_in_reverse):
            return self._freeze(key, held)
        self._used[key] = array
        self._names.setdefault(key, held)
        if is_copied:
            self._stage(held)
        elif on_host and held.is_read_in_reverse and key not in self._watched:
            self._watched[key] = _Watched(held)
        return held.launched

    def _check_version(self, value: Any) -> int | None:
        """The number of changes of a tensor by its library. It must not change from now until the
        reverse sweep.
        """
        version = _version(value)
        if version is not None:
            known = self._tensors.setdefault(id(value), [value, version])
            if known[1] != version:
                raise TaiRuntimeError(
                    "a tensor that the tape has recorded launches on was changed by its library",
                    "change it in a kernel, or before the tape begins",
                )
        return version

    def _freeze(self, key: tuple, held: HeldArray) -> np.ndarray:
        """Returns the copy that the launch reads in place of the array, with its gradient."""
        known = self._frozen.setdefault((*key, held.array.dtype.str), _Frozen(held))
        copies = len(known.versions)
        copy = known.take(held.array)
        if held.has_gradient and 0 < copies < len(known.versions):
            known.versions.pop()
            raise TaiRuntimeError(
                f"{held.what} was changed by Python after the tape had recorded a launch on it, "
                "and it has one gradient for both",
                "change it in a kernel, or before the tape begins",
            )
        self._core.keep(copy)
        self._launcher.note_frozen_array(held.value, copy.ctypes.data)
        return copy

    def _look_at_sample(self, key: tuple, held: HeldArray) -> None:
        """Checks by a sample of elements whether Python has written to the array since the last
        launch, and notes it.
        """
        known = self._sampled.get(key)
        if known is not None and known.is_changed(held.launched):
            self._core.note_array_write(*_range_of(held.array))
            del self._sampled[key]
        elif known is not None and not held.is_written:
            known.renew(held.launched)
        if held.ends_gradients:
            self._sampled[key] = _Sampled(held)

    def _stage(self, held: HeldArray) -> None:
        """Gives the kernel a contiguous copy of an array; a replay copies again."""
        copy, array = held.launched, held.array
        self._core.keep(copy)
        self._core.note_array_copy(copy.ctypes.data, *_range_of(array))
        self._core.record(lambda: pieces.copy(copy, array), None)
        if held.is_written:
            self._staged.append(held)

    def after_launch(self) -> None:
        """Notes the arrays that a launch has changed. Called when it has been recorded and has
        run.
        """
        for held in self._staged:
            copy, array = held.launched, held.array
            self._core.record(lambda copy=copy, array=array: pieces.copy(array, copy), None)
        for held in self._changing:
            for watched in self._watched.values():
                if overlap(held.array, watched.held.array):
                    watched.renew()
            for sampled in self._sampled.values():
                if sampled.held.array is held.array:
                    sampled.renew(held.launched)
                elif overlap(held.array, sampled.held.array):
                    sampled.renew(np.ascontiguousarray(sampled.held.array))
        self.forget_launch()

    def forget_launch(self) -> None:
        """Forgets the next launch: it has failed, or its arrays have been noted."""
        self._staged.clear()
        self._changing.clear()

    def use_gradient(self, value: Any, buffer: Any) -> None:
        """Returns the memory to which the gradient of an argument is added."""
        taken = getattr(getattr(value, "grad", None), "taken", None)
        if taken is not None:
            self._take()(taken)  # type: ignore[misc]
        self._core.keep(buffer)
        self._launcher.note_taped_gradient(value, buffer.ctypes.data)
        if hasattr(value, "requires_grad"):
            self._gradients.setdefault(id(value), (value, value.grad))

    def end(self) -> None:
        """Ends the recording of arrays, when the tape records no more."""
        self._launcher.forget_taped_arrays()

    def find(self, array: np.ndarray, has_gradient: bool) -> str | None:
        """The description of a launch argument that forbids an access of Python to this array now,
        or None.

        A launch that got a copy of a constant array forbids nothing.
        """
        self._learn()
        for frozen in self._frozen.values():
            if has_gradient and overlap(frozen.held.array, array):
                return frozen.held.what
        for held in self._names.values():
            if overlap(held.array, array):
                return held.what
        return None

    def of_streams(self) -> list[device_arrays.DeviceArray]:
        """Returns a GPU array of each library."""
        is_known = self.streams or self._noted is None
        tensor = None if is_known else native.noted_on_device(self._noted)
        if tensor is not None:
            array: Any = device_arrays.as_device_array(tensor)
            self.streams[array.library] = array
        return list(self.streams.values())

    @property
    def restores(self) -> bool:
        """Whether a reverse sweep restores contents of arrays."""
        self._learn_changes()
        return bool(self._restored)

    def copy_restored(self) -> list[Any]:
        """Returns copies of the arrays whose contents a sweep restores."""
        self._learn_changes()
        return [_copy_of(array) for array in self._restored.values()]

    def check_versions(self) -> None:
        """Before a sweep over recorded launches: tensors, and arrays that kernels have written,
        must still have their recorded contents.

        Raises:
            TaiRuntimeError: torch or Python has changed one since.
        """
        self._learn_changes()
        for tensor, version in self._tensors.values():
            if _version(tensor) != version:
                raise TaiRuntimeError(
                    "a tensor was changed by its library after the tape had recorded, and the "
                    "gradient needs what it held",
                    "replay the tape forward and backward: tape.replay()",
                )
        for watched in self._watched.values():
            watched.check()

    def take_versions(self) -> None:
        """Called when the launches run forward again: from then on, the present contents of arrays
        and tensors count.
        """
        self._learn()
        for entry in self._tensors.values():
            entry[1] = _version(entry[0])
        for frozen in self._frozen.values():
            frozen.renew()

    def renew_digests(self) -> None:
        """Notes the contents of arrays anew, because the launches have run forward again."""
        for watched in self._watched.values():
            watched.renew()

    def check_gradients(self) -> None:
        """Each tensor must still have the gradient that the launches add to.

        One that torch has forgotten, as its optimisers do, begins with zeros again.
        """
        self._learn_changes()
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
