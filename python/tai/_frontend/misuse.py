"""What to say of a thing that stands where a number is needed."""

from __future__ import annotations

from typing import Any

from ..dtypes import DataType
from .value import Value

# What the classes of values are called in messages of Python's own.
KINDS = {
    "ArrayArgument": "array",
    "FunctionType": "function",
    "MatrixValue": "vector or matrix",
    "Place": "element of a field",
    "ScalarField": "field",
    "StructValue": "struct",
    "Value": "number of a kernel",
}


def name_of(thing: Any) -> str:
    if isinstance(thing, Value):
        return f"a {thing.kind_name}"
    return f"'{thing}'" if isinstance(thing, str) else type(thing).__name__


def describe_misuse(thing: Any) -> str:
    """Why `thing` is no number."""
    from ..fields import Field
    from .refs import ArrayArgument

    if isinstance(thing, Field):
        return f"field '{thing.name}' stands where a number is needed"
    if isinstance(thing, ArrayArgument):
        return f"array '{thing.name}' stands where a number is needed"
    if isinstance(thing, DataType):
        return f"the type {thing.name} stands where a number is needed"
    if thing is None:
        return "None stands where a number is needed"
    if callable(thing):
        name = getattr(thing, "__name__", type(thing).__name__)
        return f"function '{name}' stands where a number is needed"
    return f"{name_of(thing)} stands where a number is needed"


def misuse_hint(thing: Any) -> str | None:
    from ..fields import Field
    from .refs import ArrayArgument

    if isinstance(thing, ArrayArgument):
        return f"read an element: {thing.name}[{', '.join('ijklmnop'[: thing.ndim])}]"
    if isinstance(thing, Field):
        indices = (
            "None"
            if thing.snode is None or not thing.shape
            else ", ".join("ijklmnop"[: len(thing.shape)])
        )
        return f"read an element: {thing.name}[{indices}]"
    if isinstance(thing, DataType):
        return f"convert a number to it: ti.cast(x, {thing.name})"
    if callable(thing):
        return "call it: add parentheses"
    return None
