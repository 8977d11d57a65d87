"""Imports of submodules by the name of another package, in whose place a program put `tai`.

After `sys.modules["taichi"] = tai`, `from taichi.lang import impl` must give the module
`tai.lang.impl`, and not a second copy of it with classes of its own.
"""

import importlib
import importlib.machinery
import sys
from types import ModuleType
from typing import Any

_PACKAGE = __package__.partition(".")[0]


class _Loader:
    """An import loader that gives an existing module under its other name."""

    def __init__(self, module: ModuleType):
        self.module, self.spec = module, module.__spec__

    def create_module(self, spec: Any) -> ModuleType:
        return self.module

    def exec_module(self, module: ModuleType) -> None:
        module.__spec__ = self.spec  # the import system has put the alias's there


class _Finder:
    """An import finder for `other.module`, where `other` is another name of this package."""

    @staticmethod
    def find_spec(name: str, path: Any = None, target: Any = None) -> Any:
        head, _, rest = name.partition(".")
        if not rest or head == _PACKAGE or sys.modules.get(head) is not sys.modules[_PACKAGE]:
            return None
        try:
            module = importlib.import_module(f"{_PACKAGE}.{rest}")
        except ModuleNotFoundError:
            return None
        return importlib.machinery.ModuleSpec(name, _Loader(module))  # type: ignore[arg-type]


def install() -> None:
    """Adds the finder, once."""
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder())
