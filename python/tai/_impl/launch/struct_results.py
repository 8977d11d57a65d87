"""Structs and tuples returned by kernels: flattened to a vector of one common type."""

from __future__ import annotations

import itertools
from types import SimpleNamespace
from typing import Any

import numpy as np

from ...errors import TaiAutodiffError, TaiTypeError
from ..base import dtypes
from ..base.dtypes import DataType
from ..fields.structs import Struct, StructType
from ..values.matrix import Matrix
from ..values.types import MatrixType, ScalarType


def _leaves(type_: StructType) -> list[Any]:
    """The types of the numbers, vectors and matrices in a struct, in order."""
    found = []
    for kind in type_.members.values():
        found += _leaves(kind) if isinstance(kind, StructType) else [kind]
    return found


def _common(kinds: list[DataType]) -> DataType:
    """A number type that holds the numbers of all these types without loss, or for 64-bit integers
    their bits.
    """
    whole = [dt for dt in kinds if not dt.is_float]
    bits = max((dt.bits for dt in whole), default=0)
    if len(whole) < len(kinds):
        is_wide = whole or any(dt.bits > 32 for dt in kinds)
        return dtypes.f64 if is_wide else dtypes.f32
    if not any(dt.is_signed for dt in whole):
        return dtypes.u64 if bits > 32 else dtypes.u32
    return dtypes.i64 if bits > 32 or dtypes.u32 in whole else dtypes.i32


class StructResult:
    """The type of a struct that a kernel returns. Like vector types it has `dtype` and `shape`."""

    def __init__(self, type_: StructType):
        self.type, self.leaves = type_, _leaves(type_)
        self.dtype = _common([leaf.dtype for leaf in self.leaves])
        self.shape = (sum(int(np.prod(leaf.shape, dtype=int)) for leaf in self.leaves),)

    def convert(self, emitter: Any, value: Any) -> Any:
        """Converts the struct that a kernel returns to a vector."""
        found = self._parts(emitter, self.type, value)
        parts = [
            emitter.bit_cast(part, self.dtype)
            if self._is_by_bits(part.dt)
            else emitter.cast(part, self.dtype)
            for part in found
        ]
        return emitter.matrix(parts, self.dtype, self.shape)

    def _is_by_bits(self, kind: DataType) -> bool:
        """Whether numbers of this type are passed by their bits, because the vector's type cannot
        hold them.
        """
        return not kind.is_float and kind.bits == 64 and self.dtype is not kind

    def _number(self, kind: DataType, number: Any) -> Any:
        """Converts a number of the vector to the type of its member."""
        if kind.is_float:
            return number
        if self._is_by_bits(kind):
            return np.array(number, self.dtype.numpy).view(kind.numpy).item()
        return kind.numpy.type(number).item()

    def _parts(self, emitter: Any, type_: StructType, value: Any) -> list[Any]:
        if hasattr(type(value), "load"):
            value = value.load()
        members = vars(value).get("members") if hasattr(value, "__dict__") else None
        if not isinstance(members, dict) or list(members) != list(type_.members):
            got = repr(value.type) if isinstance(members, dict) else "something else"
            raise TaiTypeError(f"the kernel returns a {type_!r}, but got {got}")
        found = []
        for name, kind in type_.members.items():
            if isinstance(kind, StructType):
                found += self._parts(emitter, kind, members[name])
                continue
            part = kind.convert(emitter, members[name])
            found += part.scalars() if part.shape else [part]
        return found

    def unpack(self, vector: Any, is_followed: bool) -> Struct:
        """Makes the Python struct from the numbers of the vector.

        Args:
            vector: of its numbers, with a gradient or tangent under a tape or in forward mode.
            is_followed: whether it has one.
        """
        return self._struct(self.type, (vector[i] for i in itertools.count()), is_followed)

    def _struct(self, type_: StructType, numbers: Any, is_followed: bool) -> Struct:
        entries: dict[str, Any] = {}
        for name, kind in type_.members.items():
            if isinstance(kind, StructType):
                entries[name] = self._struct(kind, numbers, is_followed)
            elif kind.shape:
                if is_followed and kind.dtype.is_float:
                    raise TaiAutodiffError(
                        f"member '{name}' of a struct that a kernel returns is a vector or "
                        "matrix, whose gradient would be lost",
                        "return numbers, or store it in a field",
                    )
                count = int(np.prod(kind.shape, dtype=int))
                flat = [self._number(kind.dtype, next(numbers)) for _ in range(count)]
                array = np.array(flat).astype(kind.dtype.numpy).reshape(kind.shape)
                entries[name] = Matrix._wrap(array)
            else:
                entries[name] = self._number(kind.dtype, next(numbers))
        return type_.value_of(entries)


class TupleResult(StructResult):
    """The type of several results of a kernel, as a struct whose members have numbers for names."""

    def __init__(self, types: list[Any]):
        super().__init__(StructType({str(number): kind for number, kind in enumerate(types)}))

    def convert(self, emitter: Any, value: Any) -> Any:
        if not isinstance(value, (tuple, list)) or len(value) != len(self.type.members):
            got = f"{len(value)} values" if isinstance(value, (tuple, list)) else "one value"
            raise TaiTypeError(f"the kernel returns {len(self.type.members)} values, but got {got}")
        return super().convert(
            emitter, SimpleNamespace(members=dict(zip(self.type.members, value)))
        )

    def unpack(self, vector: Any, is_followed: bool) -> Any:
        """The tuple in Python."""
        return tuple(value for _, value in super().unpack(vector, is_followed).items)


# The types that a kernel may return.
ResultType = ScalarType | MatrixType | StructResult
