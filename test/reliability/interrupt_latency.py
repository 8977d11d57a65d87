"""How long Ctrl-C waits for an operation on large arrays, one by one.

    python test/reliability/interrupt_latency.py --write      # the table of docs/reliability.md
    python test/reliability/interrupt_latency.py --only fill --count 5

Each operation runs in a process of its own. Another process sends SIGINT at a random moment of the
operation; the time from there to the `KeyboardInterrupt` counts. R15 asks the same of work that
never ends: kernels, sweeps, compilations.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import datetime
import os
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import soak
import tai as ti

ROOT = Path(__file__).resolve().parent.parent.parent
TABLE = ROOT / "benchmarks/results/interrupts.csv"
COLUMNS = ["operation", "where", "mb", "takes_ms", "median_ms", "worst_ms", "interrupts",
           "date", "machine", "commit"]  # fmt: skip

MB = 1 << 20
GB = 1 << 30


class Work(NamedTuple):
    """An operation on so many bytes: `prepare`, then `run`, which is interrupted."""

    run: Callable[[], Any]
    prepare: Callable[[], Any] = lambda: None
    size: int = GB


OPERATIONS: dict[str, tuple[str, Callable[[], Work]]] = {}


def operation(name: str, *archs: str) -> Callable:
    def add(make: Callable[[], Work]) -> Callable:
        for arch in archs or ("cpu", "emulated"):
            OPERATIONS[f"{name}@{arch}"] = (arch, make)
        return make

    return add


def use(x: Any) -> Callable[[], None]:
    """A launch after which the device holds a field."""
    rank = len(x.shape)

    @ti.kernel
    def one():
        for i in range(1):
            if ti.static(rank == 1):
                x[i] += 0.0
            else:
                x[i, i] += 0.0

    def launch() -> None:
        one()
        ti.sync()

    return launch


def dense(size: int = GB // 4, **options: Any) -> Any:
    x = ti.field(ti.f32, shape=size, **options)
    x.fill(1.0)
    use(x)()
    return x


def blocked(side: int = 1 << 14) -> tuple[Any, Callable[[], None]]:
    """A field whose tree comes to the host as a whole."""
    x = ti.field(ti.f32)
    ti.root.dense(ti.ij, side // 8).dense(ti.ij, 8).place(x)
    x.fill(1.0)
    launch = use(x)
    launch()
    return x, launch


def sparse(size: int = GB // 8, block: int = 1 << 12) -> Any:
    x = ti.field(ti.f32)
    ti.root.pointer(ti.i, size // block).dense(ti.i, block).place(x)

    @ti.kernel
    def activate():
        for i in range(size // block):
            x[i * block] = 1.0

    activate()
    x.fill(1.0)
    ti.sync()
    return x


@operation("fill", "cpu")
def _fill() -> Work:
    x = dense()
    return Work(lambda: x.fill(2.0))


@operation("from_numpy")
def _from_numpy() -> Work:
    x = dense()
    a = np.full(x.shape, 2.0, np.float32)
    return Work(lambda: x.from_numpy(a))


@operation("from_numpy of f64", "cpu")
def _from_f64() -> Work:
    x = dense()
    a = np.full(x.shape, 2.0, np.float64)
    return Work(lambda: x.from_numpy(a))


@operation("to_numpy")
def _to_numpy() -> Work:
    x = dense()
    return Work(x.to_numpy)


@operation("to_numpy, in blocks")
def _to_blocks() -> Work:
    x, use = blocked()
    return Work(x.to_numpy, use)


@operation("from_numpy, sparse", "cpu")
def _from_sparse() -> Work:
    x = sparse()
    a = np.full(x.shape, 2.0, np.float32)
    return Work(lambda: x.from_numpy(a), size=GB // 2)


@operation("to_numpy, sparse")
def _to_sparse() -> Work:
    x = sparse()
    return Work(x.to_numpy, size=GB // 2)


@operation("copy_from", "cpu")
def _copy_from() -> Work:
    x, y = dense(GB // 8), dense(GB // 8)
    return Work(lambda: x.copy_from(y), size=GB // 2)


@operation("a launch on an array", "emulated")
def _array_argument() -> Work:
    a = np.zeros(GB // 4, np.float32)

    @ti.kernel
    def one(a: ti.types.ndarray(dtype=ti.f32, ndim=1)):
        for i in range(16):
            a[i] += 1.0

    return Work(lambda: one(a))


@operation("ti.ndarray: fill", "cpu")
def _array_fill() -> Work:
    a = ti.ndarray(ti.f32, GB // 4)
    return Work(lambda: a.fill(2.0))


@operation("ti.ndarray: to_numpy", "cpu")
def _array_to() -> Work:
    a = ti.ndarray(ti.f32, GB // 4)
    a.fill(1.0)
    return Work(a.to_numpy)


def taped(what: str, size: int, **options: Any) -> Work:
    """A tape on which launches overwrite numbers that earlier ones have read."""
    x = dense(size, needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def square():
        for i in x:
            x[i] = x[i] * x[i]

    @ti.kernel
    def head():
        for i in range(16):
            loss[None] += x[i]

    def record() -> Any:
        with ti.ad.Tape(loss, **options) as tape:
            for _ in range(3):
                square()
            head()
        return tape

    tape = record()
    return Work(record if what == "record" else getattr(tape, what), size=4 * size)


for _what in ("record", "grad", "replay"):

    @operation(f"tape: {_what}", *(("cpu", "emulated") if _what == "grad" else ("cpu",)))
    def _tape(what: str = _what) -> Work:
        return taped(what, GB // 8)

    @operation(f"tape with snapshots: {_what}", "cpu")
    def _snapshots(what: str = _what) -> Work:
        return taped(what, GB // 8, checkpoint=2)


@operation("ti.checkpoint.save", "cpu")
def _save() -> Work:
    x = dense()
    path = Path(tempfile.mkdtemp()) / "state.npz"
    return Work(lambda: ti.checkpoint.save(path, x=x))


@operation("ti.checkpoint.load", "cpu")
def _load() -> Work:
    x = dense()
    path = Path(tempfile.mkdtemp()) / "state.npz"
    ti.checkpoint.save(path, x=x)
    return Work(lambda: ti.checkpoint.load(path, x=x))


# ---------------------------------------------------------------------------------------------


@contextlib.contextmanager
def sender() -> Iterator[subprocess.Popen]:
    """A process that sends the signal after the seconds that it reads, and says when it did."""
    code = (
        "import os, signal, sys, time\n"
        "for line in sys.stdin:\n"
        "    time.sleep(float(line))\n"
        "    now = time.monotonic()\n"
        f"    os.kill({os.getpid()}, signal.SIGINT)\n"
        "    print(now, flush=True)\n"
    )
    command = [sys.executable, "-c", code]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        yield process
        process.stdin.close()


def interrupt(process: subprocess.Popen, work: Work, delay: float) -> float | None:
    """Seconds from the signal to the exception; nothing if the work had ended before it."""
    ended = None
    try:
        work.prepare()
        process.stdin.write(f"{delay}\n")
        process.stdin.flush()
        work.run()
        ended = time.monotonic()
        while True:
            time.sleep(0.001)
    except KeyboardInterrupt:
        answered = time.monotonic()
    sent = float(process.stdout.readline())
    return None if ended is not None and sent > ended else answered - sent


def duration(work: Work) -> float:
    work.prepare()
    begun = time.monotonic()
    work.run()
    return time.monotonic() - begun


def measure(name: str, count: int) -> dict[str, Any]:
    arch, make = OPERATIONS[name]
    if arch == "emulated":
        os.environ["TAI_CUDA_EMULATION"] = "1"
    ti.init(arch=ti.cpu if arch == "cpu" else ti.cuda, default_fp=ti.f32, offline_cache=False)
    work = make()
    duration(work)
    takes = duration(work)
    choose = random.Random(0)
    found: list[float] = []
    with sender() as process:
        for _ in range(3 * count):
            if len(found) == count:
                break
            answered = interrupt(process, work, choose.uniform(0.05, 0.95) * takes)
            if answered is not None:
                found.append(1e3 * answered)
            duration(work)
    return {"operation": name.partition("@")[0], "where": arch, "mb": work.size // MB,
            "takes_ms": f"{1e3 * takes:.0f}",
            "median_ms": f"{statistics.median(found):.0f}" if found else "",
            "worst_ms": f"{max(found):.0f}" if found else "", "interrupts": len(found)}  # fmt: skip


def write(rows: list[dict[str, Any]]) -> None:
    with TABLE.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help="a part of the names of operations")
    parser.add_argument("--count", type=int, default=20, help="interrupts of each")
    parser.add_argument(
        "--write", action="store_true", help="keep the table, in benchmarks/results"
    )
    parser.add_argument("--machine", default=soak.machine("cpu"))
    parser.add_argument("--one", help=argparse.SUPPRESS)
    args = parser.parse_args()
    # Programs in the background may have been started with the signal ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if args.one:
        csv.DictWriter(sys.stdout, COLUMNS).writerow(measure(args.one, args.count))
        return
    origin = {"date": str(datetime.date.today()), "machine": args.machine,
              "commit": soak.commit()}  # fmt: skip
    rows = []
    for name in OPERATIONS:
        if args.only not in name:
            continue
        command = [sys.executable, __file__, "--one", name, "--count", str(args.count)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode != 0:
            raise SystemExit(f"{name}: {done.stderr[-2000:]}")
        (row,) = csv.DictReader(done.stdout.splitlines(), COLUMNS)
        rows.append({**row, **origin})
        print(", ".join(f"{key} {value}" for key, value in row.items() if value), flush=True)
        if args.write:
            write(rows)


if __name__ == "__main__":
    main()
