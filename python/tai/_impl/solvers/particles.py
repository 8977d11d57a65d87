"""`ti.Particles`: particles that ranks of a mesh own, and that move between them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ...errors import TaiRuntimeError, TaiRuntimeTypeError
from ..base.dtypes import i32
from ..base.program import get_program
from ..fields import root as roots
from ..fields.make import field, make_field
from ..fields.matrix_field import MatrixField
from ..fields.scalar import ScalarField
from ..fields.snode import axes
from .migration import BEFORE, BEHIND, CHUNK, FAR, FREE, kernels


class Particles:
    """Slots for particles on each rank of the mesh; without a mesh, on one rank.

    The fields of the particles have two indices: the rank, and the slot. `live` is 1 in slots that
    have a particle, and 0 in others. `migrate` moves particles to the ranks that own the rows of a
    grid in which they are; tapes record it, and its adjoint moves gradients back.
    docs/guides/many.md has an example.

    Args:
        capacity: the number of slots of each rank.
        room: the most particles that leave a rank for one of its neighbours in a call of `migrate`;
            a quarter of the slots by default.

    Attributes:
        live: the field that tells which slots have particles.
        ranks: the number of ranks.
    """

    def __init__(self, capacity: int, room: int | None = None):
        room = max(1, capacity // 4) if room is None and isinstance(capacity, int) else room
        for name, value in (("capacity", capacity), ("room", room)):
            if isinstance(value, bool) or not isinstance(value, int) or value < 1:
                raise TaiRuntimeTypeError(f"{name} is a number of particles, but got {value!r}")
        mesh = get_program().options.mesh
        self.ranks = 1 if mesh is None else mesh.ranks
        self.capacity, self.room = capacity, room
        self.live, self._going, self._coming = (field(i32) for _ in range(3))
        self._before_from, self._behind_from = field(i32), field(i32)
        self._tally, self._needs = field(i32), field(i32)
        self._chunks = -(-capacity // CHUNK)
        self._place((self.ranks, capacity), self.live, self._going, self._coming)
        self._place((self.ranks, room), self._before_from, self._behind_from)
        self._place((self.ranks, self._chunks, 4), self._tally)
        self._place((self.ranks, 4), self._needs)
        # The fields of the particles, and memory for those that leave on either side.
        self._moved: list[tuple[Any, Any, Any]] = []

    def _place(self, shape: tuple[int, ...], *fields: Any) -> None:
        level: Any = roots.root
        if get_program().options.mesh is not None:
            level = level.shard(axes(0))
        level.dense(axes(*range(len(shape))), shape).place(*fields)

    def place(self, *fields: Any) -> Particles:
        """Places fields of numbers, vectors or matrices that have no shape yet: the data of the
        particles, which `migrate` moves.
        """
        for each in fields:
            if not isinstance(each, (ScalarField, MatrixField)):
                raise TaiRuntimeTypeError(
                    f"particles have fields of numbers, vectors or matrices, but got {each!r}"
                )
            before, behind = (
                make_field(
                    each.element_shape,
                    each.dtype,
                    None,
                    None,
                    None,
                    None,
                    each.needs_grad,
                    each.needs_dual,
                )  # fmt: skip
                for _ in range(2)
            )
            for made, slots in ((each, self.capacity), (before, self.room), (behind, self.room)):
                self._place((self.ranks, slots), made, *_companions(made))
            self._moved.append((each, before, behind))
        return self

    def owners(self, places: Any, rows: int) -> np.ndarray:
        """The ranks that own the rows of a grid of `rows` rows at some places.

        Args:
            places: coordinates along the sharded axis, in rows.
        """
        block = self._block(rows)
        found = np.floor(np.asarray(places)).astype(np.int64) // block
        return np.clip(found, 0, self.ranks - 1)

    def _block(self, rows: int) -> int:
        if rows % self.ranks:
            raise TaiRuntimeError(
                f"the {self.ranks} ranks of the mesh do not divide the {rows} rows",
                f"choose a multiple of {self.ranks}",
            )
        return rows // self.ranks

    def set(self, values: Mapping[Any, Any], places: Any, rows: int) -> None:
        """Gives each rank the particles in its rows, in their order. All ranks call it alike.

        Args:
            values: arrays with the data of all particles, by field.
            places: the coordinate of each particle along the sharded axis, in rows.
            rows: the number of rows of the grid.
        """
        owners = self.owners(places, rows)
        live = np.zeros((self.ranks, self.capacity), np.int32)
        slots = np.zeros(len(owners), np.int64)
        for rank in range(self.ranks):
            own = np.flatnonzero(owners == rank)
            if len(own) > self.capacity:
                raise TaiRuntimeError(
                    f"rank {rank} gets {len(own)} particles and has {self.capacity} slots",
                    "make ti.Particles with a larger capacity",
                )
            slots[own] = np.arange(len(own))
            live[rank, : len(own)] = 1
        for each, array in values.items():
            given = np.asarray(array)
            whole = np.zeros((*live.shape, *given.shape[1:]), each.dtype.numpy)
            whole[owners, slots] = given
            each.from_numpy(whole)
        self.live.from_numpy(live)

    def take(self, *fields: Any) -> list[np.ndarray]:
        """The data of all particles by rank and slot. All ranks call it together."""
        live = self.live.to_numpy() != 0
        return [each.to_numpy()[live] for each in fields]

    def migrate(self, position: Any, rows: int, scale: float = 1.0, axis: int = 0) -> None:
        """Moves particles to the ranks that own their rows. All ranks call it together.

        A particle is in row floor(scale * x) of the grid, where x is its position along the
        sharded axis; those beyond the grid belong to the first or last rank. A particle may move to
        a neighbouring rank, and not further.

        Args:
            position: a field of the particles: of vectors, or of numbers.
            rows: the number of rows of the grid.
            scale: rows for each unit of the position.
            axis: the component of vectors that is along the sharded axis.

        Raises:
            TaiRuntimeError: on all ranks, if a rank has too few slots or too little room, or if a
                particle would have to move further. No particle has moved then.
        """
        block = self._block(rows)
        if not math.isfinite(scale):
            raise TaiRuntimeTypeError(f"scale is a number, but got {scale!r}")
        parts = kernels()
        component = axis if isinstance(position, MatrixField) else -1
        parts.count(
            self.live, self._going, self._tally, position, component, scale, block, self.ranks,
            self.capacity,
        )  # fmt: skip
        parts.add_up(self._tally, self._needs, self.ranks, self._chunks)
        if self.ranks == 1:
            return
        self._check(self._needs.to_numpy())
        parts.assign(
            self.live, self._going, self._before_from, self._behind_from, self._coming,
            self._tally, self._needs, self.ranks, self.capacity,
        )  # fmt: skip
        for each, before, behind in self._moved:
            parts.pack(each, before, self._before_from, self._needs, BEFORE)
            parts.pack(each, behind, self._behind_from, self._needs, BEHIND)
            parts.unpack(each, before, behind, self._coming, self.ranks)

    def _check(self, needs: np.ndarray) -> None:
        """Reports particles that do not fit, from the counts of all ranks."""
        for rank, row in enumerate(needs):
            if row[FAR]:
                raise TaiRuntimeError(
                    f"{row[FAR]} particles of rank {rank} have moved further than to the "
                    "neighbouring ranks",
                    "migrate more often",
                )
            for way, other in ((BEFORE, rank - 1), (BEHIND, rank + 1)):
                if row[way] > self.room:
                    raise TaiRuntimeError(
                        f"{row[way]} particles leave rank {rank} for rank {other}, and there is "
                        f"room for {self.room}",
                        f"make ti.Particles with room={row[way]} or more",
                    )
            arrive = int(needs[rank - 1][BEHIND]) if rank else 0
            arrive += int(needs[rank + 1][BEFORE]) if rank + 1 < len(needs) else 0
            if arrive > row[FREE]:
                need = self.capacity - int(row[FREE]) + arrive
                raise TaiRuntimeError(
                    f"rank {rank} gets {arrive} particles and has {row[FREE]} free slots",
                    f"make ti.Particles with capacity={need} or more",
                )


def _companions(made: Any) -> list[Any]:
    """The gradient and the tangent that a field is to have."""
    wanted = ((made.needs_grad, "grad"), (made.needs_dual, "dual"))
    return [getattr(made, name) for needed, name in wanted if needed]
