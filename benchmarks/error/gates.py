"""Judges the results of the benchmark of errors: exits with 1 if a bound is violated.

    .venv/bin/python benchmarks/error/gates.py benchmarks/results/error-<machine>.csv

A bound without measurements counts as violated, and is shown as not judged.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import modes
import rows

CONTENDED = {"scatter", "one_cell"}


@dataclass
class Gate:
    """A bar, the figures found for it, and the cases that break it."""

    name: str
    found: list[str] = field(default_factory=list)
    broken: list[str] = field(default_factory=list)

    @property
    def outcome(self) -> str:
        if self.broken:
            return "FAILS"
        return "keeps" if self.found else "not judged"

    def note(self, what: str, value: float, bar: float) -> None:
        text = f"{what}: {value:.3g}"
        self.found.append(text)
        if not value <= bar:
            self.broken.append(text)


class Table:
    """Measured rows of tai by scene, mode, where they ran, and on which machine."""

    def __init__(self, found: list[dict]):
        ours = [r for r in rows.measured(found) if r["system"] == modes.OURS]
        self.rows = {(r["scene"], r["mode"], self.place(r), r["machine"]): r for r in ours}

    @staticmethod
    def place(row: dict) -> str:
        threads = "" if row["arch"] == "cuda" else f" {row['threads']}"
        return f"{row['arch']}{threads} {row['size']}"

    def of(self, mode: str, scene: str = "") -> Iterator[dict]:
        for (here, name, *_), row in self.rows.items():
            if name == mode and scene in ("", here):
                yield row

    def pairs(self, mode: str, base: str) -> Iterator[tuple[str, dict, dict]]:
        """Rows of two modes, of the same scene at the same place on one machine."""
        for (scene, name, place, machine), row in self.rows.items():
            other = self.rows.get((scene, base, place, machine))
            if name == mode and other is not None:
                yield f"{scene} ({place})", row, other


def ratio(gate: Gate, table: Table, mode: str, base: str, bar: Callable[[str], float]) -> None:
    for where, row, other in table.pairs(mode, base):
        gate.note(f"{where} {mode}", row["least"] / other["least"], bar(row["scene"]))


def bound(gate: Gate, table: Table, scene: str, mode: str, what: str, bar: float) -> None:
    for row in table.of(mode, scene):
        if row[what] is not None:
            gate.note(f"{scene} ({table.place(row)}) {mode}", row[what], bar)


def judge(found: list[dict]) -> list[Gate]:
    """All gates of a table of rows."""
    table = Table(found)
    gates: list[Gate] = []

    def gate(name: str) -> Gate:
        gates.append(Gate(name))
        return gates[-1]

    ratio(gate("guards cost at most 2 %"), table, "f32", "f32 unguarded", lambda _: 1.02)
    compensated = gate("compensated sums cost at most 30 %")
    for bits in ("f32", "f64"):
        ratio(compensated, table, f"{bits} compensated", bits, lambda _: 1.3)
    ratio(
        gate("deterministic costs at most 1.5 times on contended scatters, 3 times elsewhere"),
        table, "f32 deterministic", "f32", lambda scene: 1.5 if scene in CONTENDED else 3.0,
    )  # fmt: skip
    faster = gate("f64 is never as fast as f32 (it is always more exact)")
    ratio(faster, table, "f32", "f64", lambda _: 1.0)
    default = gate("f32 sum at condition 1e6: at most 2e-4 off")
    bound(default, table, "sum_ill", "f32", "loss_rel", 2e-4)
    better = gate("compensated f32 sum at condition 1e6: at most 1e-7 off")
    bound(better, table, "sum_ill", "f32 compensated", "loss_rel", 1e-7)
    cell = gate("f32 numbers into one cell: at most 1e-5 off")
    bound(cell, table, "one_cell", "f32", "loss_rel", 1e-5)
    cell = gate("compensated f32 numbers into one cell: at most 1e-7 off")
    bound(cell, table, "one_cell", "f32 compensated", "loss_rel", 1e-7)
    cell = gate("f64 numbers into one cell: at most 1e-13 off")
    bound(cell, table, "one_cell", "f64", "loss_rel", 1e-13)
    ulp = gate("accurate maps: at most 1 ulp")
    for scene in ("exp", "sin", "pow"):
        bound(ulp, table, scene, "f32 accurate", "max_ulp", 1.0)
    same = gate("deterministic: one result in 100 runs (20 of long scenes)")
    for mode in modes.TAI:
        for row in table.of(mode.name) if mode.is_deterministic else ():
            same.note(f"{row['scene']} ({table.place(row)}) {mode.name}", row["distinct"], 1)
    finite = gate("finite in, finite out")
    for (scene, name, place, _), row in table.rows.items():
        finite.note(f"{scene} ({place}) {name}", row["nan_count"], 0)
    _judge_fronts(gate("each mode is on the front of some scene, or halves the memory"), table)
    _judge_failures(gate("no scene fails in a mode that this build has"), found)
    return gates


def _judge_fronts(gate: Gate, table: Table) -> None:
    groups: dict[tuple, list[dict]] = {}
    for (scene, name, *place), row in table.rows.items():
        if name != "f32 unguarded":  # nobody is asked to choose it
            groups.setdefault((scene, *place), []).append(row)
    on_front = {row["mode"] for group in groups.values() for row in rows.front(group)}
    for name in sorted({row["mode"] for group in groups.values() for row in group}):
        if modes.find(modes.OURS, name).is_deterministic:
            continue  # chosen for its bits
        if name in on_front or name in modes.JUSTIFIED:
            gate.note(name, 0, 0)
        else:
            gate.note(f"{name} is on none", 1, 0)


def _judge_failures(gate: Gate, found: list[dict]) -> None:
    for row in found:
        if row["system"] == modes.OURS:
            what = f"{row['scene']} {row['mode']}"
            gate.note(f"{what} {row['reason'] or ''}".strip(), row["status"] == "failed", 0)


def show(gates: list[Gate]) -> str:
    """As lines of text: the outcome of each bar, and all that breaks it."""
    lines = []
    for gate in gates:
        lines.append(f"{gate.outcome:10} {gate.name} ({len(gate.found)} measured)")
        lines += [f"           {text}" for text in gate.broken]
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="+", type=Path, help="what the benchmark wrote")
    given = parser.parse_args(arguments)
    found = []
    for path in given.files:
        try:
            found += rows.read(path)
        except (OSError, ValueError) as error:
            parser.error(str(error))
    gates = judge(found)
    print(show(gates))
    return 0 if all(gate.outcome == "keeps" for gate in gates) else 1


if __name__ == "__main__":
    sys.exit(main())
