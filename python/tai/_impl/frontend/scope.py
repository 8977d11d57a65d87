"""Scopes: the bindings of names while a function is compiled."""

from __future__ import annotations

import ast
import builtins
import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

from ...errors import TaiNameError, did_you_mean
from ..base import texts
from .refs import Variable
from .source import closure_of

# Python's built-in functions that have a meaning in kernels.
_BUILTINS = (
    "abs", "all", "any", "bool", "enumerate", "float", "int", "isinstance", "len", "list", "max",
    "min", "pow", "print", "range", "reversed", "round", "sum", "tuple", "zip",
)  # fmt: skip


class Bound:
    """A name that stands for a Python object: a field, a function, a list, a constant."""

    __slots__ = ("thing",)

    def __init__(self, thing: Any):
        self.thing = thing


class StaticBreak(Exception):
    """Raised for a `break` in a loop that is unrolled."""


class StaticContinue(Exception):
    """Raised for a `continue` in a loop that is unrolled."""


class Loop:
    """A loop that encloses the statement being compiled.

    Attributes:
        kind: `parallel`, `for`, `while` or `static`.
        depth: how many regions of the IR enclose its body.
        broken, skipped: flags that `break` and `continue` set, or None where the body has none.
        trips: iterations of a serial loop, infinite if only the run knows.
        names, carried: its indices, and the variables that its body changes.
    """

    def __init__(self, kind: str, depth: int):
        self.kind, self.depth = kind, depth
        self.broken: Variable | None = None
        self.skipped: Variable | None = None
        self.trips = math.inf
        self.names: Sequence[str] = ()
        self.carried: Sequence[Variable] = ()


def _is_static(node: ast.AST) -> bool:
    """Whether an expression has the form of a call of `ti.static`."""
    return isinstance(node, ast.Call) and "static" in (
        getattr(node.func, "attr", None),
        getattr(node.func, "id", None),
    )


class Frame:
    """A function that is being compiled: the kernel, or a `ti.func` inlined into it."""

    def __init__(self, function: Callable[..., Any], node: ast.FunctionDef, kind: str):
        self.function, self.node, self.kind = function, node, kind
        self.name = function.__name__
        self.filename = texts.text_of(function).filename
        self.globals = function.__globals__
        self.closure = closure_of(function)
        self.scopes: list[dict[str, Variable | Bound]] = [{}]
        # Names that were defined in inner blocks that have ended, with the line of the first
        # assignment.
        self.gone: dict[str, int] = {}
        self.loops: list[Loop] = []
        # For each branch and loop, the names that it assigns, once found.
        self.assigned: dict[ast.stmt, list[str]] = {}
        self.result: Any = None
        self.result_type: Any = None
        self.has_returned = False
        # The variables for the results of `return` inside of branches and loops; while the types of
        # the results are being found, the types found so far.
        self.results: Any = None
        self.form: Any = None
        self.depth = 0
        # Whether its loops run in order at the top of a kernel too.
        self.in_order = False
        self.call: tuple[str, int] | None = None

    @functools.cached_property
    def unrolled(self) -> set[str]:
        """Names that loops over `ti.static(…)` bind to constants or objects."""
        return {
            name.id
            for loop in ast.walk(self.node)
            if isinstance(loop, ast.For) and any(map(_is_static, ast.walk(loop.iter)))
            for name in ast.walk(loop.target)
            if isinstance(name, ast.Name)
        }

    def find(self, name: str) -> Variable | Bound | None:
        """Returns the local variable called `name`, innermost scope first, or None."""
        for scope in reversed(self.scopes):
            if name in scope:
                return scope[name]
        return None

    def lookup(self, name: str) -> Variable | Bound:
        """Finds what `name` stands for at this point of the kernel.

        Raises:
            TaiNameError: nothing.
        """
        found = self.find(name)
        if found is not None:
            return found
        for space in (self.closure, self.globals, vars(builtins)):
            if name in space:
                return Bound(space[name])
        if name in self.gone:
            raise TaiNameError(
                f"name '{name}' is not defined here",
                f"it is assigned in a block that has ended (line {self.gone[name]}): "
                "assign it before the block",
            )
        known = [*(n for scope in self.scopes for n in scope), *self.closure, *self.globals]
        hint = did_you_mean(name, known) or did_you_mean(name, _BUILTINS)
        raise TaiNameError(f"name '{name}' is not defined", hint)

    def define(self, name: str, meaning: Variable | Bound) -> None:
        self.scopes[-1][name] = meaning

    def push(self) -> None:
        self.scopes.append({})

    def pop(self, line: int) -> None:
        for name in self.scopes.pop():
            self.gone.setdefault(name, line)
