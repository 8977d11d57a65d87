"""Runs a program and writes the times of its tapes: `python timed.py FILE program …`.

The file gets a row per tape: seconds of the forward pass, with its recording, and of the reverse
sweep.
"""

from __future__ import annotations

import atexit
import json
import runpy
import sys
import time
from pathlib import Path
from typing import Any

import tai
from tai._impl.base.files import write_text


class _Tape(tai.ad.Tape):
    rows: list[tuple[float, float]] = []

    def __enter__(self) -> Any:
        result = super().__enter__()
        self._begin = time.perf_counter()
        return result

    def __exit__(self, *error: Any) -> Any:
        tai.sync()
        middle = time.perf_counter()
        result = super().__exit__(*error)
        tai.sync()
        self.rows.append((middle - self._begin, time.perf_counter() - middle))
        return result


def _write(path: Path) -> None:
    if _Tape.rows:  # a resumed program that had nothing to do leaves the file alone
        write_text(path, json.dumps(_Tape.rows))


def main() -> None:
    """Takes the file and the program's command line from that of this process."""
    path, program = Path(sys.argv[1]), sys.argv[2]
    sys.argv[:] = sys.argv[2:]
    sys.path[0] = str(Path(program).resolve().parent)
    tai.ad.Tape = _Tape  # type: ignore[misc]
    atexit.register(_write, path)
    runpy.run_path(program, run_name="__main__")


if __name__ == "__main__":
    main()
