"""Options and reports on the values that a tape keeps for the reverse sweep."""

from __future__ import annotations

import numbers
from typing import Any, NamedTuple

from ...errors import TaiRuntimeTypeError

# The numbers of the checkpoint policies, as in TaiCheckpoint of the C API.
_KINDS = {"periodic": 1, "binomial": 2, "mixed": 3}

# The default number of snapshots: enough for six thousand records with three repetitions each.
_BINOMIAL_SNAPSHOTS = 32


class TapeStats(NamedTuple):
    """The memory that a tape uses, and the amount of recomputation.

    Attributes:
        saved_bytes: current size of saved overwritten values.
        peak_bytes: peak size of snapshots and saved values.
        snapshots: peak number of snapshots; 0 without checkpoints.
        snapshot_bytes: of the largest snapshot.
        recomputed: records that were run again since the sequence last ran forward.
        optimum: records that the optimal binomial schedule would run again with as many
            snapshots, if it knew the number of records in advance and saved the values of
            one record only.
    """

    saved_bytes: int
    peak_bytes: int
    snapshots: int
    snapshot_bytes: int
    recomputed: int
    optimum: int


def parse_checkpoint(checkpoint: Any, memory_budget: Any) -> tuple[int, int, int] | None:
    """Converts a `checkpoint` argument of a tape to what `taiTapeSetCheckpoint` takes: the kind,
    the number of snapshots and the bytes. None means that the tape saves all values.

    Raises:
        TaiRuntimeTypeError: anything else than the values that `ti.ad.Tape` documents.
    """
    budget = 0
    if memory_budget is not None:
        is_number = isinstance(memory_budget, numbers.Real) and not isinstance(memory_budget, bool)
        if not is_number or not float(memory_budget).is_integer():
            raise TaiRuntimeTypeError(
                f"memory_budget is a number of bytes, but got {memory_budget!r}",
                "memory_budget=64 << 20 is 64 MiB",
            )
        budget = int(memory_budget)
        if budget <= 0:
            raise TaiRuntimeTypeError(f"a memory budget of {budget} bytes holds nothing")
    if checkpoint is None:
        if not budget:
            return None
        checkpoint = "mixed"
    if isinstance(checkpoint, int) and not isinstance(checkpoint, bool):
        if checkpoint < 1:
            raise TaiRuntimeTypeError(f"checkpoint={checkpoint}: at least one snapshot is needed")
        return _KINDS["binomial"], checkpoint, budget
    if checkpoint not in _KINDS:
        raise TaiRuntimeTypeError(
            f"checkpoint={checkpoint!r} is none of {', '.join(map(repr, _KINDS))}, "
            "None and a number of snapshots"
        )
    snapshots = 0
    if checkpoint == "binomial" and not budget:
        snapshots = _BINOMIAL_SNAPSHOTS
    return _KINDS[checkpoint], snapshots, budget
