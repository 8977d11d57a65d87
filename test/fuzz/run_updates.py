"""Random updates of what all iterations of a parallel loop share, against their serial order.

    python test/fuzz/run_updates.py --count 300
    python test/fuzz/run_updates.py --seed 17        # one seed, with its program

A program is one loop that updates variables and elements: sums, differences, products, extrema
and bits, in all forms in which a program writes them, under conditions, with indices that data
choose. It runs twice: in parallel, on the target, with the threads and the number of elements that
its seed draws; and with `serialize=True`, where all that counts is the order of its lines. Values
and gradients must agree.
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

sys.path.insert(0, str(Path(__file__).parent))

from configurations import BLOCKS, THREADS, Configuration

# Above the numbers of iterations at which a loop gets several threads, private sums and chunks.
SIZES = (7, 1031, 20011, 200_003)
# Serial loops are reversed in order, with what they overwrite.
MOST_FOR_GRADIENTS = 20011
GROUPS = 13

HEADER = f"""\
import tai as ti

x = ti.field(ti.f64, N, needs_grad=True)
n = ti.field(ti.i32, N)
g = ti.field(ti.i32, N)
h = ti.field(ti.f64, {GROUPS}, needs_grad=True)
w = ti.field(ti.i32, {GROUPS})
o = ti.field(ti.f64, (), needs_grad=True)
v = ti.Vector.field(2, ti.f64, (), needs_grad=True)
out = ti.field(ti.f64, 4, needs_grad=True)
counts = ti.field(ti.i32, 2)
loss = ti.field(ti.f64, (), needs_grad=True)


@ti.kernel
def total():
    for j in h:
        loss[None] += h[j] * (j + 0.5)
    for j in out:
        loss[None] += out[j] * (1.5 - j)
    loss[None] += 0.7 * o[None] + v[None][0] - 0.4 * v[None][1]


@ti.kernel
def run():
    a = 0.25
    b = ti.Vector([0.5, -0.5])
    c = 3
"""
FOOTER = """\
    out[0] = a
    out[1] = b[0]
    out[2] = b[1]
    counts[0] = c
"""
RESULTS = ("h", "w", "o", "v", "out", "counts")


class Generator:
    """Writes one program."""

    def __init__(self, rng: random.Random):
        self.rng = rng
        # By place: the operation of all its updates.
        self.families: dict[str, str] = {}

    def number(self) -> str:
        return self.rng.choice(
            ("x[i]", "0.5 * x[i]", "x[i] * x[i]", "ti.sin(x[i])", "0.125", "(x[i] - 0.3)")
        )

    def condition(self) -> str:
        return self.rng.choice(
            ("x[i] > 0.1", "n[i] % 3 == 0", "x[i] < 0.5 and n[i] > -50", "i % 2 == 0", "n[i] != 4")
        )

    def update(self) -> list[str]:
        is_whole = self.rng.random() < 0.3
        if is_whole:
            place, text = self.rng.choice((("c", "c"), ("w", "w[g[i]]"), ("w", "w[i % 5]")))
            family = self.rng.choice("+*&|^<>")
            value = self.rng.choice(("n[i]", "(n[i] | 1)", "3", "n[i] * 2"))
        else:
            place, text = self.rng.choice(
                (("a", "a"), ("b0", "b[0]"), ("b1", "b[1]"), ("h", "h[g[i]]"), ("h", "h[i % 7]"),
                 ("h", "h[(g[i] + 1) % 13]"), ("o", "o[None]"), ("v0", "v[None][0]"),
                 ("v1", "v[None][1]"))
            )  # fmt: skip
            family = self.rng.choice("++*<>")
            value = self.number()
        family = self.families.setdefault(place, family)
        return self.guarded(self.statements(text, family, value))

    def guarded(self, lines: list[str]) -> list[str]:
        if self.rng.random() < 0.4:
            return [f"if {self.condition()}:", *("    " + line for line in lines)]
        return lines

    def statements(self, place: str, family: str, value: str) -> list[str]:
        """One update in one of the forms that the operation has."""
        if family in "<>":
            return self.extremum(place, family, value)
        is_whole = place[0] in "cw"
        if family == "*" and not is_whole:
            # Products stay of moderate size.
            value = f"(1 + 1e-4 * {value})"
        new = [f"{place} {family} {value}", f"{value} {family} {place}"]
        if family == "+":
            rest = "n[i]" if is_whole else "x[i]"
            new += [f"{place} - {value}", f"{place} + {value} - {rest}"]
        one = self.rng.choice(new)
        form = self.rng.randrange(5)
        if form == 0 and family != "*":
            return [f"{place} {family}= {value}"]
        if form == 1:
            return [f"{place} = ti.select({self.plain_condition()}, {one}, {place})"]
        if form == 2:
            return [f"{place} = {place} if {self.condition()} else {one}"]
        if form == 3:
            return [f"{place} = {one} if {self.condition()} else {self.rng.choice(new)}"]
        return [f"{place} = {one}"]

    def plain_condition(self) -> str:
        return self.rng.choice(("x[i] > 0.1", "n[i] > 7"))

    def extremum(self, place: str, family: str, value: str) -> list[str]:
        name = "min" if family == "<" else "max"
        return self.rng.choice(
            (
                [f"{place} = ti.{name}({place}, {value})"],
                [f"{place} = {name}({value}, {place})"],
                [f"{place} = ti.select({value} {family} {place}, {value}, {place})"],
                [f"{place} = {value} if {value} {family} {place} else {place}"],
                [f"if {value} {family} {place}:", f"    {place} = {value}"],
                [f"t = {value}", f"if not ({place} {family}= t):", f"    {place} = t"],
            )
        )


def program(seed: int) -> str:
    """The text of a program, with `LOOP` where the loop begins."""
    rng = random.Random(f"updates {seed}")
    generator = Generator(rng)
    lines = []
    for _ in range(rng.randrange(1, 6)):
        lines += generator.update()
    body = "".join(f"        {line}\n" for line in lines)
    return f"{HEADER}LOOP\n{body}{FOOTER}"


def configuration(seed: int) -> tuple[Configuration, bool]:
    """Where the seed runs, and whether with `strict`."""
    rng = random.Random(f"configuration of updates {seed}")
    arch = rng.choice(("cpu", "cpu", "cpu", "emulated"))
    threads = rng.choice(BLOCKS if arch == "emulated" else THREADS)
    sizes = SIZES[:-1] if arch == "emulated" else SIZES
    where = Configuration(
        arch, threads, rng.choice((0, 1, 3, 3)), rng.choice(sizes), rng.random() < 0.3
    )
    return where, rng.random() < 0.2


def play(text: str, where: Configuration, strict: bool, folder: Path, name: str, seed: int) -> dict:
    """The values and gradients of a program."""
    import tai as ti

    with where.chosen():
        where.init(default_fp=ti.f64, offline_cache=False, strict=strict)
        file = folder / f"{name}.py"
        file.write_text(f"N = {where.elements}\n{text}")
        spec = importlib.util.spec_from_file_location(name, file)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        rng = np.random.default_rng(seed)
        size = where.elements
        module.x.from_numpy(rng.uniform(-1, 1, size))
        module.n.from_numpy(rng.integers(-100, 100, size).astype(np.int32))
        module.g.from_numpy(rng.integers(0, GROUPS, size).astype(np.int32))

        def start() -> None:
            module.h.fill(0.75)
            module.w.fill(5)
            module.o.fill(0.5)
            module.v.fill(0.25)

        start()
        module.run()
        found = {key: getattr(module, key).to_numpy() for key in RESULTS}
        if size <= MOST_FOR_GRADIENTS:
            start()
            with ti.ad.Tape(module.loss):
                module.run()
                module.total()
            found["x.grad"] = module.x.grad.to_numpy()
            found["h.grad"] = module.h.grad.to_numpy()
        return found


def judge(seed: int, folder: Path) -> tuple[str, str]:
    """`agree`, `refused` or `FAIL`, and the reason."""
    import tai as ti

    text = program(seed)
    where, strict = configuration(seed)
    size = where.elements
    serial = f"    ti.loop_config(serialize=True)\n    for i in range({size}):"
    plain = Configuration("cpu", 1, 1, size)
    try:
        expected = play(text.replace("LOOP", serial), plain, False, folder, f"serial_{seed}", seed)
        found = play(
            text.replace("LOOP", "    for i in x:"), where, strict, folder, f"parallel_{seed}", seed
        )
    except ti.TaiError as error:
        if error.lineno is not None and isinstance(error, ti.TaiAutodiffError):
            return "refused", error.message
        return "FAIL", str(error)
    for key, values in expected.items():
        scale = np.abs(values).max() if values.size else 0
        if not np.allclose(found[key], values, rtol=1e-7, atol=1e-9 * scale):
            worst = np.abs(found[key] - values).max()
            return "FAIL", f"{key}: off by {worst:.3g} of {scale:.3g}"
    return "agree", ""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=300, help="how many seeds")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--seed", type=int, help="run one seed and print its program")
    args = parser.parse_args()
    seeds = range(args.first, args.first + args.count)
    if args.seed is not None:
        seeds = range(args.seed, args.seed + 1)
        print(program(args.seed), *configuration(args.seed))
    counts: dict[str, int] = {}
    os.environ.pop("TI_ARCH", None)
    with tempfile.TemporaryDirectory() as folder:
        for seed in seeds:
            kind, reason = judge(seed, Path(folder))
            counts[kind] = counts.get(kind, 0) + 1
            if kind != "agree":
                print(f"seed {seed}, {configuration(seed)[0]}: {kind}: {reason}", flush=True)
    print(", ".join(f"{count} {kind}" for kind, count in sorted(counts.items())))
    return 1 if counts.get("FAIL") else 0


if __name__ == "__main__":
    sys.exit(main())
