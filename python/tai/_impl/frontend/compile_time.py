"""Compile-time values: `ti.static`, callees, sequences of known length."""

from __future__ import annotations

import ast
import itertools
from typing import Any

from ...errors import TaiSyntaxError, TaiTypeError
from ..fields.field import Field
from ..values import ops
from ..values.misuse import with_article
from ..values.value import MatrixValue, Value
from .atomics import takes_reference
from .context import Context, Part
from .refs import ArrayArgument, Variable
from .scope import Bound
from .structs import StructPlace, changes_struct

# A marker for a function that is known only when the surrounding code has been compiled.
_UNKNOWN = object()

# The least limit of unrolled iterations that `ti.init(unrolling_limit=…)` sets. In Taichi this
# option only gives a warning, and its default is 32.
_UNROLLING_LIMIT = 65536


class CompileTime(Part):
    """Evaluates names, `ti.static` and other expressions whose value is known while compiling.

    Attributes:
        in_static: the number of `ti.static(…)` around the expression; their arguments are meant to
            be evaluated once.
    """

    def __init__(self, context: Context):
        super().__init__(context)
        self.in_static = 0
        # For each method of a struct: whether it changes its struct.
        self._changing: dict[tuple, bool] = {}

    def static_argument(self, node: ast.expr) -> ast.expr | None:
        """Returns the argument of `ti.static(…)`, or None if `node` is another expression."""
        if not isinstance(node, ast.Call) or not isinstance(node.func, (ast.Name, ast.Attribute)):
            return None
        if self.static_callee(node.func) is not ops.static:
            return None
        if len(node.args) != 1 or node.keywords:
            if len(node.args) > 1:
                return ast.copy_location(ast.Tuple(node.args, ast.Load()), node)
            raise TaiSyntaxError("ti.static takes one argument")
        return node.args[0]

    def static_callee(self, node: ast.expr) -> Any:
        """The meaning of a name or dotted name, or None if it is not known."""
        if isinstance(node, ast.Name):
            try:
                meaning = self.frame.lookup(node.id)
            except NameError:
                return None
            return meaning.thing if isinstance(meaning, Bound) else None
        if isinstance(node, ast.Attribute):
            return self.attribute_of(self.static_callee(node.value), node.attr)
        return None

    def attribute_of(self, base: Any, name: str) -> Any:
        """Returns an attribute of an object that is known at compile time, or None."""
        if isinstance(base, StructPlace):
            return base.members.get(name, base.type.methods.get(name))
        return None if base is None or isinstance(base, Value) else getattr(base, name, None)

    def takes_reference(self, node: ast.Call) -> bool:
        """Whether a call may change the variables that it is given."""
        callee = self._callee(node.func)
        return callee is _UNKNOWN or takes_reference(callee)

    def _callee(self, node: ast.expr) -> Any:
        """The function that a call refers to: `_UNKNOWN` if it is known only when it is compiled.

        Such a function is an element of a list, or a name that is bound further inside.
        """
        if isinstance(node, ast.Subscript):
            return self._item(node)
        if isinstance(node, ast.Attribute):
            base = self._object(node.value)
            return base if base is _UNKNOWN else self.attribute_of(base, node.attr)
        if isinstance(node, ast.Name) and self.frame.find(node.id) is not None:
            return self.static_callee(node)
        is_local = (
            isinstance(node, ast.Name) and node.id in self.frame.function.__code__.co_varnames
        )
        return _UNKNOWN if is_local else self.static_callee(node)

    def _object(self, node: ast.expr) -> Any:
        """Evaluates the object before the dot of a call while compiling; a marker stands for an
        unknown object.
        """
        if isinstance(node, ast.Subscript):
            return self._item(node)
        if isinstance(node, ast.Attribute):
            base = self._object(node.value)
            return base if base is _UNKNOWN else self.attribute_of(base, node.attr)
        if isinstance(node, ast.Name) and self.frame.find(node.id) is None:
            if node.id in self.frame.unrolled:
                return _UNKNOWN
        return self.static_callee(node)

    def _item(self, node: ast.Subscript) -> Any:
        """Evaluates an item of a Python container while compiling; None for an element of a
        field.
        """
        container = self._object(node.value)
        if container is _UNKNOWN or not isinstance(container, (list, tuple, dict)):
            return container if container is _UNKNOWN else None
        try:
            return container[ast.literal_eval(node.slice)]
        except (ValueError, TypeError, LookupError):
            return _UNKNOWN

    def changes_receiver(self, node: ast.Call) -> bool:
        """Whether a call is of a method that may change the struct on which it is called."""
        if not isinstance(node.func, ast.Attribute):
            return False
        receiver = self.static_callee(node.func.value)
        return isinstance(receiver, StructPlace) and changes_struct(
            receiver.type, node.func.attr, self._changing
        )

    def is_settled(self, node: ast.Call) -> bool:
        """Whether the callee's name has a meaning that no assignment of this function changes.

        A local that is not assigned yet will mean something else when the call is compiled.
        """
        callee = node.func
        while isinstance(callee, ast.Attribute):
            callee = callee.value
        code = self.frame.function.__code__
        return isinstance(callee, ast.Name) and callee.id not in code.co_varnames + code.co_cellvars

    def evaluate(self, node: ast.expr) -> tuple[Any, bool]:
        """The value of an expression, and whether it is that of a `ti.static(…)`."""
        static = self.static_argument(node)
        return (self.visit(node), False) if static is None else (self.visit_static(static), True)

    def visit_static(self, node: ast.expr) -> Any:
        """Evaluates the argument of `ti.static(…)` once, at compile time."""
        self.in_static += 1
        try:
            return self.visit(node)
        finally:
            self.in_static -= 1

    def take_apart(self, thing: Any) -> list:
        """Returns the items of a sequence whose length is known at compile time."""
        if isinstance(thing, (Field, str)) or (
            isinstance(thing, Value) and not isinstance(thing, MatrixValue)
        ):
            raise TaiTypeError(f"{describe(thing)} cannot be taken apart")
        try:
            return list(thing)
        except TypeError:
            raise TaiTypeError(f"{describe(thing)} cannot be taken apart") from None

    def static_items(self, thing: Any) -> list:
        """Returns the items of an object over which a loop iterates at compile time."""
        if isinstance(thing, Value) and not isinstance(thing, MatrixValue):
            raise TaiTypeError(f"a number of type {thing.kind_name} cannot be iterated")
        if isinstance(thing, Field):
            raise TaiTypeError(
                f"field '{thing.name}' cannot be iterated at compile time",
                "loop over it at the top of a kernel: for i in x",
            )
        limit = self.context.options.unrolling_limit
        limit = max(limit, _UNROLLING_LIMIT) if limit > 0 else 0
        try:
            items = list(thing if limit <= 0 else itertools.islice(thing, limit + 1))
        except TypeError as error:
            raise TaiTypeError(f"{describe(thing)} cannot be iterated at compile time") from error
        if 0 < limit < len(items):
            raise TaiSyntaxError(
                f"more than {limit:,} iterations would be unrolled",
                "loop with range(…) instead, or raise the limit: ti.init(unrolling_limit=…)",
            )
        return items

    def bind_static(self, target: ast.expr, item: Any) -> None:
        """Assigns an item of an unrolled loop to the loop's target."""
        if isinstance(target, ast.Name):
            if isinstance(item, Value):
                self.frame.define(target.id, Variable(target.id, item, "loop variable"))
            else:
                self.frame.define(target.id, Bound(item))
            return
        if not isinstance(target, (ast.Tuple, ast.List)):
            raise TaiSyntaxError("the variables of a loop are names")
        parts = self.take_apart(item)
        if len(parts) != len(target.elts):
            raise TaiTypeError(f"{len(target.elts)} variables cannot take {len(parts)} values")
        for one, part in zip(target.elts, parts, strict=True):
            self.bind_static(one, part)


def describe(thing: Any) -> str:
    if isinstance(thing, Value):
        return f"a {thing.kind_name}"
    if isinstance(thing, (Field, ArrayArgument)):
        return f"{'field' if isinstance(thing, Field) else 'array'} '{thing.name}'"
    return f"'{thing}'" if isinstance(thing, str) else with_article(type(thing).__name__)
