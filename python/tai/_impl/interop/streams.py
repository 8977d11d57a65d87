"""Streams of other libraries, and their order with launches.

On a GPU each library queues its work in streams. Work on shared data is ordered between streams
by events on the GPU; the host does not wait.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

from ..base.program import get_program


def _torch() -> Any:
    """PyTorch, if the program has imported it and it has a GPU."""
    torch = sys.modules.get("torch")
    return torch if torch is not None and torch.cuda.is_available() else None


def _torch_stream(device: int) -> int:
    """Returns the address of torch's current stream."""
    torch = _torch()
    if torch is None:
        return 0
    # This function of torch, if it exists, needs no Python object for the stream.
    raw = getattr(torch._C, "_cuda_getCurrentRawStream", None)
    return torch.cuda.current_stream(device).cuda_stream if raw is None else raw(device)


# Finds the stream on which torch works.
_current_stream: Callable[[int], int] = _torch_stream


def set_current_stream(function: Callable[[int], int]) -> Callable[[int], int]:
    """Sets the function that says which stream tensors are computed on; returns the former
    function.

    Args:
        function: from the number of a GPU to the address of a stream.
    """
    global _current_stream
    before, _current_stream = _current_stream, function
    return before


def stream_number(stream: Any) -> int:
    if stream is None:
        return _current_stream(0)
    for name in ("cuda_stream", "ptr", "handle"):
        if hasattr(stream, name):
            return int(getattr(stream, name))
    return int(stream)


def wait_for_stream(stream: Any = None) -> None:
    """Launches from now on wait for the present work of a stream of CUDA.

    Needed where another library writes to a field that it shares, on a stream other than the
    default one. On the CPU it does nothing.

    Args:
        stream: of torch or cupy, or its address; None for torch's current stream.
    """
    get_program().context.wait_for_stream(stream_number(stream))


def let_stream_wait(stream: Any = None) -> None:
    """Work put on a stream of CUDA from now on waits for all launches so far."""
    get_program().context.let_stream_wait(stream_number(stream))
