"""`ti.types`: annotations of parameters, and small vector and matrix types."""

from __future__ import annotations

from typing import Any

from ._impl.base import dtypes as primitive_types
from ._impl.base.dtypes import (
    DataType,
    bf16,
    f16,
    f32,
    f64,
    float16,
    float32,
    float64,
    i8,
    i16,
    i32,
    i64,
    int8,
    int16,
    int32,
    int64,
    u1,
    u8,
    u16,
    u32,
    u64,
    uint1,
    uint8,
    uint16,
    uint32,
    uint64,
)
from ._impl.base.keywords import check_keywords
from ._impl.fields.structs import ArgPackType, StructType
from ._impl.fields.triplets import TripletsType as sparse_matrix_builder  # noqa: N813
from ._impl.values.types import (
    BitpackedFields,
    MatrixType,
    NdarrayType,
    ScalarType,
    is_integral,
    is_real,
    is_signed,
    matrix,
    ndarray,
    quant,
    template,
    vector,
)


def struct(**members: Any) -> StructType:
    """Returns the type of structs with these members."""
    return StructType(members)


def argpack(**members: Any) -> ArgPackType:
    """The type of a pack of arguments with these members, which may be arrays."""
    return ArgPackType(members)


__all__ = [
    "ArgPackType", "BitpackedFields", "DataType", "MatrixType", "NdarrayType", "ScalarType",
    "StructType", "argpack", "bf16", "f16", "f32", "f64", "float16", "float32", "float64", "i16",
    "i32", "i64", "i8", "int16", "int32", "int64", "int8", "is_integral", "is_real", "is_signed",
    "matrix", "ndarray", "primitive_types", "quant", "sparse_matrix_builder", "struct", "template",
    "u1", "u16", "u32", "u64", "u8", "uint1", "uint16", "uint32", "uint64", "uint8", "vector",
]  # fmt: skip

check_keywords(globals())
