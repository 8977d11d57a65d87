"""Arithmetic, comparisons, `and`, `or`, and conditional expressions."""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable
from typing import Any

from ...errors import TaiTypeError
from ..base.dtypes import promote, u1
from ..fields.field import Field
from ..values.misuse import describe_misuse, misuse_hint
from ..values.value import Value
from .checks import holds_value, is_struct, refuse_condition, refuse_non_number
from .compile_time import CompileTime
from .context import Context, Part
from .expressions import has_value
from .printing import formatted_by_percent
from .refs import Variable
from .structs import variables_of

BINARY = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.FloorDiv: "//", ast.Mod: "%",
    ast.Pow: "**", ast.LShift: "<<", ast.RShift: ">>", ast.BitOr: "|", ast.BitXor: "^",
    ast.BitAnd: "&", ast.MatMult: "@",
}  # fmt: skip

COMPARE = {
    ast.Eq: "==", ast.NotEq: "!=", ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">="
}  # fmt: skip

# Python's unary operators, for operands that are known at compile time.
_NOW: dict[type[ast.unaryop], Callable[[Any], Any]] = {
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Invert: operator.invert,
    ast.Not: operator.not_,
}

# Operations that may be executed although the program does not reach them: they cannot fail, and
# their partial derivatives are finite if their operands are.
_SPECULATABLE = {
    "arith.constant", "arith.addf", "arith.subf", "arith.mulf", "arith.negf", "arith.addi",
    "arith.subi", "arith.muli", "arith.andi", "arith.ori", "arith.xori", "arith.cmpi",
    "arith.cmpf", "arith.select", "arith.index_cast", "arith.extsi", "arith.extui",
    "arith.trunci", "arith.sitofp", "arith.extf", "vector.extract", "vector.from_elements",
    "vector.broadcast",
}  # fmt: skip


def _refuse_repetition(a: Any, b: Any) -> None:
    """In Python, a list times a whole number is a longer list; here the length is a constant."""
    for one, other in ((a, b), (b, a)):
        if isinstance(one, (list, tuple)) and isinstance(other, Value):
            if other.dt.is_int and not other.shape:
                raise TaiTypeError(
                    "a list is repeated a number of times that is known only when the kernel runs",
                    "to multiply each component, write ti.Vector([…]) * n",
                )


class Operators(Part):
    """The part of the compiler that handles operators.

    Args:
        context, compile_time: other parts of the compiler, which it uses.
    """

    def __init__(self, context: Context, compile_time: CompileTime):
        super().__init__(context)
        self.compile_time = compile_time

    def visit_BinOp(self, node: ast.BinOp) -> Any:
        a, b = self.visit(node.left), self.visit(node.right)
        self.at(node)
        op = BINARY[type(node.op)]
        if isinstance(node.op, ast.Mod) and isinstance(a, str) and holds_value(b):
            return formatted_by_percent(a, b)
        for side in (a, b):
            refuse_non_number(side, (a, b))
            if is_struct(side):
                raise TaiTypeError("structs have no arithmetic", "compute with their members")
        if isinstance(node.op, ast.Mult):
            _refuse_repetition(a, b)
        return self.emitter.binary(op, a, b)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> Any:
        x = self.visit(node.operand)
        self.at(node)
        if isinstance(node.op, ast.Not):
            refuse_condition(x)
        refuse_non_number(x, (x,))
        if is_struct(x):
            raise TaiTypeError("structs have no arithmetic", "compute with their members")
        if not isinstance(x, Value):
            return _NOW[type(node.op)](x)
        if isinstance(node.op, ast.UAdd):
            return x
        if x.shape and isinstance(node.op, ast.Not) and not x.dt.is_float:
            return self.emitter.compare("==", x, 0)
        name = {ast.USub: "neg", ast.Invert: "invert", ast.Not: "not"}[type(node.op)]
        return self.emitter.unary(name, x)

    def visit_Compare(self, node: ast.Compare) -> Any:
        left = self.visit(node.left)
        result: Any = None
        for op, right_node in zip(node.ops, node.comparators, strict=True):
            right = self.visit(right_node)
            self.at(node)
            one = self.compare(op, left, right)
            if result is None:
                result = one
            elif isinstance(result, Value) or isinstance(one, Value):
                result = self.emitter.binary("&", result, one)
            else:
                result = result and one
            left = right
        return result

    def compare(self, op: ast.cmpop, a: Any, b: Any) -> Any:
        if isinstance(op, (ast.Is, ast.IsNot)):
            if isinstance(a, Value) or isinstance(b, Value):
                raise TaiTypeError("'is' compares Python objects, not values", "use == or !=")
            return (a is b) == isinstance(op, ast.Is)
        if isinstance(op, (ast.In, ast.NotIn)):
            items = self.compile_time.static_items(b)
            if not has_value(a) and not any(has_value(i) for i in items):
                return (a in items) == isinstance(op, ast.In)
            found: Any = self.emitter.constant(False, u1)
            for item in items:
                found = self.emitter.binary("|", found, self.emitter.compare("==", a, item))
            return found if isinstance(op, ast.In) else self.emitter.unary("not", found)
        if is_struct(a) or is_struct(b):
            raise TaiTypeError("structs are not compared as a whole", "compare their members")
        if isinstance(a, Value) or isinstance(b, Value):
            for side in (a, b):
                refuse_non_number(side, (a, b))
        elif isinstance(op, (ast.Eq, ast.NotEq)) and isinstance(a, Field):
            raise TaiTypeError(describe_misuse(a), misuse_hint(a))
        return self.emitter.compare(COMPARE[type(op)], a, b)

    def visit_BoolOp(self, node: ast.BoolOp) -> Any:
        """`and`, `or`: the right operand is evaluated only if it decides the result."""
        is_and = isinstance(node.op, ast.And)
        result = self.visit(node.values[0])
        for right in node.values[1:]:
            if getattr(result, "is_matrix", False):
                result = self.emitter.as_value(result)
            if not isinstance(result, Value):
                refuse_condition(result)
                if bool(result) != is_and:
                    return result
                result = self.visit(right)
                continue
            if result.shape and not result.dt.is_float:
                result = self._of_elements(is_and, result, right)
            else:
                result = self.short_circuit(is_and, result, right)
        return result

    def _of_elements(self, is_and: bool, left: Value, right_node: ast.expr) -> Value:
        """`a and b` of each component of a vector or matrix: both operands are evaluated."""
        emitter = self.emitter
        right = emitter.as_value(self.visit(right_node))
        self.at(right_node)
        if right.dt.is_float:
            emitter.to_bool(right if right.shape else left)  # raises
        truth = emitter.compare("!=", left, 0)
        left, right, dt = emitter.operands(left, right)
        left, right = emitter.unify(left, right, dt)
        return emitter.select(truth, *((right, left) if is_and else (left, right)))

    def short_circuit(self, is_and: bool, left: Value, right_node: ast.expr) -> Value:
        """Returns the operand that decides, as Python does: `a or b` is `a` unless `a` is zero."""
        emitter, builder = self.emitter, self.builder
        truth = emitter.to_bool(left)
        outer = builder.get_block()
        region = builder.region()
        block = builder.block(region, [])
        builder.set_block(block)
        self.context.depth += 1
        before = self._variables(right_node)
        self.frame.push()
        right = self.visit(right_node)
        fresh = self._new_names()
        if getattr(right, "is_matrix", False):
            right = emitter.as_value(right)
        # A plain Python number takes the type of the other operand, as in arithmetic.
        if isinstance(right, Value) and right.shape and not right.dt.is_float:
            _, right, dt = emitter.operands(left, right)
            right = emitter.cast(right, dt)
        else:
            right_truth = emitter.to_bool(right)
            _, right, dt = emitter.operands(left, right)
            right = right_truth if dt is u1 else emitter.cast(right, dt)
        self.context.depth -= 1
        self.at(right_node)
        after = _taken_back(before)
        changed = [v for v in before if after[v] is not before[v]]
        values = (after, before) if is_and else (before, after)
        if all(name in _SPECULATABLE for name in builder.op_names(block)):
            builder.set_block(outer)
            builder.splice(block)
            self._select_variables(truth, changed, *values)
            if dt is u1 and not right.shape:
                return emitter.binary("&" if is_and else "|", truth, right)
            left = emitter.broadcast(emitter.cast(left, dt), right.shape)
            return emitter.select(truth, *((right, left) if is_and else (left, right)))
        builder.yield_([right.handle, *(v.value.handle for v in fresh),
                        *(after[v].handle for v in changed)])  # fmt: skip
        other = builder.region()
        builder.set_block(builder.block(other, []))
        if dt is u1 and not right.shape:
            kept = emitter.constant(not is_and, u1)
        else:
            kept = emitter.broadcast(emitter.cast(left, dt), right.shape)
        builder.yield_([kept.handle, *map(self._zero_handle, fresh),
                        *(before[v].handle for v in changed)])  # fmt: skip
        builder.set_block(outer)
        regions = [region, other] if is_and else [other, region]
        type_ = emitter.type_of(dt, right.shape)
        handle = self._branch(truth, type_, [*fresh, *changed], regions)
        return emitter.value(handle, dt, right.shape)

    def _new_names(self) -> list[Variable]:
        """Ends the scope of an operand of `and`, `or` or a conditional expression; names that the
        operand defines with `:=` remain.

        Returns:
            The numbers among them, which are zero where the operand is not evaluated.
        """
        made = self.frame.scopes.pop()
        for name, meaning in made.items():
            self.frame.define(name, meaning)
        return [variable for meaning in made.values() for variable in variables_of(meaning)]

    def _zero_handle(self, variable: Variable) -> Any:
        value, emitter = variable.value, self.emitter
        return emitter.broadcast(emitter.constant(0, value.dt), value.shape).handle

    def _variables(self, *nodes: ast.expr) -> dict[Variable, Value]:
        """Returns the variables that an expression could change, and their current values."""
        changing = (ast.Call, ast.NamedExpr)
        if not any(isinstance(part, changing) for node in nodes for part in ast.walk(node)):
            return {}
        return {
            variable: variable.value
            for scope in self.frame.scopes
            for meaning in scope.values()
            for variable in variables_of(meaning)
            if variable.hidden is None
        }

    def _select_variables(
        self, condition: Value, changed: list[Variable], then: dict, orelse: dict
    ) -> None:
        """Sets variables to their values after whichever of two expressions was evaluated."""
        for variable in changed:
            variable.value = self.emitter.select(condition, then[variable], orelse[variable])

    def _branch(
        self, condition: Value, type_: Any, changed: list[Variable], regions: list[Any]
    ) -> Any:
        """Emits an `scf.if` that yields the value of an expression and the new values of variables
        that the expression changes.
        """
        emitter = self.emitter
        types = [emitter.type_of(v.value.dt, v.value.shape) for v in changed]
        results = self.builder.if_(condition.handle, [type_, *types], *regions)
        if not changed:
            return results
        for variable, handle in zip(changed, results[1:], strict=True):
            variable.value = emitter.value(handle, variable.value.dt, variable.value.shape)
        return results[0]

    def visit_IfExp(self, node: ast.IfExp) -> Any:
        condition, _ = self.compile_time.evaluate(node.test)
        self.guarded(lambda _: refuse_condition(condition), node.test)
        if not isinstance(condition, Value):
            return self.visit(node.body if condition else node.orelse)
        if condition.shape:
            return self.emitter.select(condition, self.visit(node.body), self.visit(node.orelse))
        condition = self.emitter.to_bool(condition)
        return self.choose(
            condition, lambda: self.visit(node.body), lambda: self.visit(node.orelse), node
        )

    def choose(self, condition: Value, then: Any, orelse: Any, node: ast.expr) -> Any:
        """One of two expressions; the other one is not evaluated if it could do harm."""
        emitter, builder = self.emitter, self.builder
        outer = builder.get_block()
        blocks, regions, values = [], [], []
        before = self._variables(node)
        after: list[dict[Variable, Value]] = []
        fresh: list[list[Variable]] = []
        for arm in (then, orelse):
            region = builder.region()
            block = builder.block(region, [])
            builder.set_block(block)
            self.context.depth += 1
            self.frame.push()
            values.append(emitter.as_value(arm()))
            fresh.append(self._new_names())
            self.context.depth -= 1
            after.append(_taken_back(before))
            blocks.append(block)
            regions.append(region)
        dt = promote(values[0].dt, values[1].dt)
        shape = values[0].shape or values[1].shape
        handles = []
        for number, block in enumerate(blocks):
            builder.set_block(block)
            value = values[number]
            if value.shape and value.shape != shape:
                raise TaiTypeError(
                    f"the branches give a {values[0].kind_name} and a {values[1].kind_name}"
                )
            values[number] = emitter.broadcast(emitter.cast(value, dt), shape)
            handles.append(values[number].handle)
        self.at(node)
        changed = [v for v in before if any(held[v] is not before[v] for held in after)]
        if all(n in _SPECULATABLE for block in blocks for n in builder.op_names(block)):
            builder.set_block(outer)
            for block in blocks:
                builder.splice(block)
            self._select_variables(condition, changed, *after)
            return emitter.select(condition, *values)
        for number, (block, handle, held) in enumerate(zip(blocks, handles, after, strict=True)):
            builder.set_block(block)
            made = [
                variable.value.handle if arm == number else self._zero_handle(variable)
                for arm, variables in enumerate(fresh)
                for variable in variables
            ]
            builder.yield_([handle, *made, *(held[v].handle for v in changed)])
        builder.set_block(outer)
        changed = [*fresh[0], *fresh[1], *changed]
        handle = self._branch(condition, emitter.type_of(dt, shape), changed, regions)
        return emitter.value(handle, dt, shape)


def _taken_back(before: dict[Variable, Value]) -> dict[Variable, Value]:
    """Returns the present values of the variables, and resets the variables to the values
    `before`.
    """
    after = {variable: variable.value for variable in before}
    for variable, value in before.items():
        variable.value = value
    return after
