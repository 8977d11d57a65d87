"""The loop of descent: progress, checkpoints, a table of the losses."""

import argparse
import contextlib
import csv
import json
import os
import signal
import statistics
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import tai as ti

from .options import checkpoint, fail

# Options that may differ between a run and its continuation.
FREE = {"arch", "iterations", "movie", "out", "picture", "quick", "rate", "resume"}
# The loss of an iteration, or its columns.
Numbers = float | Mapping[str, Any]
KEEP_EVERY = 10.0  # seconds between two checkpoints
_runs: list["_Run"] = []  # the last one


def table(args: argparse.Namespace, what: str, **columns: Iterable[Any]) -> Path:
    """Writes `NAME.WHAT.csv`, a column for each argument."""
    path = args.out / f"{args.name}.{what}.csv"
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
    return path


def _settings(args: argparse.Namespace) -> dict[str, str]:
    return {key: str(value) for key, value in sorted(vars(args).items()) if key not in FREE}


class _Run:
    """The state of a descent: the kept fields, and the numbers of each iteration."""

    def __init__(self, args: argparse.Namespace, kept: dict[str, Any]):
        self.args, self.fields = args, kept
        self.columns: dict[str, list[float]] = {}
        self.best: dict[str, Any] = {}
        self.least = float("inf")
        if args.resume:
            self.load()
        self.take()

    def __len__(self) -> int:
        return len(self.columns["seconds"]) if self.columns else 0

    def losses(self) -> list[float]:
        return [*self.columns.values()][0] if self.columns else []

    def note(self, result: Numbers, seconds: float) -> None:
        row = dict(result) if isinstance(result, Mapping) else {"loss": result}
        for name, value in (row | {"seconds": seconds}).items():
            self.columns.setdefault(name, []).append(float(value))
        loss = self.losses()[-1]
        if np.isfinite(loss) and loss < self.least:
            self.least, self.best = loss, self.state  # the state before this iteration

    def take(self) -> None:
        """Copies the state, so that an interrupt amid the next iteration does no harm."""
        self.state = {name: field.to_numpy() for name, field in self.fields.items()}
        self.rows = len(self)

    def save(self) -> None:
        """Writes the copy; a file that was there stays whole until the new one is."""
        path = checkpoint(self.args)
        part = path.with_suffix(f".{os.getpid()}.npz")  # another run may have the same folder
        columns = {name: values[: self.rows] for name, values in self.columns.items()}
        arrays = {f"kept.{name}": value for name, value in self.state.items()}
        arrays |= {f"best.{name}": value for name, value in self.best.items()}
        arrays |= {f"column.{name}": np.array(values) for name, values in columns.items()}
        with _uninterrupted():
            try:
                np.savez(part, settings=json.dumps(_settings(self.args)), **arrays)
                os.replace(part, path)
            finally:
                part.unlink(missing_ok=True)
            table(self.args, "losses", iteration=range(self.rows), **columns)

    def load(self) -> None:
        path = checkpoint(self.args)
        try:
            with np.load(path) as file:
                stored = dict(file)
            made = json.loads(str(stored.pop("settings")))
            for key, value in _settings(self.args).items():
                if made[key] != value:
                    option = f"--{key.replace('_', '-')}"
                    fail(f"--resume: {path} was made with {option} {made[key]}, not {value}")
            for name, field in self.fields.items():
                field.from_numpy(stored.pop(f"kept.{name}"))
                self.best[name] = stored.pop(f"best.{name}")
        except (KeyError, ValueError, OSError, EOFError, BadZipFile, ti.TaiError) as error:
            fail(f"--resume: {path} is not a checkpoint of this program ({error})")
        for name, values in stored.items():
            self.columns[name.removeprefix("column.")] = values.tolist()
        self.least = min(self.losses())


def optimise(
    args: argparse.Namespace, iteration: Callable[[int], Numbers], **kept: Any
) -> list[float]:
    """Runs `iteration(number)` for each step of descent and returns the losses of all.

    Args:
        args: the options; `--iterations` counts from the very start, also with `--resume`.
        iteration: does one step; returns its loss, or a dictionary of numbers whose first is
            the loss. They become the columns of `NAME.losses.csv`.
        kept: the fields with the state between two iterations: parameters, and all else that the
            next iteration reads. (Anything with `to_numpy` and `from_numpy`.)
    """
    run = _Run(args, kept)
    _runs[:] = [run]
    first = len(run)
    saved = time.monotonic()
    bar = ti.tools.Progress(range(first, args.iterations), args.name)
    try:
        with _interruptible(), contextlib.closing(iter(bar)) as numbers:
            for number in numbers:
                begin = time.perf_counter()
                with np.errstate(all="ignore"):  # a loss that is not finite is told below
                    result = iteration(number)
                seconds = time.perf_counter() - begin
                run.note(result, seconds)
                loss = run.losses()[-1]
                if not np.isfinite(loss):
                    break
                run.take()
                bar.note(f"loss {loss:.6g}, {1e3 * seconds:.3g} ms")
                if time.monotonic() - saved > KEEP_EVERY:
                    run.save()
                    saved = time.monotonic()
    except BaseException as error:
        if run.rows > first:
            with contextlib.suppress(KeyboardInterrupt):  # a second one
                run.save()
            text = f"{run.rows} of {args.iterations} iterations are kept in {checkpoint(args)}"
            print(f"stopped  {text}; --resume goes on from there", file=sys.stderr)
        if isinstance(error, KeyboardInterrupt):
            if run.rows == first:
                fail("interrupted in its first iteration: nothing to keep", code=130)
            sys.exit(130)
        raise
    if run.rows > first:
        run.save()
    if len(run) > run.rows:
        before = f"what was learned before: {checkpoint(args)}" if run.rows else "nothing to keep"
        fail(f"the loss of iteration {run.rows} is not finite; {before}")
    losses = run.losses()
    if losses:
        print(f"loss     {losses[0]:.6g} -> {losses[-1]:.6g}")
        print(f"time     {_times(run.columns['seconds'][first:])}")
    return losses


def take_best(**kept: Any) -> None:
    """Restores the state with the least loss in the fields of `optimise`; for a film, say.

    Not from the checkpoint: another run in the same folder may have written its own by now.
    """
    for name, field in kept.items():
        field.from_numpy(_runs[0].best[name])


@contextlib.contextmanager
def _handled(numbers: Iterable[int], handler: Callable[..., Any]):
    """Signals go to the handler meanwhile; in the main thread, which alone gets them."""
    try:
        before = [(number, signal.signal(number, handler)) for number in numbers]
    except ValueError:  # not in the main thread
        yield
        return
    try:
        yield
    finally:
        for number, old in before:
            signal.signal(number, old)


def _interruptible():
    """A batch system's SIGTERM counts as Ctrl-C."""

    def stop(*_: Any):
        raise KeyboardInterrupt

    return _handled([signal.SIGTERM], stop)


@contextlib.contextmanager
def _uninterrupted():
    """Ctrl-C and SIGTERM wait for the end of the block: an impatient second one loses nothing."""
    came: list[bool] = []
    with _handled([signal.SIGINT, signal.SIGTERM], lambda *_: came.append(True)):
        yield
    if came:
        raise KeyboardInterrupt


def _times(seconds: list[float]) -> str:
    if not seconds:
        return "nothing was left to do"
    text = f"first iteration {1e3 * seconds[0]:.4g} ms"
    if len(seconds) > 1:
        text += f", then {1e3 * statistics.median(seconds[1:]):.4g} ms each"
    return text
