"""Statements that are written in terms of others: `match`, `else` of loops, `:=` in a `while`.

The rest of the compiler knows branches and loops only. The nodes that replace others keep their
places in the file.
"""

from __future__ import annotations

import ast
import copy
from typing import Any

from ...errors import TaiSyntaxError


def plain_definition(node: ast.FunctionDef, filename: str) -> ast.FunctionDef:
    """Returns a function definition without `match` statements and loops with `else`; `node` itself
    if it has none of them.

    Raises:
        TaiSyntaxError: a pattern that kernels do not know.
    """
    known = vars(node).get("_tai_plain")
    if known is None:
        known = node
        if any(map(_is_sugar, ast.walk(node))):
            known = _Desugar(filename).visit(copy.deepcopy(node))
            ast.fix_missing_locations(known)
        node._tai_plain = known  # type: ignore[attr-defined]
    return known


def _has_walrus(node: ast.expr) -> bool:
    return any(isinstance(part, ast.NamedExpr) for part in ast.walk(node))


def _is_sugar(node: ast.AST) -> bool:
    if isinstance(node, ast.While):
        return bool(node.orelse) or _has_walrus(node.test)
    return isinstance(node, ast.Match) or (isinstance(node, ast.For) and bool(node.orelse))


class _MarkBreaks(ast.NodeTransformer):
    """Inserts an assignment that sets the variable `name` to False before each `break` of the
    surrounding loop.
    """

    def __init__(self, name: str):
        self._name, self.found = name, False

    def visit_Break(self, node: ast.Break) -> Any:
        self.found = True
        return [_assign(self._name, ast.Constant(False), node), node]

    def visit_For(self, node: Any) -> Any:
        # A `break` in the `else` block of a nested loop leaves the surrounding loop.
        node.orelse = [s for o in node.orelse for s in _listed(self.visit(o))]
        return node

    visit_While = visit_For


class _Replace(ast.NodeTransformer):
    """Replaces names by expressions."""

    def __init__(self, by: dict[str, ast.expr]):
        self._by = by

    def visit_Name(self, node: ast.Name) -> Any:
        found = self._by.get(node.id)
        return node if found is None else ast.copy_location(copy.deepcopy(found), node)


def _placed(made: Any, node: Any) -> Any:
    """Gives the new nodes `made` the source location of `node`, except nodes that have a location
    already.
    """
    for part in ast.walk(made):
        if "lineno" in part._attributes and not hasattr(part, "lineno"):
            ast.copy_location(part, node)
    return made


def _assign(name: str, value: ast.expr, node: Any) -> ast.Assign:
    target = ast.Name(name, ast.Store())
    return _placed(ast.Assign(targets=[target], value=value, lineno=node.lineno), node)


class _Desugar(ast.NodeTransformer):
    def __init__(self, filename: str):
        self._filename, self._count = filename, 0

    def _name(self, what: str) -> str:
        """A variable name that no program can use, because it contains a dot."""
        self._count += 1
        return f"{what}.{self._count}"

    # Loops

    def visit_While(self, node: ast.While) -> Any:
        if _has_walrus(node.test):
            # The condition moves into the body, because a name that it assigns belongs to the body.
            test = _placed(ast.UnaryOp(ast.Not(), node.test), node.test)
            leave = _placed(ast.If(test=test, body=[ast.Break()], orelse=[]), node.test)
            loop = _placed(ast.While(ast.Constant(True), [leave, *node.body], []), node)
            if not node.orelse:
                return self.generic_visit(loop)
            name = self._name("completed")
            marked = _MarkBreaks(name)
            loop.body[1:] = [s for b in loop.body[1:] for s in _listed(marked.visit(b))]
            return self._completed(loop, name, node)
        return self.visit_For(node)

    def visit_For(self, node: Any) -> Any:
        if not node.orelse:
            return self.generic_visit(node)
        name = self._name("completed")
        marked = _MarkBreaks(name)
        node.body = [s for b in node.body for s in _listed(marked.visit(b))]
        if not marked.found:
            orelse, node.orelse = node.orelse, []
            return [self.generic_visit(node), *self._block(orelse)]
        return self._completed(node, name, node)

    def _completed(self, loop: Any, name: str, node: Any) -> list[ast.stmt]:
        orelse, loop.orelse = node.orelse, []
        test = _placed(ast.Name(name, ast.Load()), orelse[0])
        branch = _placed(ast.If(test=test, body=self._block(orelse), orelse=[]), orelse[0])
        return [_assign(name, ast.Constant(True), loop), self.generic_visit(loop), branch]

    def _block(self, statements: list[ast.stmt]) -> list[ast.stmt]:
        return [made for s in statements for made in _listed(self.visit(s))]

    # match

    def visit_Match(self, node: ast.Match) -> Any:
        first: list[ast.stmt] = []
        # A guard of a case may change a variable, but the subject of the `match` keeps the value
        # that it had.
        guards = any(case.guard is not None for case in node.cases)
        subject = self._subject(node.subject, first, guards)
        root: list[ast.stmt] = []
        tail = root
        for number, case in enumerate(node.cases):
            names: dict[str, ast.expr] = {}
            test = self._test(case.pattern, subject, names)
            body: list[ast.stmt] = [
                _assign(name, value, case.pattern) for name, value in names.items()
            ]
            body += self._block(case.body)
            if case.guard is not None:
                guard = _Replace(names).visit(case.guard)
                test = guard if test is None else _both(test, guard)
            if test is None:
                if number + 1 < len(node.cases):
                    self._refuse("the cases behind this one are never reached", case.pattern)
                tail += body
                break
            branch = _placed(ast.If(test=test, body=body, orelse=[]), case.pattern)
            tail.append(branch)
            tail = branch.orelse
        return first + root

    def _subject(self, node: ast.expr, first: list[ast.stmt], copies: bool) -> Any:
        """An expression for the subject of a `match` that is cheap to repeat; for a tuple, an
        expression for each item.
        """
        if isinstance(node, (ast.Tuple, ast.List)):
            return [self._subject(item, first, copies) for item in node.elts]
        if isinstance(node, ast.Constant) or (isinstance(node, ast.Name) and not copies):
            return node
        name = self._name("subject")
        first.append(_assign(name, node, node))
        return _placed(ast.Name(name, ast.Load()), node)

    def _test(self, pattern: ast.pattern, subject: Any, names: dict[str, ast.expr]) -> Any:
        """The condition that the subject of a `match` has the pattern, or None if it always has."""
        if isinstance(pattern, ast.MatchAs):
            inner = None if pattern.pattern is None else self._test(pattern.pattern, subject, names)
            if pattern.name is not None:
                names[pattern.name] = _expression(subject)
            return inner
        if isinstance(pattern, ast.MatchOr):
            tests = []
            for one in pattern.patterns:
                bound: dict[str, ast.expr] = {}
                test = self._test(one, subject, bound)
                if bound:
                    self._refuse("a pattern with '|' cannot give names in kernels", one)
                if test is None:
                    return None
                tests.append(test)
            return _placed(ast.BoolOp(ast.Or(), tests), pattern)
        if isinstance(pattern, ast.MatchSequence):
            if any(isinstance(one, ast.MatchStar) for one in pattern.patterns):
                self._refuse("kernels have no '*' in a pattern", pattern)
            if not isinstance(subject, list):
                self._refuse(
                    "a pattern of several parts is for a subject that is written as a tuple",
                    pattern, "match (v[0], v[1]):",
                )  # fmt: skip
            if len(subject) != len(pattern.patterns):
                return _placed(ast.Constant(False), pattern)
            found = None
            for one, part in zip(pattern.patterns, subject, strict=True):
                test = self._test(one, part, names)
                if test is not None:
                    found = test if found is None else _both(found, test)
            return found
        if isinstance(pattern, (ast.MatchValue, ast.MatchSingleton)):
            if isinstance(subject, list):
                return _placed(ast.Constant(False), pattern)
            is_none = isinstance(pattern, ast.MatchSingleton) and pattern.value is None
            value = pattern.value if isinstance(pattern, ast.MatchValue) else (
                ast.Constant(pattern.value)
            )  # fmt: skip
            operator = ast.Is() if is_none else ast.Eq()
            compare = ast.Compare(copy.deepcopy(subject), [operator], [value])
            return _placed(compare, pattern)
        self._refuse("kernels match numbers and tuples of numbers", pattern, "use if and elif")

    def _refuse(self, problem: str, node: Any, hint: str | None = None) -> Any:
        error = TaiSyntaxError(problem, hint)
        raise error.locate(self._filename, node.lineno, node.col_offset + 1)


def _both(one: ast.expr, other: ast.expr) -> ast.expr:
    return _placed(ast.BoolOp(ast.And(), [one, other]), one)


def _expression(subject: Any) -> ast.expr:
    if isinstance(subject, list):
        return ast.Tuple([_expression(item) for item in subject], ast.Load())
    return copy.deepcopy(subject)


def _listed(made: Any) -> list[Any]:
    return made if isinstance(made, list) else [made]
