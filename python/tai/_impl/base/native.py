"""The extension module `tai._core`, with libtai behind it, loaded when it is first needed.

Importing the package and creating types and matrices does not load it. Each name is looked up
once.
"""

from __future__ import annotations

import importlib
import importlib.machinery
import importlib.util
import os
import platform
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

# The platforms for which `make wheel` builds wheels.
WHEELS = "CPython 3.11 to 3.14 on Linux, x86-64, with glibc 2.35 or newer"

if TYPE_CHECKING:

    class WithBlock:
        """See python/src/WithBlock.cpp."""

        def __enter__(self) -> Any: ...
        def __exit__(self, kind: Any, error: Any, trace: Any) -> None: ...


def __getattr__(name: str) -> Any:
    if name.startswith("__"):
        raise AttributeError(name)
    try:
        value = getattr(importlib.import_module("tai._core"), name)
    except ImportError as error:
        raise ImportError(
            f"the compiled part of tai cannot be loaded: {error}; wheels are built for {WHEELS}"
        ) from None
    globals()[name] = value
    return value


def check_built() -> None:
    """Raises an error if this installation has no extension module for the running Python.

    Raises:
        ImportError: it names the interpreter, and those that have one.
    """
    package = os.path.dirname(sys.modules["tai"].__file__ or "")
    suffixes = importlib.machinery.EXTENSION_SUFFIXES
    if any(os.path.exists(os.path.join(package, f"_core{suffix}")) for suffix in suffixes):
        return
    if importlib.util.find_spec("tai._core"):  # an editable installation keeps it elsewhere
        return
    here = f"{platform.python_implementation()} {platform.python_version()}"
    here += f" on {platform.system()}, {platform.machine()}"
    built = sorted(path.name for path in Path(package).glob("_core*.so"))
    remedy = f"this installation has {', '.join(built)}" if built else "`make build` compiles it"
    raise ImportError(
        f"tai has no extension module for {here}: {remedy}; wheels are built for {WHEELS}"
    )
