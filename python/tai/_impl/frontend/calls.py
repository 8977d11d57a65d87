"""Calls: special forms, functions of the program, Python functions at compile time."""

from __future__ import annotations

import ast
import builtins
import math
from collections.abc import Callable
from types import FunctionType
from typing import Any

import numpy as np

from ...errors import TaiSyntaxError, TaiTypeError
from ..base.keywords import find_wrong_keyword
from ..base.parsing import parse
from ..fields.field import Field
from ..fields.structs import Struct, StructField, leaves_of
from ..values import ops
from ..values.matrix import Matrix
from ..values.misuse import describe_misuse, misuse_hint
from ..values.value import Value
from . import foreign
from .atomics import ATOMICS
from .checks import Checks, holds_value
from .compile_time import CompileTime
from .context import Context, Part
from .expressions import Expressions
from .inlining import Inlining
from .loop_config import LoopConfig
from .printing import Printing, formatted, formatted_by
from .refs import ArrayElement, Place, refuse_truth_arithmetic
from .scope import Bound
from .sparse import Levels
from .structs import as_struct_value

# Python's own functions that kernels may call, with the methods that translate the calls.
_TRANSLATED: dict[Any, Callable[..., Any]] = {
    builtins.abs: ops.abs,
    builtins.min: ops.min,
    builtins.max: ops.max,
    builtins.pow: ops.pow,
    builtins.round: ops.round,
    math.atan2: ops.atan2,
    math.pow: ops.pow,
    math.fabs: ops.abs,
    **{
        getattr(math, name): getattr(ops, name)
        for name in (
            "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh",
            "atanh", "exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "sqrt", "cbrt",
            "erf", "erfc", "hypot", "copysign", "floor", "ceil", "trunc",
        )
    },
}  # fmt: skip

# Methods of matrices that can be called as functions, such as ti.Vector.normalized(v).
_MATRIX_METHODS = {
    function
    for name, function in vars(Matrix).items()
    if isinstance(function, FunctionType) and not name.startswith("_")
}

_LEVEL_CALLS = {
    ops.append, ops.activate, ops.deactivate, ops.is_active, ops.length, ops.rescale_index,
}  # fmt: skip


class Calls(Part):
    """The part of the compiler that handles calls.

    Args:
        context, compile_time, checks, levels, expressions, printing, inlining, loop_config:
            other parts of the compiler, which it uses.
    """

    def __init__(
        self, context: Context, compile_time: CompileTime, checks: Checks, levels: Levels,
        expressions: Expressions, printing: Printing, inlining: Inlining, loop_config: LoopConfig,
    ):  # fmt: skip
        super().__init__(context)
        self.compile_time, self.checks, self.levels = compile_time, checks, levels
        self.expressions, self.printing = expressions, printing
        self.inlining, self.loop_config = inlining, loop_config

    def visit_Call(self, node: ast.Call) -> Any:
        function = self._callee(node.func)
        if function is ops.static:
            argument = self.compile_time.static_argument(node)
            if argument is None:
                raise TaiSyntaxError(
                    f"'{ast.unparse(node.func)}' is ti.static, which is called by its name",
                    "write ti.static(…)",
                )
            value = self.compile_time.visit_static(argument)
            if isinstance(value, Value):
                raise TaiTypeError(
                    "ti.static needs what is known at compile time, but "
                    f"'{ast.unparse(argument)}' is known only when the kernel runs",
                    "drop ti.static",
                )
            return value
        if function is ops.loop_config:
            return self.loop_config.configure(node)
        if function is builtins.print:
            return self.printing.print(node)
        if _is_hashable(function) and function in ATOMICS:
            return self._atomic(node, ATOMICS[function])
        kwargs: dict[str, Any] = {}
        if function is ops.select and len(node.args) == 3 and not node.keywords:
            args = self._arms_of_select(node.args)
        else:
            args, kwargs = self._arguments(node, self._references(function))
        self.at(node)
        return self.call(function, args, kwargs, node)

    def _references(self, function: Any) -> Callable[[int | str], bool]:
        """Returns a predicate that tells, by number or name, which arguments a called function may
        change: the arguments that are templates.
        """
        info = getattr(function, "_tai_func", None)
        if info is None or not info.has_templates:
            return lambda which: False
        first = 1 if getattr(function, "__self__", None) is not None else 0
        names = info.names[first:]

        def is_reference(which: int | str) -> bool:
            if isinstance(which, int):
                which = names[which] if which < len(names) else ""
            return info.kinds.get(which) == "template"

        return is_reference

    def _argument(self, node: ast.expr, is_reference: bool) -> Any:
        """Evaluates an argument; gives the place itself where the function may change it."""
        if is_reference and isinstance(node, (ast.Attribute, ast.Subscript)):
            found = self.expressions.sublocate(node)
            if isinstance(found, Place):
                return found
        return self.visit(node)

    def _arms_of_select(self, nodes: list[ast.expr]) -> list:
        """The arguments of `ti.select`. A run-time check inside of an argument applies only if that
        argument is selected.
        """
        if any(isinstance(n, ast.Starred) for n in nodes):
            return self.expressions.items(nodes)
        found = [self.visit(nodes[0])]
        for number, arm in enumerate(nodes[1:]):
            self.emitter.arms.append((found[0], number == 0))
            found.append(self.visit(arm))
            self.emitter.arms.pop()
        return found

    def _callee(self, node: ast.expr) -> Any:
        if isinstance(node, (ast.Name, ast.Attribute, ast.Subscript)):
            found = self.guarded(self.expressions.locate, node)
            return found.load() if isinstance(found, Place) else found
        return self.visit(node)

    def _arguments(
        self, node: ast.Call, is_reference: Callable[[int | str], bool]
    ) -> tuple[list, dict]:
        args: list[Any] = []
        for argument in node.args:
            if isinstance(argument, ast.Starred):
                args += self.expressions.items([argument])
            else:
                args.append(self._argument(argument, is_reference(len(args))))
        kwargs: dict[str, Any] = {}
        for keyword in node.keywords:
            named = keyword.arg is not None and is_reference(keyword.arg)
            value = self._argument(keyword.value, named)
            if keyword.arg is None:
                kwargs.update(value)
            else:
                kwargs[keyword.arg] = value
        return args, kwargs

    def call(self, function: Any, args: list, kwargs: dict, node: ast.Call) -> Any:
        info = getattr(function, "_tai_func", None)
        if info is not None:
            receiver = getattr(function, "__self__", None)
            if receiver is not None:
                args = [receiver, *args]
            return self.inlining.inline(info, args, kwargs, node, receiver is not None)
        if getattr(function, "_tai_kernel", False):
            raise TaiSyntaxError(
                f"kernel '{function.__name__}' cannot be called from a kernel",
                "make it a @ti.func",
            )
        if isinstance(function, Value) or not callable(function):
            raise TaiTypeError(f"'{ast.unparse(node.func)}' is not a function")
        if function is builtins.super and not args and not kwargs:
            return self._super()
        dynamic = any(holds_value(a) for a in (*args, *kwargs.values()))
        if dynamic and isinstance(getattr(function, "__self__", None), str):
            return self._text_method(function, args, kwargs)
        if _is_hashable(function):
            if function in _LEVEL_CALLS or function is ops.get_addr:
                if kwargs:
                    raise TaiTypeError(f"ti.{function.__name__} takes no keywords")
                return self.levels.level_call(function, args)
            if dynamic:
                if function is range:
                    raise TaiSyntaxError(
                        "this range is known only when the kernel runs",
                        "write it after 'in' of a for loop, without ti.static: lists and "
                        "comprehensions have a length that is known when the kernel is compiled",
                    )
                if function in (int, float, bool):
                    return self._convert(function, args)
                if function is str:
                    return formatted(args[0])
                if function is builtins.sum:
                    return self._fold("+", args)
                if function in (builtins.any, builtins.all):
                    return self._fold("|" if function is builtins.any else "&", args, True)
                if function is isinstance:
                    return False
                if function in _MATRIX_METHODS and args:
                    receiver = self.emitter.as_value(args[0])
                    return getattr(receiver, function.__name__)(*args[1:], **kwargs)
                function = _TRANSLATED.get(function, function)
        if isinstance(function, np.ufunc) and dynamic:
            raise foreign.error_of(function, node)
        receiver = getattr(function, "__self__", None)
        if isinstance(receiver, Field) and function.__name__ == "fill":
            return self._fill(receiver, node, *args, **kwargs)
        takes_numbers = _is_hashable(function) and function in _MATH_FUNCTIONS
        for argument in args:
            if isinstance(argument, Field) and takes_numbers:
                raise TaiTypeError(describe_misuse(argument), misuse_hint(argument))
        self.checks.check_python_call(function)
        self.context.reads.note_all(getattr(function, "__self__", None), *args, *kwargs.values())
        made = self._call_python(function, args, kwargs, node, dynamic)
        if function is Struct:
            return as_struct_value(self.emitter, made)
        return self.checks.remember(made) if isinstance(function, type) else made

    def _super(self) -> Any:
        """`super()` in a method of a Python class, which has the class in its closure."""
        first = [*self.frame.node.args.posonlyargs, *self.frame.node.args.args][:1]
        found = self.frame.find(first[0].arg) if first else None
        receiver = found.thing if isinstance(found, Bound) else None
        cls = self.frame.closure.get("__class__")
        if not isinstance(cls, type) or not isinstance(receiver, cls):
            raise RuntimeError("super(): the class is not known")  # put into our words elsewhere
        return builtins.super(cls, receiver)

    def _call_python(
        self, function: Any, args: list, kwargs: dict, node: ast.Call, dynamic: bool
    ) -> Any:
        """Calls a function of Python while the kernel is compiled."""
        if not foreign.is_foreign(function):
            if wrong := find_wrong_keyword(function, kwargs):
                raise TaiTypeError(*wrong)
            return function(*args, **kwargs)
        for argument in args:
            if isinstance(argument, Field):
                raise TaiTypeError(describe_misuse(argument), misuse_hint(argument))
        if not dynamic:
            return function(*args, **kwargs)
        try:
            return function(*args, **kwargs)
        except Exception:
            raise foreign.error_of(function, node) from None

    def call_from_python(self, function: Any, args: tuple, kwargs: dict) -> Any:
        """Inlines a `ti.func` that a plain Python function calls while it is traced."""
        node = ast.Call(ast.Name(function.__name__, ast.Load()), [], [])
        ast.copy_location(node, self.context.diagnostics.last_node)
        return self.call(function, list(args), kwargs, node)

    def _fill(self, field: Field, node: ast.Call, val: Any) -> None:
        """`x.fill(v)`: a loop over the elements, as it could be written in its place."""
        for leaf in leaves_of(field) if isinstance(field, StructField) else [field]:
            loop = parse("for _at in _grouped(_field):\n    _field[_at] = _value").body[0]
            for part in ast.walk(loop):
                ast.copy_location(part, node)
            self.frame.push()
            self.frame.define("_grouped", Bound(ops.grouped))
            self.frame.define("_field", Bound(leaf))
            self.frame.define("_value", Bound(val))
            self.visit(loop)
            self.frame.pop(node.lineno)

    def _text_method(self, function: Any, args: list, kwargs: dict) -> Any:
        """A method of a string that is given values of the kernel."""
        if function.__name__ != "format":
            raise TaiTypeError(
                f"'{function.__name__}' cannot make text of what is known only when the kernel "
                "runs",
                'print it: print(f"… {x}")',
            )
        return formatted_by(function.__self__, args, kwargs)

    def _convert(self, function: Any, args: list) -> Any:
        """`int(x)`, `float(x)`, `bool(x)`."""
        if len(args) != 1:
            raise TaiTypeError(f"{function.__name__} takes one argument")
        if function is bool:
            return self.emitter.to_bool(args[0])
        return ops.cast(args[0], function)

    def _fold(self, op: str, args: list, truth: bool = False) -> Any:
        """Combines items that are known one by one, for `sum`, `any` and `all`."""
        items = self.compile_time.take_apart(args[0]) + list(args[1:])
        if not items:
            return op == "&" if truth else 0
        if truth:
            items = [self.emitter.to_bool(item) for item in items]
        result = items[0]
        for item in items[1:]:
            result = self.emitter.binary(op, result, item)
        return result

    def _atomic(self, node: ast.Call, op: str) -> Any:
        if len(node.args) != 2 or node.keywords:
            raise TaiTypeError("an atomic operation takes a place and a value")
        place = self.expressions.sublocate(node.args[0])
        value = self.expressions.number(self.visit(node.args[1]))
        self.at(node)
        if not isinstance(place, Place):
            raise TaiTypeError(
                f"'{ast.unparse(node.args[0])}' is not an element of a field or a variable",
                "atomic operations change a place, such as x[i]",
            )
        if place.dt.is_float and op in "&|^":
            raise TaiTypeError(f"the target holds {place.dt}, and this takes whole numbers")
        refuse_truth_arithmetic(op, place.dt)
        if place.dt.is_bool:
            op = {"min": "&", "max": "|"}.get(op, op)
        if isinstance(place, ArrayElement):
            place.array.spec.is_loaded = True  # the old value is a result
        return place.atomic(op, place.convert(value))


def _is_hashable(thing: Any) -> bool:
    return not isinstance(thing, (Value, list, dict)) and type(thing).__hash__ is not None


_MATH_FUNCTIONS = {*_TRANSLATED.values(), *_TRANSLATED, int, float, bool, ops.select, ops.cast}
