"""`@ti.func`: functions that kernels call."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from ...errors import TaiSyntaxError, TaiTypeError
from ..base import state
from ..values.types import MatrixType, NdarrayType, ScalarType, template
from .signature import check_no_rest, defaults_of, names_of, parse_type, resolve


class FunctionInfo:
    """The properties of a `ti.func` that the compiler needs."""

    def __init__(self, function: Callable[..., Any]):
        self.function, self.name = function, function.__name__
        self.names = names_of(function)
        self._kinds: dict[str, Any] | None = None
        self._defaults = defaults_of(function)

    @property
    def kinds(self) -> dict[str, Any]:
        """For each parameter `"template"`, a type with `convert`, or None."""
        if self._kinds is None:
            self._kinds = {}
            for name in self.names:
                annotation = self.function.__annotations__.get(name)
                if annotation is None:
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
        if annotation is None or resolve(annotation, self.function) is None:
            return None
        type_ = parse_type(annotation, self.function, "the result")
        return type_ if isinstance(type_, (ScalarType, MatrixType)) else None

    def bind(self, args: list, kwargs: dict) -> dict[str, Any]:
        """The value of each parameter."""
        if len(args) > len(self.names):
            raise TaiTypeError(
                f"function '{self.name}' takes {len(self.names)} arguments, but got {len(args)}"
            )
        bound = dict(zip(self.names, args, strict=False))
        for name, value in kwargs.items():
            if name not in self.names or name in bound:
                problem = "gets two values for" if name in bound else "has no"
                raise TaiTypeError(f"function '{self.name}' {problem} parameter '{name}'")
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


real_func = func


def _make_function(function: Callable[..., Any], in_python: bool) -> Callable[..., Any]:
    if not hasattr(function, "__code__"):
        raise TaiTypeError(f"@ti.func takes a function, but got {function!r}")
    check_no_rest(function, "function")

    @functools.wraps(function)
    def wrapper(*args: Any, **kwargs: Any) -> Any:
        if state.emitter is not None:
            return state.emitter.call(wrapper, args, kwargs)
        if in_python:
            return function(*args, **kwargs)
        raise TaiSyntaxError(
            f"function '{function.__name__}' can be called in kernels only",
            "decorate it with @ti.pyfunc to call it from Python too",
        )

    wrapper._tai_func = FunctionInfo(function)  # type: ignore[attr-defined]
    return wrapper
