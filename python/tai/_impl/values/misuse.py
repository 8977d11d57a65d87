"""Errors for objects that are used where a number is needed."""

from __future__ import annotations

from typing import Any

from ..base.dtypes import DataType
from ..base.elements import Elements
from .value import Value

# The names that the classes of kernel values have in Python's own messages.
KINDS = {
    "ArrayArgument": "array",
    "FormattedText": "text",
    "FunctionType": "function",
    "MatrixValue": "vector or matrix",
    "Place": "element of a field",
    "StructPlace": "struct",
    "VariablePlace": "variable",
    "ScalarField": "field",
    "StructValue": "struct",
    "Value": "number of a kernel",
}


def with_article(name: str) -> str:
    return f"{'an' if name[0] in 'aeiou' or name == 'ndarray' else 'a'} {name}"


def name_of(thing: Any) -> str:
    if isinstance(thing, Value):
        return f"a {thing.kind_name}"
    if isinstance(thing, str):
        return f"'{thing}'"
    name = type(thing).__name__
    return with_article(KINDS[name]) if name in KINDS else name


def said_as(thing: Any) -> str:
    """Describes an object of a program, for an error message that says something else was
    expected.
    """
    if isinstance(thing, Value):
        return thing.kind_name
    if isinstance(thing, Elements):
        return thing._described()
    shown = repr(thing)
    return name_of(thing) if type(thing).__name__ in KINDS or len(shown) > 80 else shown


def describe_misuse(thing: Any) -> str:
    """Explains why `thing` is not a number."""
    if isinstance(thing, Elements):
        return f"{thing._described()} stands where a number is needed"
    if isinstance(thing, DataType):
        return f"the type {thing.name} stands where a number is needed"
    if thing is None:
        return "None stands where a number is needed"
    if callable(thing):
        name = getattr(thing, "__name__", type(thing).__name__)
        return f"function '{name}' stands where a number is needed"
    return f"{name_of(thing)} stands where a number is needed"


def misuse_hint(thing: Any) -> str | None:
    if isinstance(thing, Elements):
        example = thing._example()
        return None if example is None else f"read an element: {example}"
    if isinstance(thing, DataType):
        return f"convert a number to it: ti.cast(x, ti.{thing.name})"
    if members := getattr(thing, "members", None):
        return f"use one of its members: {', '.join(members)}"
    if callable(thing):
        return "call it: add parentheses"
    return None
