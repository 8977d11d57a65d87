"""All arguments of functions of one f32: the largest error, in units in the last place.

    python scripts/exhaustive.py                             # all 2^32, two hours on one core
    python scripts/exhaustive.py --stride 64                 # every 64th of them
    python scripts/exhaustive.py --minutes 8 --out cpu.json  # as far as it gets; again: the rest
    python scripts/exhaustive.py --rows cpu.json --fix       # writes docs/guides/precision.md

Each result is compared with the function in f64, which NumPy and SciPy compute within a few units
of f64: errors are known to 2e-8 units of f32. The share of results that are not the nearest f32 is
counted, too; where the exact one lies so close to the middle of two f32 that f64 cannot tell,
mpmath decides with 60 digits. Infinite results and NaN must be where the exact result has no f32.
Exits with 1 if a result is infinite or NaN where it should not be, but for mode `fast`.

The functions go one after the other, in blocks that processes share; all modes of a block have one
reference. --out keeps which blocks are done, so that a later run goes on there.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
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
# A block is the work of one process at a time; the arrays of a piece fit into its cache.
BLOCKS, PIECE = 256, 1 << 15
# Arguments of a launch on a GPU.
LAUNCH = 1 << 22


def _erf(name: str) -> Callable:
    from scipy import special

    return getattr(special, name)


# The names in ti or ti.math, and functions of arrays of f64; those that take longest come last.
FUNCTIONS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "exp": np.exp,
    "expm1": np.expm1,
    "log": np.log,
    "log1p": np.log1p,
    "sqrt": np.sqrt,
    "rsqrt": lambda x: 1 / np.sqrt(x),
    "floor": np.floor,
    "ceil": np.ceil,
    "trunc": np.trunc,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "tanh": np.tanh,
    "erf": lambda x: _erf("erf")(x),
    "cbrt": np.cbrt,
    "asinh": np.arcsinh,
    "erfc": lambda x: _erf("erfc")(x),
    "atanh": np.arctanh,
    "log10": np.log10,
    "acosh": np.arccosh,
    "sinh": np.sinh,
    "cosh": np.cosh,
}
GREATEST = float(np.finfo(np.float32).max)
# From here on, a number is rounded to infinity.
BEYOND = GREATEST + 2.0**103
# Closer to half a unit than this, the reference does not say which way to round.
UNDECIDED = 1e-7


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


def is_nearest(name: str, argument: float, found: float) -> bool:
    """Whether a result is the f32 that is nearest to the exact one, by mpmath; yes without it."""
    try:
        import mpmath
    except ImportError:
        return True
    with mpmath.workdps(60):
        x = mpmath.mpf(argument)
        if name == "rsqrt":
            exact = 1 / mpmath.sqrt(x)
        elif name == "cbrt":
            exact = mpmath.sign(x) * mpmath.cbrt(abs(x))
        else:
            exact = getattr(mpmath, name)(x)
        below, above = (float(np.nextafter(np.float32(found), np.float32(s * np.inf)))
                        for s in (-1, 1))  # fmt: skip
        mine = abs(exact - found)
        return bool(mine <= abs(exact - below) and mine <= abs(exact - above))


@dataclass
class Row:
    """Errors of a function in a mode, of the arguments that were compared so far."""

    function: str
    mode: str
    arch: str = "cpu"
    machine: str = ""
    stride: int = 1
    ulp: float = 0.0
    # The bits of the argument with the largest error.
    at: int = 0
    wrong: int = 0
    misrounded: int = 0
    # A bit for each block that was compared.
    done: int = 0

    def add(self, other: Row) -> None:
        """Takes the errors of other blocks in."""
        if other.ulp > self.ulp:
            self.ulp, self.at = other.ulp, other.at
        self.wrong += other.wrong
        self.misrounded += other.misrounded
        self.done |= other.done

    def arguments(self) -> int:
        return self.done.bit_count() * ((1 << 32) // BLOCKS // self.stride)

    def compare(
        self, bits: np.ndarray, exact: np.ndarray, found: np.ndarray, is_first: bool
    ) -> None:
        """Takes the results at some arguments in; `exact` are of f64, `found` of f32."""
        with np.errstate(over="ignore"):
            nearest = exact.astype(np.float32)
        if is_first:
            # Half a unit is the most that a nearest number is off: some of them will do.
            self._take(errors(found, exact)[0], bits)
        different = found != nearest
        if not different.any():
            return
        different &= ~(np.isnan(found) & np.isnan(nearest))
        at = np.flatnonzero(different)
        if not len(at):
            return
        off, wrong = errors(found[at], exact[at])
        self.wrong += int(wrong.sum())
        self._take(off, bits[at])
        close = np.abs(off - 0.5) < UNDECIDED
        self.misrounded += int(np.count_nonzero(~close & (off > 0.5)))
        for k in at[close]:
            argument = float(bits[k : k + 1].view(np.float32)[0])
            self.misrounded += not is_nearest(self.function, argument, float(found[k]))

    def _take(self, off: np.ndarray, bits: np.ndarray) -> None:
        worst = int(np.argmax(off))
        if off[worst] > self.ulp:
            self.ulp, self.at = float(off[worst]), int(bits[worst])


class Evaluator:
    """Functions, compiled in this process for an architecture."""

    def __init__(self, arch: str):
        import tai as ti

        self.arch = arch
        ti.init(arch=getattr(ti, arch), default_fp=ti.f32, cpu_max_num_threads=1)
        self.results = ti.field(ti.f32, PIECE if arch == "cpu" else LAUNCH)
        self.kernels: dict[tuple[str, str], Callable] = {}

    def _kernel(self, name: str, mode: str) -> Callable:
        import tai as ti

        function = getattr(ti, name, None) or getattr(ti.math, name)
        results = self.results

        @ti.kernel(**({} if mode == "default" else {"math": mode}))
        def evaluate(first: ti.u32, stride: ti.u32):
            for i in results:
                bits = first + stride * ti.cast(i, ti.u32)
                results[i] = function(ti.bit_cast(bits, ti.f32))

        return evaluate

    def results_of(self, name: str, mode: str, first: int, stride: int) -> np.ndarray:
        """The function at as many arguments as `results` has elements."""
        key = name, mode
        if key not in self.kernels:
            self.kernels[key] = self._kernel(name, mode)
        self.kernels[key](first, stride)
        return self.results.to_numpy()

    def block(self, name: str, modes: tuple[str, ...], number: int, stride: int) -> list[Row]:
        """Compares a block: every stride-th of its arguments, from a place within the stride."""
        rows = [Row(name, mode, self.arch, stride=stride, done=1 << number) for mode in modes]
        size = (1 << 32) // BLOCKS
        first, end = number * size + number % stride, (number + 1) * size
        at_once = self.results.shape[0]
        is_first = True
        while first < end:
            count = min(at_once, (end - first + stride - 1) // stride)
            found = [self.results_of(name, mode, first, stride)[:count] for mode in modes]
            for begin in range(0, count, PIECE):
                part = slice(begin, min(begin + PIECE, count))
                places = np.arange(part.start, part.stop, dtype=np.uint64)
                bits = (first + stride * places).astype(np.uint32)
                with np.errstate(all="ignore"):
                    exact = FUNCTIONS[name](bits.view(np.float32).astype(np.float64))
                for row, results in zip(rows, found, strict=True):
                    row.compare(bits, exact, results[part], is_first)
                is_first = False
            first += stride * count
        return rows


_evaluator: Evaluator | None = None


def _start(arch: str) -> None:
    global _evaluator
    _evaluator = Evaluator(arch)


def _block(name: str, modes: tuple[str, ...], number: int, stride: int, end: float) -> list[Row]:
    """A block, by a process of the pool; nothing if the time is up."""
    assert _evaluator is not None
    return _evaluator.block(name, modes, number, stride) if time.time() < end else []


def machine(arch: str) -> str:
    """The processor that computes."""
    if arch == "cuda" and not os.environ.get("TAI_CUDA_EMULATION"):
        command = ["nvidia-smi", "--query-gpu=name", "--format=csv,noheader"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        return done.stdout.splitlines()[0].strip() if done.stdout else "GPU"
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return (names or ["CPU"])[0] + (" (emulated device)" if arch == "cuda" else "")


def load(path: Path) -> list[Row]:
    rows = json.loads(path.read_text())
    return [Row(**row | {"done": int(row["done"], 16)}) for row in rows]


def save(rows: list[Row], path: Path) -> None:
    kept = [asdict(row) | {"done": f"{row.done:x}"} for row in rows]
    path.write_text(json.dumps(kept, indent=1) + "\n")


def missing(rows: list[Row], names: list[str], modes: list[str]) -> Iterator[tuple]:
    """The blocks to compare: function, modes, number."""
    for name in names:
        mine = {row.mode: row.done for row in rows if row.function == name}
        for number in range(BLOCKS):
            open_modes = tuple(m for m in modes if not mine.get(m, 0) >> number & 1)
            if open_modes:
                yield name, open_modes, number


def measure(rows: list[Row], given: argparse.Namespace) -> None:
    """Compares the blocks that are missing, in processes."""
    end = time.time() + 60 * (given.minutes or math.inf)
    found = {(row.function, row.mode): row for row in rows}
    here = machine(given.arch)
    work = list(missing(rows, given.names or list(FUNCTIONS), given.modes.split(",")))
    context = get_context("spawn")
    with ProcessPoolExecutor(given.jobs, context, _start, (given.arch,)) as pool:
        jobs = [pool.submit(_block, *block, given.stride, end) for block in work]
        saved = time.time()
        for (name, _, number), job in zip(work, jobs, strict=True):
            for part in job.result():
                key = name, part.mode
                if key not in found:
                    found[key] = Row(name, part.mode, given.arch, here, given.stride)
                    rows.append(found[key])
                found[key].add(part)
            if given.out and time.time() - saved > 5:
                save(rows, given.out)
                saved = time.time()
            if number == BLOCKS - 1:
                print(
                    table([row for row in rows if row.function == name]).splitlines()[-1],
                    flush=True,
                )
    if given.out:
        save(rows, given.out)


def table(rows: list[Row]) -> str:
    """The largest error of each function by mode, its argument, and how many are not nearest."""
    known = {row.function for row in rows}
    names = sorted(known, key=lambda name: list(FUNCTIONS).index(name))
    modes = [mode for mode in MODES if any(row.mode == mode for row in rows)]
    lines = ["| function | " + " | ".join(modes) + " | arguments |"]
    lines.append("|---" * (len(modes) + 2) + "|")
    for name in names:
        mine = {row.mode: row for row in rows if row.function == name}
        cells = []
        for mode in modes:
            if mode not in mine:
                cells.append("")
                continue
            row = mine[mode]
            at = float(np.uint32(row.at).view(np.float32))
            share = 100 * row.misrounded / max(row.arguments(), 1)
            text = f"{row.ulp:.4g} at {at:.7g}" if row.ulp else "0"
            text += f", {share:.2g} %" if row.misrounded else ""
            cells.append(text + (f", **{row.wrong} wrong**" if row.wrong else ""))
        share = min(row.arguments() for row in mine.values()) / 2**32
        cells.append("all" if share == 1 else f"1/{round(1 / share)}" if share else "none")
        lines.append(f"| `{name}` | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def tables(rows: list[Row]) -> str:
    """A table for each machine."""
    machines = list(dict.fromkeys(row.machine for row in rows))
    parts = [f"{name}:\n\n" + table([r for r in rows if r.machine == name]) for name in machines]
    return "\n".join(parts)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("names", nargs="*", help="functions; all if left out")
    add("--modes", default=",".join(MODES), help="comma-separated")
    add("--arch", default="cpu", choices=["cpu", "cuda"])
    add("--stride", type=int, default=1, help="every so many arguments: a power of two")
    add("--minutes", type=float, default=0, help="of all functions together; 0: no bound")
    add("--jobs", type=int, default=len(os.sched_getaffinity(0)))
    add("--out", type=Path, help="a file of JSON; if it exists, its blocks are not done again")
    add("--rows", type=Path, nargs="+", help="measure nothing: print what --out wrote")
    add("--fix", action="store_true", help=f"write the tables to {PAGE.relative_to(ROOT)}")
    given = parser.parse_args()
    if given.stride < 1 or given.stride & (given.stride - 1) or given.stride > 1 << 16:
        parser.error(f"--stride is a power of two up to 65536, but got {given.stride}")
    for name in given.names:
        if name not in FUNCTIONS:
            parser.error(f"unknown function '{name}', known are {', '.join(FUNCTIONS)}")
    if given.rows:
        rows = [row for path in given.rows for row in load(path)]
    else:
        rows = load(given.out) if given.out and given.out.exists() else []
        for row in rows:
            if (row.stride, row.arch) != (given.stride, given.arch):
                parser.error(
                    f"{given.out} has stride {row.stride} of {row.arch}: name another file"
                )
        measure(rows, given)
    made = tables(rows)
    print(made)
    if given.fix:
        head, rest = PAGE.read_text().split(BEGIN)
        PAGE.write_text(head + BEGIN + made + END + rest.split(END)[1])
    return int(any(row.wrong for row in rows if row.mode != "fast"))


if __name__ == "__main__":
    sys.exit(main())
