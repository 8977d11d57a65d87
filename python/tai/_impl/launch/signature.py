"""Signatures of kernels: the annotated types of parameters and results."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, get_args, get_origin

import numpy as np

from ...errors import (
    TaiCompilationError,
    TaiRuntimeTypeError,
    TaiSyntaxError,
    TaiTypeError,
    did_you_mean,
)
from ..base import dtypes, state
from ..fields.structs import Struct, StructType, items_of
from ..fields.triplets import TripletsType
from ..frontend.source import closure_of, function_ast
from ..values.types import MatrixType, NdarrayType, ScalarType, template
from .struct_results import ResultType, StructResult, TupleResult


class Parameter:
    """A parameter of a kernel, described by its annotation."""

    __slots__ = ("default", "has_default", "name", "type")

    def __init__(self, name: str, type_: Any, has_default: bool, default: Any):
        self.name, self.type = name, type_
        self.has_default, self.default = has_default, default


def names_of(function: Callable[..., Any]) -> list[str]:
    """Returns the names of the parameters of a function."""
    code = function.__code__
    return list(code.co_varnames[: code.co_argcount + code.co_kwonlyargcount])


def defaults_of(function: Callable[..., Any]) -> dict[str, Any]:
    """Default values of parameters."""
    code = function.__code__
    positional = code.co_varnames[: code.co_argcount]
    defaults = function.__defaults__ or ()
    return {
        **dict(zip(reversed(positional), reversed(defaults), strict=False)),
        **(function.__kwdefaults__ or {}),
    }


def located(error: TaiCompilationError, function: Callable[..., Any]) -> TaiCompilationError:
    """Sets the location of an error to the `def` line of a function."""
    code = function.__code__
    line = code.co_firstlineno
    try:
        node = function_ast(function)
        error.locate(code.co_filename, node.lineno, node.col_offset + 1)
    except TaiSyntaxError:
        error.locate(code.co_filename, line, 1)
    return error


def check_no_rest(function: Callable[..., Any], what: str) -> None:
    """Refuses parameters that take any number of arguments."""
    if function.__code__.co_flags & (inspect.CO_VARARGS | inspect.CO_VARKEYWORDS):
        raise located(
            TaiSyntaxError(
                f"{what} '{function.__name__}' cannot have *args or **kwargs",
                "name each parameter, or pass a tuple as a ti.template()",
            ),
            function,
        )


def check_annotations(function: Callable[..., Any], is_method: bool) -> None:
    """Refuses parameters of a kernel without a type."""
    check_no_rest(function, "kernel")
    for name in names_of(function)[1 if is_method else 0 :]:
        if name not in function.__annotations__:
            raise located(
                TaiSyntaxError(
                    f"parameter '{name}' of kernel '{function.__name__}' has no type",
                    f"annotate it: {name}: ti.f32, {name}: ti.template(), …",
                ),
                function,
            )


def resolve(annotation: Any, function: Callable[..., Any]) -> Any:
    """Returns an annotation as an object; `from __future__ import annotations` leaves text."""
    if not isinstance(annotation, str):
        return annotation
    try:
        return eval(annotation, function.__globals__, closure_of(function))
    except Exception as error:
        raise located(
            TaiSyntaxError(f"the annotation '{annotation}' has no meaning: {error}"), function
        ) from error


def says_nothing(annotation: Any, function: Callable[..., Any]) -> bool:
    """Whether an annotation leaves the type open: none, `typing.Any` or `object`."""
    return annotation is None or _is_anything(resolve(annotation, function))


def _is_anything(annotation: Any) -> bool:
    # Annotations are compared by identity, since the class of an annotation may have a comparison
    # that returns no bool.
    return annotation is Any or annotation is object


def _is_template(annotation: Any) -> bool:
    return annotation is template or isinstance(annotation, template)


def parse_type(annotation: Any, function: Callable[..., Any], what: str) -> Any:
    """Returns the type that an annotation of a parameter or result names."""
    annotation = resolve(annotation, function)
    if _is_template(annotation):
        return template()
    if annotation in (NdarrayType, TripletsType):
        return annotation()
    if isinstance(annotation, (NdarrayType, MatrixType, StructType)):
        return annotation
    found = dtypes.to_dtype(annotation)
    if found is not None:
        # In a kernel that names its precision, `float` is the type of that precision.
        return ScalarType(annotation if state.fp is None else found)
    shown = annotation.__name__ if isinstance(annotation, type) else repr(annotation)
    if _is_anything(annotation):
        raise located(
            TaiSyntaxError(
                f"{what} of '{function.__name__}' may have any type, and a kernel has to know it",
                "use a number type, ti.types.ndarray(), or ti.template() for a field and for a "
                "value that is compiled in; parameters of a ti.func may be typing.Any",
            ),
            function,
        )
    raise located(
        TaiSyntaxError(
            f"{what} of '{function.__name__}' has a type that kernels do not know: {shown}",
            "use a number type, ti.template(), ti.types.ndarray(), ti.types.vector(…) or "
            "ti.types.struct(…)",
        ),
        function,
    )


def tuple_types(annotation: Any) -> tuple:
    """The types in an annotation such as `(ti.i32, ti.f32)` or `tuple[ti.i32, ti.f32]`; none for
    another annotation.
    """
    if isinstance(annotation, tuple):
        return annotation
    return get_args(annotation) if get_origin(annotation) is tuple else ()


def _parse(
    function: Callable[..., Any], is_method: bool
) -> tuple[list[Parameter], ResultType | None]:
    """Parses the parameters of a kernel and the type of its result."""
    defaults = defaults_of(function)
    parameters = []
    for number, name in enumerate(names_of(function)):
        if number == 0 and is_method and name not in function.__annotations__:
            type_: Any = template()
        else:
            type_ = parse_type(function.__annotations__[name], function, f"parameter '{name}'")
        parameters.append(Parameter(name, type_, name in defaults, defaults.get(name)))
    annotation = function.__annotations__.get("return")
    if annotation is None or resolve(annotation, function) is None:
        return parameters, None
    result: Any
    if several := tuple_types(resolve(annotation, function)):
        try:
            result = TupleResult([parse_type(k, function, "the result") for k in several])
        except TaiRuntimeTypeError as error:  # arrays, templates
            raise located(TaiTypeError(error.message), function) from None
    elif isinstance(result := parse_type(annotation, function, "the result"), StructType):
        result = StructResult(result)
    elif not isinstance(result, (ScalarType, MatrixType)) or result.dtype.name in ("f16", "bf16"):
        raise located(
            TaiSyntaxError(
                f"kernel '{function.__name__}' cannot return {annotation!r}",
                "return a number, a vector, a matrix or a struct, or store it in a field",
            ),
            function,
        )
    if int(np.prod(result.shape, dtype=int)) > 1024:
        raise located(TaiSyntaxError("a kernel returns at most 1024 numbers"), function)
    return parameters, result


def _members(parameter: Parameter) -> list[Parameter]:
    """Splits a struct parameter into its members; other parameters are returned as they are."""
    if not isinstance(parameter.type, StructType):
        return [parameter]
    members = parameter.type.members.items()
    inner = (Parameter(f"{parameter.name}.{name}", kind, False, None) for name, kind in members)
    return [leaf for member in inner for leaf in _members(member)]


def _member_values(kernel: str, name: str, type_: Any, value: Any) -> list[Any]:
    """Returns the values of a struct argument in the order of `_members`."""
    if not isinstance(type_, StructType):
        return [value]
    if isinstance(type_, TripletsType):
        return list(type_.take(kernel, name, value).values())
    names = dict(items_of(value)) if isinstance(value, (dict, Struct)) else ()
    if set(names) != set(type_.members):
        raise TaiRuntimeTypeError(
            f"argument '{name}' of kernel '{kernel}' expects {type_!r}, but got {value!r}",
            f"make it by the type, or as a dict of its members: {', '.join(type_.members)}",
        )
    pairs = ((f"{name}.{key}", kind, value[key]) for key, kind in type_.members.items())
    return [leaf for pair in pairs for leaf in _member_values(kernel, *pair)]


class Signature:
    """The parameters of a kernel and the type of its result.

    Attributes:
        kernel: the name of the kernel.
        given: the parameters in order, as they are written.
        parameters: the same, with the members of a struct, `a.x`, in its place.
        structs: the names and types of those that are structs.
        result: a number, matrix or struct type, or None.
    """

    def __init__(self, function: Callable[..., Any], is_method: bool):
        self.kernel = function.__name__
        self.given, self.result = _parse(function, is_method)
        self.structs = {p.name: p.type for p in self.given if isinstance(p.type, StructType)}
        self.parameters = [leaf for parameter in self.given for leaf in _members(parameter)]

    @property
    def names(self) -> list[str]:
        return [parameter.name for parameter in self.parameters]

    @property
    def is_known(self) -> bool:
        """Whether the same compiled code serves all arguments."""
        return all(isinstance(p.type, (ScalarType, MatrixType)) for p in self.parameters)

    def bind(self, args: tuple, kwargs: dict) -> list[Any]:
        """The values of all parameters of a call, where structs are replaced by their members."""
        parameters = self.given
        if len(args) > len(parameters):
            raise TaiRuntimeTypeError(
                f"kernel '{self.kernel}' takes {len(parameters)} arguments, but got {len(args)}",
                f"its parameters: {', '.join(p.name for p in parameters) or 'none'}",
            )
        names = [parameter.name for parameter in parameters]
        for name in kwargs:
            if name not in names[len(args) :]:
                raise TaiRuntimeTypeError(
                    f"kernel '{self.kernel}' has no parameter '{name}'" if name not in names
                    else f"kernel '{self.kernel}' gets two values for parameter '{name}'",
                    did_you_mean(name, names[len(args) :])
                    or f"its parameters: {', '.join(names) or 'none'}",
                )  # fmt: skip
        values = list(args)
        for parameter in parameters[len(args) :]:
            if parameter.name in kwargs:
                values.append(kwargs.pop(parameter.name))
            elif parameter.has_default:
                values.append(parameter.default)
            else:
                raise TaiRuntimeTypeError(
                    f"kernel '{self.kernel}' needs an argument '{parameter.name}'",
                    f"its parameters: {', '.join(p.name for p in parameters)}",
                )
        if not self.structs:
            return values
        pairs = zip(parameters, values, strict=True)
        return [leaf for p, v in pairs for leaf in _member_values(self.kernel, p.name, p.type, v)]
