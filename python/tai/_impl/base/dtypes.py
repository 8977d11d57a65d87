"""Scalar types: `ti.f32`, `ti.i32`, …: their promotion, and conversion of numbers to them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...errors import TaiTypeError
from . import state


class DataType:
    """A scalar type of fields, arrays and kernels, such as `ti.f32`.

    Attributes:
        name: as in `ti.<name>`.
        kind: `f` float, `i` signed, `u` unsigned, `b` boolean.
        bits: width in bits.
        mlir: the type in IR; signedness is in the operations there.
    """

    __slots__ = ("bits", "kind", "mlir", "name", "numpy")

    def __init__(self, name: str, kind: str, bits: int, mlir: str, numpy: str):
        self.name, self.kind, self.bits, self.mlir = name, kind, bits, mlir
        self.numpy: np.dtype = np.dtype(numpy)

    is_float = property(lambda self: self.kind == "f")
    is_int = property(lambda self: self.kind in "iu")
    is_signed = property(lambda self: self.kind in "if")
    is_bool = property(lambda self: self.kind == "b")

    def __repr__(self) -> str:
        return self.name

    to_string = __repr__

    def __call__(self, value: Any) -> Any:
        """Converts a number: `ti.i64(x)`."""
        return cast(value, self)

    def __reduce__(self) -> Any:
        return (_named, (self.name,))

    @property
    def min(self) -> float:
        """The least finite value."""
        if self.is_float:
            return -self.max
        return -(1 << (self.bits - 1)) if self.kind == "i" else 0

    @property
    def max(self) -> float:
        """The greatest finite value."""
        if self is bf16:
            return float.fromhex("0x1.fep127")
        if self.is_float:
            return float(np.finfo(self.numpy).max)
        return (1 << (self.bits - (self.kind == "i"))) - 1


i8 = DataType("i8", "i", 8, "i8", "int8")
i16 = DataType("i16", "i", 16, "i16", "int16")
i32 = DataType("i32", "i", 32, "i32", "int32")
i64 = DataType("i64", "i", 64, "i64", "int64")
u1 = DataType("u1", "b", 1, "i1", "bool")
u8 = DataType("u8", "u", 8, "i8", "uint8")
u16 = DataType("u16", "u", 16, "i16", "uint16")
u32 = DataType("u32", "u", 32, "i32", "uint32")
u64 = DataType("u64", "u", 64, "i64", "uint64")
f16 = DataType("f16", "f", 16, "f16", "float16")
# NumPy has no type bf16, so in Python its numbers are f32.
bf16 = DataType("bf16", "f", 16, "bf16", "float32")
f32 = DataType("f32", "f", 32, "f32", "float32")
f64 = DataType("f64", "f", 64, "f64", "float64")

all_types = [u1, i8, i16, i32, i64, u8, u16, u32, u64, f16, bf16, f32, f64]
_by_name = {t.name: t for t in all_types}
_by_numpy = {t.numpy: t for t in all_types if t is not bf16}


def _named(name: str) -> DataType:
    """Returns the data type of a name; data types are pickled and copied as a call of this
    function.
    """
    return _by_name[name]


# NumPy-like names.
int8, int16, int32, int64 = i8, i16, i32, i64
uint1, uint8, uint16, uint32, uint64 = u1, u8, u16, u32, u64
float16, float32, float64 = f16, f32, f64


def to_dtype(what: Any) -> DataType | None:
    """The type that `what` names: a `DataType`, `int`, `float`, `bool` or a NumPy type.

    Returns None where it names none. `int` and `float` are the default types of `ti.init`.
    """
    if isinstance(what, DataType):
        return what
    if what is int:
        return state.options.default_ip
    if what is float:
        return default_fp()
    if what is bool:
        return u1
    if isinstance(what, (np.dtype, type)):
        try:
            return _by_numpy.get(np.dtype(what))
        except TypeError:
            return None
    name = str(what)
    if name.startswith("torch."):
        return _by_numpy.get(np.dtype(name[len("torch.") :]))
    return None


def promote(a: DataType, b: DataType) -> DataType:
    """The type of `a + b`: a float wins over an integer, then the wider one wins.

    If two integers have the same width, the unsigned type wins. Booleans count as integers narrower
    than all others.
    """
    if a is b:
        return a
    if a.is_float != b.is_float:
        return a if a.is_float else b
    if a.bits != b.bits:
        return a if a.bits > b.bits else b
    return a if a.kind == "u" else b


def computed_in(dt: DataType) -> DataType:
    """The type in which arithmetic on values of `dt` is done: 16-bit floats are for storage only,
    and are computed in f32.

    In a kernel that names its precision it is no narrower than that.
    """
    if not dt.is_float:
        return dt
    if state.fp is not None and state.fp.bits > dt.bits:
        return state.fp
    return f32 if dt.bits == 16 else dt


def default_fp() -> DataType:
    """The type of `float`: the precision of a kernel that names one, else the default type."""
    return state.fp or state.options.default_fp


def stored_as(what: Any) -> DataType | None:
    """The type of a field for the type that the user gives: with a 16-bit precision, `float` means
    that 16-bit type.
    """
    if what is float and state.options.precision in ("f16", "bf16"):
        return _by_name[state.options.precision]
    return to_dtype(what)


def gradient_of(dt: DataType) -> DataType:
    """The type in which the gradients of a field of `dt` are kept and summed."""
    return f64 if dt.is_float and state.options.adjoints == "f64" else computed_in(dt)


def dtype_of(value: Any) -> DataType:
    """The type that a Python or NumPy number has in a kernel."""
    if isinstance(value, (bool, np.bool_)):
        return u1
    if isinstance(value, np.generic):
        found = _by_numpy.get(value.dtype)
        if found is not None:
            return found
    return state.options.default_ip if isinstance(value, int) else default_fp()


# Numbers in a type


def misfit(number: Any, dt: DataType) -> TaiTypeError:
    """Makes the error for a whole number that a type cannot hold."""
    if isinstance(number, float):
        return TaiTypeError(
            f"{number} is no whole number of type {dt}", "give a finite number, or take ti.f32"
        )
    if number.bit_length() > 128:
        return TaiTypeError(
            f"a whole number of {number.bit_length()} bits does not fit {dt}",
            "whole numbers have at most 64 bits; floats hold larger ones: ti.f64",
        )
    default = state.options.default_ip
    if dt is default or not default.min <= number <= default.max:
        wide = "u64" if number > 2**63 - 1 else "i64"
        hint = f"name a wider type: ti.{wide}({number})"
        if dt is default and wide == "i64":
            hint += ", or ti.init(default_ip=ti.i64)"
    else:
        hint = f"ti.cast({number}, ti.{dt}) keeps its low bits: {wrapped(number, dt)}"
    return TaiTypeError(f"the whole number {number} does not fit {dt}", hint)


def wrapped(number: int, dt: DataType) -> int:
    """Returns the number of type `dt` whose low bits equal those of `number`."""
    number &= (1 << dt.bits) - 1
    return number - (1 << dt.bits) if number > dt.max else number


def fit(number: Any, dt: DataType) -> int:
    """Converts a number to a whole number if the type can hold it; a float loses its fraction.

    Raises:
        TaiTypeError: it cannot.
    """
    if isinstance(number, float) and not math.isfinite(number):
        raise misfit(number, dt)
    whole = int(number)
    if not dt.min <= whole <= dt.max:
        raise misfit(whole, dt)
    return whole


def rounded(number: Any, dt: DataType) -> float:
    """Returns the number as a float type holds it, rounded to nearest."""
    try:
        near: Any = float(number) if dt.bits == 64 else dt.numpy.type(number)
    except OverflowError:
        raise TaiTypeError(
            f"a whole number of {number.bit_length()} bits is too large for {dt}",
            "the largest float is near 1.8e308",
        ) from None
    if dt.bits == 64:
        return float(near)
    if dt is bf16 and np.isfinite(near):
        bits = int(near.view(np.uint32))
        near = np.uint32((bits + 0x7FFF + (bits >> 16 & 1)) & 0xFFFF0000).view(np.float32)
    return float(near)


def convert(number: Any, dt: DataType) -> Any:
    """Converts a number to a type that the program names: `ti.cast(300, ti.u8)` keeps the low bits.

    Raises:
        TaiTypeError: a whole number that neither this type nor the default one can hold.
    """
    if dt.is_bool:
        return bool(number)
    if dt.is_float:
        return rounded(number, dt)
    default = state.options.default_ip
    if isinstance(number, float) and not math.isfinite(number):
        raise misfit(number, dt)
    whole = int(number)
    if not (dt.min <= whole <= dt.max or default.min <= whole <= default.max):
        raise misfit(whole, dt)
    return wrapped(whole, dt)


def cast(x: Any, dtype: Any) -> Any:
    """Converts x to another type; floats become whole numbers by dropping the fraction."""
    emitter = state.emitter
    if emitter is not None:
        target = emitter.to_dtype(dtype)
        if hasattr(x, "emit_operand") or getattr(x, "is_matrix", False):
            return emitter.cast(emitter.as_value(x), target)
        if isinstance(x, (bool, int, float, np.generic)):
            number = x.item() if isinstance(x, np.generic) else x
            return emitter.constant(convert(number, target), target)
        return emitter.cast(emitter.as_value(x), target)
    resolved = to_dtype(dtype)
    if resolved is None:
        raise TaiTypeError(f"{dtype!r} is not a type of numbers")
    if getattr(x, "is_matrix", False):
        return x.cast(resolved)
    return convert(x.item() if hasattr(x, "item") else x, resolved)
