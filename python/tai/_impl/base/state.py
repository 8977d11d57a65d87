"""The program that `ti.init` created, and the kernel that the front end is compiling.

A module of its own, so that every other module can read it without an import cycle. The C++
side has no global state: this is all of the package's. The active tape and the kernel being
compiled are thread-local.
"""

from __future__ import annotations

import sys
import threading
import types
from typing import Any

# The options of the last `ti.init`, or the defaults before.
options: Any = None
# The current program, which is made at its first use.
program: Any = None
# The number of kernels that have been defined in this process.
kernels_made: int = 0


# The state of the calling thread, with the members of `_State`.
emitter: Any
tape: Any
forward: bool
fp: Any
rounding: Any
version: Any
shadows: bool
thread: object


class _OfThread(threading.local):
    emitter: Any = None
    tape: Any = None
    forward: bool = False
    # How the linear solves ended that the tape of this thread has recorded.
    solves: Any = ()
    fp: Any = None
    rounding: Any = None
    version: Any = None
    shadows: bool = False

    def __init__(self) -> None:
        # An object that identifies the thread: no other thread has it, now or later.
        self.token = object()


of_thread = _OfThread()


class _State(types.ModuleType):
    """A module whose attributes include variables that differ from thread to thread.

    They are set in `of_thread`, in one step of the interpreter: a signal handler might raise at the
    first step of a function that sets them, or in a `finally` before they are reset.
    """

    @property
    def emitter(self) -> Any:
        """The emitter of the kernel that is being compiled, or None in Python scope."""
        return of_thread.emitter

    @property
    def forward(self) -> bool:
        """Whether the thread is in forward mode: kernels are launched with their tangents."""
        return of_thread.forward

    @property
    def fp(self) -> Any:
        """The type of `float` in the kernel that is being compiled, if it names one; else None."""
        return of_thread.fp

    @property
    def rounding(self) -> Any:
        """The factory of emitters for kernels that estimate their rounding errors, or None."""
        return of_thread.rounding

    @property
    def version(self) -> Any:
        """The types and modes that kernels are compiled for in the place of their own, or None."""
        return of_thread.version

    @property
    def shadows(self) -> bool:
        """Whether kernels are compiled with shadows, although the program's have none."""
        return of_thread.shadows

    @property
    def thread(self) -> object:
        """Returns an object that stands for the calling thread."""
        return of_thread.token

    @property
    def tape(self) -> Any:
        """Returns the tape that records this thread, or None."""
        return of_thread.tape


sys.modules[__name__].__class__ = _State
