"""`ti.loop_config`: options of the loop that follows."""

from __future__ import annotations

import ast
from typing import Any

from ...errors import TaiTypeError, did_you_mean
from ..values.value import Value
from .block_sizes import check_block_dim
from .context import Context, Part


class LoopConfig(Part):
    """The part of the compiler that handles `ti.loop_config`: options of the next loop."""

    def __init__(self, context: Context):
        super().__init__(context)
        self._options: dict[str, Any] = {}

    def take(self) -> dict[str, Any]:
        """Returns the options for the loop that begins, and clears them, so that no other loop gets
        them.
        """
        options, self._options = self._options, {}
        return options

    def put_back(self, options: dict[str, Any]) -> None:
        """Keeps options that no loop has used for the next loop."""
        self._options = options

    def configure(self, node: ast.Call) -> None:
        if node.args:
            raise TaiTypeError("ti.loop_config takes keywords only")
        known = {"serialize", "parallelize", "block_dim", "block_dim_adaptive",
                 "bit_vectorize", "halo"}  # fmt: skip
        for keyword in node.keywords:
            if keyword.arg not in known:
                raise TaiTypeError(
                    f"ti.loop_config has no option '{keyword.arg}'",
                    did_you_mean(str(keyword.arg), known),
                )
            value = self.visit(keyword.value)
            if isinstance(value, Value):
                raise TaiTypeError("the options of a loop are known at compile time")
            if keyword.arg == "block_dim":
                value = check_block_dim(value, self.context.options)
            if keyword.arg == "halo":
                value = _halo_rows(value)
            self._options[keyword.arg] = value


def _halo_rows(value: Any) -> int:
    """The number of rows of a `halo`, -1 for all."""
    if value == "all":
        return -1
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise TaiTypeError(f"halo is a number of rows or 'all', but got {value!r}")
    return value
