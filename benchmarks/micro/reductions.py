"""Reductions that the compiler recognises, beside the atomics that a user would write.

    python benchmarks/micro/reductions.py
    python benchmarks/micro/reductions.py --modes deterministic --threads 2 --types f32 --bar 1.1

Each row is one update in two kernels of one process, which run in turns: as a program writes it
(`m = ti.min(m, x[i])`), and as an atomic (`ti.atomic_min(m, x[i])`). The least time of a launch
counts, of processor time on one thread and else of the clock. The last column is their ratio. The
exit status is 1 if a ratio is above the bar.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import tai as ti

MODES = {"default": {}, "deterministic": {"deterministic": True}, "strict": {"strict": True}}
TYPES = ("f32", "f64", "i32")
BINS = 512

# Name: the update, the atomic, and the types if not all; `m` is a variable, `o` an element of no
# dimension, `h` an element of a field, `v` a vector, `s` a struct.
ROWS: dict[str, tuple[str, ...]] = {
    "sum": ("m = m + x[i]", "m += x[i]"),
    "difference": ("m = m - x[i]", "m -= x[i]"),
    "product": ("m = m * q[i]", "ti.atomic_mul(m, q[i])"),
    "min": ("m = ti.min(m, x[i])", "ti.atomic_min(m, x[i])"),
    "max": ("m = max(x[i], m)", "ti.atomic_max(m, x[i])"),
    "min by if": ("if x[i] < m: m = x[i]", "ti.atomic_min(m, x[i])"),
    "max by select": ("m = ti.select(x[i] > m, x[i], m)", "ti.atomic_max(m, x[i])"),
    "max by else": ("m = x[i] if x[i] > m else m", "ti.atomic_max(m, x[i])"),
    "sum under if": ("if x[i] > 1: m = m + x[i]", "if x[i] > 1: m += x[i]"),
    "sum by select": ("m = ti.select(x[i] > 1, m + x[i], m)", "if x[i] > 1: m += x[i]"),
    "count": ("if x[i] > 1: m = m + 2", "if x[i] > 1: m += 2"),
    "min under and": (
        "if b[i] > 3 and x[i] < m: m = x[i]", "if b[i] > 3: ti.atomic_min(m, x[i])"),
    "and": ("m = m & x[i]", "ti.atomic_and(m, x[i])", "i32"),
    "or": ("m = x[i] | m", "ti.atomic_or(m, x[i])", "i32"),
    "xor": ("m = m ^ x[i]", "ti.atomic_xor(m, x[i])", "i32"),
    "element sum": ("o[None] = o[None] + x[i]", "o[None] += x[i]"),
    "element product": ("o[None] = o[None] * q[i]", "ti.atomic_mul(o[None], q[i])"),
    "element min": ("o[None] = ti.min(o[None], x[i])", "ti.atomic_min(o[None], x[i])"),
    "element max by if": ("if x[i] > o[None]: o[None] = x[i]", "ti.atomic_max(o[None], x[i])"),
    "component": ("v[1] = v[1] + x[i]", "v[1] += x[i]"),
    "component min": ("v[1] = min(v[1], x[i])", "ti.atomic_min(v[1], x[i])"),
    "member": ("s.a = s.a + x[i]", "s.a += x[i]"),
    "member of an element": ("t[None].a = t[None].a + x[i]", "t[None].a += x[i]"),
    "histogram": ("h[b[i]] = h[b[i]] + x[i]", "h[b[i]] += x[i]"),
    "histogram by if": ("if x[i] > 1: h[b[i]] = h[b[i]] + x[i]", "if x[i] > 1: h[b[i]] += x[i]"),
    "histogram product": ("h[b[i]] = h[b[i]] * q[i]", "ti.atomic_mul(h[b[i]], q[i])"),
    "histogram max": ("h[b[i]] = ti.max(h[b[i]], x[i])", "ti.atomic_max(h[b[i]], x[i])"),
    "histogram max by if": (
        "if x[i] > h[b[i]]: h[b[i]] = x[i]", "ti.atomic_max(h[b[i]], x[i])"),
    "histogram max under and": (
        "if x[i] > 1 and x[i] > h[b[i]]: h[b[i]] = x[i]",
        "if x[i] > 1: ti.atomic_max(h[b[i]], x[i])"),
}  # fmt: skip

FIELDS = """\
import tai as ti
F = ti.{real}
Pair = ti.types.struct(a=F, b=F)
x, q = ti.field(F, {n}), ti.field(F, {n})
b = ti.field(ti.i32, {n})
o, h, t = ti.field(F, ()), ti.field(F, {bins}), Pair.field(shape=())
"""
KERNEL = """
@ti.kernel
def k{number}() -> F:
    m = F(1)
    v = ti.Vector([1, 1], F)
    s = Pair(F(1), F(1))
    for i in x:
        {line}
    return m + v[1] + s.a
"""


def load(rows: list[str], real: str, n: int, folder: Path, name: str):
    """A module with two kernels for each row."""
    text = FIELDS.format(real=real, n=n, bins=BINS)
    for number, row in enumerate(rows):
        for side in (0, 1):
            head, _, rest = ROWS[row][side].partition(": ")
            line = f"{head}:\n            {rest}" if rest else head
            text += KERNEL.format(number=2 * number + side, line=line)
    file = folder / f"{name}.py"
    file.write_text(text)
    spec = importlib.util.spec_from_file_location(name, file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    rng = np.random.default_rng(3)
    dtype = {"f32": np.float32, "f64": np.float64, "i32": np.int32}[real]
    module.x.from_numpy((3 * rng.standard_normal(n)).astype(dtype))
    module.q.from_numpy((1 + 1e-5 * rng.standard_normal(n)).astype(dtype))
    module.b.from_numpy(rng.integers(0, BINS, n).astype(np.int32))
    for memory in (module.o, module.h, module.t):
        memory.fill(1)
    return module


def pair(sides: list, rounds: int, batch: int, clock) -> list[float]:
    """The least seconds of a launch of each of the two."""
    best = [np.inf, np.inf]
    for turn in range(rounds):
        for side in (0, 1) if turn % 2 else (1, 0):
            begin = clock()
            for _ in range(batch):
                sides[side]()
            best[side] = min(best[side], (clock() - begin) / batch)
    return best


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--modes", default="default,deterministic", help="comma-separated")
    parser.add_argument("--threads", default="1,2", help="comma-separated")
    parser.add_argument("--types", default=",".join(TYPES), help="comma-separated")
    parser.add_argument("--rows", help="comma-separated; all by default")
    parser.add_argument("--size", type=int, default=200_000, help="iterations of a loop")
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--batch", type=int, default=3, help="launches of a round")
    parser.add_argument("--bar", type=float, default=1.1, help="highest ratio that passes")
    options = parser.parse_args()
    worst = 0.0
    print(f"# {options.size} iterations: microseconds of a launch as written, as atomics; ratio")
    with tempfile.TemporaryDirectory() as folder:
        for mode in options.modes.split(","):
            for threads in map(int, options.threads.split(",")):
                for real in options.types.split(","):
                    rows = [row for row in ROWS if ROWS[row][2:] in ((), (real,))]
                    if options.rows:
                        rows = [row for row in rows if row in options.rows.split(",")]
                    ti.init(
                        arch=ti.cpu, cpu_max_num_threads=threads, offline_cache=False,
                        **MODES[mode],
                    )  # fmt: skip
                    name = f"rows_{mode}_{threads}_{real}"
                    module = load(rows, real, options.size, Path(folder), name)
                    clock = time.process_time if threads == 1 else time.perf_counter
                    for number, row in enumerate(rows):
                        sides = [getattr(module, f"k{2 * number + side}") for side in (0, 1)]
                        for kernel in sides:
                            kernel()
                        written, atomic = pair(sides, options.rounds, options.batch, clock)
                        worst = max(worst, written / atomic)
                        mark = " above" if written > options.bar * atomic else ""
                        print(
                            f"{mode:14} {threads} {real} {row:24} {1e6 * written:9.1f} "
                            f"{1e6 * atomic:9.1f} {written / atomic:6.3f}{mark}",
                            flush=True,
                        )  # fmt: skip
    return 1 if worst > options.bar else 0


if __name__ == "__main__":
    sys.exit(main())
