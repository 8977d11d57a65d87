"""The extension module `tai._core`, with libtai behind it, loaded when it is first needed.

Importing the package and creating types and matrices does not load it. Each name is looked up
once.
"""

from __future__ import annotations

import importlib
from typing import Any


def __getattr__(name: str) -> Any:
    if name.startswith("__"):
        raise AttributeError(name)
    value = getattr(importlib.import_module("tai._core"), name)
    globals()[name] = value
    return value
