"""`ti.lang.impl`: the program behind the package."""

from __future__ import annotations

import sys
from typing import Any

from .._impl.base import program, state
from .._impl.base.options import Options
from .._impl.fields.arrays import ndarray
from .._impl.fields.make import field
from .._impl.fields.root import materialize, open_root, root
from .._impl.values.ops import grouped, ndrange, static


class Runtime:
    """What `get_runtime()` returns."""

    @property
    def prog(self) -> program.Program:
        return program.get_program()

    @property
    def materialized(self) -> bool:
        return not open_root(self.prog).children

    def materialize(self) -> None:
        """Allocates the fields that were placed in the layout."""
        materialize(self.prog, sys._getframe(1).f_globals)

    def sync(self) -> None:
        program.sync()

    @property
    def default_fp(self) -> Any:
        return state.options.default_fp

    @property
    def default_ip(self) -> Any:
        return state.options.default_ip


_runtime = Runtime()


def get_runtime() -> Runtime:
    return _runtime


def current_cfg() -> Options:
    """The options of `ti.init`."""
    return state.options


__all__ = [
    "Runtime", "current_cfg", "field", "get_runtime", "grouped", "ndarray", "ndrange", "root",
    "static",
]  # fmt: skip
