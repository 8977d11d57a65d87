"""The values that the tape of a solution keeps: all of them, or snapshots from which it recomputes.

Snapshots do not change a result by more than the order of its sums, so `ti.solve_to` chooses
between them and saved values by memory and time. See docs/decisions/0081-checkpoints-by-time.md.
"""

from __future__ import annotations

import math
from typing import Any

from ...errors import TaiError
from .choices import Choice
from .tuning import distance

# Tapes that keep fewer bytes stay in the caches, where snapshots gain no time.
LEAST_KEPT = 4 * 2**20
# The part of the saved bytes that snapshots may take in the trial.
_PART = 8
# Snapshots are preferred if all saved values take this many times as long.
_GAIN = 1.15
# The iterations of a trial: one that compiles, and one of each kind in turns.
TRIAL = 3


def choose_density(search: Any, chosen: Choice, base: Any, room: float, budget: int | None) -> str:
    """Chooses between saved values and snapshots; returns the words for it.

    Without a budget, the program was measured with all values saved, and snapshots in an eighth
    of that memory are tried. With a budget, it was measured with snapshots.

    Args:
        search: measures a version: loss, gradient, seconds and report.
        room: the greatest relative error of the results.
        budget: the most bytes that the tape may keep; None for any number.
    """
    version = chosen.version
    if budget is not None:
        return _keep_budget(search, chosen, base, room, budget)
    if version.memory < LEAST_KEPT or search.iterations_left < TRIAL:
        return "everything"
    saved, kept = version.memory, {"memory_budget": version.memory // _PART}
    before = version.seconds
    try:
        version.checkpoint = kept
        result = search.measure(version)
        times = {}
        for name, checkpoint in (("everything", {}), ("snapshots", kept)):
            version.checkpoint, version.seconds = checkpoint, math.inf
            search.measure(version)
            times[name] = version.seconds
    except TaiError:  # the budget does not hold a snapshot, or a kernel cannot run again
        times, result = {"everything": before, "snapshots": math.inf}, chosen.result
    errors = distance(result, base)
    if times["everything"] < _GAIN * times["snapshots"] or max(errors) > room:
        version.checkpoint, version.memory = {}, saved
        version.seconds = min(before, times["everything"])
        return "everything"
    _take(chosen, result, errors)
    return "snapshots"


def _keep_budget(search: Any, chosen: Choice, base: Any, room: float, budget: int) -> str:
    """Measures snapshots within the budget, and all saved values if the budget holds them."""
    version = chosen.version
    kept = {"memory_budget": budget}
    if version.checkpoint != kept:
        # The reference had more memory.
        version.checkpoint, version.seconds = kept, math.inf
        result = search.measure(version)
        _take(chosen, result, distance(result, base))
    if version.most_saved > budget or search.iterations_left < TRIAL - 1:
        return "snapshots"
    slow, memory = version.seconds, version.memory
    version.checkpoint = {}
    result = search.measure(version)
    version.seconds = math.inf
    search.measure(version)
    errors = distance(result, base)
    if version.seconds > slow or version.memory > budget or max(errors) > room:
        version.checkpoint, version.seconds, version.memory = kept, slow, memory
        return "snapshots"
    _take(chosen, result, errors)
    return "everything"


def _take(chosen: Choice, result: Any, errors: tuple[float, float]) -> None:
    """Takes the result of a run with other snapshots, and the greater of the errors."""
    chosen.result, chosen.seconds = result, chosen.version.seconds
    chosen.errors = max(chosen.errors[0], errors[0]), max(chosen.errors[1], errors[1])
