"""Text with values of the kernel in it: `print`, f-strings, `"…".format(…)`."""

from __future__ import annotations

import ast
import re
import string
from collections.abc import Callable
from typing import Any

from ...errors import TaiSyntaxError, TaiTypeError
from ..base.dtypes import f64, i64, u64
from ..fields.field import Field
from ..values.misuse import describe_misuse, misuse_hint, name_of
from ..values.value import Value
from .checks import holds_value
from .context import Context, Part
from .expressions import Expressions
from .refs import ArrayArgument, Place
from .structs import StructValue

# Matches the placeholder of a value in a text for the runtime.
_PLACE = re.compile(r"\{(?::([^}]*))?\}")


class FormattedText:
    """Text with values of the kernel: `{}` or `{:…}` stands for each."""

    def __init__(self, text: str, values: list[Value]):
        self.text, self.values = text, values

    def __str__(self) -> str:
        raise TaiTypeError(
            "a text with values of the kernel in it is for print and assert only",
        )

    __repr__ = __str__


def formatted(thing: Any) -> FormattedText:
    """Returns the text that printing `thing` writes."""
    if isinstance(thing, FormattedText):
        return thing
    if isinstance(thing, Place):
        thing = thing.load()
    if isinstance(thing, Value):
        # Integers of IR have no sign, and narrower integers are converted; see Printing.printable.
        place = "{:u}" if thing.dt is u64 else "{}"
        if len(thing.shape) != 2:
            return FormattedText(place, [thing])
        row = "[" + ", ".join([place] * thing.shape[1]) + "]"
        return FormattedText("[" + ", ".join([row] * thing.shape[0]) + "]", thing.scalars())
    if isinstance(thing, StructValue):
        return _listed("{", [(f"{k}: ", v) for k, v in thing.members.items()], "}")
    if isinstance(thing, (Field, ArrayArgument)):
        raise TaiTypeError(describe_misuse(thing), misuse_hint(thing))
    if isinstance(thing, dict) and holds_value(thing):
        return _listed("{", [(f"{k!r}: ", v) for k, v in thing.items()], "}")
    if isinstance(thing, (tuple, list)) and holds_value(thing):
        left, right = ("(", ",)" if len(thing) == 1 else ")") if isinstance(thing, tuple) else "[]"
        return _listed(left, [("", v) for v in thing], right)
    if holds_value(thing):
        raise TaiTypeError(f"a {type(thing).__name__} of values cannot be printed", "print a tuple")
    return FormattedText(str(thing), [])


def _listed(left: str, items: list[tuple[str, Any]], right: str) -> FormattedText:
    parts = [(name, formatted(item)) for name, item in items]
    text = ", ".join(name + part.text for name, part in parts)
    return FormattedText(left + text + right, [v for _, part in parts for v in part.values])


def formatted_by(template: str, args: list, kwargs: dict) -> FormattedText:
    """Formats as `template.format(*args, **kwargs)`, with values of the kernel among the
    arguments.
    """
    text, values, position = "", [], 0
    for literal, name, spec, conversion in string.Formatter().parse(template):
        text += literal
        if name is None:
            continue
        if name == "" or name.isdigit():
            number = int(name) if name else position
            position += 1
            if number >= len(args):
                raise TaiTypeError(f"the text has a place for value {number}, but there is none")
            thing = args[number]
        elif name in kwargs:
            thing = kwargs[name]
        else:
            raise TaiTypeError(
                f"the text has a place '{{{name}}}' that the kernel cannot fill",
                "number or name the values themselves",
            )
        part = _with_spec(thing, spec or "", conversion)
        text += part.text
        values += part.values
    return FormattedText(text, values)


# Matches a placeholder of `template % values`: name, flags, width, precision, kind.
_PERCENT = re.compile(r"%(?:\((\w+)\))?([-+ #0]*)(\*|\d*)(?:\.(\*|\d*))?[hlL]?(.)", re.DOTALL)


def formatted_by_percent(template: str, values: Any) -> FormattedText:
    """Formats as `template % values`, with values of the kernel among the values."""
    text, shown, end, used = "", [], 0, 0
    items = [values] if not isinstance(values, (tuple, dict)) else values
    for place in _PERCENT.finditer(template):
        text, end = text + template[end : place.start()], place.end()
        name, flags, width, precision, kind = place.groups()
        if kind == "%":
            text += "%"
            continue
        if "*" in (width, precision) or kind not in "diuxXoeEfFgGsrac":
            raise TaiTypeError(
                f"kernels have no format '{place[0]}'", "formats are those as in %d, %8.3f and %s"
            )
        if name is not None or isinstance(items, dict):
            if not isinstance(items, dict) or name not in items:
                raise TaiTypeError(f"the text has a place '{place[0]}' that has no value")
            thing = items[name]
        elif used == len(items):
            raise TaiTypeError(f"the text has a place '{place[0]}' more than there are values")
        else:
            thing, used = items[used], used + 1
        part = _by_percent(place[0], thing, flags, width, precision, kind)
        text += part.text
        shown += part.values
    if not isinstance(items, dict) and used < len(items):
        raise TaiTypeError(f"the text has places for {used} values, but got {len(items)}")
    return FormattedText(text + template[end:], shown)


def _by_percent(
    place: str, thing: Any, flags: str, width: str, precision: str | None, kind: str
) -> FormattedText:
    if isinstance(thing, Place):
        thing = thing.load()
    if not holds_value(thing):
        bare = place if "(" not in place else "%" + place[place.index(")") + 1 :]
        return FormattedText(bare % (thing,), [])
    if kind in "srac" or not isinstance(thing, Value) or thing.shape:
        if kind in "sra" and not width and precision is None:
            return formatted(thing)
        if kind == "c" or (kind in "sra" and precision is not None):
            raise TaiTypeError(f"kernels have no format '{place}'", "write %s, %d or %g")
        if not isinstance(thing, Value) or precision is not None:
            raise TaiTypeError(
                f"the format '{place}' is for one number, but got {name_of(thing)}",
                "format its parts",
            )
    is_whole = thing.dt.is_int
    if kind in "diu" and not is_whole:  # as Python, which cuts the fraction
        thing = thing.emitter.cast(thing, i64)
    spec = "" if kind in "sradiu" else kind
    align = "<" if "-" in flags and width else ">" if kind in "sra" and width else ""
    sign = "+" if "+" in flags else " " if " " in flags else ""
    # Python fills up texts with blanks even where zeros were asked for.
    zero = "0" if "0" in flags and "-" not in flags and width and kind not in "sra" else ""
    digits = "" if precision is None else f".{precision or 0}"
    if kind in "diuxXo" and digits:
        raise TaiTypeError(f"kernels have no format '{place}'", "write a width, as in %04d")
    if kind in "eEfFgG" and is_whole:
        thing = thing.emitter.cast(thing, f64)
    other = "#" if "#" in flags and kind in "xXo" else ""
    return _with_spec(thing, f"{align}{sign}{other}{zero}{width}{digits}{spec}")


_CONVERSIONS: dict[str, Callable[[Any], str]] = {"r": repr, "a": ascii, "s": str}


def _with_spec(thing: Any, spec: str, conversion: str | None = None) -> FormattedText:
    if not holds_value(thing):
        if isinstance(thing, Field):
            raise TaiTypeError(describe_misuse(thing), misuse_hint(thing))
        shown = _CONVERSIONS[conversion](thing) if conversion else thing
        return FormattedText(format(shown, spec), [])
    if not spec:
        return formatted(thing)
    if isinstance(thing, Place):
        thing = thing.load()
    if not isinstance(thing, Value):
        raise TaiTypeError(
            f"the format '{spec}' is for numbers and vectors, but got {name_of(thing)}",
            "format its parts",
        )
    _check_spec(spec, thing)
    whole = formatted(thing)
    return FormattedText(
        _PLACE.sub(lambda place: f"{{:{spec}{place[1] or ''}}}", whole.text), whole.values
    )


# Format specifications that Python accepts and the runtime does not write: other fills and the
# grouping of digits.
_NO_SPEC = re.compile(r"[{}]|[,_nczs]|\d{4,}")


def _check_spec(spec: str, value: Value) -> None:
    """Refuses specifications that Python would refuse for a number of this type."""
    problem = None
    if not spec.isascii() or _NO_SPEC.search(spec):
        problem = "kernels have no such format"
    else:
        try:
            format(1.0 if value.dt.is_float else 1, spec)
        except (ValueError, OverflowError) as error:
            problem = str(error)
    if problem:
        raise TaiTypeError(
            f"'{spec}' is no format for a {value.dt}: {problem}",
            "formats are those of Python's numbers, as in {x:8.3f}, {n:04d} or {n:x}",
        )


class Printing(Part):
    """The part of the compiler that handles text.

    Args:
        context, expressions: other parts of the compiler, which it uses.
    """

    def __init__(self, context: Context, expressions: Expressions):
        super().__init__(context)
        self.expressions = expressions

    def visit_JoinedStr(self, node: ast.JoinedStr) -> Any:
        """Returns a formatted string that contains values, or a plain string."""
        text, values = "", []
        for part in node.values:
            if isinstance(part, ast.Constant):
                text += str(part.value)
                continue
            assert isinstance(part, ast.FormattedValue)
            thing = self.visit(part.value)
            if isinstance(thing, FormattedText):
                raise TaiSyntaxError("texts with values do not nest", "write one f-string")
            spec = "" if part.format_spec is None else self.visit(part.format_spec)
            conversion = chr(part.conversion) if part.conversion > 0 else None
            shown = _with_spec(thing, spec, conversion)
            text += shown.text
            values += shown.values
        return FormattedText(text, values) if values else text

    def print(self, node: ast.Call) -> None:
        separator, end = " ", "\n"
        for keyword in node.keywords:
            value = self.visit(keyword.value)
            if keyword.arg == "sep" and isinstance(value, str):
                separator = value
            elif keyword.arg == "end" and isinstance(value, str):
                end = value
            elif keyword.arg not in ("flush",):
                raise TaiTypeError(
                    f"print in a kernel has no option '{keyword.arg}'", "it has sep, end and flush"
                )
        parts = [formatted(item) for item in self.expressions.items(node.args)]
        values = [value for part in parts for value in part.values]
        if values and any(_PLACE.search(part.text) for part in parts if not part.values):
            raise TaiSyntaxError(
                "a text with '{}' is printed beside values, which would go there",
                'write an f-string, or "…".format(…)',
            )
        self.at(node)
        text = separator.join(part.text for part in parts) + end.removesuffix("\n")
        handles = [self.printable(v).handle for v in values]
        self.builder.print(text, handles, end.endswith("\n"))

    def printable(self, value: Value) -> Value:
        """Converts unsigned numbers to i64 for printing, since types of the IR have no sign."""
        if value.dt.kind == "u" and value.dt.bits < 64:
            return self.emitter.cast(value, i64)
        return value
