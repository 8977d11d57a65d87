"""R10: sparse layouts that run out of memory say so, and the program goes on.

Each case is a layout, a limit of memory, and a way to ask for more cells than fit. The exception
must name the level and give sizes; earlier cells must still be there, a kernel on other fields must
work, and so must the same layout once its cells are given back.
"""

from __future__ import annotations

import random
import re
from collections import Counter

import numpy as np
import tai as ti
from bars import Bar, choose_arch

LAYOUTS = ["pointer", "nested", "hash", "bitmasked", "dynamic"]
WAYS = ["parallel", "serial", "array", "host", "activate"]
SIZE = re.compile(r"\b\d+(\.\d+)? (B|KiB|MiB|GiB)\b")


class Case:
    """One layout that is too large for its limit."""

    def __init__(self, choose: random.Random, arch: str):
        self.arch = choose.choice(("cpu", "cpu", "emulated")) if arch == "both" else arch
        self.layout = choose.choice(LAYOUTS)
        # If cells take no more memory than their written elements, or are small, all are written.
        ways = {"dynamic": ["append"], "bitmasked": WAYS[:3], "nested": WAYS[:4]}
        self.way = choose.choice(ways.get(self.layout, WAYS))
        self.block = choose.choice((64, 256, 1024, 1000))
        self.type = choose.choice((ti.f32, ti.f64, ti.i32))
        self.limit = choose.choice((1 << 18, 1 << 20, 3_000_000))
        self.threads = choose.choice((1, 2, 4))
        bytes_of_cell = self.block * (8 if self.type is ti.f64 else 4)
        self.cells = 4 * self.limit // bytes_of_cell + 8

    def __str__(self) -> str:
        return (f"{self.arch}, {self.layout}, {self.way}, blocks of {self.block} {self.type}, "
                f"{self.limit} B, {self.threads} threads")  # fmt: skip

    def begin(self) -> None:
        choose_arch(self.arch)
        ti.init(offline_cache=False, memory_limit=self.limit, cpu_max_num_threads=self.threads)
        self.x = x = ti.field(self.type, name="x")
        self.other = other = ti.field(ti.i32, shape=1000)
        # Memory of its own before the pool takes the rest.
        other.fill(0)
        block, cells = self.block, self.cells
        if self.layout == "pointer":
            self.level = ti.root.pointer(ti.i, cells)
            self.level.dense(ti.i, block).place(x)
        elif self.layout == "nested":
            cells = self.cells = -(-cells // 8) * 8
            self.level = ti.root.pointer(ti.i, cells // 8)
            self.level.pointer(ti.i, 8).dense(ti.i, block).place(x)
        elif self.layout == "hash":
            self.level = ti.root.hash(ti.i, cells)
            self.level.dense(ti.i, block).place(x)
        elif self.layout == "bitmasked":
            self.level = ti.root.pointer(ti.i, cells)
            self.level.bitmasked(ti.i, block).place(x)
        else:
            self.level = ti.root.dense(ti.i, cells).dynamic(ti.j, block, chunk_size=block)
            self.level.place(x)

        @ti.kernel
        def write(first: ti.i32, count: ti.i32):
            for b in range(first, first + count):
                for k in range(block):
                    x[b * block + k] = b + 1

        @ti.kernel
        def write_serially(first: ti.i32, count: ti.i32):
            ti.loop_config(serialize=True)
            for b in range(first, first + count):
                for k in range(block):
                    x[b * block + k] = b + 1

        @ti.kernel
        def append(first: ti.i32, count: ti.i32):
            for b in range(first, first + count):
                for _ in range(block):
                    x[b].append(b + 1)

        level = self.level

        @ti.kernel
        def activate(first: ti.i32, count: ti.i32):
            for b in range(first, first + count):
                ti.activate(level, [b])

        @ti.kernel
        def count_up():
            for i in other:
                other[i] += i

        self.write = append if self.layout == "dynamic" else write
        self.write_serially, self.activate, self.count_up = write_serially, activate, count_up

    def exhaust(self) -> None:
        """Asks for more than there is."""
        if self.way in ("parallel", "append"):
            # The lists of the first three cells are full.
            self.write(3, self.cells - 3)
        elif self.way == "serial":
            self.write_serially(0, self.cells)
        elif self.way == "host":
            for b in range(self.cells):
                self.x[b * self.block] = 1
        elif self.way == "array":
            self.x.from_numpy(np.ones(self.x.shape, self.x.to_numpy().dtype))
        else:
            self.activate(0, self.cells)
        ti.sync()

    def value(self, cell: int) -> float:
        return self.x[cell, 0] if self.layout == "dynamic" else self.x[cell * self.block]


def judge(case: Case) -> list[str]:
    case.begin()
    problems = []
    case.write(0, 3)
    ti.sync()
    try:
        case.exhaust()
        return [f"{case.cells} cells were made"]
    except ti.TaiMemoryError as error:
        message = error.message
        if "level above @x" not in message and "level over" not in message:
            problems.append(f"the level is not named: {message}")
        if len(SIZE.findall(message)) < 2:
            problems.append(f"no sizes are named: {message}")
    except Exception as error:
        problems.append(f"a {type(error).__name__}: {error}")
    if case.way not in ("host", "array") and [case.value(c) for c in range(3)] != [1, 2, 3]:
        problems.append("what was there before is gone")
    for turn in (1, 2):
        case.count_up()
        if case.other.to_numpy().tolist() != [turn * i for i in range(1000)]:
            problems.append("the next kernel gave other numbers")
        if case.layout == "dynamic":
            ti.root.deactivate_all()
        else:
            case.level.deactivate_all()
        case.write(5, 4)
        ti.sync()
        if [case.value(c) for c in (5, 8)] != [6, 9]:
            problems.append("the layout is of no use afterwards")
    return problems


def main() -> None:
    bar = Bar(
        "R10", "sparse layouts without memory", full=1000, short=40, adds=True,
        target="an exception with the level and sizes, the context alive, the next kernel right",
        miss="another exception or none, lost cells, or a program of no use afterwards",
        archs=("both", "cpu", "emulated", "cuda"),
    )  # fmt: skip
    args = bar.parse()
    counts: Counter[str] = Counter()
    wrong = done = 0
    while done < args.count and bar.left() > 0:
        case = Case(random.Random(args.seed + done), args.arch)
        counts[f"{case.layout} on {case.arch}"] += 1
        for problem in (problems := judge(case)):
            print(f"seed {args.seed + done} ({case}): {problem}", flush=True)
        wrong += bool(problems)
        done += 1
    kinds = ", ".join(f"{n} {kind}" for kind, n in sorted(counts.items()))
    bar.report(f"{done} layouts ({kinds})", f"{wrong} with errors", met=not wrong and done > 0)


if __name__ == "__main__":
    main()
