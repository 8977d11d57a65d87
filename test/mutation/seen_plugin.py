"""A plugin of pytest that notes the mutants of a C++ build that each test reaches."""

from __future__ import annotations

import json
import mmap
import os

SEEN = os.environ.get("TAI_MUTANT_SEEN")
NOTES = os.environ.get("TAI_MUTANT_NOTES")
_map = None
if SEEN and NOTES:
    with open(SEEN, "r+b") as file:
        _map = mmap.mmap(file.fileno(), 0)


def pytest_runtest_logreport(report) -> None:
    if _map is None or report.when != "call":
        return
    numbers = [number for number, byte in enumerate(_map[:]) if byte]
    _map[:] = bytes(len(_map))
    row = {"test": report.nodeid, "seconds": report.duration, "passed": report.passed,
           "numbers": numbers}  # fmt: skip
    with open(NOTES, "a") as notes:
        notes.write(json.dumps(row) + "\n")
