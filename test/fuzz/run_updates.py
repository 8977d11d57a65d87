"""Random parallel loops whose iterations share memory, against their serial order.

    python test/fuzz/run_updates.py --count 2000 --jobs 2
    python test/fuzz/run_updates.py --seed 17        # one seed, with its program

A program is one loop: reductions in all forms in which a program writes them, stores that collide,
reads of what other iterations write, under conditions and at indices that data choose. Plain
Python runs its body one iteration after another. That gives the values, the derivative along a
direction, and the races: which iterations come to which element, and how (`serial_order`). Each
seed draws where the program runs: target, threads, level, number of elements, type, and whether
strict, deterministic or with checks.

Without a race, the program is accepted, and its values and gradients are those of the serial order.
If several iterations store to one element, it keeps the number of one of them, and under a tape
that of the last one, which has the gradient. In one thread, and with `serialize`,
values are those of the serial order for all programs. With a race, the program is refused,
or its result is not looked at; with `debug=True` it is refused.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import random
import sys
import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

import serial_order
import shared_programs as programs
import workers
from configurations import BLOCKS, THREADS, Configuration
from serial_order import Dual, Input, Memory, Parts

# Odd, and above the numbers of iterations at which a loop gets vectors, chunks, several threads,
# private sums and 16 bits.
SIZES = (17, 33, 261, 1031, 4099, 20011, 65_537, 200_003)
# How often they are drawn: plain Python takes 10 s for the last one.
SHARES = (8, 6, 6, 10, 6, 3, 1.5, 0.7)
# In f32 the rounding of sums and products of more terms is no small number.
MOST_IN_SINGLE = 4099
# Derivatives in plain Python take their time.
MOST_FOR_GRADIENTS = 20011

# Refusals of the adjoint of a kernel that has no race.
LIMITS = ("is needed by the gradient", "of an element of an array has no gradient")


@dataclass(frozen=True)
class Case:
    """Where and how a program runs."""

    where: Configuration
    real: str = "f64"
    strict: bool = False
    debug: bool = False
    serialize: bool = False

    def __str__(self) -> str:
        words = [str(self.where), self.real]
        words += [name for name in ("strict", "debug", "serialize") if getattr(self, name)]
        return ",".join(words)

    @property
    def has_order(self) -> bool:
        """Whether iterations run one after another."""
        one = self.where.arch in ("cpu", "python") and self.where.threads == 1
        return self.serialize or one


def parse(word: str) -> Case:
    where, real, *flags = word.split(",")
    from configurations import parse

    return Case(parse(where), real, **dict.fromkeys(flags, True))


def draw_case(seed: int) -> Case:
    rng = random.Random(f"case {seed}")
    arch = rng.choice(("cpu", "cpu", "cpu", "cpu", "emulated", "python"))
    threads = rng.choice({"cpu": THREADS, "emulated": BLOCKS}.get(arch, (1,)))
    sizes = {"cpu": SIZES, "emulated": SIZES[:-2], "python": SIZES[:3]}[arch]
    real = rng.choice(("f64", "f64", "f64", "f32"))
    if real == "f32":
        sizes = [n for n in sizes if n <= MOST_IN_SINGLE]
    size = rng.choices(sizes, SHARES[: len(sizes)])[0]
    mode = rng.choice(("default", "default", "deterministic", "strict"))
    where = Configuration(arch, threads, rng.choice((0, 1, 3, 3)), size, mode == "deterministic")
    return Case(where, real, mode == "strict", rng.random() < 0.25, rng.random() < 0.1)


class Data:
    """The numbers that a seed's program begins with, and the direction of its derivative."""

    def __init__(self, seed: int, n: int, real: str):
        rng = np.random.default_rng(seed)
        dtype = {"f32": np.float32, "f64": np.float64}[real]

        def floats(shape) -> np.ndarray:
            return rng.uniform(-1, 1, shape).astype(dtype)

        self.start = {"x": floats(n)}
        self.whole = {
            "n": rng.integers(-100, 100, n), "g": rng.integers(0, programs.GROUPS, n),
            "p": rng.permutation(n), "q": rng.integers(0, n, n),
        }  # fmt: skip
        for name, (size, parts) in programs.FLOATS.items():
            count = n if size == "N" else size
            for part in parts or (None,):
                first = programs.FIRST.get(name)
                values = floats(count)
                self.start[name, part] = values if first is None else np.full(count, first, dtype)
        self.along = {key: floats(len(values)) for key, values in self.start.items()}


@dataclass
class Serial:
    """The result of the serial order: values by memory and part, a derivative, and the log."""

    values: dict
    slope: float | None
    size: float
    log: serial_order.Log


def run_in_order(program: programs.Program, data: Data, n: int, derives: bool) -> Serial:
    log = serial_order.Log(program.updates())

    def number(key, i):
        value = float(data.start[key][i])
        return Dual(value, float(data.along[key][i])) if derives else value

    names: dict = {key: [int(i) for i in values] for key, values in data.whole.items()}
    names |= {"N": n, "F": float}
    names["x"] = Input(None, "x", [number("x", i) for i in range(n)], False)
    for name, (size, parts) in programs.FLOATS.items():
        count = n if size == "N" else size
        keys = [None] if name in "ov" else range(count)
        if parts:
            values = {(k, part): number((name, part), k or 0) for k in keys for part in parts}
            names[name] = Parts(log, name, values, False)
        else:
            names[name] = Memory(log, name, {k: number((name, None), k or 0) for k in keys}, False)
    for name, size in programs.WHOLES.items():
        count = n if size == "N" else size
        names[name] = Memory(
            log, name, dict.fromkeys(range(count), programs.FIRST.get(name, 0)), True
        )
    for _, text, first in programs.VARIABLES.values():
        is_whole = first.isdigit()
        start = int(first) if is_whole else float(first)
        names[text[:-3]] = Memory(log, text[:-3], {0: start}, is_whole)
    serial_order.run(program.body(), names, program.iterations(n), log)
    for place, (name, at) in {
        ("out", 0): ("A", 0), ("out", 1): ("B0", 0), ("out", 2): ("B1", 0), ("out", 3): ("R", 0),
        ("counts", 0): ("C", 0),
    }.items():  # fmt: skip
        names[place[0]].values[place[1]] = names[name].values[at]
    values, slope, size = {}, 0.0, 0.0
    for name, (_, parts) in programs.FLOATS.items():
        for part in parts or (None,):
            found = names[name].values
            keys = [k for k in found if k[1] == part] if parts else list(found)
            values[name, part] = np.array([getattr(found[k], "value", found[k]) for k in keys])
            if derives:
                slopes = np.array([getattr(found[k], "slope", 0.0) for k in keys])
                terms = slopes * weights(name, part, len(keys))
                slope += terms.sum()
                size += np.abs(terms).sum()
    for name in programs.WHOLES:
        values[name, None] = np.array(list(names[name].values.values()))
    return Serial(values, slope if derives else None, size, log)


def weights(name: str, part, count: int) -> np.ndarray:
    """The derivatives of `loss` in `total`."""
    j = np.arange(count)
    return {
        "h": j + 0.5, "out": 1.5 - j, "o": 0.7 + 0 * j, "y": 0.1 * (j % 7) + 0.2,
        "z": -(0.1 * (j % 5) - 0.3), "v": (-0.4 if part == 1 else 1.0) + 0 * j,
        "s": 0.3 + j if part == "a" else -0.2 + 0 * j,
    }[name]  # fmt: skip


class Compiled:
    """A program as tai runs it."""

    def __init__(self, program: programs.Program, case: Case, data: Data, folder: Path, seed: int):
        import tai as ti

        self.program, self.case, self.data = program, case, data
        case.where.init(
            default_fp=getattr(ti, case.real), offline_cache=False, strict=case.strict,
            debug=case.debug,
        )  # fmt: skip
        name = f"shared_{seed}"
        file = folder / f"{name}.py"
        file.write_text(f"N = {case.where.elements}\n{program.kernel(case.real, case.serialize)}")
        spec = importlib.util.spec_from_file_location(name, file)
        self.module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(self.module)
        for key, values in data.whole.items():
            getattr(self.module, key).from_numpy(values.astype(np.int32))
        self.memory("x").from_numpy(data.start["x"])

    def memory(self, name: str):
        if self.program.places == "arrays" and name in "yz":
            return getattr(self.module, name + "_array")
        return getattr(self.module, name)

    @property
    def arrays(self) -> list:
        return [self.memory("y"), self.memory("z")] if self.program.places == "arrays" else []

    def start(self) -> None:
        for name, (_, parts) in programs.FLOATS.items():
            values = [self.data.start[name, part] for part in parts or (None,)]
            if name == "s":
                self.memory(name).from_numpy(dict(zip(parts, values, strict=True)))
            elif name == "v":
                self.memory(name).from_numpy(np.array([v[0] for v in values]))
            else:
                memory = self.memory(name)
                memory.from_numpy(values[0].reshape(memory.shape))
        for name in programs.WHOLES:
            self.memory(name).fill(programs.FIRST.get(name, 0))

    def launch(self) -> None:
        self.module.run(self.case.where.elements, *self.arrays)

    def run(self) -> dict:
        import tai as ti

        self.start()
        self.launch()
        ti.sync()
        return self.values()

    def values(self, suffix: str = "") -> dict:
        found = {}
        names = list(programs.FLOATS) + ([] if suffix else list(programs.WHOLES))
        for name in names:
            memory = self.memory(name)
            numbers = (memory.grad if suffix else memory).to_numpy()
            parts = programs.FLOATS.get(name, (0, ()))[1]
            for part in parts or (None,):
                one = numbers[part] if name == "s" else numbers
                one = one[..., part] if name == "v" else one
                found[name, part] = np.atleast_1d(one)
        return found

    def slope(self) -> float:
        """The gradient along the direction of the data."""
        import tai as ti

        self.start()
        with ti.ad.Tape(self.module.loss):
            self.launch()
            self.module.total(*self.arrays)
        found = self.values("grad") | {"x": self.memory("x").grad.to_numpy()}
        found = {key: values for key, values in found.items() if key[0] != "out"}
        return sum(
            float(np.sum(values.astype(np.float64) * self.data.along[key]))
            for key, values in found.items()
        )


def compare(found: dict, serial: Serial, case: Case, races: set[str], taped: bool) -> str:
    """The difference from the serial order, or nothing."""
    tolerance = 1e-7 if case.real == "f64" else 1e-3
    for key, expected in serial.values.items():
        scale = max(np.abs(expected).max(), np.sqrt(case.where.elements) * 1e-2)
        bad = ~(np.abs(found[key] - expected) <= tolerance * scale)
        for i in np.flatnonzero(bad):
            visits = serial.log.visits.get((key[0], int(i)))
            # A tape chooses among stores that carry a derivative only.
            is_open = (not taped or key[0] in programs.WHOLES) and not case.has_order
            if is_open and visits and visits.writers == serial_order.MANY:
                stored = [float(getattr(v, "value", v)) for v in visits.stored.values()]
                if np.abs(np.array(stored) - found[key][i]).min() <= tolerance * scale:
                    continue
            return (
                f"{key[0]} {key[1]}: {found[key][i]!r} at {i} instead of {expected[i]!r}, "
                f"{bad.sum()} of {bad.size} differ"
            )
    return ""


def judge(program: programs.Program, case: Case, seed: int, folder: Path) -> tuple[str, str, str]:
    """`agree`, `refused`, `open` (a race that is not reported) or `FAIL`; the reason; details."""
    import tai as ti

    n = case.where.elements
    data = Data(seed, n, case.real)
    derives = n <= MOST_FOR_GRADIENTS
    serial = run_in_order(program, data, n, derives)
    races = serial.log.races()
    # Iterations that store to one element have a result, and under a tape a known one.
    undefined = races - {"stores"}
    phase = "run"
    try:
        with case.where.chosen(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            compiled = Compiled(program, case, data, folder, seed)
            found = compiled.run()
            if case.debug and not case.has_order and undefined & {"reads", "updates"}:
                return "FAIL", "debug does not report a race", str(races)
            if undefined and not case.has_order:
                return "open", ", ".join(sorted(undefined)), ""
            if difference := compare(found, serial, case, races, False):
                return "FAIL", "a value is wrong", difference
            if case.where.deterministic and not races:
                again = compiled.run()
                if any(not np.array_equal(found[key], again[key]) for key in found):
                    return "FAIL", "a deterministic result has other bits", ""
            if derives:
                phase = "tape"
                slope = compiled.slope()
                if difference := compare(compiled.values(), serial, case, races, True):
                    return "FAIL", "a value under a tape is wrong", difference
                bound = 1e-8 if case.real == "f64" else 2e-3
                if not abs(slope - serial.slope) <= bound * max(serial.size, np.sqrt(n)):
                    return "FAIL", "a gradient is wrong", f"{slope!r} instead of {serial.slope!r}"
    except ti.TaiError as error:
        reason = f"{phase}: {type(error).__name__}: {plain(error.message)}"
        # Under a tape, stores that collide may be refused, and values that the adjoint lacks.
        may_refuse = (undefined and not case.has_order) or (
            phase == "tape" and (races or any(words in error.message for words in LIMITS))
        )
        if not may_refuse or error.lineno is None:
            return "FAIL", reason, f"{sorted(races)}\n{error}"
        return "refused", reason, str(error)
    return "agree", "", ""


def plain(message: str) -> str:
    from outcome import plain

    return plain(message)


def judge_seed(seed: int, folder: Path) -> dict:
    kind, reason, detail = judge(programs.draw(seed), draw_case(seed), seed, folder)
    return {"seed": seed, "kind": kind, "reason": reason, "detail": detail}


def word_of(seed: int) -> str:
    return str(draw_case(seed))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=2000, help="how many seeds")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--log", type=Path, help="file of outcomes, one JSON object for each")
    parser.add_argument("--seed", type=int, help="run one seed and print its program")
    parser.add_argument("--configuration", help="the one for --seed, as failures report it")
    parser.add_argument("--minutes", type=float, default=1e9, help="stop after that long")
    args = parser.parse_args()
    os.environ.pop("TI_ARCH", None)
    if args.seed is not None:
        program = programs.draw(args.seed)
        case = parse(args.configuration) if args.configuration else draw_case(args.seed)
        print(program.kernel(case.real, case.serialize))
        with tempfile.TemporaryDirectory() as folder:
            kind, reason, detail = judge(program, case, args.seed, Path(folder))
        print(f"seed {args.seed}, {case}: {kind}: {reason}\n{detail}")
        return 1 if kind == "FAIL" else 0
    seeds = list(range(args.first, args.first + args.count))
    rows = workers.judge_all(judge_seed, seeds, args.jobs, args.log, word_of, 60 * args.minutes)
    print(workers.summary(rows))
    return 1 if any(row["kind"] == "FAIL" for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
