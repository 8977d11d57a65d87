"""Other types and modes for a program that exists: its fields hold other floats for a while.

A place of a field stands for memory in C++ by three attributes: its type, its symbol and its core.
While a `Version` is on, the places of the program have those of a twin of another type, kernels
are compiled once more for them, and the program runs unchanged.

See docs/decisions/0065-solve-to.md.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from ..base import dtypes, native, state
from ..base.locks import snapshot
from ..base.program import get_program
from ..fields.scalar import ScalarField
from ..fields.snode import FieldsBuilder, axes
from .precision import owner_of
from .snapshot import Snapshot
from .sparse import sparse_level

_numbers = itertools.count()
# The attributes of a field that belong to its memory and change with its type.
_ATTRIBUTES = ("dtype", "symbol", "_core")


class Twin:
    """The storage of a field, and a twin: memory of another type that kernels can use in place of
    it.
    """

    def __init__(self, place: Any, dtype: Any):
        self.place = place
        grad = place._companions.get("grad")
        made = ScalarField(dtype, f"{owner_of(place).name}_{dtype.name}", "primal",
                           place.element_shape)  # fmt: skip
        made.needs_grad = grad is not None and grad._core is not None
        builder = FieldsBuilder()
        shape = place.shape
        node = builder.dense(axes(*range(len(shape))), shape) if shape else builder.root
        offset = place.offset if any(place.offset) else None
        node.place(made, offset=offset)
        self._tree = builder.finalize()
        made.materialize()
        self._pairs: list[tuple[Any, Any]] = [(place, made)]
        if made.needs_grad:
            self._pairs.append((grad, made._companions["grad"]))

    def copy_in(self) -> None:
        """Copies the values of a field to its twin, before the twin takes the place of the
        field.
        """
        place, made = self._pairs[0]
        array = Snapshot._take(place)
        made.core.copy_from(np.ascontiguousarray(array, made.dtype.numpy))

    def copy_out(self) -> None:
        """Copies values and gradients of the twin back to the field, once the field has its own
        memory again.
        """
        for place, made in self._pairs:
            array = Snapshot._take(made)
            place.core.copy_from(np.ascontiguousarray(array, place.dtype.numpy))

    def exchange(self) -> None:
        """Makes the field use the memory of its twin, or its own memory again."""
        fields = get_program().fields
        for place, made in self._pairs:
            for name in _ATTRIBUTES:
                mine, other = getattr(place, name), getattr(made, name)
                setattr(place, name, other)
                setattr(made, name, mine)
            for one in (place, made):
                assert one.symbol is not None  # both are in memory
                fields[one.symbol] = one

    def destroy(self) -> None:
        self._tree.destroy()


class Version(native.WithBlock):
    """Runs a program with other types of fields and other modes while the `with` block runs.

    Attributes:
        key: a key by which compiled code is found, besides the arguments.
        modes: words of kernels, as those of `ti.kernel`; words of a kernel's own go first.
        kinds: the types of storage places, by the identity of the place.
        loaded, stored, accumulated: symbols of the fields that its kernels use.
        places: the places of floats that they use.
        writes: lines about arrays of the caller that they write to.
        seconds: the least time of an iteration.
        tolerances: the factor by which the tolerances of solvers are multiplied.
        checkpoint: the arguments of its tapes that say which values they keep.
        memory: the most bytes that its last tape has kept.
        most_saved: a bound of the bytes that a tape keeps if it saves all values; 0 if unknown.
    """

    def __init__(
        self, modes: dict[str, Any], types: Iterable[tuple[Any, Any]] = (), is_plain: bool = False
    ):
        self.modes = modes
        # A version without types and modes of its own uses the compiled code of the program.
        self.key = () if is_plain else (("version", next(_numbers)),)
        self.twins: list[Twin] = []
        owners: dict[int, tuple[Any, Any]] = {}
        for place, dtype in types:
            if place.dtype is not dtype:
                self.twins.append(Twin(place, dtype))
                owners |= {id(owner): (owner, kind) for owner, kind in _owners(place, dtype)}
        self._owners = list(owners.values())
        self.loaded: set[str] = set()
        self.stored: set[str] = set()
        self.accumulated: set[str] = set()
        self.places: dict[int, Any] = {}
        self.writes: list[str] = []
        self.tolerances = 1.0
        self.checkpoint: dict[str, Any] = {}
        self.memory = self.most_saved = 0
        self.seconds = math.inf
        self._is_on = False

    def note(self, kernel: Any, name: str) -> None:
        """Notes that a kernel is launched for the first time in the block."""
        self.loaded |= {f.symbol for f in kernel.fields}
        self.accumulated |= {f.symbol for f in kernel.accumulated}
        self.stored |= {f.symbol for f in (*kernel.stored, *kernel.accumulated)}
        for f in (*kernel.fields, *kernel.stored, *kernel.accumulated):
            if f.dtype.is_float and f.role == "primal":
                self.places[id(f)] = f
        for spec in kernel.specs:
            if spec.kind == "array" and kernel.uses_of(spec)[1]:
                self.writes.append(name)

    def note_memory(self, tape: Any) -> None:
        """Notes the memory of a tape; no launch saves more than a snapshot holds."""
        stats = tape.stats()
        self.memory = stats.peak_bytes
        self.most_saved = tape.num_records * stats.snapshot_bytes

    def _enter(self) -> Version:
        for twin in self.twins:
            twin.copy_in()
        self._is_on = True
        self._exchange()
        state.of_thread.version = self
        return self

    def _end(self) -> None:
        if not self._is_on:
            return
        self._is_on = False
        state.of_thread.version = None
        self._exchange()

    def _exchange(self) -> None:
        for twin in self.twins:
            twin.exchange()
        self._owners = [(owner, _retyped(owner, dtype)) for owner, dtype in self._owners]
        _forget_launches()

    def copy_out(self) -> None:
        """Copies the values and gradients of the last run from the twins to the fields; to be
        called after the block.
        """
        for twin in self.twins:
            twin.copy_out()

    def destroy(self) -> None:
        for twin in self.twins:
            twin.destroy()
        self.twins = []


def _owners(place: Any, dtype: Any) -> list[tuple[Any, Any]]:
    """The vector or matrix field that a storage place belongs to, and its gradient, with their
    types.
    """
    owner = owner_of(place)
    if owner is place:
        return []
    found = [(owner, dtype)]
    grad = owner._companions.get("grad")
    if grad is not None:
        found.append((grad, dtypes.gradient_of(dtype)))
    return found


def _retyped(owner: Any, dtype: Any) -> Any:
    """Sets the type of a field or component; returns the former type."""
    former, owner.dtype = owner.dtype, dtype
    return former


def _forget_launches() -> None:
    """Makes Python forget which compiled code a launch uses and which type `float` stands for, so
    that both are looked up again.
    """
    for kernel in snapshot(get_program().kernels):
        kernel.forget_launches()
        kernel.forget_types()


def can_change(place: Any) -> bool:
    """Whether a field can get a copy of another type: it is dense, and no window of another
    field.
    """
    return sparse_level(place) is None and not getattr(place, "is_window", False)
