"""Expressions: each is a Python object known now, or a value of the kernel."""

from __future__ import annotations

import ast
import itertools
import operator
from typing import Any

from ...errors import TaiAutodiffError, TaiNameError, TaiSyntaxError, TaiTypeError, did_you_mean
from ..base import state
from ..base.dtypes import DataType, promote, u1
from ..fields.field import Field
from ..fields.structs import StructField
from ..tracking.tracked import Number, TrackedMatrix, TrackedVector
from ..values.matrix import swizzle
from ..values.misuse import describe_misuse, misuse_hint
from ..values.value import MatrixValue, NoAttribute, Value
from .checks import is_struct, refuse_condition
from .refs import ArrayArgument, Part, Place, Variable, VariablePlace, field_element
from .sparse import list_element, list_method
from .structs import StructPlace, struct_element
from .templates import ARRAY_FORM

BINARY = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.FloorDiv: "//", ast.Mod: "%",
    ast.Pow: "**", ast.LShift: "<<", ast.RShift: ">>", ast.BitOr: "|", ast.BitXor: "^",
    ast.BitAnd: "&", ast.MatMult: "@",
}  # fmt: skip

COMPARE = {
    ast.Eq: "==", ast.NotEq: "!=", ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">="
}  # fmt: skip

# Operations that may run although the program did not ask for them: they cannot fault, and
# their partial derivatives are finite wherever their operands are.
_SPECULATABLE = {
    "arith.constant", "arith.addf", "arith.subf", "arith.mulf", "arith.negf", "arith.addi",
    "arith.subi", "arith.muli", "arith.andi", "arith.ori", "arith.xori", "arith.cmpi",
    "arith.cmpf", "arith.select", "arith.index_cast", "arith.extsi", "arith.extui",
    "arith.trunci", "arith.sitofp", "arith.extf", "vector.extract", "vector.from_elements",
    "vector.broadcast",
}  # fmt: skip


# The least that `ti.init(unrolling_limit=…)` can mean: Taichi's only warns, from 32 on.
_UNROLLING_LIMIT = 65536


class Expressions:
    """The part of the compiler that evaluates expressions."""

    emitter: Any
    builder: Any
    frame: Any
    depth: int
    reads: Any
    form_only: bool

    # Names, attributes, subscripts

    def locate(self, node: ast.expr) -> Any:
        """A `Place` for what can be assigned, else what the expression evaluates to."""
        if isinstance(node, ast.Name):
            meaning = self.frame.lookup(node.id)
            if isinstance(meaning, Variable):
                return VariablePlace(self.emitter, meaning)
            return meaning.thing
        if isinstance(node, ast.Attribute):
            form_only = self.form_only
            self.form_only = isinstance(node.value, ast.Attribute) and node.attr in ARRAY_FORM
            base = self.sublocate(node.value)
            self.form_only = False
            return self.attribute(base, node.attr, form_only)
        if isinstance(node, ast.Subscript):
            base = self.sublocate(node.value)
            key = self.visit(node.slice)
            self.at(node)
            return self.subscript(base, key, node)
        return self.visit(node)

    def sublocate(self, node: ast.expr) -> Any:
        """`locate` with errors placed at `node`."""
        if isinstance(node, (ast.Name, ast.Attribute, ast.Subscript)):
            return self.guarded(self.locate, node)
        return self.visit(node)

    def visit_Name(self, node: ast.Name) -> Any:
        found = self.locate(node)
        if isinstance(found, (Number, TrackedVector, TrackedMatrix)):
            raise TaiAutodiffError(
                f"'{ast.unparse(node)}': a value with a gradient is a constant here",
                "pass it to the kernel as an argument, or its plain value: float(…), .to_numpy()",
            )
        return found.load() if isinstance(found, Place) else found

    visit_Attribute = visit_Subscript = visit_Name

    def attribute(self, base: Any, name: str, form_only: bool = False) -> Any:
        if isinstance(base, StructPlace):
            return base.member(name)
        if isinstance(base, Place):
            if len(base.shape) == 1:
                found = swizzle(name, base.shape[0])
                if found is not None:
                    if len(found) == 1:
                        return base.component(found[0])
                    return Part(base, found, (len(found),))
            base = base.load()
        if isinstance(base, Field) and name != "dtype" and not hasattr(type(base), name):
            found = list_method(self, base, name)
            if found is not None:
                return found
            if isinstance(base, StructField) and name in base.members:
                return base.members[name]
            raise TaiTypeError(
                f"field '{base.name}' has no attribute '{name}'",
                did_you_mean(name, [m for m in dir(base) if not m.startswith("_")]),
            )
        try:
            found = getattr(base, name)
            self.reads.note(base, name, found, form_only)
            return found
        except NoAttribute:
            raise
        except AttributeError:
            kind = getattr(base, "__name__", None) or type(base).__name__
            raise TaiNameError(
                f"'{kind}' has no attribute '{name}'", did_you_mean(name, dir(base))
            ) from None

    def subscript(self, base: Any, key: Any, node: ast.Subscript) -> Any:
        if isinstance(base, Place):
            if base.shape:
                return base.at(key)
            base = base.load()
        if isinstance(base, Field):
            found = list_element(self, base, key)
            if found is not None:
                return found
            element = struct_element if isinstance(base, StructField) else field_element
            return element(self.emitter, base, key)
        if isinstance(base, ArrayArgument):
            return base.element(key)
        if isinstance(base, Value):
            return base[key]
        if base is None and isinstance(node.value, ast.Attribute) and node.value.attr in (
            "grad", "dual"
        ):  # fmt: skip
            name = ast.unparse(node.value.value)
            raise TaiAutodiffError(
                f"'{name}' holds whole numbers, which have no gradient",
                "a field of floats, such as ti.f32, has one with needs_grad=True",
            )
        if _has_value(key):
            if getattr(base, "is_matrix", False):
                return self.emitter.as_value(base)[key]
            raise TaiTypeError(
                f"a {type(base).__name__} takes an index that is known at compile time",
                "loop with ti.static(range(…)), or put the numbers in a field",
            )
        if callable(base) and not hasattr(type(base), "__getitem__"):
            raise TaiTypeError(describe_misuse(base), misuse_hint(base))
        return base[key]

    # Literals and containers

    def visit_Constant(self, node: ast.Constant) -> Any:
        if isinstance(node.value, complex):
            raise TaiTypeError("kernels have no complex numbers", "use a vector of two floats")
        return node.value

    def visit_Tuple(self, node: ast.Tuple) -> tuple:
        return tuple(self.items(node.elts))

    def visit_List(self, node: ast.List) -> list:
        return self.remember(self.items(node.elts))

    def visit_Set(self, node: ast.Set) -> Any:
        raise TaiSyntaxError("kernels have no sets", "use a list")

    def visit_Dict(self, node: ast.Dict) -> dict:
        result: dict[Any, Any] = {}
        for key, value in zip(node.keys, node.values, strict=True):
            if key is None:
                result.update(self.visit(value))
            else:
                result[self.visit(key)] = self.visit(value)
        return self.remember(result)

    def items(self, nodes: list[ast.expr]) -> list:
        result: list[Any] = []
        for node in nodes:
            if isinstance(node, ast.Starred):
                result += self.take_apart(self.visit(node.value))
            else:
                result.append(self.visit(node))
        return result

    def take_apart(self, thing: Any) -> list:
        """The items of a sequence whose length is known."""
        if isinstance(thing, (Field, str)) or (
            isinstance(thing, Value) and not isinstance(thing, MatrixValue)
        ):
            raise TaiTypeError(f"{_what(thing)} cannot be taken apart")
        try:
            return list(thing)
        except TypeError:
            raise TaiTypeError(f"{_what(thing)} cannot be taken apart") from None

    def visit_Slice(self, node: ast.Slice) -> slice:
        parts = (node.lower, node.upper, node.step)
        return slice(*(None if p is None else self.visit(p) for p in parts))

    def comprehension(self, node: Any, make: Any) -> list:
        result: list[Any] = []

        def level(index: int) -> None:
            if index == len(node.generators):
                result.append(make())
                return
            generator = node.generators[index]
            for item in self.static_items(self.visit(generator.iter), generator.iter):
                self.bind_static(generator.target, item)
                conditions = [self.visit(c) for c in generator.ifs]
                if any(isinstance(c, Value) for c in conditions):
                    raise TaiTypeError("the conditions of a comprehension are compile-time")
                if all(conditions):
                    level(index + 1)

        self.frame.push()
        level(0)
        self.frame.pop(node.lineno)
        return result

    def visit_ListComp(self, node: ast.ListComp) -> list:
        return self.remember(self.comprehension(node, lambda: self.visit(node.elt)))

    visit_GeneratorExp = visit_ListComp

    def visit_DictComp(self, node: ast.DictComp) -> dict:
        return dict(
            self.comprehension(node, lambda: (self.visit(node.key), self.visit(node.value)))
        )

    def static_items(self, thing: Any, node: ast.expr) -> list:
        """The items of something that is iterated at compile time."""
        if isinstance(thing, Value) and not isinstance(thing, MatrixValue):
            raise TaiTypeError(f"a number of type {thing.kind_name} cannot be iterated")
        if isinstance(thing, Field):
            raise TaiTypeError(
                f"field '{thing.name}' cannot be iterated at compile time",
                "loop over it at the top of a kernel: for i in x",
            )
        limit = state.options.unrolling_limit
        limit = max(limit, _UNROLLING_LIMIT) if limit > 0 else 0
        try:
            items = list(thing if limit <= 0 else itertools.islice(thing, limit + 1))
        except TypeError as error:
            raise TaiTypeError(f"{_what(thing)} cannot be iterated at compile time") from error
        if 0 < limit < len(items):
            raise TaiSyntaxError(
                f"more than {limit:,} iterations would be unrolled",
                "loop with range(…) instead, or raise the limit: ti.init(unrolling_limit=…)",
            )
        return items

    def visit_NamedExpr(self, node: ast.NamedExpr) -> Any:
        raise TaiSyntaxError("kernels have no ':='", "assign in a statement of its own")

    # Operators

    def visit_BinOp(self, node: ast.BinOp) -> Any:
        a, b = self.visit(node.left), self.visit(node.right)
        self.at(node)
        op = BINARY[type(node.op)]
        for side in (a, b):
            self.refuse_non_number(side, (a, b))
        return self.emitter.binary(op, a, b)

    def refuse_non_number(self, thing: Any, operands: tuple) -> None:
        """Fields and functions are no operands; say so in the user's words."""
        if isinstance(thing, (Field, ArrayArgument)) or thing is None or (
            callable(thing) and not isinstance(thing, (Value, DataType)) and not hasattr(
                thing, "is_matrix")
        ):  # fmt: skip
            raise TaiTypeError(describe_misuse(thing), misuse_hint(thing))
        if isinstance(thing, str) and any(isinstance(o, Value) for o in operands):
            raise TaiTypeError(describe_misuse(thing), 'to print it: print(f"… {x}")')

    def visit_UnaryOp(self, node: ast.UnaryOp) -> Any:
        x = self.visit(node.operand)
        self.at(node)
        if isinstance(node.op, ast.Not):
            refuse_condition(x)
        self.refuse_non_number(x, (x,))
        if not isinstance(x, Value):
            functions = {ast.USub: operator.neg, ast.UAdd: operator.pos,
                         ast.Invert: operator.invert, ast.Not: operator.not_}  # fmt: skip
            return functions[type(node.op)](x)
        if isinstance(node.op, ast.UAdd):
            return x
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
            items = self.static_items(b, None)
            if not _has_value(a) and not any(_has_value(i) for i in items):
                return (a in items) == isinstance(op, ast.In)
            found: Any = self.emitter.constant(False, u1)
            for item in items:
                found = self.emitter.binary("|", found, self.emitter.compare("==", a, item))
            return found if isinstance(op, ast.In) else self.emitter.unary("not", found)
        if is_struct(a) or is_struct(b):
            raise TaiTypeError("structs are not compared as a whole", "compare their members")
        if isinstance(a, Value) or isinstance(b, Value):
            for side in (a, b):
                self.refuse_non_number(side, (a, b))
        elif isinstance(op, (ast.Eq, ast.NotEq)) and isinstance(a, Field):
            raise TaiTypeError(describe_misuse(a), misuse_hint(a))
        return self.emitter.compare(COMPARE[type(op)], a, b)

    def visit_BoolOp(self, node: ast.BoolOp) -> Any:
        """`and`, `or`: what stands on the right is evaluated only if it matters."""
        is_and = isinstance(node.op, ast.And)
        result = self.visit(node.values[0])
        for right in node.values[1:]:
            if not isinstance(result, Value):
                refuse_condition(result)
                if bool(result) != is_and:
                    return result
                result = self.visit(right)
                continue
            result = self.short_circuit(is_and, result, right)
        return result

    def short_circuit(self, is_and: bool, left: Value, right_node: ast.expr) -> Value:
        """As in Python, the operand that decides: `a or b` is `a` unless that is zero."""
        emitter, builder = self.emitter, self.builder
        truth = emitter.to_bool(left)
        outer = builder.get_block()
        region = builder.region()
        block = builder.block(region, [])
        builder.set_block(block)
        self.depth += 1
        right = self.visit(right_node)
        right_truth = emitter.to_bool(right)
        # A plain number takes the type of the other operand, as it does in arithmetic.
        _, right, dt = emitter.operands(left, right)
        right = right_truth if dt is u1 else emitter.cast(right, dt)
        self.depth -= 1
        self.at(right_node)
        if all(name in _SPECULATABLE for name in builder.op_names(block)):
            builder.set_block(outer)
            builder.splice(block)
            if dt is u1:
                return emitter.binary("&" if is_and else "|", truth, right)
            left = emitter.cast(left, dt)
            return emitter.select(truth, *((right, left) if is_and else (left, right)))
        builder.yield_([right.handle])
        other = builder.region()
        builder.set_block(builder.block(other, []))
        kept = emitter.constant(not is_and, u1) if dt is u1 else emitter.cast(left, dt)
        builder.yield_([kept.handle])
        builder.set_block(outer)
        regions = [region, other] if is_and else [other, region]
        handle = builder.if_(truth.handle, [emitter.type_of(dt)], *regions)
        return Value(emitter, handle, dt)

    def visit_IfExp(self, node: ast.IfExp) -> Any:
        static = self.static_argument(node.test)
        condition = self.visit(node.test) if static is None else self.visit_static(static)
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
        for arm in (then, orelse):
            region = builder.region()
            block = builder.block(region, [])
            builder.set_block(block)
            self.depth += 1
            values.append(emitter.as_value(arm()))
            self.depth -= 1
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
        if all(n in _SPECULATABLE for block in blocks for n in builder.op_names(block)):
            builder.set_block(outer)
            for block in blocks:
                builder.splice(block)
            return emitter.select(condition, *values)
        for block, handle in zip(blocks, handles, strict=True):
            builder.set_block(block)
            builder.yield_([handle])
        builder.set_block(outer)
        handle = builder.if_(condition.handle, [emitter.type_of(dt, shape)], *regions)
        return emitter.value(handle, dt, shape)

    def visit_Lambda(self, node: ast.Lambda) -> Any:
        raise TaiSyntaxError("kernels have no lambda", "define a @ti.func outside")

    def visit_Starred(self, node: ast.Starred) -> Any:
        raise TaiSyntaxError("'*' stands in calls and lists only")

    def visit_Await(self, node: ast.expr) -> Any:
        raise TaiSyntaxError("kernels have no coroutines and generators")

    visit_Yield = visit_YieldFrom = visit_Await

    def visit_SetComp(self, node: ast.SetComp) -> Any:
        raise TaiSyntaxError("kernels have no sets", "use a list comprehension")


def _has_value(thing: Any) -> bool:
    if isinstance(thing, (tuple, list)):
        return any(_has_value(t) for t in thing)
    if isinstance(thing, slice):
        return any(isinstance(t, Value) for t in (thing.start, thing.stop, thing.step))
    return isinstance(thing, Value)


def _what(thing: Any) -> str:
    if isinstance(thing, Value):
        return f"a {thing.kind_name}"
    if isinstance(thing, (Field, ArrayArgument)):
        return f"{'field' if isinstance(thing, Field) else 'array'} '{thing.name}'"
    return f"'{thing}'" if isinstance(thing, str) else f"a {type(thing).__name__}"
