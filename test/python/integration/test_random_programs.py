"""Random programs give the same results in a kernel as in Python.

Kernels are Python syntax, so each program is one text, run once by Python and once compiled.
Integers stay small enough not to wrap; floats are f64 on both sides. Each seed draws where it runs
and with how many elements, as random kernels do; `pytest -k "gradient and 1007"` runs one again.
"""

import importlib.util
import random
import sys
from pathlib import Path

import numpy as np
import pytest
import tai as ti

sys.path.insert(0, str(Path(__file__).parents[2] / "fuzz"))

import configurations  # noqa: E402

PROGRAMS = 40
POINTS = [(0, 0.5), (3, -1.25), (7, 2.0), (-4, 0.1)]


class Writer:
    """Writes a random function body over integers `a…` and floats `f…`."""

    def __init__(self, seed):
        self.random = random.Random(seed)
        self.lines = []
        self.integers, self.floats = ["n"], ["x"]
        self.count = 0

    def pick(self, *options):
        return self.random.choice(options)

    def integer(self, depth=2):
        if depth == 0 or self.random.random() < 0.25:
            return self.pick(self.random.choice(self.integers), str(self.random.randint(-9, 9)))
        a, b = self.integer(depth - 1), self.integer(depth - 1)
        return self.pick(
            f"({a} + {b})",
            f"({a} - {b})",
            f"(({a}) * ({b}) % 101)",
            f"(({a}) // {self.random.choice([-3, -2, 2, 5])})",
            f"(({a}) % {self.random.choice([-4, 3, 7])})",
            f"min({a}, {b})",
            f"max({a}, {b})",
            f"abs({a})",
            f"(({a}) & 15)",
            f"(-{a})" if not a.startswith("-") else f"({a})",
            f"({a} if {self.condition(depth - 1)} else {b})",
            f"int({self.real(depth - 1)})",
        )

    def real(self, depth=2):
        if depth == 0 or self.random.random() < 0.25:
            return self.pick(self.random.choice(self.floats), f"{self.random.uniform(-2, 2):.3f}")
        a, b = self.real(depth - 1), self.real(depth - 1)
        return self.pick(
            f"({a} + {b})",
            f"({a} - {b})",
            f"({a} * {b})",
            f"({a} / (1.5 + abs({b})))",
            f"math.sin({a})",
            f"math.exp(-abs({a}))",
            f"math.sqrt(abs({a}))",
            f"(({a}) ** 2)",
            f"min({a}, {b})",
            f"max({a}, {b})",
            f"({a} if {self.condition(depth - 1)} else {b})",
            f"float({self.integer(depth - 1)})",
        )

    def condition(self, depth=1):
        if depth <= 0:
            return f"{self.integer(0)} {self.pick('<', '<=', '==', '!=')} {self.integer(0)}"
        return self.pick(
            f"({self.integer(depth)} < {self.integer(depth)})",
            f"({self.real(depth)} >= {self.real(depth)})",
            f"({self.condition(depth - 1)} and {self.condition(depth - 1)})",
            f"({self.condition(depth - 1)} or {self.condition(depth - 1)})",
            f"(not {self.condition(depth - 1)})",
            f"({self.integer(0)} < {self.integer(0)} < {self.integer(0)})",
        )

    def emit(self, indent, text):
        self.lines.append("    " * indent + text)

    def assignment(self, indent):
        """A new variable, or a change of an old one; magnitudes stay bounded."""
        kind = self.random.random()
        targets = [[v for v in self.integers if v[0] == "a"], [v for v in self.floats if v != "x"]]
        if kind < 0.3 and targets[0]:
            self.emit(indent, f"{self.random.choice(targets[0])} = ({self.integer()}) % 1000")
        elif kind < 0.6 and targets[1]:
            self.emit(indent, f"{self.random.choice(targets[1])} = math.tanh({self.real()})")
        elif kind < 0.7 and targets[1]:
            self.emit(indent, f"{self.random.choice(targets[1])} += math.tanh({self.real(1)})")
        elif kind < 0.85:
            self.count += 1
            self.emit(indent, f"a{self.count} = ({self.integer()}) % 1000")
            self.integers.append(f"a{self.count}")
        else:
            self.count += 1
            self.emit(indent, f"f{self.count} = math.tanh({self.real()})")
            self.floats.append(f"f{self.count}")

    def block(self, indent, depth, loop):
        """Some statements; names that they define end with them."""
        known = list(self.integers), list(self.floats)
        for _ in range(self.random.randint(1, 4)):
            self.statement(indent, depth, loop)
        self.integers, self.floats = known

    def statement(self, indent, depth, loop):
        choice = self.random.random()
        if depth == 0 or choice < 0.5:
            self.assignment(indent)
        elif choice < 0.7:
            self.emit(indent, f"if {self.condition()}:")
            self.block(indent + 1, depth - 1, loop)
            if loop and self.random.random() < 0.4:
                self.emit(indent + 1, self.pick("break", "continue"))
            elif self.random.random() < 0.5:
                self.emit(indent, "else:")
                self.block(indent + 1, depth - 1, loop)
        elif choice < 0.88:
            self.count += 1
            name = f"i{self.count}"
            self.emit(indent, f"for {name} in range({self.pick('3', '5', 'abs(n)', '2, 6')}):")
            self.integers.append(name)
            self.block(indent + 1, depth - 1, True)
            self.integers.remove(name)
        else:
            self.count += 1
            name = f"w{self.count}"
            self.emit(indent, f"{name} = 0")
            self.emit(indent, f"while {name} < 6 and {self.condition(0)}:")
            self.emit(indent + 1, f"{name} += 1")
            self.block(indent + 1, depth - 1, True)

    def program(self):
        self.emit(1, "a0 = 1")
        self.emit(1, "f0 = 0.5")
        self.integers.append("a0")
        self.floats.append("f0")
        for _ in range(6):
            self.statement(1, 3, False)
        body = "\n".join(self.lines)
        result = " + ".join(
            [*(f"{v} * {i + 1}" for i, v in enumerate(self.integers)), *self.floats]
        )
        return body, result


TEMPLATE = """
import math

import tai as ti


def plain(n, x):
{body}
    return {result}


inlined = ti.func(plain)
x = ti.field(ti.f64, shape={elements}, needs_grad=True)
y = ti.field(ti.f64, shape={elements})
loss = ti.field(ti.f64, shape=(), needs_grad=True)


@ti.kernel
def serial(n: ti.i32, x: ti.f64) -> ti.f64:
    result = 0.0
    if n < 1000:  # loops inside are serial
        result = inlined(n, x)
    return result


@ti.kernel
def parallel(x: ti.f64):
    for k in y:
        y[k] = inlined(k % 8 - 4, x)


@ti.kernel
def total():
    for k in x:
        loss[None] += inlined(k % 8 - 4, x[k])
"""


@pytest.fixture
def where(seed):
    """The configuration of a seed; the tests run in it."""
    found = configurations.draw(seed, configurations.default_targets())
    with found.chosen():
        yield found
        ti.reset()


def load(seed, folder, where):
    """A random program as a module."""
    where.init(default_fp=ti.f64, offline_cache=False)
    print(where)
    body, result = Writer(seed).program()
    file = folder / f"random_program_{seed}.py"
    file.write_text(TEMPLATE.format(body=body, result=result, elements=where.elements))
    spec = importlib.util.spec_from_file_location(file.stem, file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("seed", range(PROGRAMS))
def test_values(seed, tmp_path, where):
    module = load(seed, tmp_path, where)
    for n, x in POINTS:
        assert module.serial(n, x) == pytest.approx(module.plain(n, x), rel=1e-12, abs=1e-12)
    module.parallel(0.3)
    expected = np.resize([module.plain(k - 4, 0.3) for k in range(8)], where.elements)
    assert np.allclose(module.y.to_numpy(), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("seed", range(1000, 1000 + PROGRAMS))
def test_gradient(seed, tmp_path, where):
    """Against central differences of the Python function; the best of some steps."""
    module = load(seed, tmp_path, where)
    points = np.random.default_rng(seed).uniform(-2, 2, where.elements)
    module.x.from_numpy(points)
    with ti.ad.Tape(module.loss):
        module.total()
    gradient = module.x.grad.to_numpy()
    # The points at both ends, and some between.
    for k in {*range(8), *range(13, len(points), 97), len(points) - 2, len(points) - 1}:
        if k >= len(points):
            continue
        n, x = k % 8 - 4, points[k]
        differences = [
            (module.plain(n, x + h) - module.plain(n, x - h)) / (2 * h)
            for h in (1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
        ]
        error = min(abs(d - gradient[k]) / max(1, abs(d)) for d in differences)
        assert error < 1e-6
