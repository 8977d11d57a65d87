"""Source locations of errors in kernels, and Python exceptions turned into errors of tai."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable
from typing import Any, TypeVar

from ...errors import (
    SHOW_TRACEBACK,
    TaiCompilationError,
    TaiError,
    TaiIndexError,
    TaiTypeError,
    shorten,
)
from ..base import texts
from ..base.handlers import is_of_a_handler
from ..values.misuse import KINDS, with_article
from .scope import Frame, StaticBreak, StaticContinue

Result = TypeVar("Result")

_OWN_CLASSES = (
    rf"(?<!')\b(?:{'|'.join(k for k in KINDS if k not in ('Value', 'Place'))})\b(?!')"
    + (r"|(?<=not )(?:Value|Place)$")
)


class Diagnostics:
    """Gives errors the place in the program where they occur.

    Args:
        frames: the functions that are compiled, innermost last.

    Attributes:
        last_node: the node that the operations which are made stand at.
        from_python: the exception of Python code that ended the compilation, as an error of ours.
    """

    def __init__(self, frames: list[Frame]):
        self._frames = frames
        self.last_node: Any = frames[0].node
        self.from_python: TaiError | None = None

    def guarded(self, method: Callable[[Any], Result], node: Any) -> Result:
        """Runs a method on a node and gives errors without a place that of the node."""
        try:
            return method(node)
        except TaiError as error:
            self.place(error, node)
            raise
        except (StaticBreak, StaticContinue):
            raise
        except Exception as error:
            if is_of_a_handler(error.__traceback__):
                raise
            raise self.translated(error, node) from (error if SHOW_TRACEBACK else None)

    def translated(self, error: Exception, node: ast.AST) -> TaiError:
        """An exception of Python code that ran at compile time, as one of ours."""
        kinds = {IndexError: TaiIndexError, KeyError: TaiIndexError, TypeError: TaiTypeError}
        kind = next((k for e, k in kinds.items() if isinstance(error, e)), TaiCompilationError)
        text = str(error) or type(error).__name__
        text = re.sub(r"'(\w+)'", lambda found: f"'{KINDS.get(found[1], found[1])}'", text)
        # Messages of Python name internal classes, as in "not StructValue": only these class names
        # are replaced, because a simple word could be a name of the program.
        text = re.sub(_OWN_CLASSES, lambda found: with_article(KINDS[found[0]]), text)
        # A message such as "MatrixValue.dot() missing …" names a class that the program does not
        # have.
        text = re.sub(r"^(\w+)\.(?=\w+\(\))", lambda f: "" if f[1] in KINDS else f[0], text)
        if isinstance(error, KeyError):
            text = f"no item {text}"
        elif isinstance(error, RecursionError):
            text = "the program nests too deeply"
        elif text.startswith("super()"):
            text = "super() does not know the class here"
        made = kind(text)
        if isinstance(error, RecursionError):
            made.hint = "divide it into functions, or long sums into several statements"
        elif text.startswith("super()"):
            made.hint = "name the class: Base.f(self, x)"
        elif isinstance(error, (AssertionError, AttributeError, RuntimeError)):
            made.hint = "TAI_TRACEBACK=1 in the environment shows where in Python this arose"
        self.place(made, node)
        self.from_python = made
        return made

    def place(self, error: TaiError, node: Any) -> None:
        if error.lineno is not None or not hasattr(node, "lineno"):
            return
        same_line = node.end_lineno == node.lineno
        error.locate(
            self._frames[-1].filename,
            node.lineno,
            self.column(node.lineno, node.col_offset) + 1,
            self.column(node.lineno, node.end_col_offset) + 1 if same_line else None,
        )
        error.source = self._line(node.lineno)
        error.trail = self.trail()

    def column(self, line: int, offset: int) -> int:
        """Returns a column in characters, whereas `ast` counts bytes."""
        text = self._line(line)
        return offset if text.isascii() else len(text.encode()[:offset].decode(errors="ignore"))

    def _line(self, line: int) -> str:
        lines = texts.text_of(self._frames[-1].function).lines
        return lines[line - 1] if line <= len(lines) else ""

    def trail(self) -> list[str]:
        """Lists the functions in which the code being compiled lies, innermost first."""
        lines = []
        for frame in reversed(self._frames):
            if frame.call is None:
                lines.append(f"in kernel '{frame.name}'")
            else:
                filename, line = frame.call
                lines.append(f"in function '{frame.name}', called at {shorten(filename)}:{line}")
        return lines[:6]
