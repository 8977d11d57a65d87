"""NumPy's functions of numbers that have a gradient: values, and partial derivatives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

# The type of a function that computes the derivative of a NumPy function, given the argument and
# the value.
UNARY: dict[str, Callable[[Any, Any], Any]] = {
    "absolute": lambda x, y: np.sign(x),
    "arccos": lambda x, y: -1 / np.sqrt(1 - x * x),
    "arccosh": lambda x, y: 1 / np.sqrt(x * x - 1),
    "arcsin": lambda x, y: 1 / np.sqrt(1 - x * x),
    "arcsinh": lambda x, y: 1 / np.sqrt(x * x + 1),
    "arctan": lambda x, y: 1 / (1 + x * x),
    "arctanh": lambda x, y: 1 / (1 - x * x),
    "cbrt": lambda x, y: 1 / (3 * y * y),
    "cos": lambda x, y: -np.sin(x),
    "cosh": lambda x, y: np.sinh(x),
    "deg2rad": lambda x, y: np.pi / 180,
    "exp": lambda x, y: y,
    "exp2": lambda x, y: y * np.log(2),
    "expm1": lambda x, y: y + 1,
    "fabs": lambda x, y: np.sign(x),
    "log": lambda x, y: 1 / x,
    "log10": lambda x, y: 1 / (x * np.log(10)),
    "log1p": lambda x, y: 1 / (1 + x),
    "log2": lambda x, y: 1 / (x * np.log(2)),
    "negative": lambda x, y: -1.0,
    "positive": lambda x, y: 1.0,
    "rad2deg": lambda x, y: 180 / np.pi,
    "reciprocal": lambda x, y: -y * y,
    "sinc": lambda x, y: 0.0 if x == 0 else (np.cos(np.pi * x) - y) / x,
    "sin": lambda x, y: np.cos(x),
    "sinh": lambda x, y: np.cosh(x),
    "sqrt": lambda x, y: 0.5 / y,
    "square": lambda x, y: 2 * x,
    "tan": lambda x, y: 1 + y * y,
    "tanh": lambda x, y: 1 - y * y,
}
UNARY["degrees"], UNARY["radians"] = UNARY["rad2deg"], UNARY["deg2rad"]

# For each function of two numbers, both of its partial derivatives.
BINARY: dict[str, Callable[[Any, Any, Any], tuple[Any, Any]]] = {
    "arctan2": lambda a, b, y: (b / (a * a + b * b), -a / (a * a + b * b)),
    "copysign": lambda a, b, y: (np.copysign(1.0, a) * np.copysign(1.0, b), 0.0),
    "fmod": lambda a, b, y: (1.0, -np.trunc(a / b)),
    "hypot": lambda a, b, y: (a / y, b / y),
    "logaddexp": lambda a, b, y: (np.exp(a - y), np.exp(b - y)),
    "logaddexp2": lambda a, b, y: (np.exp2(a - y), np.exp2(b - y)),
    "maximum": lambda a, b, y: (float(a >= b), float(a < b)),
    "minimum": lambda a, b, y: (float(a <= b), float(a > b)),
}
BINARY["fmax"], BINARY["fmin"] = BINARY["maximum"], BINARY["minimum"]

# Functions of NumPy that are also operators of Python.
OPERATORS = {
    "add": "add", "subtract": "sub", "multiply": "mul", "divide": "truediv", "power": "pow",
    "float_power": "pow", "remainder": "mod",
}  # fmt: skip

# Functions whose value does not change with a small change of the argument.
CONSTANT = {
    "around", "ceil", "equal", "fix", "floor", "floor_divide", "greater", "greater_equal",
    "heaviside", "isfinite", "isinf", "isnan", "less", "less_equal", "logical_and", "logical_not",
    "logical_or", "logical_xor", "not_equal", "rint", "round", "sign", "signbit", "trunc",
}  # fmt: skip

# NumPy functions that need no gradient: they ask for the form of an object, compare it, or write it
# to a file.
FORM = {
    "allclose", "array2string", "array_equal", "array_equiv", "array_repr", "array_str", "can_cast",
    "format_float_positional", "format_float_scientific", "isclose", "iscomplexobj", "isneginf",
    "isposinf", "isrealobj", "isscalar", "ndim", "result_type", "save", "savetxt", "savez",
    "savez_compressed", "shape", "size",
}  # fmt: skip


def clip(a: Any, a_min: Any = None, a_max: Any = None, *, min: Any = None, max: Any = None) -> Any:
    """`np.clip` of a number; the gradient goes to the bound that holds."""
    for bound in (a_min, min):
        a = a if bound is None else np.maximum(a, bound)
    for bound in (a_max, max):
        a = a if bound is None else np.minimum(a, bound)
    return a


def where(condition: Any, x: Any, y: Any) -> Any:
    """Evaluates `np.where` of one condition and two numbers."""
    return x if condition else y


# NumPy functions that are composed of other functions here, if all their arguments are single
# numbers.
COMPOSED: dict[str, Callable[..., Any]] = {"clip": clip, "where": where}


def derivative(name: str, values: list[float]) -> tuple[float, tuple[float, ...]] | None:
    """The value of a function and its partial derivatives; None if it is not known here."""
    with np.errstate(all="ignore"):
        result = float(getattr(np, name)(*values))
        if len(values) == 1 and name in UNARY:
            return result, (float(UNARY[name](np.float64(values[0]), np.float64(result))),)
        if len(values) == 2 and name in BINARY:
            first, second = (np.float64(value) for value in values)
            partials = BINARY[name](first, second, np.float64(result))
            return result, tuple(map(float, partials))
    return None
