"""Counters of skipped work: `ti.profiler.skips()`."""

from __future__ import annotations

from typing import Any

from . import state
from .program import get_program


def format_bytes(count: int) -> str:
    """Formats a number of bytes with a unit, for reading."""
    value, unit = float(count), 0
    units = ("B", "KiB", "MiB", "GiB", "TiB", "PiB", "EiB")
    while value >= 1024 and unit < len(units) - 1:
        value, unit = value / 1024, unit + 1
    return f"{value:.1f} {units[unit]}" if unit else f"{count} B"


class Skips(dict):
    """Counters by the name of the skip: `skips()["unchanged-lists"]["reused"]`.

    `str` makes a table of them.

    Attributes:
        on: the names of the skips that are on.
        levels: for each sparse level that has had a list, by its name in the layout: lists
            `made` and `reused`.
    """

    def __init__(self, rows: list[tuple[str, str, int, bool]]):
        super().__init__()
        self.on: set[str] = set()
        self.levels: dict[str, dict[str, int]] = {}
        for skip, counter, value, is_on in rows:
            self.setdefault(skip, {})[counter] = value
            if is_on:
                self.on.add(skip)

    def __str__(self) -> str:
        lines = []
        for skip, counters in self.items():
            shown = [
                f"{name.replace('_', ' ')} "
                + (format_bytes(value) if name.startswith("bytes") else str(value))
                for name, value in counters.items()
            ]
            switch = "on" if skip in self.on else "off"
            lines.append(f"{skip:<22}{switch:<5}{', '.join(shown)}")
            if skip == "unchanged-lists" and len(self.levels) > 1:
                for level, lists in self.levels.items():
                    lines.append(f"{'':<29}{level}: made {lists['made']}, reused {lists['reused']}")
        return "\n".join(lines)


def skips() -> Skips:
    """Returns the counters of skipped work since `ti.init` or the last `clear_skips`.

    Returns:
        A dictionary of dictionaries, by the names that `ti.init(skip=…)` takes;
        docs/decisions/0008-skips.md defines each number.
    """
    found = Skips(get_program().context.skips())
    program = state.program
    found["unlaunched-kernels"]["kernels_defined"] = program.kernels_defined()
    for level, (made, reused) in _lists(program).items():
        made_before, reused_before = program.lists_before.get(level, (0, 0))
        made, reused = made - made_before, reused - reused_before
        if made or reused:
            lists = found.levels.setdefault(repr(level), {"made": 0, "reused": 0})
            lists["made"] += made
            lists["reused"] += reused
    return found


def _lists(program: Any) -> dict[Any, tuple[int, int]]:
    """The numbers of lists of active cells that each sparse level has made and reused."""
    found = {}
    roots = {field.level.root_node for field in program.fields.values() if field.level}
    for root in roots:
        if root.tree is not None:
            for number, level in enumerate(root.sparse_levels()):
                found[level] = program.context.sparse_level(root.tree, number)[3:5]
    return found


def print_skips() -> None:
    """Prints a table of the counters of skipped work, one line for each skip."""
    print(skips())


def clear_skips() -> None:
    """Sets the counters of skipped work to zero."""
    if state.program is not None:
        state.program.context.clear_skips()
        state.program.count_kernels_from_here()
        state.program.lists_before = _lists(state.program)
