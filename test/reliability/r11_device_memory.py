"""R11: a GPU that runs out of memory says for what and who holds it, and the program goes on.

In each cycle the memory of the device runs out when a tree is made, when a launch activates cells,
and in a tape. Each exception must name the request, the limit, and the trees and tapes with their
sizes. After the request is gone, kernels and tapes give the right numbers, and neither this process
nor the device holds more than in the first cycles.
"""

from __future__ import annotations

import gc
import random
import re
import sys
import tempfile

import numpy as np
import tai as ti
from bars import Bar, resident

MOST_GROWTH = 1.0  # % of the resident memory
# A GPU gives its memory in pieces of 2 MiB, of which cells would leave none to others.
SCALE = 16 if any(word.endswith("cuda") for word in sys.argv) else 1
LIMIT = SCALE * 4 << 20
HOLDS = re.compile(r"this program holds ([\d.]+ \w+): (.+)")


class Scene:
    """Fields that exist in all cycles, with kernels on them."""

    def __init__(self, cache: str):
        # Kernels on a new tree are compiled in each cycle; R12 tests the memory that this leaves.
        ti.init(offline_cache_file_path=cache, device_memory_limit=LIMIT)
        self.small = small = ti.field(ti.f64, shape=1000, name="small", needs_grad=True)
        self.loss = loss = ti.field(ti.f64, shape=(), name="loss", needs_grad=True)
        self.cells = cells = ti.field(ti.f32, name="cells")
        self.level = ti.root.pointer(ti.i, 4096)
        self.level.dense(ti.i, SCALE * 1024).place(cells)

        @ti.kernel
        def fill(a: ti.f64):
            for i in small:
                small[i] = a * i

        @ti.kernel
        def measure():
            for i in small:
                loss[None] += small[i] ** 2

        @ti.kernel
        def write(count: ti.i32):
            for b in range(count):
                cells[SCALE * 1024 * b] = b

        @ti.kernel
        def touch(x: ti.template()):
            for i in x:
                x[i] = 1.0

        @ti.kernel
        def step(x: ti.template()):
            for i in x:
                x[i] = ti.sin(x[i]) * x[i] + 1.0

        @ti.kernel
        def add_up(x: ti.template()):
            for i in x:
                loss[None] += x[i]

        self.fill, self.measure, self.write = fill, measure, write
        self.touch, self.step, self.add_up = touch, step, add_up

    def tree(self, size: int):
        x = ti.field(ti.f64, name="x", needs_grad=True)
        builder = ti.FieldsBuilder()
        builder.dense(ti.i, size).place(x)
        return x, builder.finalize()

    def exhaust_tree(self, choose: random.Random) -> None:
        x, tree = self.tree(choose.choice((LIMIT // 8, LIMIT)))
        try:
            self.touch(x)
            ti.sync()
        finally:
            tree.destroy()

    def exhaust_launch(self, choose: random.Random) -> None:
        try:
            self.write(choose.choice((2000, 4096)))
            ti.sync()
        finally:
            self.level.deactivate_all()

    def exhaust_tape(self, choose: random.Random) -> None:
        x, tree = self.tree(SCALE * 20_000)
        try:
            with ti.ad.Tape(self.loss):
                for _ in range(choose.choice((40, 100))):
                    self.step(x)
                self.add_up(x)
            ti.sync()
        finally:
            tree.destroy()

    def check(self, a: float) -> str:
        """The faults of the program afterwards."""
        self.fill(a)
        with ti.ad.Tape(self.loss):
            self.measure()
        i = np.arange(1000)
        if not np.isclose(self.loss[None], (a * i) @ (a * i), rtol=1e-12):
            return "the loss is wrong afterwards"
        if not np.allclose(self.small.grad.to_numpy(), 2 * a * i, rtol=1e-14, atol=0):
            return "the gradient is wrong afterwards"
        self.write(3)
        ti.sync()
        if self.cells[SCALE * 2048] != 2 or self.level.num_active != 3:
            return "cells are of no use afterwards"
        self.level.deactivate_all()
        return ""


def run_cycle(scene: Scene, choose: random.Random, a: float) -> tuple[list[str], str]:
    """The faults of a cycle, and the contents of the device when a tree found no room."""
    problems, held = [], ""
    for what in choose.sample(("tree", "launch", "tape"), 3):
        try:
            getattr(scene, f"exhaust_{what}")(choose)
            problems.append(f"{what}: there was memory")
        except ti.TaiMemoryError as error:
            message = error.message
            if (
                "out of memory on the device" not in message
                or f"{LIMIT >> 20}.0 MiB" not in message
            ):
                problems.append(f"{what}: the device or its limit is not named: {message}")
            found = HOLDS.search(message)
            if what != "launch" and not found:
                problems.append(f"{what}: who holds the memory is not said: {message}")
            if what == "launch" and "level above @cells" not in message:
                problems.append(f"{what}: the level is not named: {message}")
            if what == "tree" and found:
                held = found[1]
        except Exception as error:
            problems.append(f"{what}: a {type(error).__name__}: {error}")
        if problem := scene.check(a):
            problems.append(f"{what}: {problem}")
    return problems, held


def main() -> None:
    bar = Bar(
        "R11", "a device without memory", full=1000, short=25,
        target="an exception with a breakdown; 1,000 cycles, no leak",
        miss="another exception or none, no breakdown, wrong numbers afterwards, or a leak",
        archs=("emulated", "cuda"),
    )  # fmt: skip
    args = bar.parse()
    choose = random.Random(args.seed)
    cache = tempfile.TemporaryDirectory()
    scene = Scene(cache.name)
    wrong = done = before = 0
    first = held = ""
    while done < args.count and bar.left() > 0:
        problems, held = run_cycle(scene, choose, 1.0 + done % 7)
        for problem in problems:
            print(f"cycle {done}: {problem}", flush=True)
        wrong += bool(problems)
        done += 1
        if done == max(5, args.count // 10):
            gc.collect()
            first, before = held, resident()
    gc.collect()
    growth = 100.0 * (resident() - before) / before if before else 0.0
    most = 3 * MOST_GROWTH if args.short else MOST_GROWTH
    bar.report(
        f"{done} cycles of 3 on {args.arch}",
        f"{wrong} with errors, RSS {growth:+.1f} %, the device held {first} and {held}",
        met=not wrong and growth <= most and first == held != "", bar=f"0, {most:.0f} %",
    )  # fmt: skip


if __name__ == "__main__":
    main()
