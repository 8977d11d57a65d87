"""`@ti.func`: functions that kernels call."""

from __future__ import annotations

import copy
import functools
import weakref
from collections.abc import Callable
from typing import Any

from ...errors import TaiSyntaxError, TaiTypeError, did_you_mean
from ..base import state, texts
from ..values.types import MatrixType, NdarrayType, ScalarType, template
from . import autoreload
from .signature import (
    check_no_rest,
    defaults_of,
    names_of,
    parse_type,
    resolve,
    says_nothing,
    tuple_types,
)


class TupleType:
    """The type of the results of a function that returns several values."""

    def __init__(self, types: list[Any]):
        self.types = types

    def convert(self, emitter: Any, value: Any) -> tuple:
        if not isinstance(value, (tuple, list)) or len(value) != len(self.types):
            got = f"{len(value)} values" if isinstance(value, (tuple, list)) else "one value"
            raise TaiTypeError(f"the function returns {len(self.types)} values, but got {got}")
        pairs = zip(self.types, value, strict=True)
        return tuple(t.convert(emitter, v) if hasattr(t, "convert") else v for t, v in pairs)


class FunctionInfo:
    """The properties of a `ti.func` that the compiler needs."""

    def __init__(self, function: Callable[..., Any]):
        self.function, self.name = function, function.__name__
        self.in_order = False  # whether its loops run on one thread, as those of `ti.real_func`
        texts.note(function)
        # The specialisations of kernels into which the function is compiled.
        self.users: weakref.WeakSet = weakref.WeakSet()
        self.names = names_of(function)
        self._kinds: dict[str, Any] | None = None
        self._defaults = defaults_of(function)

    def of_receiver(self) -> FunctionInfo:
        """Describes the function as a method whose first argument is its struct, which it may
        change.
        """
        made = copy.copy(self)
        made._kinds = {**self.kinds, self.names[0]: "template"}
        return made

    def drop_users(self) -> None:
        """Makes the kernels that contain the function be compiled again."""
        for user in list(self.users):
            user.drop()

    @property
    def kinds(self) -> dict[str, Any]:
        """For each parameter of the function: `"template"`, a type with a method `convert`, or
        None.
        """
        if self._kinds is None:
            self._kinds = {}
            for name in self.names:
                annotation = self.function.__annotations__.get(name)
                if says_nothing(annotation, self.function):
                    self._kinds[name] = None
                    continue
                type_ = parse_type(annotation, self.function, f"parameter '{name}'")
                if isinstance(type_, template):
                    self._kinds[name] = "template"
                else:
                    self._kinds[name] = None if isinstance(type_, NdarrayType) else type_
        return self._kinds

    @property
    def has_templates(self) -> bool:
        return "template" in self.kinds.values()

    @property
    def result_type(self) -> Any:
        annotation = self.function.__annotations__.get("return")
        if says_nothing(annotation, self.function) or resolve(annotation, self.function) is None:
            return None
        if several := tuple_types(resolve(annotation, self.function)):
            return TupleType([self._part_of_result(k) for k in several])
        type_ = parse_type(annotation, self.function, "the result")
        return type_ if isinstance(type_, (ScalarType, MatrixType)) else None

    def _part_of_result(self, annotation: Any) -> Any:
        if says_nothing(annotation, self.function):
            return None
        return parse_type(annotation, self.function, "the result")

    def bind(self, args: list, kwargs: dict) -> dict[str, Any]:
        """Returns the value of each parameter of a call."""
        if len(args) > len(self.names):
            raise TaiTypeError(
                f"function '{self.name}' takes {len(self.names)} arguments, but got {len(args)}"
            )
        bound = dict(zip(self.names, args, strict=False))
        for name, value in kwargs.items():
            if name not in self.names or name in bound:
                problem = "gets two values for" if name in bound else "has no"
                raise TaiTypeError(
                    f"function '{self.name}' {problem} parameter '{name}'",
                    None if name in bound else did_you_mean(name, self.names),
                )
            bound[name] = value
        for name in self.names:
            if name not in bound:
                if name not in self._defaults:
                    raise TaiTypeError(f"function '{self.name}' needs an argument '{name}'")
                bound[name] = self._defaults[name]
        return bound


def func(function: Callable[..., Any], is_real_function: bool = False) -> Callable[..., Any]:
    """Makes a function that kernels can call; it is compiled in place of each call."""
    return _make_function(function, False)


def pyfunc(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `ti.func`, and Python can call it too."""
    return _make_function(function, True)


def real_func(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `ti.func`, and its loops run in order, wherever it is called."""
    made = _make_function(function, False)
    made._tai_func.in_order = True  # type: ignore[attr-defined]
    return made


def _make_function(function: Callable[..., Any], in_python: bool) -> Callable[..., Any]:
    if not hasattr(function, "__code__"):
        raise TaiTypeError(f"@ti.func takes a function, but got {function!r}")
    check_no_rest(function, "function")

    @functools.wraps(function)
    def wrapper(*args: Any, **kwargs: Any) -> Any:
        if state.emitter is not None:
            return state.emitter.call(wrapper, args, kwargs)
        if in_python:
            # The function is not taken from the closure: a reloaded module may have put another one
            # there.
            return wrapper._tai_func.function(*args, **kwargs)  # type: ignore[attr-defined]
        raise TaiSyntaxError(
            f"function '{function.__name__}' can be called in kernels only",
            "call it from a function with @ti.kernel; or decorate it with @ti.pyfunc to call it "
            "from Python too",
        )

    info = FunctionInfo(function)
    wrapper._tai_func = info  # type: ignore[attr-defined]
    _replace_former(info)
    return wrapper


# For each module and qualified name, the function that was defined last.
_last: dict[tuple[int, str], weakref.ref[FunctionInfo]] = {}


def _replace_former(info: FunctionInfo) -> None:
    """When a module is reloaded or a cell is run again, kernels that use the former function look
    it up again.
    """
    names, qualname = info.function.__globals__, info.function.__qualname__
    if "<locals>" in qualname:
        return
    own = (id(names), qualname)
    keys = [own]
    if qualname == f"{autoreload.CLASS_OF_A_METHOD}.{info.name}":
        keys = [k for k in _last if k[0] == id(names) and k[1].split(".")[-1] == info.name]
    for key in keys:
        former = _last[key]() if key in _last else None
        if former is not None and former.function.__globals__ is names:
            former.drop_users()
    _last[own] = weakref.ref(info)
