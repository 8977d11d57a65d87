"""Arrays and fields shared with other libraries: DLPack, torch, and the order of their work.

On a GPU each library queues its work in streams. What crosses from one to the other is put in
order by events on the GPU, and the host waits for nothing.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from . import _state, dtypes
from .errors import TaiError, TaiRuntimeError, TaiRuntimeTypeError
from .program import get_program

CPU, CUDA = 1, 2
_CODES = {"i": 0, "u": 1, "f": 2, "b": 6}


def _dtype_of(code: int, bits: int, lanes: int) -> dtypes.DataType | None:
    for name, known in _CODES.items():
        if known == code and lanes == 1:
            wanted = 1 if name == "b" else bits
            for dt in dtypes.all_types:
                if dt.kind == name and dt.bits == wanted:
                    return dt
    return None


# Streams


def _torch() -> Any:
    """PyTorch, if the program has imported it and it has a GPU."""
    torch = sys.modules.get("torch")
    return torch if torch is not None and torch.cuda.is_available() else None


def _torch_stream(device: int) -> int:
    """The address of torch's current stream."""
    torch = _torch()
    if torch is None:
        return 0
    # Without an object for the stream, if this torch has such a function.
    raw = getattr(torch._C, "_cuda_getCurrentRawStream", None)
    return torch.cuda.current_stream(device).cuda_stream if raw is None else raw(device)


# What says on which stream torch works.
_current_stream: Callable[[int], int] = _torch_stream


def set_current_stream(function: Callable[[int], int]) -> Callable[[int], int]:
    """Lets another function say on which stream tensors are worked on; returns the one before.

    Args:
        function: from the number of a GPU to the address of a stream.
    """
    global _current_stream
    before, _current_stream = _current_stream, function
    return before


def _stream_number(stream: Any) -> int:
    if stream is None:
        return _current_stream(0)
    for name in ("cuda_stream", "ptr", "handle"):
        if hasattr(stream, name):
            return int(getattr(stream, name))
    return int(stream)


def wait_for_stream(stream: Any = None) -> None:
    """What is launched from now on waits for what a stream of CUDA holds now.

    Needed where another library writes to a field that it shares, on a stream other than the
    default one. On the CPU it does nothing.

    Args:
        stream: of torch or cupy, or its address; None for torch's current stream.
    """
    get_program().context.wait_for_stream(_stream_number(stream))


def let_stream_wait(stream: Any = None) -> None:
    """What a stream of CUDA is given from now on waits for all launches so far."""
    get_program().context.let_stream_wait(_stream_number(stream))


# Fields to others


def _storage(field: Any) -> Any:
    """The place that holds all of the field."""
    single = getattr(field, "single", field)
    if single is None or getattr(field, "is_window", False):
        raise BufferError(
            f"field '{field.name}' cannot be shared: its components lie apart; copy it, by "
            "to_numpy or to_torch"
        )
    field._placed_node()
    return single


def field_device(field: Any) -> tuple[int, int]:
    """Kind and number of the device, as DLPack has them."""
    _storage(field).materialize()
    return (CUDA, 0) if get_program().context.is_on_gpu() else (CPU, 0)


def field_dlpack(
    field: Any, stream: Any, max_version: Any, dl_device: Any, copy: bool | None
) -> Any:
    """The capsule of a field, which shares its memory."""
    device = field_device(field)
    if copy:
        raise BufferError("a field is shared as it is: copy what comes of it")
    if dl_device is not None and tuple(dl_device) != device:
        raise BufferError(f"field '{field.name}' is on device {device}, not on {dl_device}")
    single = _storage(field)
    context = get_program().context
    try:
        address, _, steps, owner = single.core.lend()
    except TaiError as error:
        raise BufferError(str(error)) from None
    size = 1 if field.dtype.is_bool else field.dtype.bits // 8
    shape = (*field.shape, *field.element_shape)
    if any(step % size for step, extent in zip(steps, shape, strict=True) if extent > 1):
        raise BufferError(f"field '{field.name}' cannot be shared: its elements are not aligned")
    if device[0] == CUDA and stream != -1:
        # 1 is the default stream, 2 that of the thread; None means the former.
        context.let_stream_wait(1 if stream is None else int(stream))
    strides = [step // size for step in steps]
    from . import _core

    return _core.make_dlpack(
        address, list(shape), strides, _CODES[field.dtype.kind], 8 * size, device[0], owner,
        max_version is not None and tuple(max_version) >= (1, 0),
    )  # fmt: skip


def _shares_with(field: Any, tensor: Any) -> Any:
    """A tensor that shares the memory of the field, if it is where `tensor` is; else None.

    Torch's current stream waits for what has been launched.
    """
    import torch

    kind = {"cpu": CPU, "cuda": CUDA}.get(tensor.type)
    try:
        if (kind, tensor.index or 0) != field_device(field):
            return None
        return torch.from_dlpack(field)
    except (BufferError, RuntimeError, TypeError):
        return None


def to_torch(field: Any, device: Any) -> Any:
    """A copy as a torch tensor, from device to device where it can be."""
    import torch

    where = torch.device("cpu" if device is None else device)
    shared = _shares_with(field, where)
    if shared is None:
        tensor = torch.from_numpy(field.to_numpy())
        return tensor if device is None else tensor.to(where)
    copy = shared.clone(memory_format=torch.contiguous_format)
    if where.type == "cuda":
        # What is launched next may change the field.
        wait_for_stream(torch.cuda.current_stream())
    return copy


def from_torch(field: Any, tensor: Any) -> None:
    """Copies a torch tensor into a field, from device to device where it can be."""
    tensor = tensor.detach()
    wanted = (*field.shape, *field.element_shape)
    shared = None
    if tuple(tensor.shape) == wanted and _state.tape is None and not _state.forward:
        shared = _shares_with(field, tensor.device)
    if shared is None:
        return field.from_numpy(tensor.cpu().numpy())
    import torch

    shared.copy_(tensor)
    if tensor.device.type == "cuda":
        wait_for_stream(torch.cuda.current_stream())
    _storage(field).core.note_write()


# Arrays of others


class DeviceArray:
    """An array in the memory of a GPU, which kernels take as they take NumPy arrays.

    Attributes:
        dtype: NumPy's name of the type.
        shape: the extents.
    """

    class _Address:
        def __init__(self, data: int):
            self.data = data

    class _Flags:
        def __init__(self, is_dense: bool, is_writeable: bool):
            self.c_contiguous, self.writeable = is_dense, is_writeable

    def __init__(
        self, address: int, shape: Any, dtype: Any, owner: Any, strides: Any = None,
        is_writeable: bool = True, number: int = 0, stream: Any = None,
    ):  # fmt: skip
        self.shape, self.dtype = tuple(int(n) for n in shape), np.dtype(dtype)
        self.ndim = len(self.shape)
        self.ctypes = DeviceArray._Address(address)
        dense, step = True, 1
        steps = None if strides is None else strides[::-1]
        for place, extent in enumerate(self.shape[::-1]):
            dense &= steps is None or extent <= 1 or steps[place] == step
            step *= extent
        dense |= step == 0
        self.flags = DeviceArray._Flags(dense, is_writeable)
        self.nbytes = step * self.dtype.itemsize
        # Of the library that it comes from: a stream, or None for torch's current one.
        self.library = stream
        self._owner, self._number = owner, number

    def check(self, what: str) -> None:
        """Raises where kernels cannot use it."""
        context = get_program().context
        # An emulated GPU knows its own memory.
        if not context.is_on_gpu() and not (
            self.nbytes == 0 or context.is_on_device(self.ctypes.data)
        ):
            raise TaiRuntimeTypeError(
                f"{what} is on a GPU, and kernels run on the CPU",
                "copy it to the CPU, or use ti.init(arch=ti.cuda)",
            )
        if self._number != 0:
            raise TaiRuntimeTypeError(
                f"{what} is on GPU number {self._number}, and kernels run on number 0",
                "choose one for all by the environment variable CUDA_VISIBLE_DEVICES",
            )
        if not self.flags.c_contiguous:
            raise TaiRuntimeTypeError(
                f"{what} is not contiguous", "pass a contiguous copy of it: t.contiguous()"
            )

    def stream(self) -> int:
        """The stream on which its library works now."""
        return _stream_number(self.library)

    def to_numpy(self) -> np.ndarray:
        raise TaiRuntimeError("an array on a GPU has no copy here", "ask its library for one")

    def __repr__(self) -> str:
        return f"<array of {self.dtype} on a GPU, shape {self.shape}>"


@functools.cache
def numpy_type(dtype: Any) -> np.dtype:
    """NumPy's name for a type of torch.

    Raises:
        TaiRuntimeTypeError: it has none, as bfloat16.
    """
    name = str(dtype).removeprefix("torch.")
    try:
        return np.dtype(name)
    except TypeError:
        raise TaiRuntimeTypeError(
            f"kernels have no numbers of type {name}, which the tensor holds",
            "convert it: t.float()",
        ) from None


def as_device_array(value: Any) -> DeviceArray | None:
    """An array of torch, jax, cupy or another library on a GPU; None if it is not one."""
    if isinstance(value, DeviceArray):
        return value
    if getattr(value, "is_cuda", None) is True:  # torch
        value = value.detach()
        return DeviceArray(
            value.data_ptr(), value.shape, numpy_type(value.dtype), value,
            value.stride(), number=value.device.index or 0,
        )  # fmt: skip
    interface = getattr(value, "__cuda_array_interface__", None)
    if interface is None:
        return None
    address, is_read_only = interface["data"]
    dtype = np.dtype(interface["typestr"])
    steps = interface.get("strides")
    strides = None if steps is None else tuple(step // dtype.itemsize for step in steps)
    stream = interface.get("stream")
    return DeviceArray(
        address, interface["shape"], dtype, value, strides, not is_read_only,
        stream=1 if stream is None else stream,
    )  # fmt: skip


def from_dlpack(value: Any) -> Any:
    """An array of another library, without a copy, for kernels to use.

    Args:
        value: what has `__dlpack__`: an array of torch, jax, cupy, NumPy.

    Returns:
        a NumPy array that shares the memory, or for memory of a GPU a `DeviceArray`, which
        kernels take as an argument. Launches wait for what its library has queued so far.

    Raises:
        TaiRuntimeTypeError: memory of another kind, or a type that kernels do not know.
    """
    kind, number = value.__dlpack_device__()
    if kind == CPU:
        return np.from_dlpack(value)
    if kind != CUDA:
        raise TaiRuntimeTypeError(f"the array is on a device of kind {kind}, not on an NVIDIA GPU")
    from . import _core

    # Its stream waits; ours is told to wait for that.
    found = _core.take_dlpack(value.__dlpack__(stream=1))
    dt = _dtype_of(*found["type"])
    if dt is None:
        raise TaiRuntimeTypeError("the array holds numbers of a type that kernels do not have")
    array = DeviceArray(
        found["address"], found["shape"], dt.numpy, found["owner"], found["strides"],
        not found["read_only"], number, stream=1,
    )  # fmt: skip
    array.check("the array")
    wait_for_stream(1)
    return array


# Launches


def order_before(arrays: list[DeviceArray]) -> set[int]:
    """The next launch waits for the libraries of its arrays; their streams."""
    context = get_program().context
    streams = {array.stream() for array in arrays}
    for stream in streams:
        context.wait_for_stream(stream)
    return streams


def order_after(streams: set[int]) -> None:
    """Those wait for the launch."""
    context = get_program().context
    for stream in streams:
        context.let_stream_wait(stream)
