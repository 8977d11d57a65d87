"""The program that `ti.init` made, and what the front end is compiling now.

Kept in a module of its own, so that every other module can read it without an
import cycle. The C++ side has no global state: this is the package's one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ._frontend.emitter import Emitter
    from .program import Options, Program

# The options of the last `ti.init`, or the defaults before.
options: Options = None  # type: ignore[assignment]
# The program, made at the first use.
program: Program | None = None
# The emitter of the kernel that is being compiled, or None in Python scope.
emitter: Emitter | None = None
# The tape that is recording, or None.
tape: Any = None
# How many kernels have been defined.
kernels_made: int = 0
# Whether kernels are launched with their tangents.
forward: bool = False
