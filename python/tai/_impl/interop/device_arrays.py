"""Arrays of other libraries in GPU memory, and launches that use them."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from ...errors import TaiRuntimeError, TaiRuntimeTypeError
from ..base import native
from ..base.program import get_program
from .dlpack import CPU, CUDA, dtype_of
from .streams import stream_number, wait_for_stream


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
        # The stream of the library that the array comes from, or None for torch's current stream.
        self.library = stream
        self._owner, self._number = owner, number

    def check(self, what: str) -> None:
        """Raises an error if kernels cannot use the array."""
        context = get_program().context
        # An emulated GPU recognises addresses of its own memory.
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
        """The stream on which the array's library works at present."""
        return stream_number(self.library)

    def to_numpy(self) -> np.ndarray:
        raise TaiRuntimeError("an array on a GPU has no copy here", "ask its library for one")

    def __repr__(self) -> str:
        return f"<array of {self.dtype} on a GPU, shape {self.shape}>"


@functools.cache
def numpy_type(dtype: Any) -> np.dtype:
    """Returns NumPy's type for a type of torch.

    Raises:
        TaiRuntimeTypeError: it has none, as bfloat16.
    """
    name = str(dtype).removeprefix("torch.")
    try:
        found = np.dtype(name)
    except TypeError:
        found = None
    # Libraries add number types to NumPy: ml_dtypes, which jax loads, adds bfloat16.
    if found is None or found.isbuiltin != 1:
        raise TaiRuntimeTypeError(
            f"kernels have no numbers of type {name}, which the tensor holds",
            "convert it: t.float()",
        )
    return found


def as_device_array(value: Any) -> DeviceArray | None:
    """An array of torch, jax, cupy or another library on a GPU; None if it is not one."""
    if isinstance(value, DeviceArray):
        return value
    is_cuda = getattr(value, "is_cuda", None)  # of torch
    if is_cuda is False:
        return None  # Its `__cuda_array_interface__` would raise an error, which takes long.
    if is_cuda is True:
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


# Kinds of torch tensors whose elements are not stored contiguously: a test for each, and a hint.
_FORMS = [
    (lambda t: getattr(t, "is_meta", False), "has no memory (device 'meta')",
     "make it on a device: torch.empty_like(x, device='cpu')"),
    (lambda t: getattr(t, "is_quantized", False), "is quantized", "pass x.dequantize()"),
    (lambda t: getattr(t, "is_nested", False), "is nested", "pass x.to_padded_tensor(0.0)"),
    (lambda t: "strided" not in str(getattr(t, "layout", "strided")), "is sparse",
     "pass x.to_dense()"),
    (lambda t: getattr(t, "is_conj", bool)(), "is a conjugate that is computed later",
     "pass x.resolve_conj(), as two numbers: torch.view_as_real(…)"),
    (lambda t: getattr(t, "is_neg", bool)(), "is a negative that is computed later",
     "pass x.resolve_neg()"),
]  # fmt: skip


def find_form(tensor: Any) -> tuple[str, str] | None:
    """The reason and the hint if a tensor of torch is stored in no dense memory, or None."""
    for is_form, what, hint in _FORMS[:4]:
        if is_form(tensor):
            return what, hint
    return None


def is_of_jax(value: Any) -> bool:
    """Whether a value is an array of JAX, or a tracer that stands for one."""
    return type(value).__module__.split(".")[0] in ("jax", "jaxlib")


def _not_shared(value: Any, error: Exception | None) -> TaiRuntimeTypeError:
    """The error for an array whose library does not share its memory."""
    name = type(value).__name__
    if is_of_jax(value) and name.endswith("Tracer"):
        return TaiRuntimeTypeError(
            "an array that JAX traces has no memory, which a kernel could take",
            "within jit, grad and vmap, call a function that ti.jax.wrap makes of the kernel: see "
            "docs/guides/jax.md",
        )
    for is_form, what, hint in _FORMS:
        if is_form(value):
            return TaiRuntimeTypeError(f"the tensor {what}: kernels take dense memory", hint)
    reason = str(error).splitlines()[0] if str(error) else type(error).__name__
    return TaiRuntimeTypeError(
        f"the memory of a {name} cannot be shared: {reason}", "pass a dense copy on the CPU"
    )


def host_view(tensor: Any) -> np.ndarray:
    """The NumPy array that shares the memory of a tensor of torch.

    Raises:
        TaiRuntimeTypeError: it is of a form that has no dense memory.
    """
    try:
        return tensor.detach().numpy()
    except (RuntimeError, TypeError, ValueError, NotImplementedError) as error:
        raise _not_shared(tensor, error) from None


def from_exporter(value: Any) -> np.ndarray:
    """The NumPy array that shares the memory of an array on the CPU, by DLPack.

    Raises:
        TaiRuntimeTypeError: its library does not share it.
    """
    try:
        return np.from_dlpack(value)
    except (BufferError, RuntimeError, TypeError, ValueError, AttributeError) as error:
        raise _not_shared(value, error) from None


def from_dlpack(value: Any) -> Any:
    """An array of another library, without a copy, for kernels to use.

    Args:
        value: an object with `__dlpack__`: an array of torch, jax, cupy, NumPy.

    Returns:
        a NumPy array that shares the memory, or for memory of a GPU a `DeviceArray`, which
        kernels take as an argument. Launches wait for all work that its library has queued so far.

    Raises:
        TaiRuntimeTypeError: memory of another kind, or a type that kernels do not know.
    """
    if not hasattr(value, "__dlpack_device__"):
        raise TaiRuntimeTypeError(
            f"from_dlpack takes an array of another library, but got {value!r}",
            "it has __dlpack__, as arrays of NumPy, torch, jax and cupy have",
        )
    try:
        kind, number = value.__dlpack_device__()
    except (BufferError, RuntimeError, TypeError, ValueError) as error:
        raise _not_shared(value, error) from None
    if kind == CPU:
        return from_exporter(value)
    if kind != CUDA:
        raise TaiRuntimeTypeError(
            f"the array is on a device of kind {kind}, not on an NVIDIA GPU",
            "copy it to the CPU, or to a GPU by CUDA",
        )
    # The stream of the other library waits for its own work; this library's stream is told to wait
    # for that.
    found = native.take_dlpack(value.__dlpack__(stream=1))
    dt = dtype_of(*found["type"])
    if dt is None:
        raise TaiRuntimeTypeError("the array holds numbers of a type that kernels do not have")
    array = DeviceArray(
        found["address"], found["shape"], dt.numpy, found["owner"], found["strides"],
        not found["read_only"], number, stream=1,
    )  # fmt: skip
    array.check("the array")
    wait_for_stream(1)
    return array


def order_before(arrays: list[DeviceArray]) -> set[int]:
    """Makes the next launch wait for the streams of the libraries whose arrays it takes; returns
    the streams.
    """
    context = get_program().context
    streams = {array.stream() for array in arrays}
    for stream in streams:
        context.wait_for_stream(stream)
    return streams


def order_after(streams: set[int]) -> None:
    """Makes the streams of other libraries wait for the launch."""
    context = get_program().context
    for stream in streams:
        context.let_stream_wait(stream)
