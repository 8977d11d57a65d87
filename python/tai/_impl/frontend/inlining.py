"""Inlining of `ti.func` functions: compiled anew at each call."""

from __future__ import annotations

import ast
from typing import Any

import numpy as np

from ...errors import TaiSyntaxError
from ..fields.structs import Struct
from ..values.value import Value
from .context import Context, Part
from .loop_config import LoopConfig
from .refs import Place, Variable
from .returns import Returns
from .scope import Bound, Frame
from .source import function_ast
from .structs import Reference, StructPlace, StructValue, StructVariable, as_struct_value

# The greatest depth of nested inlined functions, and of recursive calls of one function.
_MAX_INLINE_DEPTH = 400
_MAX_RECURSION = 50


class Inlining(Part):
    """The part of the compiler that compiles a `ti.func` in place of its call.

    Args:
        context, returns, loop_config: other parts of the compiler, which it uses.
    """

    def __init__(self, context: Context, returns: Returns, loop_config: LoopConfig):
        super().__init__(context)
        self.returns, self.loop_config = returns, loop_config

    def inline(self, info: Any, args: list, kwargs: dict, node: ast.Call, is_method: bool) -> Any:
        """Compiles the body of a `ti.func` in place of its call."""
        same = sum(frame.function is info.function for frame in self.context.frames)
        if same > _MAX_RECURSION:
            raise TaiSyntaxError(
                f"function '{info.name}' calls itself more than {_MAX_RECURSION} times: functions "
                "are compiled in place of each call, whatever ends the recursion when they run",
                "write a loop, or end the recursion by if ti.static(…) on a ti.template()",
            )
        if len(self.context.frames) > _MAX_INLINE_DEPTH:
            raise TaiSyntaxError(
                f"more than {_MAX_INLINE_DEPTH} functions call one another",
                "functions are compiled in place of each call: call fewer of them in each other",
            )
        self.context.functions.add(info)
        bound = info.bind(args, kwargs)
        frame = Frame(info.function, function_ast(info.function), "func")
        frame.depth = self.context.depth
        frame.in_order = info.in_order or self.frame.in_order
        frame.result_type = info.result_type
        frame.call = (self.frame.filename, node.lineno)
        positional = dict(zip(info.names[1 if is_method else 0 :], node.args, strict=False))
        for keyword in node.keywords:
            if keyword.arg is not None:
                positional[keyword.arg] = keyword.value
        for name, value in bound.items():
            kind = info.kinds[name]
            frame.define(name, self.parameter(name, value, kind, positional.get(name)))
        options = self.loop_config.take()
        was_dead, self.context.is_dead = self.context.is_dead, False
        self.context.enter(frame)
        self.returns.prepare_returns()
        self.body(frame.node.body)
        result = self.returns.finish_function()
        self.context.leave()
        self.context.is_dead = was_dead
        self.loop_config.put_back(options)
        return result

    def parameter(self, name: str, value: Any, kind: Any, node: ast.expr | None) -> Any:
        """Returns the meaning of a parameter in the body of an inlined function."""
        if kind == "template":
            if isinstance(node, ast.Name):
                meaning = self.frame.find(node.id)
                if isinstance(meaning, (Variable, Reference)):
                    return meaning
                if isinstance(meaning, Bound) and isinstance(meaning.thing, StructPlace):
                    return Reference(meaning.thing)  # `self`
            if isinstance(value, Place):
                return Reference(value)
            return Variable(name, value) if isinstance(value, Value) else Bound(value)
        if isinstance(value, Struct):
            value = as_struct_value(self.emitter, value)
        if isinstance(value, StructValue):
            return StructVariable(self.emitter, name, value)
        if kind is not None:
            return Variable(name, kind.convert(self.emitter, value))
        if isinstance(value, (Value, bool, int, float, np.generic)) or getattr(
            value, "is_matrix", False
        ):
            return Variable(name, self.emitter.as_value(value))
        return Bound(value)
