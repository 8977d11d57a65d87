"""The rows of the benchmark of errors: columns, file format, and Pareto dominance."""

from __future__ import annotations

import csv
import os
from pathlib import Path

KEY = ["scene", "size", "system", "mode", "arch", "threads"]
COLUMNS = [
    *KEY, "version", "clock", "ms", "p10", "p90", "least", "n", "peak_mb", "loss", "loss_rel",
    "grad_rel", "grad_cos", "max_ulp", "distinct", "runs", "nan_count", "launches", "final_loss",
    "final_steps", "status", "reason", "machine", "git",
]  # fmt: skip
NUMBERS = {
    "ms", "p10", "p90", "least", "peak_mb", "loss", "loss_rel", "grad_rel", "grad_cos", "max_ulp",
    "distinct", "runs", "nan_count", "launches", "final_loss", "final_steps", "n",
}  # fmt: skip


def key_of(row: dict) -> tuple[str, ...]:
    return tuple(str(row[name]) for name in KEY)


def read(path: Path) -> list[dict]:
    """The rows of a file; numbers are numbers, and an empty text is None.

    Raises:
        ValueError: the file has other columns, or what should be a number is none.
    """
    with path.open(newline="") as stream:
        reader = csv.DictReader(stream)
        absent = [name for name in COLUMNS if name not in (reader.fieldnames or ())]
        if absent:
            raise ValueError(f"{path} has no column '{absent[0]}'")
        rows = []
        for number, raw in enumerate(reader, 2):
            if None in raw.values() or None in raw:
                continue  # cut off where a run was killed
            row: dict = dict(raw)
            for name in NUMBERS:
                try:
                    row[name] = float(raw[name]) if raw[name] else None
                except ValueError:
                    raise ValueError(
                        f"{path}:{number}: '{raw[name]}' in column '{name}' is no number"
                    ) from None
            rows.append(row)
    return rows


def _text(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.9g}" if abs(value) >= 1e5 else f"{value:.5g}"
    return str(value)


def write(path: Path, rows: list[dict]) -> None:
    """Replaces a file, which is whole at any time."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    with part.open("w", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows([[_text(row.get(name)) for name in COLUMNS] for row in rows])
    os.replace(part, path)


def error_of(row: dict) -> float | None:
    """The error that a row is drawn by: of the gradient, or of the loss where that is greater."""
    found = [row[name] for name in ("grad_rel", "loss_rel") if row.get(name) is not None]
    return max(found) if found else None


def measured(rows: list[dict]) -> list[dict]:
    return [row for row in rows if row["status"] == "ok"]


def is_dominated(row: dict, others: list[dict]) -> bool:
    """Whether another row is at least as fast and as exact, and better in one of the two."""
    mine = row["ms"], error_of(row)
    for other in others:
        its = other["ms"], error_of(other)
        if its != mine and its[0] <= mine[0] and its[1] <= mine[1]:
            return True
    return False


def front(rows: list[dict]) -> list[dict]:
    """The rows that none dominates, fastest first."""
    found = [row for row in rows if not is_dominated(row, rows)]
    return sorted(found, key=lambda row: row["ms"])


def beats_all(row: dict, others: list[dict]) -> bool:
    """Whether a row is faster than each of the others and at least as exact."""
    return bool(others) and all(
        row["ms"] < other["ms"] and error_of(row) <= error_of(other) for other in others
    )
