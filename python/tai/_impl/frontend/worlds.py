"""Kernels of a batch: their statements stand for one world, and run for all of them.

A loop at the top of such a kernel gets one dimension more, in front of its own; statements between
loops become a loop over the worlds. Within these loops, a field of the batch has an index less than
its memory: that of the world.
"""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterable
from typing import Any

from ...errors import TaiIndexError, TaiSyntaxError
from ..fields.field import Field
from ..fields.scalar import ComponentField
from ..fields.structs import StructField
from ..fields.whole import WholeElements

# The name of the variable that says whether a world takes part; it is no valid name in Python.
ACTIVE = "(the world is active)"


class WorldLoop(ast.For):
    """A loop over the worlds of a batch, around statements that belong to one world."""


def batch_of(field: Any) -> Any:
    """Returns the batch that a field belongs to, or None."""
    while True:
        if isinstance(field, ComponentField):
            field = field._whole
        elif isinstance(field, WholeElements):
            field = field.field
        elif isinstance(field, Field) and field.primal is not None:
            field = field.primal
        else:
            break
    if isinstance(field, StructField):
        field = next(iter(field.members.values()))
        return batch_of(field)
    return getattr(field, "batch", None)


class Stack:
    """The worlds of a kernel whose arrays are given with one dimension more, in front.

    Attributes:
        names: of the parameters that are such arrays; others are the same for all worlds.
    """

    is_masked = False

    def __init__(self, names: Iterable[str]):
        self.names = frozenset(names)


class Worlds:
    """The worlds of the batch for which a kernel is compiled.

    Attributes:
        batch: the `ti.batch`, or a `Stack`.
        index: that of the world in the loop that is compiled, or None between loops.
        sized_by: an array whose first extent is the number of worlds, for a `Stack`.
    """

    def __init__(self, batch: Any):
        self.batch = batch
        self.index: Any = None
        self.sized_by: Any = None

    def size(self, emitter: Any) -> Any:
        """The number of worlds."""
        if not isinstance(self.batch, Stack):
            return self.batch.size
        return emitter.from_index(emitter.builder.extent(self.sized_by, emitter.index(0)))

    def is_stacked(self, name: str) -> bool:
        """Whether a parameter is an array with separate elements for each world."""
        return isinstance(self.batch, Stack) and name in self.batch.names

    def index_of_array(self, name: str) -> Any:
        """Returns the first index of an element of such an array: the number of the world.

        Raises:
            TaiSyntaxError: the statement does not belong to a world.
        """
        if self.index is None:
            raise TaiSyntaxError(
                f"array '{name}' has a part for each element of the batch, and this statement "
                "belongs to none of them",
                f"read {name} inside of the loop",
            )
        return self.index

    def has(self, field: Any) -> bool:
        """Whether a field has separate elements for each world."""
        return batch_of(field) is self.batch

    def indices(self, field: Any, indices: list[Any]) -> list[Any]:
        """Returns the indices of an element of a field in memory, where the world comes first.

        Raises:
            TaiSyntaxError: the statement does not belong to a world.
        """
        if not self.has(field):
            return indices
        if self.index is None:
            raise TaiSyntaxError(
                f"field '{field.name}' has a part for each world, and this statement is none of a "
                "world's: its result is used by loops of all worlds",
                f"read {field.name} inside of the loop",
            )
        count = len(field.shape) - 1
        if len(indices) != count:
            hint = f"a field of one element in each world is read as {field.name}[None]"
            raise TaiIndexError(
                f"field '{field.name}' has {count} dimension{'s' * (count != 1)} in each world, "
                f"but got {len(indices)} ind{'ices' if len(indices) != 1 else 'ex'}",
                hint if count == 0 else "leave the index of the world away",
            )
        return [self.index, *indices]


def single_world(field: Any) -> Any:
    """Returns the shape of a field of a batch within one world."""
    return tuple(field.shape[1:])


def statements_of(statements: list[ast.stmt], is_masked: bool) -> list[ast.stmt]:
    """The body of a kernel with a loop around each statement that belongs to a world."""
    assigned: Counter[str] = Counter()
    for statement in statements:
        assigned.update(_assigned_in(statement))
    loops = [node for node in statements if isinstance(node, ast.For)]
    inside = {name for loop in loops for name in _assigned_in(loop)}
    found: list[ast.stmt] = []
    group: list[ast.stmt] = []

    def close() -> None:
        if not group:
            return
        loop = WorldLoop(
            target=ast.Tuple(elts=[], ctx=ast.Store()), iter=ast.Tuple(elts=[], ctx=ast.Load()),
            body=_masked(list(group), is_masked), orelse=[],
        )  # fmt: skip
        for node in (loop, loop.target, loop.iter):
            ast.copy_location(node, group[0])
        found.append(loop)
        group.clear()

    for statement in statements:
        if isinstance(statement, ast.For):
            close()
            is_static = "static" in ast.unparse(statement.iter).split("(")[0]
            body = statements_of if is_static else _masked
            copied = ast.For(
                target=statement.target, iter=statement.iter, type_comment=None,
                body=body(statement.body, is_masked), orelse=statement.orelse,
            )  # fmt: skip
            found.append(ast.copy_location(copied, statement))
        elif _is_text(statement) or isinstance(statement, (ast.Pass, ast.Return)) or (
            loops and _is_uniform(statement, assigned, inside)
        ) or _is_loop_config(statement):  # fmt: skip
            close()
            found.append(statement)
        else:
            group.append(statement)
    close()
    return found


def _masked(statements: list[ast.stmt], is_masked: bool) -> list[ast.stmt]:
    if not is_masked:
        return statements
    test = ast.copy_location(ast.Name(id=ACTIVE, ctx=ast.Load()), statements[0])
    return [ast.copy_location(ast.If(test=test, body=statements, orelse=[]), statements[0])]


def _is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def _is_loop_config(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and "loop_config" in ast.unparse(node.value)


def _assigned_in(statement: ast.stmt) -> list[str]:
    nodes = ast.walk(statement)
    return [n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]


def _is_uniform(node: ast.stmt, assigned: Counter[str], inside: set[str]) -> bool:
    """Whether a statement is the only assignment to a name, so that the value is the same in the
    loops of all worlds.

    A name that loops change as well (`inside`) counts, too: it is refused there.
    """
    if not isinstance(node, ast.Assign) or len(node.targets) != 1:
        return False
    target = node.targets[0]
    if not isinstance(target, ast.Name):
        return False
    return assigned[target.id] == 1 or target.id in inside
