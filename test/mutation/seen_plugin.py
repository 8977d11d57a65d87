"""A plugin of pytest that notes the mutants of a C++ build that each test reaches."""

from __future__ import annotations

import json
import mmap
import os

SEEN = os.environ.get("TAI_MUTANT_SEEN")
NOTES = os.environ.get("TAI_MUTANT_NOTES")
WORKER = os.environ.get("PYTEST_XDIST_WORKER")
_map = None
if SEEN and NOTES and WORKER:
    # Each worker of pytest-xdist has files of its own. The library has not been loaded yet.
    size = os.path.getsize(SEEN)
    SEEN, NOTES = f"{SEEN}-{WORKER}", NOTES.replace(".jsonl", f"-{WORKER}.jsonl")
    with open(SEEN, "wb") as file:
        file.write(bytes(size))
    os.environ["TAI_MUTANT_SEEN"] = SEEN
if SEEN and NOTES:
    with open(SEEN, "r+b") as file:
        _map = mmap.mmap(file.fileno(), 0)


def pytest_runtest_logreport(report) -> None:
    # The process that gives the tests to the workers reports them again.
    if _map is None or report.when != "call" or (hasattr(report, "node") and not WORKER):
        return
    numbers = [number for number, byte in enumerate(_map[:]) if byte]
    _map[:] = bytes(len(_map))
    row = {"test": report.nodeid, "seconds": report.duration, "passed": report.passed,
           "numbers": numbers}  # fmt: skip
    with open(NOTES, "a") as notes:
        notes.write(json.dumps(row) + "\n")
