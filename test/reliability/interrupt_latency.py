"""How long Ctrl-C waits for an operation on large arrays, one by one.

    python test/reliability/interrupt_latency.py              # the table, into docs/reliability.md
    python test/reliability/interrupt_latency.py --only fill --count 5

Each operation runs in a process of its own. Another process sends SIGINT at a random moment of the
operation; the time from there to the `KeyboardInterrupt` counts. R15 asks the same of work that
never ends: kernels, sweeps, compilations.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import os
import random
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tai as ti

ROOT = Path(__file__).resolve().parent.parent.parent
TABLE = ROOT / "benchmarks/results/interrupts.csv"
COLUMNS = ["operation", "where", "mb", "takes_ms", "median_ms", "worst_ms", "interrupts",
           "date", "machine", "commit"]  # fmt: skip

MB = 1 << 20
GB = 1 << 30


class Work(NamedTuple):
    """An operation: `prepare`, then `run`, which is interrupted."""

    run: Callable[[], Any]
    prepare: Callable[[], Any] = lambda: None
    # Whether a run that was interrupted must be followed by a whole one.
    bytes: int = GB


OPERATIONS: dict[str, tuple[str, Callable[[], Work]]] = {}


def operation(name: str, *archs: str) -> Callable:
    def add(make: Callable[[], Work]) -> Callable:
        for arch in archs or ("cpu", "emulated"):
            OPERATIONS[f"{name}@{arch}"] = (arch, make)
        return make

    return add


def on_device(*fields: Any) -> None:
    """Makes the device hold the fields."""
    for x in fields:
        touch(x)
    ti.sync()


def touch(x: Any) -> None:
    @ti.kernel
    def one():
        for i in range(1):
            x[i] += 0.0

    one()


def dense(size: int = GB // 4, **options: Any) -> Any:
    x = ti.field(ti.f32, shape=size, **options)
    x.fill(1.0)
    on_device(x)
    return x


def interleaved(size: int = GB // 8, **options: Any) -> Any:
    x, y = ti.field(ti.f32, **options), ti.field(ti.f32)
    ti.root.dense(ti.i, size).place(x, y)
    x.fill(1.0)
    on_device(x)
    return x


def blocked(side: int = 1 << 14) -> Any:
    x = ti.field(ti.f32)
    ti.root.dense(ti.ij, side // 8).dense(ti.ij, 8).place(x)
    x.fill(1.0)

    @ti.kernel
    def one():
        for i in range(1):
            x[i, i] += 0.0

    one()
    ti.sync()
    return x


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


@operation("fill")
def _fill() -> Work:
    x = dense()
    return Work(lambda: x.fill(2.0))


@operation("fill, between other fields")
def _fill_between() -> Work:
    x = interleaved()
    return Work(lambda: x.fill(2.0), bytes=GB // 2)


@operation("fill, in blocks")
def _fill_blocks() -> Work:
    x = blocked()
    return Work(lambda: x.fill(2.0))


@operation("fill, sparse")
def _fill_sparse() -> Work:
    x = sparse()
    return Work(lambda: x.fill(2.0), bytes=GB // 2)


@operation("from_numpy")
def _from_numpy() -> Work:
    x = dense()
    a = np.full(x.shape, 2.0, np.float32)
    return Work(lambda: x.from_numpy(a))


@operation("from_numpy, f64 array")
def _from_numpy_f64() -> Work:
    x = dense()
    a = np.full(x.shape, 2.0, np.float64)
    return Work(lambda: x.from_numpy(a))


@operation("to_numpy")
def _to_numpy() -> Work:
    x = dense()
    return Work(x.to_numpy)


@operation("from_numpy, between other fields")
def _from_between() -> Work:
    x = interleaved()
    a = np.full(x.shape, 2.0, np.float32)
    return Work(lambda: x.from_numpy(a), bytes=GB // 2)


@operation("to_numpy, between other fields")
def _to_between() -> Work:
    x = interleaved()
    return Work(x.to_numpy, bytes=GB // 2)


@operation("from_numpy, in blocks")
def _from_blocks() -> Work:
    x = blocked()
    a = np.full(x.shape, 2.0, np.float32)
    return Work(lambda: x.from_numpy(a), lambda: on_device2(x))


@operation("to_numpy, in blocks")
def _to_blocks() -> Work:
    x = blocked()
    return Work(x.to_numpy, lambda: on_device2(x))


def on_device2(x: Any) -> None:
    x[0, 0] = 1.0
    if x not in _ones:

        @ti.kernel
        def one():
            for i in range(1):
                x[i, i] += 0.0

        _ones[x] = one
    _ones[x]()
    ti.sync()


_ones: dict[Any, Any] = {}


@operation("from_numpy, sparse")
def _from_sparse() -> Work:
    x = sparse()
    a = np.full(x.shape, 2.0, np.float32)
    return Work(lambda: x.from_numpy(a), bytes=GB // 2)


@operation("to_numpy, sparse")
def _to_sparse() -> Work:
    x = sparse()
    return Work(x.to_numpy, bytes=GB // 2)


@operation("copy_from")
def _copy_from() -> Work:
    x, y = dense(GB // 8), dense(GB // 8)
    return Work(lambda: x.copy_from(y), bytes=GB // 2)


@operation("copy_from, in blocks")
def _copy_blocks() -> Work:
    x, y = blocked(1 << 13), ti.field(ti.f32, shape=(1 << 13, 1 << 13))
    return Work(lambda: x.copy_from(y), bytes=GB // 4)


@operation("to_torch")
def _to_torch() -> Work:
    x = dense()
    return Work(x.to_torch)


@operation("from_torch")
def _from_torch() -> Work:
    import torch

    x = dense()
    a = torch.full(x.shape, 2.0)
    return Work(lambda: x.from_torch(a))


@operation("a launch on an array")
def _array_argument() -> Work:
    a = ti.ndarray(ti.f32, GB // 4)

    @ti.kernel
    def one(a: ti.types.ndarray(dtype=ti.f32, ndim=1)):
        for i in range(16):
            a[i] += 1.0

    return Work(lambda: one(a))


@operation("a launch on a NumPy array", "emulated")
def _numpy_argument() -> Work:
    a = np.zeros(GB // 4, np.float32)

    @ti.kernel
    def one(a: ti.types.ndarray(dtype=ti.f32, ndim=1)):
        for i in range(16):
            a[i] += 1.0

    return Work(lambda: one(a))


@operation("array.fill", "cpu")
def _array_fill() -> Work:
    a = ti.ndarray(ti.f32, GB // 4)
    a.fill(1.0)
    return Work(lambda: a.fill(2.0))


@operation("array.from_numpy", "cpu")
def _array_from() -> Work:
    a = ti.ndarray(ti.f32, GB // 4)
    b = np.full(a.shape, 2.0, np.float32)
    return Work(lambda: a.from_numpy(b))


@operation("array.to_numpy", "cpu")
def _array_to() -> Work:
    a = ti.ndarray(ti.f32, GB // 4)
    a.fill(1.0)
    return Work(a.to_numpy)


@operation("array.copy_from(field)", "cpu")
def _array_copy() -> Work:
    a = ti.ndarray(ti.f32, GB // 8)
    x = dense(GB // 8)
    return Work(lambda: a.copy_from(x), bytes=GB // 2)


def taped(x: Any, rounds: int = 1, **options: Any) -> tuple[Any, Callable[[], None]]:
    """A tape on which `rounds` launches overwrite what earlier ones have read."""
    loss = ti.field(ti.f32, shape=(), needs_grad=True)
    many = len(x.shape) == 1

    @ti.kernel
    def head():
        for i in range(16):
            loss[None] += x[i] * x[i]

    @ti.kernel
    def read():
        for i in x:
            x[i] = x[i] * x[i]

    del many

    def record():
        with ti.ad.Tape(loss, **options) as tape:
            for _ in range(rounds):
                read()
            head()
        return tape

    return loss, record


def tape_work(x: Any, what: str, rounds: int = 2, **options: Any) -> Work:
    loss, record = taped(x, rounds, **options)
    loss[None] = 0
    tape = record()
    size = int(np.prod(x.shape)) * 4
    return Work(record if what == "record" else getattr(tape, what), bytes=size)


for _what in ("record", "grad", "replay"):

    @operation(f"tape, {_what}")
    def _tape(what: str = _what) -> Work:
        x = dense(GB // 8, needs_grad=True)
        return tape_work(x, what)

    @operation(f"tape with a budget, {_what}")
    def _tape_budget(what: str = _what) -> Work:
        x = dense(GB // 8, needs_grad=True)
        return tape_work(x, what, 4, memory="3GB")

    @operation(f"tape with snapshots, {_what}")
    def _tape_snapshots(what: str = _what) -> Work:
        x = dense(GB // 16, needs_grad=True)
        return tape_work(x, what, 6, checkpoints=2)


@operation("tape, a write of the host")
def _tape_write() -> Work:
    x = dense(GB // 8, needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)
    a = np.full(x.shape, 2.0, np.float32)

    @ti.kernel
    def head():
        for i in x:
            loss[None] += x[i] * x[i]

    def record():
        with ti.ad.Tape(loss):
            head()
            x.from_numpy(a)

    return Work(record, bytes=GB // 2)


@operation("ti.checkpoint.save", "cpu")
def _save() -> Work:
    x = dense(GB // 8)
    path = ROOT / "build/latency.npz"
    return Work(lambda: ti.checkpoint.save(path, x=x), bytes=GB // 2)


@operation("ti.checkpoint.load", "cpu")
def _load() -> Work:
    x = dense(GB // 8)
    path = ROOT / "build/latency.npz"
    ti.checkpoint.save(path, x=x)
    return Work(lambda: ti.checkpoint.load(path, x=x), bytes=GB // 2)


@operation("tape.validate", "cpu")
def _validate() -> Work:
    x = dense(GB // 16, needs_grad=True)
    loss, record = taped(x, 1, validation=True)
    return Work(record, bytes=GB // 4)


@operation("parallel_sort")
def _sort() -> Work:
    x = dense(1 << 25)
    return Work(lambda: ti.algorithms.parallel_sort(x), bytes=1 << 27)


@operation("a sparse matrix built", "cpu")
def _builder() -> Work:
    n = 1 << 23
    builder = ti.linalg.SparseMatrixBuilder(n, n, max_num_triplets=2 * n, dtype=ti.f32)

    @ti.kernel
    def put(b: ti.types.sparse_matrix_builder()):
        for i in range(n):
            b[i, (i * 7919) % n] += 1.0
            b[i, i] += 2.0

    put(builder)
    return Work(builder.build, lambda: None, bytes=n * 24)


@operation("a list of cells")
def _list() -> Work:
    x = ti.field(ti.f32)
    n = 1 << 24
    ti.root.pointer(ti.i, n).dense(ti.i, 4).place(x)

    @ti.kernel
    def activate():
        for i in range(n):
            x[i * 4] = 1.0

    @ti.kernel
    def loop():
        for i in x:
            x[i] += 1.0

    activate()
    loop()

    def change():
        ti.deactivate(x.parent().parent(), [0]) if False else None
        x[0] = 1.0
        x.parent().parent().deactivate_all()
        activate()
        ti.sync()

    return Work(loop, change, bytes=n * 16)


@operation("deactivate_all")
def _deactivate() -> Work:
    x = sparse(GB // 8, 1 << 6)
    level = x.parent().parent()

    @ti.kernel
    def activate():
        for i in range(x.shape[0] >> 6):
            x[i << 6] = 1.0

    def prepare():
        activate()
        ti.sync()

    return Work(level.deactivate_all, prepare, bytes=GB // 2)


@operation("read of an element", "emulated")
def _download() -> Work:
    x = blocked()

    def prepare():
        on_device2(x)

    return Work(x.to_numpy, prepare)


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
    return {"operation": name.partition("@")[0], "where": arch, "mb": work.bytes // MB,
            "takes_ms": f"{1e3 * takes:.0f}",
            "median_ms": f"{statistics.median(found):.0f}" if found else "",
            "worst_ms": f"{max(found):.0f}" if found else "", "interrupts": len(found)}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="")
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--one", help=argparse.SUPPRESS)
    args = parser.parse_args()
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if args.one:
        row = measure(args.one, args.count)
        csv.DictWriter(sys.stdout, COLUMNS).writerow(row)
        return
    for name in OPERATIONS:
        if args.only not in name:
            continue
        done = subprocess.run(
            [sys.executable, __file__, "--one", name, "--count", str(args.count)],
            capture_output=True,
            text=True,
        )
        print(name, done.stdout.strip() or done.stderr[-1500:], flush=True)


if __name__ == "__main__":
    main()
