"""Fields shared with other libraries, and copied to and from torch."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import TaiError
from ..base import native, pieces, state
from ..base.dtypes import bf16
from ..base.program import get_program
from .dlpack import CODES, CPU, CUDA
from .streams import wait_for_stream


def _storage(field: Any) -> Any:
    """Returns the scalar field whose memory holds all elements of the field."""
    field._placed_node()
    single = getattr(field, "single", field)
    if single is None or getattr(field, "is_window", False):
        raise BufferError(
            f"field '{field.name}' cannot be shared: its components lie apart; copy it, by "
            "to_numpy or to_torch"
        )
    if single._sharded is not None:
        raise BufferError(
            f"field '{field.name}' cannot be shared: processes have parts of it; copy it, by "
            "to_numpy or to_torch"
        )
    return single


def field_device(field: Any) -> tuple[int, int]:
    """Returns the kind and number of the device where a field is, as DLPack defines them."""
    _storage(field).materialize()
    return (CUDA, 0) if get_program().context.is_on_gpu() else (CPU, 0)


def check_on_host(field: Any) -> None:
    """Raises BufferError for a field in the memory of a GPU."""
    if field_device(field)[0] != CPU:
        raise BufferError(
            f"field '{field.name}' is on the GPU, where NumPy has no arrays; copy it, by to_numpy()"
        )


class Loan:
    """Keeps the memory of a field alive while another library uses it."""

    def __init__(self, owner: Any):
        self._owner = owner


def field_dlpack(
    field: Any, stream: Any, max_version: Any, dl_device: Any, copy: bool | None
) -> tuple[Any, Loan]:
    """Makes a DLPack capsule that shares the memory of a field, and an object that exists as long
    as the sharing.
    """
    device = field_device(field)
    if copy:
        raise BufferError("a field is shared as it is: copy what comes of it")
    if dl_device is not None and tuple(dl_device) == (CPU, 0):
        check_on_host(field)
    if dl_device is not None and tuple(dl_device) != device:
        raise BufferError(f"field '{field.name}' is on device {device}, not on {dl_device}")
    if field.dtype is bf16:
        raise BufferError(
            f"field '{field.name}' cannot be shared: it holds bf16; copy it, by to_numpy or "
            "to_torch, as f32"
        )
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
        # In this protocol, stream 1 is the default stream and 2 that of the thread; None means the
        # default stream.
        context.let_stream_wait(1 if stream is None else int(stream))
    strides = [step // size for step in steps]
    loan = Loan(owner)
    capsule = native.make_dlpack(
        address, list(shape), strides, CODES[field.dtype.kind], 8 * size, device[0], loan,
        max_version is not None and tuple(max_version) >= (1, 0),
    )  # fmt: skip
    return capsule, loan


def cuda_interface(field: Any) -> tuple[dict[str, Any], Loan]:
    """The memory of a field as `__cuda_array_interface__` describes it, and its loan."""
    try:
        address, _, steps, owner = _storage(field).core.lend()
    except (TaiError, BufferError) as error:
        raise AttributeError(str(error)) from None
    if field.dtype is bf16:
        raise AttributeError(f"field '{field.name}' holds bf16, which the interface does not know")
    # Stream 1 is the default stream, which is made to wait for the work on the field.
    get_program().context.let_stream_wait(1)
    shape = (*field.shape, *field.element_shape)
    found = {
        "shape": shape, "typestr": np.dtype(field.dtype.numpy).str, "data": (address, False),
        "strides": tuple(steps), "version": 3, "stream": 1,
    }  # fmt: skip
    return found, Loan(owner)


def place_of(field: Any) -> tuple[int, tuple[int, ...]]:
    """The address of the first element of a field, and the bytes from index to index."""
    address, _, steps, _ = _storage(field).core.lend()
    return address, steps


def owner_of(field: Any) -> Any:
    """Returns an object that keeps the memory of a field alive."""
    return _storage(field).core.lend()[3]


class _Lent:
    """A wrapper of a field for `torch.from_dlpack`, for a tensor that only exists during a copy."""

    def __init__(self, field: Any):
        self._field = field

    def __dlpack__(
        self, *, stream: Any = None, max_version: Any = None, dl_device: Any = None,
        copy: bool | None = None,
    ) -> Any:  # fmt: skip
        return field_dlpack(self._field, stream, max_version, dl_device, copy)[0]

    def __dlpack_device__(self) -> tuple[int, int]:
        return field_device(self._field)


def _shares_with(field: Any, tensor: Any) -> Any:
    """Makes a tensor that shares the memory of the field, if the field is on the device `tensor`;
    otherwise None.

    Torch's current stream waits for all launches so far.
    """
    import torch

    kind = {"cpu": CPU, "cuda": CUDA}.get(tensor.type)
    try:
        if (kind, tensor.index or 0) != field_device(field):
            return None
        return torch.from_dlpack(_Lent(field))
    except (BufferError, RuntimeError, TypeError):
        return None


def to_torch(field: Any, device: Any) -> Any:
    """Copies a field to a new torch tensor, directly on the GPU if possible."""
    import torch

    where = torch.device("cpu" if device is None else device)
    shared = _shares_with(field, where)
    if shared is None:
        tensor = torch.from_numpy(field.to_numpy())
        return tensor if device is None else tensor.to(where)
    copy = torch.empty_like(shared, memory_format=torch.contiguous_format)
    pieces.copy(copy, shared)
    if where.type == "cuda":
        # The next launch may change the field, so it waits for the stream of torch.
        wait_for_stream(torch.cuda.current_stream())
    return copy


def from_torch(field: Any, tensor: Any) -> None:
    """Copies a torch tensor into a field, directly on the GPU if possible."""
    import torch

    tensor = tensor.detach()
    wanted = (*field.shape, *field.element_shape)
    shared = None
    if tuple(tensor.shape) == wanted and state.tape is None and not state.forward:
        shared = _shares_with(field, tensor.device)
    if shared is None:
        # NumPy has no type bf16; f32 holds its numbers exactly.
        is_short = tensor.dtype == torch.bfloat16
        return field.from_numpy((tensor.float() if is_short else tensor).cpu().numpy())
    pieces.copy(shared, tensor)
    if tensor.device.type == "cuda":
        wait_for_stream(torch.cuda.current_stream())
    _storage(field).core.note_write()
