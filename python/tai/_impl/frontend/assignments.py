"""Assignments to variables and elements, and rebinding of names."""

from __future__ import annotations

import ast
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from ...errors import TaiSyntaxError, TaiTypeError
from ..fields.field import Field
from ..fields.structs import Struct
from ..values.misuse import describe_misuse, misuse_hint
from ..values.value import Value
from .checks import Checks, refuse_non_number
from .compile_time import CompileTime
from .context import Context, Part
from .expressions import Expressions
from .operators import BINARY
from .refs import Place, Variable, VariablePlace, refuse_truth_arithmetic
from .scope import Bound
from .structs import Reference, StructPlace, StructValue, StructVariable, as_struct_value

_ATOMIC_ASSIGN = {"+", "-", "&", "|", "^"}


class Assignments(Part):
    """The part of the compiler that handles assignments.

    Args:
        context, compile_time, checks, expressions: other parts of the compiler, which it uses.
    """

    def __init__(
        self, context: Context, compile_time: CompileTime, checks: Checks, expressions: Expressions
    ):
        super().__init__(context)
        self.compile_time, self.checks, self.expressions = compile_time, checks, expressions

    def visit_Assign(self, node: ast.Assign) -> None:
        value, is_static = self.compile_time.evaluate(node.value)
        for target in node.targets:
            self.at(node)
            self.guarded(lambda t: self.assign(t, value, node, is_static), target)

    def visit_NamedExpr(self, node: ast.NamedExpr) -> Any:
        value, is_static = self.compile_time.evaluate(node.value)
        self.at(node)
        self.assign_name(node.target.id, value, is_static)
        return self.visit(ast.copy_location(ast.Name(node.target.id, ast.Load()), node))

    def assign(self, target: ast.expr, value: Any, node: ast.stmt, is_static: bool = False) -> None:
        if isinstance(target, (ast.Tuple, ast.List)):
            self.unpack(target, value, node, is_static)
            return
        if isinstance(target, ast.Name):
            self.assign_name(target.id, value, is_static)
            return
        if isinstance(target, ast.Starred):
            raise TaiSyntaxError("'*' in the target of an assignment is not supported in kernels")
        place = self.expressions.locate(target)
        self.at(node)
        if isinstance(place, Value):
            raise TaiTypeError(
                f"'{ast.unparse(target)}' is part of a value without a place, which cannot change",
                "give it a name: b = …, and change that of b",
            )
        if not isinstance(place, Place):
            self.assign_item(target, lambda old: value)
            return
        place.store(place.convert(self.expressions.number(value)))

    def unpack(self, target: ast.Tuple | ast.List, value: Any, node: Any, is_static: bool) -> None:
        items = self.compile_time.take_apart(value)
        if any(isinstance(t, ast.Starred) for t in target.elts):
            raise TaiSyntaxError("'*' in the target of an assignment is not supported in kernels")
        if len(items) != len(target.elts):
            raise TaiTypeError(f"{len(target.elts)} targets cannot take {len(items)} values")
        for one, item in zip(target.elts, items, strict=True):
            self.guarded(partial(self.assign, value=item, node=node, is_static=is_static), one)

    def assign_name(self, name: str, value: Any, is_static: bool) -> None:
        meaning = self.frame.find(name)
        if isinstance(value, Struct) and not is_static:
            value = as_struct_value(self.emitter, value)
        if isinstance(meaning, Variable):
            place = VariablePlace(self.emitter, meaning)
            place.store(place.convert(self.expressions.number(value)))
            return
        if isinstance(meaning, Reference):
            meaning.store(value)
            return
        if isinstance(value, StructValue) and meaning is None and not is_static:
            self.frame.define(name, StructVariable(self.emitter, name, value))
            return
        if meaning is None and not is_static:
            self.checks.warn_of_hidden_field(name)
        is_number = isinstance(value, (Value, bool, int, float, np.generic)) or getattr(
            value, "is_matrix", False
        )
        is_outer = meaning is not None and self.frame.scopes[-1].get(name) is None
        if is_outer and self.context.depth > 0:
            raise TaiTypeError(
                f"'{name}' is known at compile time outside of this block and cannot change in it",
                "give it another name",
            )
        if is_static or not is_number:
            self.frame.define(name, Bound(value))
            return
        self.frame.define(name, Variable(name, self.emitter.as_value(value)))

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is None:
            raise TaiSyntaxError("a variable needs a value", f"{ast.unparse(node)} = 0")
        if not isinstance(node.target, ast.Name):
            raise TaiSyntaxError("only variables are annotated")
        dtype = self.emitter.to_dtype(self.visit(node.annotation))
        if self.frame.find(node.target.id) is not None:
            raise TaiSyntaxError(f"variable '{node.target.id}' has its type already")
        value = self.visit(node.value)
        self.at(node)
        self.emitter.check_fraction(value, dtype, f"variable '{node.target.id}' of type {dtype}")
        if isinstance(value, (bool, int, float)):
            value = self.emitter.constant(value, dtype)
        else:
            value = self.emitter.cast(self.emitter.as_value(value), dtype)
        self.frame.define(node.target.id, Variable(node.target.id, value))

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        value = self.visit(node.value)
        op = BINARY[type(node.op)]
        place = self.guarded(self.expressions.locate, node.target)
        self.at(node)
        if not isinstance(place, Place):
            self.augment_static(node, op, place, value)
            return
        refuse_non_number(value, (value,))
        if isinstance(place, StructPlace):
            raise TaiTypeError("structs have no arithmetic", "compute with their members")
        value = self.expressions.number(value)
        refuse_truth_arithmetic(op, place.dt)
        if op in "+-":
            self.checks.warn_of_stopped_counter(node, place, value)
        if op in _ATOMIC_ASSIGN and place.dt.is_float and op in "&|^":
            raise TaiTypeError(f"'{op}=' takes whole numbers, but the target holds {place.dt}")
        if op not in _ATOMIC_ASSIGN or isinstance(place, VariablePlace):
            if (
                isinstance(place, VariablePlace)
                and place.variable.hidden is not None
                and (op in _ATOMIC_ASSIGN)
            ):
                place.atomic(op, place.convert(value))
                return
            if op in _ATOMIC_ASSIGN and place.dt.is_int:
                value = place.convert(value)  # as for elements of fields
            place.store(place.convert(self.emitter.binary(op, place.load(), value)))
            return
        place.atomic(op, place.convert(value))

    def augment_static(self, node: ast.AugAssign, op: str, old: Any, value: Any) -> None:
        """Compiles `a += …` where `a` is known at compile time."""
        if (
            isinstance(node.target, ast.Name)
            and isinstance(self.frame.find(node.target.id), Bound)
            and not isinstance(old, Field)
        ):
            self.frame.define(node.target.id, Bound(self.emitter.binary(op, old, value)))
            return
        if isinstance(old, Field):
            raise TaiTypeError(describe_misuse(old), misuse_hint(old))
        self.assign_item(node.target, lambda old: self.emitter.binary(op, old, value))

    def refuse_second_name(self, items: list) -> None:
        """Refuses to change a list to which another name refers as well.

        In Python that would change, too; in kernels of Taichi, where lists are copied, not.
        """

        def refers(thing: Any) -> bool:
            if thing is items:
                return True
            return isinstance(thing, (list, tuple)) and any(refers(inner) for inner in thing)

        bound = [
            name
            for frame in self.context.frames
            for scope in frame.scopes
            for name, meaning in scope.items()
            if isinstance(meaning, Bound) and refers(meaning.thing)
        ]
        if len(bound) > 1:
            raise TaiTypeError(
                f"a list that is '{bound[0]}' and '{bound[-1]}' cannot change",
                "copy it first, as in b = list(a), or make it a vector: ti.Vector([…])",
            )

    def assign_item(self, target: ast.expr, change: Callable[[Any], Any]) -> None:
        """`a[1] = …` where `a` is a list that the program makes in this block."""
        base = target.value if isinstance(target, ast.Subscript) else None
        local = self.frame.find(base.id) if isinstance(base, ast.Name) else None
        items: Any = local.thing if isinstance(local, Bound) else None
        is_list = isinstance(items, list)
        if isinstance(target, ast.Subscript) and is_list and self.checks.may_change(items):
            key = self.visit(target.slice)
            old = items[key] if isinstance(key, int) else None
            if isinstance(old, (Value, bool, int, float)):
                self.refuse_second_name(items)
                # The item keeps its type, like a variable.
                item = Variable(ast.unparse(target), self.emitter.as_value(old))
                place = VariablePlace(self.emitter, item)
                place.store(place.convert(self.expressions.number(change(old))))
                items[key] = item.value
                return
        raise TaiTypeError(
            f"a kernel cannot change the Python object '{ast.unparse(target)}'",
            "make it a vector: ti.Vector([…])"
            if is_list
            else "use a field for what a kernel writes",
        )
