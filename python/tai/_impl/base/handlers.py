"""Exceptions of signal handlers, which may come at any statement."""

from __future__ import annotations

import signal
from types import FunctionType, MethodType, TracebackType


def is_of_a_handler(trace: TracebackType | None) -> bool:
    """Whether a traceback belongs to an exception that the handler of a signal has raised."""
    handlers = {
        handler.__code__
        for handler in map(signal.getsignal, signal.valid_signals())
        if isinstance(handler, FunctionType | MethodType)
    }
    while trace is not None:
        if trace.tb_frame.f_code in handlers:
            return True
        trace = trace.tb_next
    return False
