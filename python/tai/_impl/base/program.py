"""The state between two calls of `ti.init`: the C++ context, trees, fields and kernels."""

from __future__ import annotations

import atexit
import sys
import weakref
from collections.abc import Callable
from typing import Any

from ...errors import TaiError, TaiRuntimeError
from . import native, state
from .locks import Lock, snapshot
from .options import Options, texts_of
from .symbols import Symbols
from .targets import cpu

# Functions that drop data when the program is reset; higher modules of the package add to this
# list.
at_close: list[Callable[[], None]] = []


class Program:
    """The state of the package between two calls of `ti.init`: fields, trees, kernels."""

    def __init__(self, options: Options):
        self.options = options
        self.context = native.Context()
        # The root of the tree that is being laid out under `ti.root`; see `fields.root`.
        self.root: Any = None
        # The roots of trees that were laid out and are not allocated yet.
        self.laid_out: list[Any] = []
        # A lock that is held while fields are placed under `ti.root`, so that no other thread
        # allocates an incomplete tree.
        self.layout = Lock()
        # The Python functions of kernels by symbol, for reports that name a line.
        functions: dict[str, Any] = {}
        self.kernel_functions = functions
        self.symbols = Symbols(self.context.has_kernel, lambda name: functions.pop(name, None))
        self.num_trees = 0
        # The roots of the allocated trees, by symbol.
        self.trees: dict[str, Any] = {}
        # The number of tapes whose reverse sweep has run, and the losses that were reported as NaN
        # or infinite.
        self.sweeps = 0
        self.told_losses: set[str] = set()
        # All fields by symbol, for diagnostics and for clearing gradients.
        self.fields: dict[str, Any] = {}
        self.kernels: weakref.WeakSet = weakref.WeakSet()
        # The memory in which forward mode keeps results of kernels; see `tracking.tangents`.
        self.pools: list[Any] = []
        # The probes by which a precision report measures roundings; see `ad.rounding`.
        self.probes: Any = None
        # Whether some of its kernels have had shadows.
        self.has_shadows = options.shadow
        self.count_kernels_from_here()
        # The numbers of lists that sparse levels had made and reused at the last `clear_skips`.
        self.lists_before: dict[Any, tuple[int, int]] = {}
        for name, text in texts_of(options).items():
            self.context.set_option(name, text)

    def close(self) -> None:
        """Frees all memory of a program, even if its fields and kernels are still referenced."""
        for field in snapshot(self.fields.values()):
            field.release()
        for kernel in snapshot(self.kernels):
            kernel.release()
        self.fields.clear()
        self.trees.clear()
        self.pools.clear()
        self.probes = None
        for forget in at_close:
            forget()

    def count_kernels_from_here(self) -> None:
        """Counts kernels from here on: the kernels that were defined so far are forgotten."""
        self.first_kernel = state.kernels_made

    def kernels_defined(self) -> int:
        """The number of kernels defined since the count began, and of earlier ones still in use."""
        earlier = sum(kernel.number < self.first_kernel for kernel in snapshot(self.kernels))
        return state.kernels_made - self.first_kernel + earlier

    def unique_symbol(self, wanted: str, is_hidden: bool = False) -> str:
        """A symbol that no tree, place or field of this program has; see `Symbols.take`."""
        return self.symbols.take(wanted, is_hidden)


def get_program() -> Program:
    """Returns the program, which is made with default options if `ti.init` was not called."""
    if state.program is None:
        state.program = Program(state.options)
    return state.program


state.options = Options()


def check_reset() -> None:
    """Refuses `ti.init` and `ti.reset` while a tape or forward mode is open.

    Raises:
        TaiRuntimeError: one is.
    """
    if state.tape is not None:
        raise TaiRuntimeError("the program cannot be reset inside a ti.ad.Tape")
    if state.forward:
        raise TaiRuntimeError("the program cannot be reset in forward mode")


def reset() -> None:
    """Forgets all fields and compiled kernels."""
    check_reset()
    if state.program is None:
        return
    _wait()
    native.next_generation()
    state.program.close()
    state.program = None


@atexit.register
def _wait() -> None:
    """Waits for the GPU before the program is destroyed, so that the output and the failures of its
    kernels appear.
    """
    if state.program is None or state.program.options.arch == cpu:
        return
    try:
        state.program.context.synchronize()
    except TaiError as error:
        print(f"[tai] a kernel has failed: {error}", file=sys.stderr)


@atexit.register
def _stop_background_work() -> None:
    """Ends background compilations, which must not outlive the libraries that they use.

    Programs are not always freed at the end: one whose tape is open is not.
    """
    core = sys.modules.get("tai._core")
    if core is not None:
        core.stop_background_work()


def sync() -> None:
    """Waits until all launches have run."""
    if state.program is not None:
        state.program.context.synchronize()
