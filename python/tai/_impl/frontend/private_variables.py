"""Variables of a kernel that each iteration of a parallel loop may have for itself.

    t = 0.0
    for i in range(n):
        t = x[i] * 2
        y[i] = t

Every iteration assigns `t` before it reads it, and nothing reads it after the loop. So the
iterations need not share it.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable


class _Scan(ast.NodeVisitor):
    """Follows the statements of a block in order, and notes whether one of them may read the
    variable before each path to it has assigned it.

    Attributes:
        is_assigned: whether all paths to the present statement have assigned the variable.
        is_read: whether a statement may have read an earlier value.
    """

    def __init__(self, name: str):
        self.name = name
        self.is_assigned = self.is_read = False

    def block(self, statements: Iterable[ast.stmt]) -> None:
        for statement in statements:
            self.visit(statement)

    def visit_Name(self, node: ast.Name) -> None:
        if node.id == self.name and not self.is_assigned:
            self.is_read = True

    def visit_Assign(self, node: ast.Assign) -> None:
        self.visit(node.value)
        for target in node.targets:
            self._assign(target)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self.visit(node.value)
            self._assign(node.target)

    def visit_If(self, node: ast.If) -> None:
        self.visit(node.test)
        before = self.is_assigned
        self.block(node.body)
        then, self.is_assigned = self.is_assigned, before
        self.block(node.orelse)
        self.is_assigned = self.is_assigned and then

    def visit_For(self, node: ast.For) -> None:
        self.visit(node.iter)
        self._repeated(node.body, node.target)
        self.block(node.orelse)

    def visit_While(self, node: ast.While) -> None:
        self.visit(node.test)
        self._repeated(node.body, None)
        self.block(node.orelse)

    def visit_Continue(self, node: ast.Continue) -> None:
        self.is_assigned = True  # nothing follows on this path

    def visit_Break(self, node: ast.Break) -> None:
        self.is_assigned = True

    def visit_Return(self, node: ast.Return) -> None:
        self.generic_visit(node)
        self.is_assigned = True

    def _repeated(self, body: list[ast.stmt], target: ast.expr | None) -> None:
        """The body of a loop, which may run no time at all."""
        before = self.is_assigned
        if target is not None:
            self._assign(target)
        self.block(body)
        self.is_assigned = before

    def _assign(self, target: ast.expr) -> None:
        if isinstance(target, ast.Tuple | ast.List):
            for element in target.elts:
                self._assign(element)
        elif isinstance(target, ast.Name):
            self.is_assigned = self.is_assigned or target.id == self.name
        else:  # a component of the variable keeps the other ones
            self.visit(target)


def is_private(name: str, loop: ast.For, function: ast.FunctionDef) -> bool:
    """Whether each iteration of `loop`, which assigns the variable `name`, may have a variable of
    its own: none reads the value of another one, and no statement after the loop reads the last.
    """
    arguments = function.args
    parameters = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
    rest = _after(loop, function.body)
    if rest is None or any(p.arg == name for p in parameters):
        return False
    for statements in (loop.body, rest):
        scan = _Scan(name)
        scan.block(statements)
        if scan.is_read:
            return False
    return True


def _after(loop: ast.For, statements: list[ast.stmt]) -> list[ast.stmt] | None:
    """The statements that follow `loop` in a list of statements or in a branch of one of them; None
    if it is not there, or in a loop.
    """
    for number, statement in enumerate(statements):
        rest = statements[number + 1 :]
        if statement is loop:
            return rest
        if isinstance(statement, ast.If):
            for branch in (statement.body, statement.orelse):
                inner = _after(loop, branch)
                if inner is not None:
                    return inner + rest
    return None
