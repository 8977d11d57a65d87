"""Random sequences of small launches under tapes, on a device and on the CPU: equal results.

    python test/fuzz/launch_sequences.py --count 100 [--first 0] [--target emulated|cuda]

A device runs launches that it has seen before as one program, in which a launch waits only for
launches that touch what it touches. The kernels read and write rows of fields at constant,
computed, wrapped and unknown indices, in several layouts; each program runs its tape several times,
some of them with other bounds of loops.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import random
import sys
import tempfile
from pathlib import Path

import numpy as np

N, RUNS = 16, 6
NAMES = ["x", "y", "w", "loss", "x.grad", "y.grad", "w.grad"]
THREADS = ["1", "32", "96"]  # of the emulated device
# Environment variables that `judge` sets.
SETTINGS = ["TAI_BACKGROUND_PROGRAMS", "TAI_CUDA_EMULATION", "TAI_EMULATED_THREADS"]

LAYOUTS = {
    "whole": "x, y = (ti.field(ti.f64, shape=(T + 1, B, N), needs_grad=True) for _ in range(2))",
    "cells": """x, y = (ti.field(ti.f64, needs_grad=True) for _ in range(2))
    ti.root.dense(ti.ijk, (T + 1, B, N)).place(x, y, x.grad, y.grad)""",
    "turned": """x, y = (ti.field(ti.f64, needs_grad=True) for _ in range(2))
    ti.root.dense(ti.k, N).dense(ti.ij, (T + 1, B)).place(x)
    ti.root.dense(ti.i, T + 1).dense(ti.jk, (B, N)).place(y)
    ti.root.lazy_grad()""",
    "blocks": """x, y = (ti.field(ti.f64, needs_grad=True) for _ in range(2))
    ti.root.dense(ti.i, T + 1).dense(ti.jk, (B, 4)).dense(ti.k, 4).place(x)
    ti.root.dense(ti.ik, (T + 1, N)).dense(ti.j, B).place(y)
    ti.root.lazy_grad()""",
}
LOOPS = [
    "for b, i in ti.ndrange(B, N):",
    "for b, i in ti.ndrange((1, B), (first, last)):",
    "for i in range(first, last):",
    "for i in range(N):",
]


class Program:
    """The text of a module whose function `run` returns the results of each run of its tape."""

    def __init__(self, seed: int):
        self.rng = random.Random(seed)
        self.steps, self.bodies = self.rng.choice([2, 3]), self.rng.choice([3, 4, 8])

    def index(self, variable: str, extent: int) -> str:
        constant = self.rng.randrange(extent)
        return self.rng.choice([
            variable, variable, str(constant), f"({variable} + {constant}) % {extent}",
            f"p[{variable}] % {extent}", f"({variable} * 2) % {extent}", f"{variable} // 2",
            f"ti.max({variable} - 1, 0)", "first" if extent == N else variable,
        ])  # fmt: skip

    def read(self, has_bodies: bool, written: str) -> str:
        body = self.index("b", self.bodies) if has_bodies else str(self.rng.randrange(self.bodies))
        if self.rng.random() < 0.2 and written != "w":
            return f"w[{body}, {self.index('i', N)}][{self.rng.randrange(3)}]"
        field = self.rng.choice(["x", "y"])
        # Of the field that it writes, an iteration reads earlier rows only.
        at = (
            "t" if field == written else self.rng.choice(["t", str(self.rng.randrange(self.steps))])
        )
        return f"{field}[{at}, {body}, {self.index('i', N)}]"

    def kernel(self, number: int) -> str:
        loop = self.rng.choice(LOOPS)
        has_bodies = loop.startswith("for b")
        body = "b" if has_bodies else str(self.rng.randrange(self.bodies))
        written = self.rng.choice(["x", "y", "x", "y", "w"])
        reads = [self.read(has_bodies, written) for _ in range(self.rng.choice([1, 2]))]
        value = " + ".join(f"0.3 * ti.sin({one})" for one in reads)
        if written == "w":
            update = f"w[{body}, i][{self.rng.randrange(3)}] += {value}"
        else:
            update = self.rng.choice([
                f"{written}[t + 1, {body}, i] += {value}",
                f"{written}[t + 1, {body}, i] = {value}",
                f"{written}[t + 1, {body}, {self.index('i', N)}] += {value}",
            ])  # fmt: skip
        return f"""
    @ti.kernel
    def k{number}(t: ti.i32, first: ti.i32, last: ti.i32):
        {loop}
            {update}
"""

    def text(self) -> str:
        count = self.rng.randrange(2, 5)
        rows = [self.rng.randrange(self.bodies) for _ in range(3)]
        bounds = self.rng.choice(["number % 3, number % 3 + 5", "0, N", "3, 9", "number, N"])
        kernels = "".join(self.kernel(number) for number in range(count))
        launches = "\n".join(f"                k{n}(t, first, last)" for n in range(count))
        return f"""import numpy as np
import tai as ti

T, B, N = {self.steps}, {self.bodies}, {N}


def run(runs):
    {LAYOUTS[self.rng.choice(list(LAYOUTS))]}
    w = ti.Vector.field(3, ti.f64, shape=(B, N), needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    p = ti.field(ti.i32, shape=N)
{kernels}
    @ti.kernel
    def total(first: ti.i32, last: ti.i32):
        for i in range(first, last):
            loss[None] += x[T, {rows[0]}, i] ** 2 + y[T - 1, {rows[1]}, i] * w[{rows[2]}, i][1]

    rng = np.random.default_rng(5)
    before = [rng.uniform(0.2, 1, shape) for shape in ((T + 1, B, N), (T + 1, B, N), (B, N, 3))]
    p.from_numpy(rng.integers(0, N, N).astype(np.int32))
    found = []
    for number in range(runs):
        for field, values in zip((x, y, w), before):
            field.from_numpy(values)
        loss[None] = 0
        first, last = {bounds}
        with ti.ad.Tape(loss):
            for t in range(T):
{launches}
            total(first, last)
        found.append([f.to_numpy() for f in (x, y, w, loss, x.grad, y.grad, w.grad)])
    return found
"""


def results(path: Path, target: str) -> list | str:
    """The results of a program on a target, or the message with which it is refused."""
    import tai as ti

    arch = ti.cpu if target == "cpu" else ti.cuda
    ti.init(arch=arch, offline_cache=False, default_fp=ti.f64, deterministic=True)
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    try:
        return module.run(RUNS)
    except ti.TaiError as error:
        return f"{type(error).__name__}: {error.message}"


def judge(seed: int, target: str, folder: Path) -> str:
    """Returns "agrees" or "refused", or says how the results differ.

    Args:
        seed: of the program.
        target: "emulated" or "cuda".
        folder: for the text of the program.
    """
    path = folder / f"sequence_{seed}.py"
    path.write_text(Program(seed).text())
    # Programs of a device are compiled at once: they run the second tape.
    os.environ["TAI_BACKGROUND_PROGRAMS"] = "0"
    os.environ["TAI_CUDA_EMULATION"] = "1" if target == "emulated" else ""
    os.environ["TAI_EMULATED_THREADS"] = THREADS[seed % len(THREADS)]
    expected, found = results(path, "cpu"), results(path, target)
    if isinstance(expected, str) or isinstance(found, str):
        return "refused" if type(expected) is type(found) else f"{expected} and {found}"
    for number, (ours, theirs) in enumerate(zip(expected, found, strict=True)):
        for name, one, other in zip(NAMES, ours, theirs, strict=True):
            off = np.abs(one - other).max() / max(np.abs(one).max(), 1e-30)
            if not off <= 1e-9:
                return f"{name} of run {number} is off by {off:.1e}: {path}"
    return "agrees"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=20, help="how many programs")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--target", choices=["emulated", "cuda"], default="emulated")
    args = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="tai-sequences-"))
    found = {s: judge(s, args.target, folder) for s in range(args.first, args.first + args.count)}
    wrong = {s: what for s, what in found.items() if what not in ("agrees", "refused")}
    for seed, what in wrong.items():
        print(f"seed {seed}: {what}")
    agreed = list(found.values()).count("agrees")
    print(f"{args.count} programs: {agreed} agree, {len(wrong)} differ")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
