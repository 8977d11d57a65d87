"""Vectors that are indexed at run time lie in memory at -O1 and above, and are scalars at -O0.

Random programs of them give what NumPy gives, and the same gradients both ways.
"""

import importlib.util
import random

import numpy as np
import pytest
import tai as ti

COUNT = 37
HEADER = """
import tai as ti

@ti.kernel
def run(x: ti.template(), n: ti.template(), y: ti.template()):
    for i in x:
        body(x, n, y, i)

@ti.func
"""


class Program:
    """Statements on two vectors, a number and counters, as text for both languages."""

    def __init__(self, seed, size, depth=2):
        self.random = random.Random(seed)
        self.size, self.lines, self.loops = size, [], 0
        self.emit(0, f"a = {{vector}}([0.25 * c - x[i] for c in range({size})])")
        self.emit(0, f"b = {{vector}}([x[i] * c for c in range({size})])")
        self.emit(0, "s = x[i]")
        self.block(0, depth, ["i"])
        self.emit(0, "y[i] = s + " + " + ".join(f"{v}[{c}]" for v in "ab" for c in range(size)))

    def emit(self, level, line):
        self.lines.append("    " * (level + 1) + line)

    def index(self, counters):
        at = " + ".join(f"{self.random.randint(1, 5)} * {c}" for c in counters)
        return f"({at} + {self.random.randint(0, 7)}) % {self.size}"

    def block(self, level, depth, counters):
        for _ in range(self.random.randint(2, 4)):
            self.statement(level, depth, counters)

    def statement(self, level, depth, counters):
        v, w = self.random.sample("ab", 2)
        at, other = self.index(counters), self.index(counters)
        kinds = ["write", "add", "read", "copy", "whole", "swap"]
        kind = self.random.choice(kinds + 3 * ["if", "for", "while"] * (depth > 0))
        if kind == "write":
            self.emit(level, f"{v}[{at}] = 0.5 * {w}[{other}] + 0.125 * s")
        elif kind == "add":
            self.emit(level, f"{v}[{at}] += 0.25 * s")
        elif kind == "read":
            self.emit(level, f"s = 0.5 * s + 0.25 * {v}[{at}] * {v}[{other}]")
        elif kind == "copy":
            self.emit(level, f"{v} = {{copy}}({w})")
        elif kind == "whole":
            self.emit(level, f"{v} = 0.5 * {v} + 0.25 * {w}")
        elif kind == "swap":
            self.emit(level, "a, b = {copy}(b), {copy}(a)")
        elif kind == "if":
            self.emit(level, f"if ({self.index(counters)}) < {self.size // 2}:")
            self.block(level + 1, depth - 1, counters)
            self.emit(level, "else:")
            self.block(level + 1, depth - 1, counters)
        else:
            self.loops += 1
            c = f"k{self.loops}"
            if kind == "for":
                self.emit(level, f"for {c} in range(n[i] % {self.random.randint(2, 4)}):")
            else:
                self.emit(level, f"{c} = 0")
                self.emit(level, f"while {c} < n[i] % {self.random.randint(2, 4)}:")
                self.emit(level + 1, f"{c} += 1")
            if self.random.random() < 0.3:
                self.emit(level + 1, f"if ({self.index([*counters, c])}) == 1:")
                self.emit(level + 2, self.random.choice(["break", "continue"]))
            self.block(level + 1, depth - 1, [*counters, c])

    def text(self, **words):
        return "def body(x, n, y, i):\n" + "\n".join(self.lines).format(**words) + "\n"


def load(program, path):
    path.write_text(HEADER + program.text(vector="ti.Vector", copy=""))
    spec = importlib.util.spec_from_file_location("vectors_program", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.run


def results(program, path, x_values, n_values, dt, **options):
    """The values and, of floats, the gradient of their sum."""
    ti.init(default_fp=ti.f64, **options)
    x, n = ti.field(dt, shape=COUNT, needs_grad=True), ti.field(ti.i32, shape=COUNT)
    y, loss = ti.field(dt, shape=COUNT, needs_grad=True), ti.field(dt, (), needs_grad=True)
    x.from_numpy(x_values)
    n.from_numpy(n_values)
    run = load(program, path)

    @ti.kernel
    def total():
        for i in y:
            loss[None] += y[i] * (1 + i % 3)

    with ti.ad.Tape(loss):
        run(x, n, y)
        total()
    return y.to_numpy(), x.grad.to_numpy(), run


@pytest.mark.parametrize("seed", range(24))
def test_random_programs(seed, tmp_path):
    generator = np.random.default_rng(seed)
    size = [7, 8, 12, 17, 24, 40][seed % 6]
    program = Program(seed, size)
    x = generator.uniform(-1, 1, COUNT)
    n = generator.integers(0, 9, COUNT).astype(np.int32)

    body = {}
    exec(program.text(vector="np.array", copy="np.array"), {"np": np}, body)  # noqa: S102
    wanted = np.zeros(COUNT)
    for i in range(COUNT):
        body["body"](x, n, wanted, i)

    got = {
        level: results(program, tmp_path / f"o{level}.py", x, n, ti.f64, opt_level=level)
        for level in (0, 3)
    }
    for level in (0, 3):
        np.testing.assert_allclose(got[level][0], wanted, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(got[3][1], got[0][1], rtol=1e-11, atol=1e-11)

    # And against differences along one direction.
    step = 1e-6
    ends = []
    for sign in (1, -1):
        y = np.zeros(COUNT)
        for i in range(COUNT):
            body["body"](x + sign * step, n, y, i)
        ends.append(y * (1 + np.arange(COUNT) % 3))
    np.testing.assert_allclose(got[3][1], (ends[0] - ends[1]) / (2 * step), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("count", [5, 16])
@pytest.mark.parametrize("dt", [ti.f16, ti.f32, ti.i8, ti.u8, ti.i16, ti.i32, ti.u64], ids=str)
def test_types(dt, count):
    """A stack of a few numbers of each type."""
    ti.init()
    x, y = ti.field(dt, shape=65), ti.field(dt, shape=65)
    x.from_numpy((np.arange(65) % 50).astype(dt.numpy))

    @ti.kernel
    def reverse():
        for i in x:
            stack = ti.Vector([0 for _ in range(count)], dt=dt)
            top = 0
            for k in range(i % (count + 1)):
                stack[top] = x[i] + k
                top += 1
            total = ti.cast(0, dt)
            while top > 0:
                top -= 1
                total = ti.cast(total // 2 + stack[top], dt)
            y[i] = total

    reverse()
    wanted = np.zeros(65, dt.numpy)
    for i in range(65):
        stack = [i % 50 + k for k in range(i % (count + 1))]
        while stack:
            wanted[i] = wanted[i] // 2 + stack.pop()
    np.testing.assert_array_equal(y.to_numpy(), wanted)


def test_sums_beside_a_stack():
    """The sums of the loop still have private copies for each thread."""
    ti.init(default_fp=ti.f64)
    n = 65_537
    x, total, bins = ti.field(ti.f64, n), ti.field(ti.f64, ()), ti.field(ti.f64, 7)
    x.from_numpy(np.linspace(0, 1, n))

    @ti.kernel
    def add():
        for i in x:
            kept = ti.Vector.zero(ti.f64, 9)
            for k in range(1 + i % 9):
                kept[k] = x[i] * (k + 1)
            s = 0.0
            for k in range(9):
                s += kept[k]
            total[None] += s
            bins[i % 7] += s

    add()
    i = np.arange(n)
    terms = np.linspace(0, 1, n) * (1 + i % 9) * (2 + i % 9) / 2
    assert total[None] == pytest.approx(terms.sum(), rel=1e-12)
    np.testing.assert_allclose(bins.to_numpy(), np.bincount(i % 7, terms), rtol=1e-12)


def test_memory_of_an_iteration_is_not_that_of_another():
    """Loops in loops each begin with zeros, and serial code has its own."""
    ti.init(default_fp=ti.f64)
    y = ti.field(ti.f64, shape=(50, 4))

    @ti.kernel
    def run(n: ti.i32) -> ti.f64:
        first = ti.Vector.zero(ti.f64, 12)
        for k in range(n):
            first[k % 12] += k
        for i in range(50):
            for r in range(4):
                v = ti.Vector.zero(ti.f64, 12)
                for k in range(i % 13):
                    v[k] += 1.0
                s = 0.0
                for k in range(12):
                    s += v[k] * (k + 1) + first[k]
                y[i, r] = s
        last = 0.0
        for k in range(n):
            last += first[k % 12]
        return last

    n = 30
    first = np.bincount(np.arange(n) % 12, np.arange(n), 12)
    assert run(n) == first[np.arange(n) % 12].sum()
    i = np.arange(50)
    wanted = (i % 13) * (i % 13 + 1) / 2 + first.sum()
    np.testing.assert_array_equal(y.to_numpy(), np.repeat(wanted[:, None], 4, axis=1))
