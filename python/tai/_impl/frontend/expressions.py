"""Expressions: each is a Python object at compile time, or a value of the kernel."""

from __future__ import annotations

import ast
import re
from typing import Any

import numpy as np

from ...errors import TaiAutodiffError, TaiNameError, TaiSyntaxError, TaiTypeError, did_you_mean
from ..base.keywords import CELL_OPERATIONS
from ..fields.field import Field
from ..fields.structs import Struct, StructField
from ..tracking.tracked import Number, TrackedMatrix, TrackedVector
from ..values.matrix import swizzle
from ..values.misuse import KINDS, describe_misuse, misuse_hint, with_article
from ..values.value import NoAttribute, Value
from .checks import Checks
from .compile_time import CompileTime
from .context import Context, Part
from .refs import ArrayArgument, Place, Variable, VariablePlace, field_element
from .refs import Part as SomeComponents
from .sparse import Levels, list_element, list_method
from .structs import StructPlace, StructValue, as_struct_value, struct_element
from .templates import ARRAY_FORM
from .triplets import TripletsValue
from .worlds import single_world


class Expressions(Part):
    """The part of the compiler that evaluates expressions other than arithmetic and calls.

    Args:
        context, compile_time, checks, levels: other parts of the compiler, which it uses.
    """

    def __init__(self, context: Context, compile_time: CompileTime, checks: Checks, levels: Levels):
        super().__init__(context)
        self.compile_time, self.checks, self.levels = compile_time, checks, levels
        # Whether only the form (shape, type) of the next attribute is wanted, not its value.
        self._form_only = False

    # Names, attributes, subscripts

    def locate(self, node: ast.expr) -> Any:
        """A `Place` if the expression can be assigned to, else its value."""
        if isinstance(node, ast.Name):
            meaning = self.frame.lookup(node.id)
            if isinstance(meaning, Variable):
                return VariablePlace(self.emitter, meaning)
            return meaning.thing
        if isinstance(node, ast.Attribute):
            form_only = self._form_only
            self._form_only = isinstance(node.value, ast.Attribute) and node.attr in ARRAY_FORM
            base = self.sublocate(node.value)
            self._form_only = False
            return self.attribute(base, node.attr, form_only)
        if isinstance(node, ast.Subscript):
            base = self.sublocate(node.value)
            key = self.visit(node.slice)
            self.at(node)
            return self.subscript(base, key, node)
        return self.visit(node)

    def sublocate(self, node: ast.expr) -> Any:
        """Evaluates `node` like `locate`, with errors placed at `node`."""
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
                    return SomeComponents(base, found, (len(found),))
            if name == "fill" and base.shape:
                return base.fill
            base = base.load()
        if isinstance(base, StructField) and name in base.members:
            return base.members[name]
        if isinstance(base, Field) and name != "dtype" and not hasattr(type(base), name):
            found = list_method(self.levels, base, name)
            if found is not None:
                return found
            raise TaiTypeError(
                f"field '{base.name}' has no attribute '{name}'",
                CELL_OPERATIONS.get(name)
                or did_you_mean(name, [m for m in dir(base) if not m.startswith("_")]),
            )
        try:
            found = getattr(base, name)
            self.context.reads.note(base, name, found, form_only)
            worlds = self.emitter.worlds
            if name == "shape" and worlds is not None and worlds.has(base):
                return single_world(base)
            return found
        except NoAttribute:
            raise
        except AttributeError:
            kind = getattr(base, "__name__", None) or type(base).__name__
            kind = re.sub(r"^tai\b", "ti", KINDS.get(kind, kind))
            raise TaiNameError(
                f"'{kind}' has no attribute '{name}'",
                did_you_mean(name, [m for m in dir(base) if not m.startswith("_")]),
            ) from None

    def subscript(self, base: Any, key: Any, node: ast.Subscript) -> Any:
        if isinstance(base, Place):
            if base.shape:
                return base.at(key)
            base = base.load()
        if isinstance(base, Field):
            found = list_element(self.levels, base, key)
            if found is not None:
                return found
            if isinstance(base, StructField):
                return struct_element(self.emitter, base, key)
            return field_element(self.emitter, base, key)
        if isinstance(base, ArrayArgument):
            return base.element(key)
        if isinstance(base, TripletsValue):
            return base.entry(key)
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
        if base is None:
            raise TaiTypeError(
                f"'{ast.unparse(node.value)}' is None, which has no elements",
                "the grad of a ti.ndarray is None unless it is made with needs_grad=True",
            )
        if has_value(key):
            if getattr(base, "is_matrix", False):
                return self.emitter.as_value(base)[key]
            raise TaiTypeError(
                f"{with_article(type(base).__name__)} takes an index that is known at compile time",
                "loop with ti.static(range(…)), or pass it as an argument: x: ti.types.ndarray()"
                if hasattr(base, "__dlpack__")
                else "loop with ti.static(range(…)), or put the numbers in a field",
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
        return self.checks.remember(self.items(node.elts))

    def visit_Set(self, node: ast.Set) -> Any:
        raise TaiSyntaxError("kernels have no sets", "use a list")

    def visit_Dict(self, node: ast.Dict) -> dict:
        result: dict[Any, Any] = {}
        for key, value in zip(node.keys, node.values, strict=True):
            if key is None:
                result.update(self.visit(value))
            else:
                result[self.visit(key)] = self.visit(value)
        return self.checks.remember(result)

    def items(self, nodes: list[ast.expr]) -> list:
        result: list[Any] = []
        for node in nodes:
            if isinstance(node, ast.Starred):
                result += self.compile_time.take_apart(self.visit(node.value))
            else:
                result.append(self.visit(node))
        return result

    def number(self, value: Any) -> Any:
        """Returns the right side of an assignment as a value to compute with."""
        if isinstance(value, (Value, StructValue)):
            return value
        if isinstance(value, (bool, int, float, np.generic)):
            return value.item() if isinstance(value, np.generic) else value
        if isinstance(value, Struct):
            return as_struct_value(self.emitter, value)
        return self.emitter.as_value(value)

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
            for item in self.compile_time.static_items(self.visit(generator.iter)):
                self.compile_time.bind_static(generator.target, item)
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
        return self.checks.remember(self.comprehension(node, lambda: self.visit(node.elt)))

    visit_GeneratorExp = visit_ListComp

    def visit_DictComp(self, node: ast.DictComp) -> dict:
        return dict(
            self.comprehension(node, lambda: (self.visit(node.key), self.visit(node.value)))
        )

    def visit_Lambda(self, node: ast.Lambda) -> Any:
        raise TaiSyntaxError("kernels have no lambda", "define a @ti.func outside")

    def visit_Starred(self, node: ast.Starred) -> Any:
        raise TaiSyntaxError("'*' stands in calls and lists only")

    def visit_Await(self, node: ast.expr) -> Any:
        raise TaiSyntaxError("kernels have no coroutines and generators")

    visit_Yield = visit_YieldFrom = visit_Await

    def visit_SetComp(self, node: ast.SetComp) -> Any:
        raise TaiSyntaxError("kernels have no sets", "use a list comprehension")


def has_value(thing: Any) -> bool:
    if isinstance(thing, (tuple, list)):
        return any(has_value(t) for t in thing)
    if isinstance(thing, slice):
        return any(isinstance(t, Value) for t in (thing.start, thing.stop, thing.step))
    return isinstance(thing, Value)
