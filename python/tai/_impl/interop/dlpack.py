"""DLPack's codes of devices and types."""

from __future__ import annotations

from ..base.dtypes import DataType, all_types

CPU, CUDA = 1, 2
CODES = {"i": 0, "u": 1, "f": 2, "b": 6}


def dtype_of(code: int, bits: int, lanes: int) -> DataType | None:
    for name, known in CODES.items():
        if known == code and lanes == 1:
            wanted = 1 if name == "b" else bits
            for dt in all_types:
                if dt.kind == name and dt.bits == wanted:
                    return dt
    return None
