"""Helpers of experiments: running example programs, checks, and results for the page."""

from __future__ import annotations

import contextlib
import csv
import importlib
import io
import json
import math
import os
import re
import shutil
import signal
import statistics
import subprocess
import sys
from argparse import Namespace
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import tai

LEVELS = ("once", "quick", "full")
_TIMED = Path(__file__).resolve().with_name("timed.py")
_PACKAGES = Path(tai.__file__).resolve().parents[1]
_T = TypeVar("_T")


class Failed(Exception):
    """An experiment that did not run; the text is its reason, in one line."""


class LeftOut(Exception):
    """Raised for an experiment for which this machine lacks something."""


@dataclass
class Result:
    """The result of an experiment: rows of the page, and the checks that failed."""

    name: str
    status: str = "ok"
    reason: str = ""
    seconds: float = 0.0
    load: float = 0.0  # of the machine, when it was done
    machine: str = ""  # processor and GPU
    cores: int = 1  # that processes were allowed
    blocks: list[list[Any]] = field(default_factory=list[list[Any]])


@dataclass
class Run:
    """One run of an example program, with its output."""

    name: str
    folder: Path
    output: str
    tapes: list[tuple[float, float]]

    def table(self, what: str = "losses") -> dict[str, list[float]]:
        """Returns the columns of a table that the example wrote."""
        path = self.folder / f"{self.name}.{what}.csv"
        with path.open(newline="") as file:
            names, *rows = csv.reader(file)
        return {name: [float(row[k]) for row in rows] for k, name in enumerate(names)}

    @property
    def losses(self) -> list[float]:
        return self.table()["loss"]

    @property
    def seconds(self) -> list[float]:
        """The time of each iteration; the first iteration compiles."""
        return self.table()["seconds"]

    def find(self, pattern: str) -> list[float]:
        """The numbers in the groups of a pattern that the output has, or a failure."""
        found = re.search(pattern, self.output, re.M)
        if found is None:
            raise Failed(f"{self.name} printed no '{pattern}'")
        return [float(text) for text in found.groups()]


def last_line(text: str) -> str:
    lines = [line for line in text.splitlines() if line.strip()]
    return lines[-1].strip() if lines else "it said nothing"


class Lab:
    """Runs the examples for one experiment after the other.

    Args:
        examples: the folder of the programs.
        out: where runs and results go.
        level: `once` (single iterations), `quick` or `full`.
        arch: the target.
        resume: go on with the results of runs in `out`.
        extra: options for every program.
    """

    def __init__(
        self, examples: Path, out: Path, level: str, arch: str, resume: bool,
        extra: Sequence[str] = (),
    ):  # fmt: skip
        self.examples, self.out, self.arch, self.resume = examples, out, arch, resume
        self.level, self.extra = level, list(extra)
        self.result = Result("none")

    def begin(self, name: str) -> Result:
        """A new experiment."""
        self.result = Result(name)
        return self.result

    def pick(self, *values: _T) -> _T:
        """Returns one of three values, by the level of the experiments (short to full)."""
        return values[LEVELS.index(self.level)]

    # Programs

    def run(
        self, name: str, *options: Any, label: str = "run", iterations: int = 0,
        timed: bool = False, pictures: bool = False, cache: Path | None = None,
    ) -> Run:  # fmt: skip
        """Runs an example in a folder of its own.

        Raises:
            Failed: it ended with an error.
            LeftOut: it needs a library or a device that is not there.
        """
        program = self.examples / f"{name}.py"
        if not program.is_file():
            raise Failed(f"there is no {program}")
        folder = self.out / "runs" / self.result.name / label
        folder.mkdir(parents=True, exist_ok=True)
        times = folder / "times.json"
        command = [sys.executable, *([str(_TIMED), str(times)] if timed else [])]
        command += [str(program), *map(str, options), "--out", str(folder), *self.extra]
        command += ["--iterations", str(iterations)] if iterations else []
        command += ["--arch", self.arch] if self.arch != "cpu" else []
        command += [] if pictures else ["--no-picture"]
        command += ["--resume"] if self.resume and (folder / f"{name}.npz").is_file() else []
        words = " ".join([name, *map(str, options)])
        print(f"  {self.result.name}: {words}", file=sys.stderr, flush=True)
        environment = os.environ | {"PYTHONPATH": self._path()}
        if cache:
            environment["TAI_CACHE_DIR"] = str(cache)
        output, errors, status = _call(command, environment)
        if status:
            reason = last_line(errors)
            if "not installed" in reason or "cannot be loaded" in reason or "--arch" in reason:
                raise LeftOut(reason)
            if status < 0:
                reason = f"ended by signal {signal.Signals(-status).name}"
            raise Failed(f"{words}: {reason}")
        tapes: list[Any] = json.loads(times.read_text()) if timed else []
        return Run(name, folder, output, [(a, b) for a, b in tapes])

    @staticmethod
    def _path() -> str:
        before = os.environ.get("PYTHONPATH")
        return str(_PACKAGES) + (os.pathsep + before if before else "")

    # Checks

    def check(self, holds: bool, what: str) -> None:
        """Notes that a check has failed; the experiment continues, and counts as failed."""
        if not holds:
            self.result.status = "failed"
            self.result.reason += ("; " if self.result.reason else "") + what

    def near(self, found: float, expected: float, rel: float, what: str) -> None:
        """Checks a number against one that was measured or derived."""
        close = math.isclose(found, expected, rel_tol=rel, abs_tol=1e-12)
        self.check(close, f"{what} is {found:.6g} and not {expected:.6g}")

    def first_losses(self, run: Run, expected: Sequence[float], rel: float) -> None:
        """Checks the losses of the first iterations against those of the paper's program."""
        for number, (found, known) in enumerate(zip(run.losses, expected, strict=False)):
            self.near(found, known, rel, f"loss {number} of {run.name}")

    # The page

    def text(self, text: str) -> None:
        self.result.blocks.append(["text", " ".join(text.split())])

    def table(self, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
        shown = [[show(cell) for cell in row] for row in rows]
        self.result.blocks.append(["table", list(header), shown])

    def picture(self, path: Path, caption: str) -> None:
        """Adds a picture that an example has made to the page, or a note on why there is none."""
        if not path.is_file():
            self.text("(No picture: that takes `pip install matplotlib`.)")
            return
        pictures = self.out / "pictures"
        pictures.mkdir(exist_ok=True)
        count = sum(block[0] == "picture" for block in self.result.blocks)
        name = f"paper_{self.result.name}_{count + 1}.png"
        shutil.copyfile(path, pictures / name)
        self.result.blocks.append(["picture", f"pictures/{name}", caption])

    def plot(self, what: str, curves: dict[str, Any], caption: str, **options: Any) -> None:
        """Plots curves in the style of the examples."""
        folder = self.out / "runs" / self.result.name
        folder.mkdir(parents=True, exist_ok=True)
        args = Namespace(out=folder, name="plot", picture=True)
        sys.path.insert(0, str(self.examples))
        try:
            studio = importlib.import_module("studio")
        except ImportError as error:
            raise Failed(f"{self.examples} has no frame of the examples ({error})") from None
        finally:
            sys.path.pop(0)
        said = io.StringIO()
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            studio.plot(args, what, curves, **options)
        self.picture(folder / f"plot.{what}.png", caption)


def show(cell: Any) -> str:
    """Formats a cell of a table."""
    return f"{cell:.6g}" if isinstance(cell, float) else str(cell)


def usual(values: Sequence[float]) -> float:
    """The median of all times except the first, which includes compilation; of a single time, that
    time.
    """
    return statistics.median(values[1:] or values)


def _call(command: list[str], environment: dict[str, str]) -> tuple[str, str, int]:
    """Runs a program; an interrupt is passed on, so that the program saves its results."""
    pipe = subprocess.PIPE
    process = subprocess.Popen(
        command, stdout=pipe, stderr=pipe, text=True, env=environment, start_new_session=True
    )
    try:
        output, errors = process.communicate()
    except BaseException:
        process.send_signal(signal.SIGINT)
        try:
            process.communicate(timeout=60)
        except BaseException:
            process.kill()
            process.wait()
            raise
        raise
    return output, errors, process.returncode
