"""The rows of the benchmark of errors: columns, file format, and dominance beyond the spread."""

from __future__ import annotations

import csv
import os
from pathlib import Path

KEY = ["scene", "size", "system", "mode", "arch", "threads"]
COLUMNS = [
    *KEY, "version", "clock", "ms", "q1", "q3", "least", "rounds", "peak_mb", "loss", "error",
    "error_low", "error_high", "loss_rel", "grad_rel", "grad_cos", "max_ulp", "inputs", "condition",
    "reference_error", "distinct", "runs", "nan_count", "launches", "final_loss", "final_steps",
    "status", "reason", "machine", "git", "session",
]  # fmt: skip
TEXTS = {*KEY, "version", "clock", "status", "reason", "machine", "git", "session"}
NUMBERS = set(COLUMNS) - TEXTS
# Errors below this one are equal.
FLOOR = 1e-15


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


def error_of(row: dict) -> float:
    """The median error of the gradient or of the loss, whichever is greater."""
    return row["error"]


def measured(rows: list[dict]) -> list[dict]:
    return [row for row in rows if row["status"] == "ok"]


def is_as_exact(row: dict, other: dict) -> bool:
    """Whether the error of a row is none, or not beyond the spread of the other's errors."""
    return row["error"] <= max(other["error_high"], FLOOR)


def is_faster(row: dict, other: dict) -> bool:
    """Whether a row is faster by more than the spread: their quartiles do not overlap."""
    return row["q3"] < other["q1"]


def is_more_exact(row: dict, other: dict) -> bool:
    """Whether the error of a row is smaller by more than the spread over inputs."""
    return max(row["error_high"], FLOOR) < other["error_low"]


def is_dominated(row: dict, others: list[dict]) -> bool:
    """Whether another row is as fast and as exact, and better in one by more than the spread."""
    return any(
        (is_faster(other, row) and is_as_exact(other, row))
        or (is_more_exact(other, row) and not is_faster(row, other))
        for other in others
        if other is not row
    )


def front(rows: list[dict]) -> list[dict]:
    """The rows that none dominates, fastest first."""
    found = [row for row in rows if not is_dominated(row, rows)]
    return sorted(found, key=lambda row: row["ms"])


def why_not_one_session(rows: list[dict]) -> str | None:
    """The reason why rows make no page together; None if they do."""
    if any("dirty" in row["git"] for row in rows):
        return "rows are of a tree with changes that are not committed"
    commits = sorted({row["git"] for row in rows})
    if len(commits) != 1 or not commits[0]:
        return f"rows are of {len(commits)} commits: {', '.join(commits) or 'none'}"
    sessions: dict[tuple, set[str]] = {}
    for row in rows:
        place = row["machine"], row["arch"], row["threads"]
        sessions.setdefault(place, set()).add(row["session"])
    for (machine, arch, threads), found in sessions.items():
        if len(found) != 1:
            return f"rows of {machine}, {arch}, threads {threads} are of {len(found)} sessions"
    return None
