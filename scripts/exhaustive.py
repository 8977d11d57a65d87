"""All arguments of functions of one f32: the largest error, in units in the last place.

    python scripts/exhaustive.py --stride 64                 # every 64th of all 2^32 arguments
    python scripts/exhaustive.py --seconds 60 --jobs 16      # at most a minute for each function
    python scripts/exhaustive.py --fix                       # writes docs/guides/precision.md

Each argument is compared with the function in f64, which is right to a unit of f64 and so to 2e-9
units of f32. Infinite results and NaN must be where the exact result has no f32. With --seconds,
pieces are taken in an order that spreads them over all arguments, and the table says how many there
were. Exits with 1 if a result is infinite or NaN where it should not be.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs/guides/precision.md"
BEGIN, END = (
    "<!-- exhaustive: begin (scripts/exhaustive.py --fix) -->\n",
    "<!-- exhaustive: end -->\n",
)
MODES = ("default", "accurate", "fast")
# Arguments of a piece; pieces are taken in steps of an odd number, which reaches all.
PIECE, STEP = 1 << 20, 2654435761


def _erf(name: str) -> Callable:
    from scipy import special

    return getattr(special, name)


# The names in ti or ti.math, and functions of arrays of f64.
FUNCTIONS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "exp": np.exp,
    "expm1": np.expm1,
    "log": np.log,
    "log10": np.log10,
    "log1p": np.log1p,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "sinh": np.sinh,
    "cosh": np.cosh,
    "tanh": np.tanh,
    "asinh": np.arcsinh,
    "acosh": np.arccosh,
    "atanh": np.arctanh,
    "sqrt": np.sqrt,
    "rsqrt": lambda x: 1 / np.sqrt(x),
    "cbrt": np.cbrt,
    "erf": lambda x: _erf("erf")(x),
    "erfc": lambda x: _erf("erfc")(x),
    "floor": np.floor,
    "ceil": np.ceil,
    "trunc": np.trunc,
}
GREATEST = float(np.finfo(np.float32).max)
# From here on, a number is rounded to infinity.
BEYOND = GREATEST + 2.0**103


def errors(found: np.ndarray, exact: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Errors in units of the last place of the exact results, and which results are wrong.

    A result is wrong if it is infinite or NaN where it should not be, or the other way round.
    Within a unit of the greatest f32, infinity is right, too.
    """
    is_nan = np.isnan(exact)
    is_inf = np.abs(exact) >= BEYOND
    near = (np.abs(exact) >= GREATEST) & ~is_nan
    wrong = np.isnan(found) != is_nan
    wrong |= np.isinf(found) & ~near | (is_inf & np.isfinite(found) & (np.abs(found) < GREATEST))
    wrong |= is_inf & np.isinf(found) & (np.signbit(found) != np.signbit(exact))
    exponent = np.maximum(np.frexp(np.where(is_nan | is_inf, 1.0, exact))[1] - 24, -149)
    with np.errstate(invalid="ignore"):
        off = np.abs(found.astype(np.float64) - exact) * np.ldexp(1.0, -exponent)
    off[~np.isfinite(off) | near | ~np.isfinite(found)] = 0.0
    return off, wrong


class _Piece:
    """A function in a mode, compiled in this process."""

    def __init__(self, name: str, mode: str, arch: str):
        import tai as ti

        ti.init(arch=getattr(ti, arch), math=mode, default_fp=ti.f32, cpu_max_num_threads=1)
        self.name = name
        x, self.y = ti.field(ti.f32, PIECE), ti.field(ti.f32, PIECE)
        self.x = x
        function = getattr(ti, name, None) or getattr(ti.math, name)
        y = self.y

        @ti.kernel
        def evaluate():
            for i in x:
                y[i] = function(x[i])

        self.evaluate = evaluate

    def worst(self, first: int, stride: int) -> tuple[float, int, int]:
        """The largest error, its argument's bits, and how many results are wrong."""
        bits = (first + stride * np.arange(PIECE, dtype=np.uint64)).astype(np.uint32)
        arguments = bits.view(np.float32)
        self.x.from_numpy(arguments)
        self.evaluate()
        with np.errstate(all="ignore"):
            exact = FUNCTIONS[self.name](arguments.astype(np.float64))
        off, wrong = errors(self.y.to_numpy(), exact)
        at = int(np.argmax(off))
        return float(off[at]), int(bits[at]), int(wrong.sum())


def run(name: str, mode: str, arch: str, stride: int, part: int, parts: int, end: float) -> dict:
    """The pieces of one process: number `part`, and each `parts`-th from there."""
    piece = _Piece(name, mode, arch)
    pieces = (1 << 32) // (PIECE * stride)
    found = {"ulp": 0.0, "at": 0, "wrong": 0, "arguments": 0}
    for number in range(part, pieces, parts):
        if time.time() > end and found["arguments"]:
            break
        # Spread over all, wherever it ends.
        place = number * STEP % pieces
        ulp, at, wrong = piece.worst(place * PIECE * stride + number % stride, stride)
        if ulp > found["ulp"]:
            found["ulp"], found["at"] = ulp, at
        found["wrong"] += wrong
        found["arguments"] += PIECE
    return found


def measure(name: str, mode: str, given: argparse.Namespace) -> dict:
    """A function in a mode, over all processes."""
    end = time.time() + (given.seconds or math.inf)
    with ProcessPoolExecutor(given.jobs, get_context("spawn")) as pool:
        jobs = [
            pool.submit(run, name, mode, given.arch, given.stride, part, given.jobs, end)
            for part in range(given.jobs)
        ]
        parts = [job.result() for job in jobs]
    worst = max(parts, key=lambda part: part["ulp"])
    return {
        "function": name, "mode": mode, "ulp": worst["ulp"],
        "at": float(np.uint32(worst["at"]).view(np.float32)),
        "wrong": sum(part["wrong"] for part in parts),
        "arguments": sum(part["arguments"] for part in parts),
    }  # fmt: skip


def table(rows: list[dict]) -> str:
    """The largest error of each function by mode, and the argument that has it."""
    names = list(dict.fromkeys(row["function"] for row in rows))
    modes = list(dict.fromkeys(row["mode"] for row in rows))
    lines = ["| function | " + " | ".join(f"{mode} (at)" for mode in modes) + " | arguments |"]
    lines.append("|---" * (len(modes) + 2) + "|")
    for name in names:
        mine = {row["mode"]: row for row in rows if row["function"] == name}
        cells = []
        for mode in modes:
            row = mine[mode]
            text = f"{row['ulp']:.4g} ({row['at']:.7g})"
            cells.append(text + (f", {row['wrong']} wrong" if row["wrong"] else ""))
        share = min(row["arguments"] for row in mine.values()) / 2**32
        cells.append("all" if share == 1 else f"1/{round(1 / share)}")
        lines.append(f"| `{name}` | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("names", nargs="*", help="functions; all if left out")
    add("--modes", default=",".join(MODES), help="comma-separated")
    add("--arch", default="cpu", choices=["cpu", "cuda"])
    add("--stride", type=int, default=1, help="every so many arguments: a power of two")
    add("--seconds", type=float, default=0, help="for each function in each mode; 0: no bound")
    add("--jobs", type=int, default=len(os.sched_getaffinity(0)))
    add("--out", type=Path, help="a file of JSON, for --rows")
    add("--rows", type=Path, help="measure nothing: print what --out wrote")
    add("--fix", action="store_true", help=f"write the table to {PAGE.relative_to(ROOT)}")
    given = parser.parse_args()
    if given.stride < 1 or given.stride & (given.stride - 1) or given.stride > 1 << 12:
        parser.error(f"--stride is a power of two up to 4096, but got {given.stride}")
    for name in given.names:
        if name not in FUNCTIONS:
            parser.error(f"unknown function '{name}', known are {', '.join(FUNCTIONS)}")
    rows = json.loads(given.rows.read_text()) if given.rows else []
    for name in [] if given.rows else given.names or FUNCTIONS:
        for mode in given.modes.split(","):
            rows.append(measure(name, mode, given))
            print(json.dumps(rows[-1]), flush=True)
            if given.out:
                given.out.write_text(json.dumps(rows, indent=1) + "\n")
    made = table(rows)
    print(made)
    if given.fix:
        head, rest = PAGE.read_text().split(BEGIN)
        PAGE.write_text(head + BEGIN + made + END + rest.split(END)[1])
    return int(any(row["wrong"] for row in rows if row["mode"] != "fast"))


if __name__ == "__main__":
    sys.exit(main())
