"""Calls: special forms, `ti.func` inlining, Python functions at compile time."""

from __future__ import annotations

import ast
import builtins
import math
from collections.abc import Callable
from types import FunctionType
from typing import Any

import numpy as np

from ...errors import TaiSyntaxError, TaiTypeError, did_you_mean
from ..fields.field import Field
from ..values import ops
from ..values.matrix import Matrix
from ..values.misuse import describe_misuse, misuse_hint
from ..values.value import Value
from .block_sizes import check_block_dim
from .checks import holds_value
from .printing import formatted, formatted_by
from .refs import Place, Variable
from .scope import Bound, Frame
from .source import function_ast
from .statements import refuse_truth_arithmetic
from .structs import StructValue, StructVariable

# How deep functions may call one another, and one of them itself.
_MAX_INLINE_DEPTH = 400
_MAX_RECURSION = 50

# Python's own functions, by what they do to values of a kernel.
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
            "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "log",
            "sqrt", "floor", "ceil", "trunc",
        )
    },
}  # fmt: skip

_ATOMICS = {
    ops.atomic_add: "+",
    ops.atomic_sub: "-",
    ops.atomic_mul: "*",
    ops.atomic_min: "min",
    ops.atomic_max: "max",
    ops.atomic_and: "&",
    ops.atomic_or: "|",
    ops.atomic_xor: "^",
}

# Methods of matrices, for calls such as ti.Vector.normalized(v).
_MATRIX_METHODS = {
    function
    for name, function in vars(Matrix).items()
    if isinstance(function, FunctionType) and not name.startswith("_")
}

_LEVEL_CALLS = {
    ops.append, ops.activate, ops.deactivate, ops.is_active, ops.length, ops.rescale_index,
}  # fmt: skip


class Calls:
    """The part of the compiler that handles calls."""

    emitter: Any
    builder: Any
    frame: Any
    depth: int

    def static_argument(self, node: ast.expr) -> ast.expr | None:
        """The argument of `ti.static(…)`, or None if `node` is something else."""
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
        """What a name or dotted name stands for, or None if that is not known."""
        if isinstance(node, ast.Name):
            try:
                meaning = self.frame.lookup(node.id)
            except NameError:
                return None
            return meaning.thing if isinstance(meaning, Bound) else None
        if isinstance(node, ast.Attribute):
            base = self.static_callee(node.value)
            return (
                None if base is None or isinstance(base, Value) else getattr(base, node.attr, None)
            )
        return None

    def takes_reference(self, node: ast.Call) -> bool:
        """Whether a call may change the variables that it is given."""
        callee = self.static_callee(node.func)
        if callee in _ATOMICS if isinstance(callee, Callable) else False:
            return True
        info = getattr(callee, "_tai_func", None)
        return info is not None and info.has_templates

    def is_settled(self, node: ast.Call) -> bool:
        """Whether the callee is found by a name that this function does not give a meaning."""
        callee = node.func
        while isinstance(callee, ast.Attribute):
            callee = callee.value
        return isinstance(callee, ast.Name) and self.frame.find(callee.id) is None

    def visit_Call(self, node: ast.Call) -> Any:
        function = self.callee(node.func)
        if function is ops.static:
            argument = self.static_argument(node)
            value = self.visit_static(argument)
            if isinstance(value, Value):
                raise TaiTypeError(
                    "ti.static needs what is known at compile time, but "
                    f"'{ast.unparse(argument)}' is known only when the kernel runs",
                    "drop ti.static",
                )
            return value
        if function is ops.loop_config:
            return self.configure_loop(node)
        if function is builtins.print:
            return self.print(node)
        if function in _ATOMICS if _is_hashable(function) else False:
            return self.atomic(node, _ATOMICS[function])
        if function is ops.select and len(node.args) == 3 and not node.keywords:
            args, kwargs = self.arms_of_select(node.args), {}
        else:
            args, kwargs = self.arguments(node)
        self.at(node)
        return self.call(function, args, kwargs, node)

    def arms_of_select(self, nodes: list[ast.expr]) -> list:
        """The arguments of a select. What an arm checks counts only where it is taken."""
        if any(isinstance(n, ast.Starred) for n in nodes):
            return self.items(nodes)
        found = [self.visit(nodes[0])]
        for number, arm in enumerate(nodes[1:]):
            self.emitter.arms.append((found[0], number == 0))
            found.append(self.visit(arm))
            self.emitter.arms.pop()
        return found

    def visit_static(self, node: ast.expr) -> Any:
        """The argument of `ti.static(…)`: what is evaluated once, and meant to be."""
        self.in_static += 1
        try:
            return self.visit(node)
        finally:
            self.in_static -= 1

    def callee(self, node: ast.expr) -> Any:
        if isinstance(node, (ast.Name, ast.Attribute, ast.Subscript)):
            found = self.guarded(self.locate, node)
            return found.load() if isinstance(found, Place) else found
        return self.visit(node)

    def arguments(self, node: ast.Call) -> tuple[list, dict]:
        args = self.items(node.args)
        kwargs: dict[str, Any] = {}
        for keyword in node.keywords:
            value = self.visit(keyword.value)
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
            return self.inline(info, args, kwargs, node, receiver is not None)
        if getattr(function, "_tai_kernel", False):
            raise TaiSyntaxError(
                f"kernel '{function.__name__}' cannot be called from a kernel",
                "make it a @ti.func",
            )
        if isinstance(function, Value) or not callable(function):
            raise TaiTypeError(f"'{ast.unparse(node.func)}' is not a function")
        dynamic = any(holds_value(a) for a in (*args, *kwargs.values()))
        if dynamic and isinstance(getattr(function, "__self__", None), str):
            return self.text_method(function, args, kwargs)
        if _is_hashable(function):
            if function in _LEVEL_CALLS or function is ops.get_addr:
                if kwargs:
                    raise TaiTypeError(f"ti.{function.__name__} takes no keywords")
                return self.level_call(function, args)
            if dynamic:
                if function is range:
                    raise TaiSyntaxError(
                        "this range is known only when the kernel runs",
                        "write it after 'in' of a for loop, without ti.static",
                    )
                if function in (int, float, bool):
                    return self.convert(function, args)
                if function is str:
                    return formatted(args[0])
                if function is builtins.sum:
                    return self.fold("+", args)
                if function in (builtins.any, builtins.all):
                    return self.fold("|" if function is builtins.any else "&", args, True)
                if function is isinstance:
                    return False
                if function in _MATRIX_METHODS and args:
                    receiver = self.emitter.as_value(args[0])
                    return getattr(receiver, function.__name__)(*args[1:], **kwargs)
                function = _TRANSLATED.get(function, function)
        if isinstance(function, np.ufunc) and dynamic:
            raise TaiTypeError(
                f"np.{function.__name__} cannot take values of a kernel",
                f"use ti.{function.__name__}",
            )
        for argument in args:
            if isinstance(argument, Field) and function in _MATH_FUNCTIONS:
                raise TaiTypeError(describe_misuse(argument), misuse_hint(argument))
        self.check_python_call(function)
        self.reads.note_all(getattr(function, "__self__", None), *args, *kwargs.values())
        made = function(*args, **kwargs)
        return self.remember(made) if isinstance(function, type) else made

    def text_method(self, function: Any, args: list, kwargs: dict) -> Any:
        """A method of a string that is given values of the kernel."""
        if function.__name__ != "format":
            raise TaiTypeError(
                f"'{function.__name__}' cannot make text of what is known only when the kernel "
                "runs",
                'print it: print(f"… {x}")',
            )
        return formatted_by(function.__self__, args, kwargs)

    def convert(self, function: Any, args: list) -> Any:
        """`int(x)`, `float(x)`, `bool(x)`."""
        if len(args) != 1:
            raise TaiTypeError(f"{function.__name__} takes one argument")
        if function is bool:
            return self.emitter.to_bool(args[0])
        return ops.cast(args[0], function)

    def fold(self, op: str, args: list, truth: bool = False) -> Any:
        """`sum`, `any`, `all` over items known one by one."""
        items = self.take_apart(args[0]) + list(args[1:])
        if not items:
            return op == "&" if truth else 0
        if truth:
            items = [self.emitter.to_bool(item) for item in items]
        result = items[0]
        for item in items[1:]:
            result = self.emitter.binary(op, result, item)
        return result

    # Special forms

    def configure_loop(self, node: ast.Call) -> None:
        if node.args:
            raise TaiTypeError("ti.loop_config takes keywords only")
        known = {"serialize", "parallelize", "block_dim", "block_dim_adaptive",
                 "bit_vectorize"}  # fmt: skip
        for keyword in node.keywords:
            if keyword.arg not in known:
                raise TaiTypeError(
                    f"ti.loop_config has no option '{keyword.arg}'",
                    did_you_mean(str(keyword.arg), known),
                )
            value = self.visit(keyword.value)
            if isinstance(value, Value):
                raise TaiTypeError("the options of a loop are known at compile time")
            if keyword.arg == "block_dim":
                value = check_block_dim(value, self.program.options)
            self.loop_options[keyword.arg] = value

    def atomic(self, node: ast.Call, op: str) -> Any:
        if len(node.args) != 2 or node.keywords:
            raise TaiTypeError("an atomic operation takes a place and a value")
        place = self.sublocate(node.args[0])
        value = self.number(self.visit(node.args[1]))
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
        return place.atomic(op, place.convert(value))

    # Inlining

    def inline(self, info: Any, args: list, kwargs: dict, node: ast.Call, is_method: bool) -> Any:
        """Compiles the body of a `ti.func` in place of its call."""
        same = sum(frame.function is info.function for frame in self.frames)
        if same > _MAX_RECURSION:
            raise TaiSyntaxError(
                f"function '{info.name}' calls itself more than {_MAX_RECURSION} times: functions "
                "are compiled in place of each call, whatever ends the recursion when they run",
                "write a loop, or end the recursion by if ti.static(…) on a ti.template()",
            )
        if len(self.frames) > _MAX_INLINE_DEPTH:
            raise TaiSyntaxError(
                f"more than {_MAX_INLINE_DEPTH} functions call one another",
                "functions are compiled in place of each call: call fewer of them in each other",
            )
        bound = info.bind(args, kwargs)
        frame = Frame(info.function, function_ast(info.function), "func")
        frame.depth = self.depth
        frame.result_type = info.result_type
        frame.call = (self.frame.filename, node.lineno)
        positional = dict(zip(info.names[1 if is_method else 0 :], node.args, strict=False))
        for keyword in node.keywords:
            if keyword.arg is not None:
                positional[keyword.arg] = keyword.value
        for name, value in bound.items():
            kind = info.kinds[name]
            frame.define(name, self.parameter(name, value, kind, positional.get(name)))
        options, self.loop_options = self.loop_options, {}
        was_dead, self.is_dead = self.is_dead, False
        self.enter(frame)
        self.prepare_returns()
        self.body(frame.node.body)
        result = self.finish_function()
        self.leave()
        self.is_dead, self.loop_options = was_dead, options
        return result

    def parameter(self, name: str, value: Any, kind: Any, node: ast.expr | None) -> Any:
        """What a parameter of an inlined function stands for."""
        if kind == "template":
            if isinstance(node, ast.Name):
                meaning = self.frame.find(node.id)
                if isinstance(meaning, (Variable, StructVariable)):
                    return meaning
            return Variable(name, value) if isinstance(value, Value) else Bound(value)
        if isinstance(value, StructValue):
            return StructVariable(self.emitter, name, value)
        if kind is not None:
            return Variable(name, kind.convert(self.emitter, value))
        if isinstance(value, (Value, bool, int, float, np.generic)) or getattr(
            value, "is_matrix", False
        ):
            return Variable(name, self.emitter.as_value(value))
        return Bound(value)


def _is_hashable(thing: Any) -> bool:
    return not isinstance(thing, (Value, list, dict)) and type(thing).__hash__ is not None


_MATH_FUNCTIONS = {*_TRANSLATED.values(), *_TRANSLATED, int, float, bool, ops.select, ops.cast}
