"""Source lines of recorded kernels."""

from __future__ import annotations

import ast
from typing import Any

from ...errors import TaiSyntaxError, shorten
from ..base import state, texts

# Functions whose derivative is not finite everywhere.
_SINGULAR = {"sqrt", "rsqrt", "log", "pow", "acos", "asin", "atan2", "tan", "norm", "normalized",
             "inverse", "svd", "polar_decompose", "exp"}  # fmt: skip


def function_of(symbol: str | None) -> Any:
    """The Python function of a kernel by its name in the IR, or None."""
    program = state.program
    if symbol is None or program is None:
        return None
    functions = program.kernel_functions
    # A kernel whose loops are launched one by one has a number at the end of its name.
    return functions.get(symbol) or functions.get(symbol.split(".")[0])


class Place:
    """The source location of a record of a tape.

    Attributes:
        kernel: name of the kernel or host function.
        filename, lineno: of its definition, or None.
    """

    def __init__(self, core: Any, record: int):
        self.record = record
        self.symbol = core.kernel_of(record)
        self.function = function_of(self.symbol)
        self.is_host = self.symbol is None
        if self.is_host:
            host = core.host_function(record)
            self.function = getattr(host, "func", host)
        name = getattr(self.function, "__name__", None) or self.symbol or "host function"
        self.kernel = name
        code = getattr(self.function, "__code__", None)
        self.filename = code.co_filename if code else None
        self.lineno = code.co_firstlineno if code else None

    def __str__(self) -> str:
        what = "host function" if self.is_host else "kernel"
        text = f"{what} '{self.kernel}'"
        if self.filename:
            text += f" ({shorten(self.filename)}:{self.lineno})"
        return text

    def suspects(self) -> list[tuple[int, str]]:
        """Lines with operations whose derivative is not finite everywhere."""
        try:
            tree = texts.definition(self.function)
            lines = texts.text_of(self.function).lines
        except (AttributeError, TaiSyntaxError):
            return []
        found: dict[int, str] = {}
        for node in ast.walk(tree):
            name = None
            if isinstance(node, ast.Call):
                name = getattr(node.func, "attr", getattr(node.func, "id", None))
            elif isinstance(node, (ast.BinOp, ast.AugAssign)):
                if isinstance(node.op, (ast.Div, ast.Pow)):
                    name = "pow"
            if name in _SINGULAR:
                line = node.lineno  # type: ignore[attr-defined]
                found[line] = lines[line - 1].strip()
        return sorted(found.items())
