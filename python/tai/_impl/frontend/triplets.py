"""Builders of sparse matrices in kernels: `A[i, j] += v` appends an entry."""

from __future__ import annotations

from typing import Any

from ...errors import TaiIndexError, TaiTypeError
from .refs import ArrayArgument, Place


class TripletsValue:
    """A sparse matrix builder that is an argument of the kernel."""

    def __init__(self, emitter: Any, name: str, arrays: dict[str, ArrayArgument]):
        self.emitter, self.name, self.arrays = emitter, name, arrays

    def entry(self, key: Any) -> TripletPlace:
        indices = key if isinstance(key, tuple) else (key,)
        if len(indices) != 2:
            raise TaiIndexError(
                f"'{self.name}' is the builder of a matrix, which has 2 indices, but got "
                f"{len(indices)}",
                f"{self.name}[i, j] += …",
            )
        return TripletPlace(self, indices)


class TripletPlace(Place):
    """An entry of a sparse matrix builder, to which a kernel can only add."""

    shape = ()

    def __init__(self, triplets: TripletsValue, indices: tuple):
        self.emitter, self.triplets, self.indices = triplets.emitter, triplets, indices
        self.dt = triplets.arrays["values"].dt

    def load(self) -> Any:
        raise self._refuse("read")

    def store(self, value: Any) -> None:
        raise self._refuse("set")

    def _refuse(self, what: str) -> TaiTypeError:
        name = self.triplets.name
        return TaiTypeError(
            f"an entry of '{name}' cannot be {what}: a builder collects what is added",
            f"{name}[i, j] += …, and {name}.build() afterwards",
        )

    def atomic(self, op: str, value: Any) -> None:
        if op not in ("+", "-"):
            raise self._refuse(f"changed by '{op}='")
        emitter, arrays = self.emitter, self.triplets.arrays
        row, column = (self._index(i) for i in self.indices)
        last = emitter.binary("-", arrays["rows"].shape[0], 1)
        number = arrays["count"].element(0).atomic("+", emitter.as_value(1))
        at = emitter.binary("min", number, last)
        for name, part in (("rows", row), ("columns", column)):
            arrays[name].element(at).store(part)
        if op == "-":
            value = emitter.unary("neg", value)
        arrays["values"].element(at).store(value)

    def _index(self, index: Any) -> Any:
        place = self.triplets.arrays["rows"].element(0)
        value = self.emitter.as_value(index)
        if value.shape or not value.dt.is_int:
            raise TaiIndexError("the indices of a matrix are whole numbers")
        return place.convert(value)
