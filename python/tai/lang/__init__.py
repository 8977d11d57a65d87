"""Names of Taichi's internal modules that programs import.

They are loaded on first use: some need the extension module.
"""

import importlib
from types import ModuleType

from .._impl.base.keywords import missing_attribute

__all__ = [
    "enums", "exception", "field", "impl", "kernel_impl", "matrix", "misc", "ops", "snode", "util",
]  # fmt: skip


def __getattr__(name: str) -> ModuleType:
    if name in __all__:
        return importlib.import_module(f".{name}", __name__)
    raise missing_attribute(f"module 'tai.lang' has no attribute '{name}'", name, __all__)
