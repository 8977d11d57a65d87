"""Export of fields to other libraries, and import from them; see `interop`."""

from __future__ import annotations

from typing import Any

from ..base import state
from ..history import origins, torch_graphs
from ..interop import sharing

_UNSAID: Any = object()


class Shareable:
    """Gives fields the methods by which torch and DLPack share their memory."""

    def to_torch(self, device: Any = None) -> Any:
        """A copy as a torch tensor: on the GPU that kernels run on, without the host."""
        if state.tape is not None or state.forward:
            origins.note_read(self)
        return sharing.to_torch(self, device)

    def from_torch(self, tensor: Any) -> None:
        """Copies a torch tensor into the field: from that GPU, without the host.

        A `TaiGradientWarning` names the line if torch records and the tensor requires a gradient,
        which ends there: pass `tensor.detach()` where that is meant.
        """
        torch_graphs.warn_of_a_copy(self, tensor)
        sharing.from_torch(self, tensor)

    def __dlpack__(
        self, *, stream: Any = _UNSAID, max_version: Any = None, dl_device: Any = _UNSAID,
        copy: bool | None = None,
    ) -> Any:  # fmt: skip
        """The memory of the field for another library, by DLPack, without a copy.

        `torch.from_dlpack(x)` is a tensor that changes with the field, and the other way round;
        it outlives the field. On a GPU, the stream waits for the launches so far. Before a launch
        that uses data written on a stream other than the default one, call `ti.wait_for_stream()`.

        Raises:
            BufferError: a sparse field, or elements that do not lie evenly; or NumPy asks for a
                field on a GPU.
        """
        # This is how NumPy asks for the memory of a field. For memory on a GPU, its own error would
        # not name the field.
        if stream is _UNSAID and dl_device is None:
            sharing.check_on_host(self)
        stream = None if stream is _UNSAID else stream
        dl_device = None if dl_device is _UNSAID else dl_device
        capsule, loan = sharing.field_dlpack(self, stream, max_version, dl_device, copy)
        origins.note_view(self, loan, *sharing.place_of(self))
        return capsule

    def _lend_memory(self) -> Any:
        """Returns an object that keeps the memory of the field alive."""
        return sharing.owner_of(self)

    @property
    def __cuda_array_interface__(self) -> dict[str, Any]:
        """Describes the memory of a field on a GPU for CuPy and Numba; without a GPU there is no
        such attribute.

        It lives as long as the field. Work on streams other than the default one waits for
        launches by `ti.let_stream_wait`.
        """
        if sharing.field_device(self)[0] != sharing.CUDA:
            raise AttributeError("the field is on the CPU, and has no __cuda_array_interface__")
        found, self._lent = sharing.cuda_interface(self)
        origins.note_view(self, self._lent, *sharing.place_of(self))
        return found

    def __dlpack_device__(self) -> tuple[int, int]:
        """Tells DLPack where the field is: `(1, 0)` for the host, `(2, 0)` for the GPU."""
        return sharing.field_device(self)
