"""The syntax tree of a Python function, with the line numbers of its file."""

from __future__ import annotations

import ast
from collections.abc import Callable
from typing import Any

from ...errors import TaiSyntaxError
from ..base import texts
from .desugar import plain_definition


def function_ast(function: Callable[..., Any]) -> ast.FunctionDef:
    """Returns the syntax tree of `function`, as `desugar` leaves it.

    Raises:
        TaiSyntaxError: its source is not at hand, or has changed, or a pattern is refused.
    """
    found = texts.definition(function)
    if isinstance(found, ast.AsyncFunctionDef):
        raise TaiSyntaxError(
            f"'{function.__name__}' is an 'async def', and kernels have no coroutines", "write def"
        ).locate(function.__code__.co_filename, found.lineno, found.col_offset + 1)
    return plain_definition(found, texts.text_of(function).filename)


def closure_of(function: Callable[..., Any]) -> dict[str, Any]:
    """Returns the variables that `function` takes from the functions around it."""
    values = {}
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        try:
            values[name] = cell.cell_contents
        except ValueError:  # not assigned yet
            continue
    return values


def dotted(node: ast.expr) -> list[str] | None:
    """Returns the names in `a.b.c`, or None if `node` is another expression."""
    names: list[str] = []
    while isinstance(node, ast.Attribute):
        names.insert(0, node.attr)
        node = node.value
    return [node.id, *names] if isinstance(node, ast.Name) else None


def own_exits(statements: list[ast.stmt]) -> bool:
    """Whether the statements contain a `break` or `continue` of the loop around them."""
    for statement in statements:
        if isinstance(statement, (ast.Break, ast.Continue)):
            return True
        if isinstance(statement, ast.If) and (
            own_exits(statement.body) or own_exits(statement.orelse)
        ):
            return True
    return False


class AssignedNames(ast.NodeVisitor):
    """Collects the names of variables that some statements may change.

    Args:
        takes_reference: tells whether a call may change the variables given to it.
        changes_receiver: tells whether a call of a method may change its struct.
        is_settled: tells whether it will always say the same of a call.
        known: results for branches and loops that have been searched before. Without it, a chain of
            branches would be walked again for each of them.
    """

    def __init__(
        self,
        takes_reference: Callable[[ast.Call], bool],
        changes_receiver: Callable[[ast.Call], bool],
        is_settled: Callable[[ast.Call], bool],
        known: dict[ast.stmt, list[str]],
    ):
        self.names: dict[str, None] = {}  # in order of appearance
        self._takes_reference, self._changes_receiver = takes_reference, changes_receiver
        self._is_settled, self._known = is_settled, known
        self._settled = True

    def collect(self, statements: list[ast.stmt]) -> list[str]:
        for statement in statements:
            self.visit(statement)
        return list(self.names)

    def _target(self, node: ast.expr) -> None:
        while isinstance(node, (ast.Subscript, ast.Attribute, ast.Starred)):
            node = node.value
        if isinstance(node, ast.Name):
            self.names[node.id] = None
        elif isinstance(node, (ast.Tuple, ast.List)):
            for item in node.elts:
                self._target(item)

    def visit_Assign(self, node: ast.Assign) -> None:
        for target in node.targets:
            self._target(target)
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        self._target(node.target)
        self.generic_visit(node)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        self._target(node.target)
        self.generic_visit(node)

    def visit_NamedExpr(self, node: ast.NamedExpr) -> None:
        self._target(node.target)
        self.generic_visit(node)

    def visit_If(self, node: ast.stmt) -> None:
        names = self._known.get(node)
        if names is None:
            inside = AssignedNames(
                self._takes_reference, self._changes_receiver, self._is_settled, self._known
            )
            inside.generic_visit(node)
            names = list(inside.names)
            if inside._settled:
                self._known[node] = names
            else:
                self._settled = False
        self.names.update(dict.fromkeys(names))

    visit_While = visit_If

    def visit_Call(self, node: ast.Call) -> None:
        self._settled = self._settled and self._is_settled(node)
        if self._takes_reference(node):
            for argument in [*node.args, *(k.value for k in node.keywords)]:
                self._target(argument)
        if isinstance(node.func, ast.Attribute) and (
            node.func.attr == "fill" or self._changes_receiver(node)
        ):
            self._target(node.func.value)
        self.generic_visit(node)
