"""The base class of fields and arrays, for modules that only distinguish them from numbers."""

from __future__ import annotations

from typing import Any, NoReturn

import numpy as np

from ...errors import TaiRuntimeTypeError
from .keywords import MissingMethod, present_names

# Python operators that are refused for whole fields and arrays.
_OPERATORS = {
    "add": "+", "sub": "-", "mul": "*", "truediv": "/", "floordiv": "//", "mod": "%", "pow": "**",
    "matmul": "@", "and": "&", "or": "|", "xor": "^", "lshift": "<<", "rshift": ">>",
}  # fmt: skip
_COMPARISONS = {"lt": "<", "le": "<=", "gt": ">", "ge": ">="}

# Types of Python numbers and lists of numbers. Arrays of any library are recognised by `__array__`.
_NUMBERS = (int, float, complex, list, tuple, range)

# The functions of NumPy that stand for the operators of elements.
_FUNCTIONS = {
    "add": "+", "subtract": "-", "multiply": "*", "divide": "/", "floor_divide": "//",
    "remainder": "%", "power": "**", "matmul": "@", "less": "<", "less_equal": "<=",
    "greater": ">", "greater_equal": ">=", "bitwise_and": "&", "bitwise_or": "|",
    "bitwise_xor": "^", "left_shift": "<<", "right_shift": ">>", "equal": "==",
    "not_equal": "!=",
}  # fmt: skip


class Elements:
    """Storage that kernels and Python read and write element by element: a field or an array.

    NumPy takes it as a copy: `np.asarray(x)`, `np.sqrt(x)`, `np.max(x)`. The operators of Python
    are refused, so that no program computes on the host by mistake. `x == y` of two of them says
    whether they are the same one, and they are keys of dictionaries.
    """

    backward = MissingMethod()
    __dir__ = present_names

    def suggest_name(self, name: str) -> None:
        """Takes the name of the variable that holds this field or array, if it has no name yet."""

    def _described(self) -> str:
        """Its description in messages."""
        return f"a {type(self).__name__}"

    def _example(self) -> str | None:
        """The text of an access to one of the elements, for a hint in a message."""
        return None

    def _shown_name(self) -> str:
        """Returns a name for the object, for the lines of a hint."""
        return "x"

    # NumPy

    def to_numpy(self) -> Any:
        raise NotImplementedError

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        """Returns a copy, like `to_numpy`; `np.from_dlpack(x)` shares the memory instead."""
        if copy is False:
            raise ValueError(
                "np.asarray of fields and arrays makes a copy; np.from_dlpack(x) shares the memory"
            )
        array = self.to_numpy()
        return array if dtype is None else array.astype(dtype)

    @property
    def __array_interface__(self) -> dict[str, Any]:
        """A copy of the numbers in the form that libraries other than NumPy request."""
        array = self.__array__()
        if array.ndim == 0:
            raise AttributeError("NumPy takes a single number by __array__ only")
        interface = dict(array.__array_interface__)
        # The bytes object keeps the memory alive, which an address would not.
        whole = np.ascontiguousarray(array)
        interface["data"] = whole.reshape(-1).view(np.uint8).data if array.size else bytearray(1)
        interface["strides"] = None
        return interface

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        symbol = _FUNCTIONS.get(ufunc.__name__)
        if method == "__call__" and symbol is not None and len(inputs) == 2:
            other = inputs[1] if inputs[0] is self else inputs[0]
            self._refuse_operator(symbol, other, inputs[0] is not self)
        if any(isinstance(out, Elements) for out in options.get("out", ())):
            raise TaiRuntimeTypeError(
                f"np.{ufunc.__name__} cannot write to {self._described()}", "x.from_numpy(array)"
            )
        arrays = (np.asarray(i) if isinstance(i, Elements) else i for i in inputs)
        return getattr(ufunc, method)(*arrays, **options)

    def __format__(self, spec: str) -> str:
        return str(self) if not spec else format_numbers(np.asarray(self), spec)

    # Operators

    def _shown_index(self) -> str:
        name, example = self._shown_name(), self._example() or "x[i]"
        index = example[example.index("[") :]
        return index.replace(name, f"{name}{name}") if name in index else index

    def _refuse_operator(self, symbol: str, other: Any, is_swapped: bool = False) -> NoReturn:
        name, index = self._shown_name(), self._shown_index()
        own = f"{name}{index}"
        if isinstance(other, Elements):
            shown = other._shown_name()
            operand = f"{shown if other is self or shown != name else _another(name)}{index}"
        elif isinstance(other, (int, float, np.generic)) or np.shape(other) == ():
            operand = repr(other.item() if hasattr(other, "item") else other)
        else:
            operand = f"{_another(name)}{index}"
        left, right = (operand, own) if is_swapped else (own, operand)
        self._refuse_expression(symbol, index, f"{left} {symbol} {right}")

    def _refuse_expression(self, symbol: str, index: str, value: str) -> NoReturn:
        name = self._shown_name()
        update = f"z{index} = {value}"
        if index == "[None]":
            body = f"    {update}"
        else:
            body = f"    for {index[1:-1]} in {name}:\n        {update}"
        raise TaiRuntimeTypeError(
            f"{self._described()} is no number in Python, and has no operator '{symbol}'",
            f"compute with {name}.to_numpy(), or with the elements in a kernel:\n"
            f"@ti.kernel\ndef compute():\n{body}",
        )

    def _compare(self, other: Any, symbol: str) -> Any:
        if isinstance(other, Elements):
            return (self is other) == (symbol == "==")
        if isinstance(other, _NUMBERS) or hasattr(other, "__array__"):
            self._refuse_operator(symbol, other)
        return NotImplemented

    def __eq__(self, other: Any) -> Any:
        return self._compare(other, "==")

    def __ne__(self, other: Any) -> Any:
        return self._compare(other, "!=")

    __hash__ = object.__hash__

    # Numbers

    def _only_number(self, function: str) -> Any:
        """The number of a field or array without dimensions, as `x[None]` reads it."""
        shape: Any = (*self.shape, *self.element_shape)  # type: ignore[attr-defined]
        if shape == () and not hasattr(self, "members"):
            return self[None]  # type: ignore[index]
        example = self._example()
        raise TaiRuntimeTypeError(
            f"{self._described()} is no number in Python: its shape is {shape}",
            "copy all numbers: x.to_numpy()".replace("x", self._shown_name())
            if example is None
            else f"read an element: {function}({example})",
        )

    def __float__(self) -> float:
        return float(self._only_number("float"))

    def __int__(self) -> int:
        return int(self._only_number("int"))

    def __neg__(self) -> NoReturn:
        index = self._shown_index()
        self._refuse_expression("-", index, f"-{self._shown_name()}{index}")

    def __invert__(self) -> NoReturn:
        index = self._shown_index()
        self._refuse_expression("~", index, f"~{self._shown_name()}{index}")

    def __abs__(self) -> NoReturn:
        raise TaiRuntimeTypeError(
            f"{self._described()} is no number in Python", "take abs of its elements in a kernel"
        )


def _define(name: str, symbol: str, is_swapped: bool) -> None:
    def refuse(self: Elements, other: Any) -> NoReturn:
        self._refuse_operator(symbol, other, is_swapped)

    refuse.__name__ = name
    setattr(Elements, name, refuse)


for _name, _symbol in _OPERATORS.items():
    _define(f"__{_name}__", _symbol, False)
    _define(f"__r{_name}__", _symbol, True)
for _name, _symbol in _COMPARISONS.items():
    _define(f"__{_name}__", _symbol, False)


def is_number(value: Any) -> bool:
    """Whether a value stands for one number. A field or an array does not, though `float(x)`
    reads one without dimensions."""
    return not isinstance(value, (str, Elements)) and hasattr(value, "__float__")


def _another(name: str) -> str:
    """Suggests a variable name that is not `name`, for a second field or array in an example."""
    return "y" if name != "y" else "x"


def format_numbers(numbers: Any, spec: str) -> str:
    """The numbers of an array as text: each in a format such as `.2f`, with commas as in a list."""
    if getattr(numbers, "ndim", 0) == 0:
        return format(numbers.item() if hasattr(numbers, "item") else numbers, spec)
    return "[" + ", ".join(format_numbers(item, spec) for item in numbers) + "]"
