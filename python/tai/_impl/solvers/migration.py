"""The kernels of `ti.Particles`: they move particles between neighbouring ranks.

Index `r` is that of the rank in all fields, so that the compiler puts in the exchanges. The order
of particles does not depend on threads: each chunk of slots is counted, and the counts are added
up.
"""

from __future__ import annotations

import functools
from typing import Any

from ..base.dtypes import i32
from ..launch.kernels import kernel
from ..values.ops import cast, floor, max, min, ndrange, static, stop_grad
from ..values.types import template

CHUNK = 256  # slots that one iteration counts

# The columns of `tally`: particles that leave for the rank before and for the one behind, and free
# slots. The columns of `needs` add particles that would have to go further.
BEFORE, BEHIND, FREE, FAR = range(4)


@functools.cache
def kernels() -> Any:
    class Kernels:
        @staticmethod
        @kernel
        def count(
            live: template(), going: template(), tally: template(), position: template(),
            axis: template(), scale: float, block: i32, ranks: template(), capacity: template(),
        ):  # fmt: skip
            # `going` is -1 for particles that leave for the rank before, 1 for those that leave for
            # the one behind, 2 for those that are too far, and 0 for those that stay.
            for r, c in ndrange(ranks, (capacity + CHUNK - 1) // CHUNK):
                before, behind, free, far = 0, 0, 0, 0
                for s in range(c * CHUNK, min((c + 1) * CHUNK, capacity)):
                    way = 0
                    if live[r, s] == 0:
                        free += 1
                    else:
                        place = 0.0
                        if static(axis < 0):
                            place = stop_grad(position[r, s]) * scale
                        else:
                            place = stop_grad(position[r, s][axis]) * scale
                        owner = cast(floor(place), i32) // block
                        owner = max(0, min(owner, ranks - 1))
                        if owner == r - 1:
                            way = -1
                            before += 1
                            free += 1
                        elif owner == r + 1:
                            way = 1
                            behind += 1
                            free += 1
                        elif owner != r:
                            way = 2
                            far += 1
                    going[r, s] = way
                tally[r, c, 0] = before
                tally[r, c, 1] = behind
                tally[r, c, 2] = free
                tally[r, c, 3] = far

        @staticmethod
        @kernel
        def add_up(tally: template(), needs: template(), ranks: template(), chunks: template()):
            # Each count becomes the sum of those in front of it.
            for r, k in ndrange(ranks, 4):
                total = 0
                for c in range(chunks):
                    number = tally[r, c, k]
                    tally[r, c, k] = total
                    total += number
                needs[r, k] = total

        @staticmethod
        @kernel
        def assign(
            live: template(), going: template(), before_from: template(), behind_from: template(),
            coming: template(), tally: template(), needs: template(), ranks: template(),
            capacity: template(),
        ):  # fmt: skip
            # The rooms get the slots from which they are filled, and `coming` gets the number of
            # the room from which a slot is filled, plus one, negative for the rank before.
            for r, c in ndrange(ranks, (capacity + CHUNK - 1) // CHUNK):
                before, behind, free = tally[r, c, 0], tally[r, c, 1], tally[r, c, 2]
                from_before = needs[max(r - 1, 0), 1]
                if r == 0:
                    from_before = 0
                from_behind = needs[min(r + 1, ranks - 1), 0]
                if r == ranks - 1:
                    from_behind = 0
                for s in range(c * CHUNK, min((c + 1) * CHUNK, capacity)):
                    source, stays = 0, live[r, s]
                    if going[r, s] == -1:
                        before_from[r, before] = s
                        before += 1
                        stays = 0
                    elif going[r, s] == 1:
                        behind_from[r, behind] = s
                        behind += 1
                        stays = 0
                    if stays == 0:
                        if free < from_before:
                            source = -(free + 1)
                        elif free < from_before + from_behind:
                            source = free - from_before + 1
                        free += 1
                    coming[r, s] = source
                    live[r, s] = 1 if stays != 0 or source != 0 else 0

        @staticmethod
        @kernel
        def pack(
            field: template(), rooms: template(), rooms_from: template(), needs: template(),
            side: template(),
        ):  # fmt: skip
            # A loop over rooms, and not over slots: no two iterations store to a room.
            for r, k in rooms:
                if k < needs[r, side]:
                    rooms[r, k] = field[r, rooms_from[r, k]]

        @staticmethod
        @kernel
        def unpack(
            field: template(), before: template(), behind: template(), coming: template(),
            ranks: template(),
        ):  # fmt: skip
            # A rank reads the rooms of its neighbours that are for it.
            for r, s in coming:
                source = coming[r, s]
                if source < 0:
                    field[r, s] = behind[max(r - 1, 0), -source - 1]
                elif source > 0:
                    field[r, s] = before[min(r + 1, ranks - 1), source - 1]

    return Kernels
