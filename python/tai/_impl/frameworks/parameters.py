"""The parameters of functions that become operators of another framework."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable
from typing import Any

from ...errors import TaiRuntimeError, TaiRuntimeTypeError
from ..launch.kernels import Kernel
from ..values.types import NdarrayType, ScalarType

# The Python names of kinds of number types.
_KINDS = {"f": "float", "i": "int", "u": "int", "b": "bool"}


def kinds_of(function: Any, user: str) -> dict[str, str]:
    """The parameters of a kernel or function: `array`, or the type of a number.

    Args:
        function: the kernel or function.
        user: the function of the package that wraps it, for messages.

    Raises:
        TaiRuntimeTypeError: a parameter is neither, or it is no function.
    """
    if isinstance(function, Kernel):
        kinds = {}
        for parameter in function._get_signature().given:
            if isinstance(parameter.type, NdarrayType):
                kinds[parameter.name] = "array"
            elif isinstance(parameter.type, ScalarType):
                dt = parameter.type.dtype
                kinds[parameter.name] = "bool" if dt.is_bool else _KINDS[dt.kind]
            else:
                raise TaiRuntimeTypeError(
                    f"parameter '{parameter.name}' of kernel '{function.__name__}' is neither an "
                    f"array nor a number, and {user} takes nothing else",
                    "wrap a function with arrays and numbers that launches the kernel",
                )
        return kinds
    if not inspect.isfunction(function):
        raise TaiRuntimeTypeError(
            f"{user} takes a kernel or a function, but got {function!r}",
            "wrap a function that calls the method of the object",
        )
    numbers = {float: "float", int: "int", bool: "bool", "float": "float", "int": "int",
               "bool": "bool"}  # fmt: skip
    kinds = {}
    for given in inspect.signature(function).parameters.values():
        if given.kind not in (given.POSITIONAL_ONLY, given.POSITIONAL_OR_KEYWORD):
            raise TaiRuntimeTypeError(
                f"parameter '{given.name}' of '{function.__name__}' takes any number of "
                "arguments, or is given by name alone",
                "name each parameter",
            )
        kinds[given.name] = numbers.get(given.annotation, "array")
    return kinds


def asks_for_tape(error: TaiRuntimeError) -> bool:
    """Whether a gradient was refused before it ran because only a tape has the values it needs."""
    return type(error) is TaiRuntimeError and "under a tape" in error.message


def in_order(what: str, names: list[str], inputs: tuple, named: dict[str, Any]) -> tuple:
    """Returns the inputs of a call in the order of their names.

    Args:
        what: the operator, for messages.
        names: the names of the inputs.
        inputs, named: the positional and keyword arguments of the call.

    Raises:
        TaiRuntimeTypeError: one is missing, given twice, or unknown.
    """
    known = f"its inputs: {', '.join(names)}"
    for name in named:
        if name not in names:
            raise TaiRuntimeTypeError(f"{what} has no input '{name}'", known)
        if name in names[: len(inputs)]:
            raise TaiRuntimeTypeError(f"input '{name}' of {what} is given twice", known)
    if len(inputs) + len(named) != len(names):
        given = len(inputs) + len(named)
        raise TaiRuntimeTypeError(f"{what} takes {len(names)} inputs, but got {given}", known)
    return *inputs, *[named[name] for name in names[len(inputs) :]]


def check_outputs(function: str, outputs: Any, kinds: dict[str, str], like: str) -> None:
    """Refuses outputs that are no parameters, or whose shape is not said.

    Args:
        function: the name of the kernel or function.
        outputs: the argument `outputs` of the user.
        kinds: the kinds of all parameters.
        like: how the framework writes an array by which an output is described.

    Raises:
        TaiRuntimeTypeError: the outputs are wrong.
    """
    what = f"outputs of '{function}'"
    if not isinstance(outputs, dict) or not outputs:
        raise TaiRuntimeTypeError(
            f"{what} must be a dict from parameters to shapes, but got {outputs!r}",
            'outputs={"y": "x"}: y has the shape and type of x',
        )
    for name, shape in outputs.items():
        if kinds.get(name) != "array":
            known = ", ".join(n for n, kind in kinds.items() if kind == "array")
            raise TaiRuntimeTypeError(
                f"{what} name '{name}', which is no array among its parameters",
                f"its arrays: {known or 'none'}",
            )
        is_input = isinstance(shape, str) and kinds.get(shape) == "array"
        if not callable(shape) and not (is_input and shape not in outputs):
            raise TaiRuntimeTypeError(
                f"{what} say {shape!r} of '{name}', which is no array that it is given",
                f"the name of an array with its shape and type, or a function of the inputs that "
                f"returns a shape, or {like}",
            )
        inputs = [n for n in kinds if n not in outputs]
        if callable(shape) and not _takes(shape, len(inputs)):
            raise TaiRuntimeTypeError(
                f"{what}: the function for '{name}' does not take the {len(inputs)} inputs",
                f"it is called with all inputs in order: lambda {', '.join(inputs)}: …",
            )


def copy_shared(
    values: Iterable[Any], address_of: Callable[[Any], int | None], copy: Callable[[Any], Any]
) -> list[Any]:
    """Returns the values, with copies of arrays that are where an earlier array is.

    A kernel adds the gradient by each argument to memory of its own, and refuses arguments that
    share memory otherwise. A user may give an operator one array twice.

    Args:
        values: the inputs of an operator.
        address_of: returns where the memory of a value begins, or None if it has none.
        copy: copies a value.
    """
    known: set[int] = set()
    found = []
    for value in values:
        address = address_of(value)
        if address is not None:
            value = copy(value) if address in known else value
            known.add(address)
        found.append(value)
    return found


def _takes(function: Any, count: int) -> bool:
    """Whether a function can be called with `count` positional arguments."""
    try:
        inspect.signature(function).bind(*[None] * count)
    except TypeError:
        return False
    except ValueError:  # of a function in C that does not say
        return True
    return True


def as_shape(operator: str, output: str, answer: Any) -> tuple:
    """Returns the shape that a function of `outputs` has answered: an extent or several.

    Extents are whole numbers from 0 on, or symbols of a framework that stand for them. A symbol is
    not compared, because the framework would take the answer for a fact of the program.

    Raises:
        TaiRuntimeTypeError: it is no shape.
    """
    no_numbers = (str, bytes, float, type(None))
    is_list = isinstance(answer, Iterable) and not isinstance(answer, no_numbers)
    extents = tuple(answer) if is_list else (answer,)
    if any(n < 0 if isinstance(n, int) else isinstance(n, no_numbers) for n in extents):
        raise TaiRuntimeTypeError(
            f"outputs of '{operator}' give {answer!r} as the shape of '{output}'",
            "return a whole number or a tuple of them, such as x.shape or (x.shape[0], 3)",
        )
    return extents
