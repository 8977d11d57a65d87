"""Functions of other libraries in kernels: an expression of the package in place of each."""

from __future__ import annotations

import ast
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ...errors import TaiTypeError

# NumPy rounds halves to even numbers.
_EVEN = "ti.round({0}), which rounds halves away from zero"

# For each function of NumPy and `math` on numbers: the expression that computes the same in
# kernels, with {0}, {1}, … for the arguments.
_OF_NUMBERS = {
    "absolute": "ti.abs({0})", "fabs": "ti.abs({0})", "square": "{0} ** 2",
    "cbrt": "ti.cbrt({0})", "exp2": "ti.math.exp2({0})", "expm1": "ti.math.expm1({0})",
    "log2": "ti.math.log2({0})", "log10": "ti.log10({0})", "log1p": "ti.math.log1p({0})",
    "arcsin": "ti.asin({0})", "arccos": "ti.acos({0})", "arctan": "ti.atan({0})",
    "arctan2": "ti.atan2({0}, {1})", "sinh": "ti.sinh({0})", "cosh": "ti.cosh({0})",
    "arcsinh": "ti.asinh({0})", "arccosh": "ti.acosh({0})", "arctanh": "ti.atanh({0})",
    "rint": _EVEN, "trunc": "ti.trunc({0})",
    "sign": "ti.math.sign({0})", "negative": "-{0}", "positive": "{0}", "reciprocal": "1 / {0}",
    "isnan": "ti.math.isnan({0})", "isinf": "ti.math.isinf({0})",
    "isfinite": "not (ti.math.isnan({0}) or ti.math.isinf({0}))",
    "deg2rad": "ti.math.radians({0})", "rad2deg": "ti.math.degrees({0})",
    "degrees": "ti.math.degrees({0})", "radians": "ti.math.radians({0})",
    "signbit": "{0} < 0", "conjugate": "{0}", "invert": "~{0}", "logical_not": "{0} == 0",
    "maximum": "ti.max({0}, {1})", "minimum": "ti.min({0}, {1})", "fmax": "ti.max({0}, {1})",
    "fmin": "ti.min({0}, {1})", "power": "{0} ** {1}", "float_power": "{0} ** {1}",
    "pow": "{0} ** {1}", "hypot": "ti.hypot({0}, {1})", "mod": "{0} % {1}",
    "remainder": "{0} % {1}",
    "fmod": "ti.math.sign({0}) * (ti.abs({0}) % ti.abs({1}))", "divide": "{0} / {1}",
    "floor_divide": "{0} // {1}", "add": "{0} + {1}", "subtract": "{0} - {1}",
    "multiply": "{0} * {1}", "logical_and": "{0} != 0 and {1} != 0",
    "logical_or": "{0} != 0 or {1} != 0",
    "logical_xor": "bool({0}) != bool({1})", "equal": "{0} == {1}", "not_equal": "{0} != {1}",
    "less": "{0} < {1}", "less_equal": "{0} <= {1}", "greater": "{0} > {1}",
    "greater_equal": "{0} >= {1}",
    "copysign": "ti.copysign({0}, {1})", "bitwise_and": "{0} & {1}",
    "bitwise_or": "{0} | {1}", "bitwise_xor": "{0} ^ {1}", "left_shift": "{0} << {1}",
    "right_shift": "{0} >> {1}",
    "heaviside": "ti.select({0} < 0, 0.0, ti.select({0} > 0, 1.0, {1}))",
    "logaddexp": "ti.max({0}, {1}) + ti.math.log1p(ti.exp(-ti.abs({0} - {1})))",
    "ldexp": "{0} * 2.0 ** {1}", "matmul": "{0} @ {1}", "clip": "ti.math.clamp({0}, {1}, {2})",
    "where": "ti.select({0}, {1}, {2})", "round": _EVEN, "around": _EVEN,
    "isclose": "ti.abs({0} - {1}) < 1e-6", "float32": "ti.cast({0}, ti.f32)",
    "float64": "ti.cast({0}, ti.f64)", "int32": "ti.cast({0}, ti.i32)",
    "int64": "ti.cast({0}, ti.i64)",
}  # fmt: skip

_OF_VECTORS = {
    "sum": "{0}.sum()", "max": "{0}.max()", "amax": "{0}.max()", "min": "{0}.min()",
    "amin": "{0}.min()", "any": "{0}.any()", "all": "{0}.all()", "norm": "{0}.norm()",
    "inv": "{0}.inverse()", "det": "{0}.determinant()", "solve": "{0}.inverse() @ {1}",
    "dot": "{0}.dot({1})", "cross": "{0}.cross({1})", "trace": "{0}.trace()",
}  # fmt: skip

_SAME = (
    "sqrt",
    "exp",
    "log",
    "sin",
    "cos",
    "tan",
    "tanh",
    "floor",
    "ceil",
    "atan2",
    "acos",
    "asin",
)

_NO_ANSWER = (
    "write it with operators and functions of ti, or compute it in Python before the launch and "
    "pass the result"
)


_TEXTS = {**_OF_NUMBERS, **_OF_VECTORS, **{name: f"ti.{name}({{0}})" for name in _SAME}}
_TEXTS |= {"atan2": "ti.atan2({0}, {1})", "clamp": _OF_NUMBERS["clip"]}
# Libraries whose functions have the names of NumPy's. They are not imported to look at them.
_LIKE_NUMPY = ("jax", "torch", "cupy")


def _find_all() -> dict[Any, str]:
    found: dict[Any, str] = {}
    texts = _TEXTS
    for library in (np, np.linalg, math):
        for name, text in texts.items():
            if library is math and name in _OF_VECTORS:
                continue
            function = getattr(library, name, None)
            if callable(function):
                found[function] = text
    return found


_ANSWERS = _find_all()


def is_foreign(function: Any) -> bool:
    """Whether a function belongs to another library, which does not know values of kernels."""
    if isinstance(function, np.ufunc):
        return True
    return callable(function) and _library_of(function) in ("numpy", "math", *_LIKE_NUMPY)


def _library_of(function: Any) -> str:
    return (getattr(function, "__module__", None) or "").split(".")[0]


def _text(node: ast.expr) -> str:
    text = ast.unparse(node)
    is_closed = isinstance(node, (ast.Name, ast.Call, ast.Attribute, ast.Subscript)) or (
        isinstance(node, ast.Constant)
    )
    return text if is_closed else f"({text})"


def error_of(function: Callable[..., Any], node: ast.Call) -> TaiTypeError:
    """The error for a call of another library's function with values of a kernel; its hint shows
    the equivalent expression in kernels.
    """
    name = ast.unparse(node.func)
    texts = [_text(argument) for argument in node.args]
    hint = _NO_ANSWER
    answer = _ANSWERS.get(function)
    if answer is None and _library_of(function) in _LIKE_NUMPY:
        answer = _TEXTS.get(getattr(function, "__name__", ""))
    if answer is not None:
        try:
            hint = f"write {answer.format(*texts)}"
        except IndexError:  # keywords, or fewer arguments
            hint = f"write {answer.format(*'abc')}"
    return TaiTypeError(f"{name} cannot take values of a kernel", hint)
