"""Random sequences of kernels on sparse layouts: gradients against complex steps in NumPy.

The reference knows which cells are active and nothing of tapes. Run this file with a number to
try that many sequences on each layout: `python test_sparse_programs.py 1000`.
"""

import random
import sys

import numpy as np
import pytest
import tai as ti

N = 24
# Each layout: its levels, and the number of elements that become active together.
LAYOUTS = {
    "pointer": ([("pointer", 6), ("dense", 4)], 4),
    "bitmasked": ([("bitmasked", 24)], 1),
    "hash": ([("hash", 8), ("dense", 3)], 3),
    "two_levels": ([("pointer", 3), ("pointer", 4), ("dense", 2)], 2),
    "mixed": ([("pointer", 4), ("bitmasked", 6)], 1),
    "under_dense": ([("dense", 4), ("pointer", 3), ("dense", 2)], 2),
    "dynamic": ([("dynamic", 24)], None),
}
SAVING = [{}, {}, {"checkpoint": "binomial"}, {"checkpoint": "periodic"}, {"checkpoint": 2}]


class Scene:
    """The fields, the kernels, and the same operations in NumPy."""

    def __init__(self, layout):
        levels, self.block = LAYOUTS[layout]
        self.x = ti.field(ti.f64, needs_grad=True)
        node, sparse = ti.root, []
        for kind, extent in levels:
            node = getattr(node, kind)(ti.i, extent)
            sparse += [node] if kind != "dense" else []
        node.place(self.x)
        self.top, self.level = sparse[0], sparse[-1]
        # Elements in a cell of the outermost sparse level.
        self.top_block = N // self.top.shape[0] if self.block else N
        self.c, self.y = (ti.field(ti.f64, shape=N, needs_grad=True) for _ in range(2))
        self.loss = ti.field(ti.f64, shape=(), needs_grad=True)
        self.make_kernels()

    def make_kernels(self):
        x, y, c, loss, level = self.x, self.y, self.c, self.loss, self.level
        block = self.block or 1

        @ti.kernel
        def square(a: ti.f64, s: ti.i32):
            for i in x:
                x[i] = x[i] * x[i] * 0.3 + c[i] * a

        @ti.kernel
        def scatter(a: ti.f64, s: ti.i32):
            for i in range(4):
                x[(3 * i + s) % N] += c[i] * a * y[i]

        @ti.kernel
        def gather(a: ti.f64, s: ti.i32):
            for i in y:
                y[i] = 0.5 * y[i] + a * x[(i + s) % N] * x[i]

        @ti.kernel
        def store(a: ti.f64, s: ti.i32):
            for i in range(3):
                x[(5 * i + s) % N] = a * y[i] * c[i]

        @ti.kernel
        def listed(a: ti.f64, s: ti.i32):
            for i in x:
                y[i] += a * x[i] * y[i]

        @ti.kernel
        def asks(a: ti.f64, s: ti.i32):
            for i in y:
                if ti.is_active(level, i // block):
                    y[i] = y[i] * y[i] * a
                else:
                    y[i] = 0.9 * y[i]

        @ti.kernel
        def carries(a: ti.f64, s: ti.i32):
            for i in x:
                v = x[i]
                for k in range(3):
                    v = v * v * 0.2 + a * c[k]
                y[i] += v

        @ti.kernel
        def activate(a: ti.f64, s: ti.i32):
            ti.activate(level, s // block)

        @ti.kernel
        def deactivate(a: ti.f64, s: ti.i32):
            ti.deactivate(level, s // block)

        @ti.kernel
        def begin():
            for i in y:
                loss[None] += 0.1 * x[i] * y[i]

        @ti.kernel
        def total():
            for i in y:
                loss[None] += y[i] * y[i] * 0.1
            for i in x:
                loss[None] += x[i] * (1.0 + 0.1 * i)

        self.kernels = {
            "square": square, "scatter": scatter, "gather": gather, "store": store,
            "listed": listed, "asks": asks, "carries": carries, "activate": activate,
            "deactivate": deactivate,
        }  # fmt: skip
        self.begin, self.total = begin, total

    def do(self, op, a, s):
        if op == "clear":
            self.top.deactivate_all()
        elif op == "write":
            self.x[s] = a
        elif op == "fill":
            self.x.fill(a)
        else:
            self.kernels[op](a, s)

    # In NumPy

    def activated(self, active, s):
        active = active.copy()
        if self.block is None:
            active[: s + 1] = True
        else:
            active[s // self.block * self.block :][: self.block] = True
        return active

    def refer(self, state, op, a, s):
        c, x, y, active = state
        x, y, i = x.copy(), y.copy(), np.arange(N)
        before = x.copy()
        if op == "square":
            x = np.where(active, x * x * 0.3 + c * a, x)
        elif op == "scatter":
            for k in range(4):
                x[(3 * k + s) % N] += c[k] * a * y[k]
                active = self.activated(active, (3 * k + s) % N)
        elif op == "gather":
            y = 0.5 * y + a * x[(i + s) % N] * x
        elif op == "store":
            for k in range(3):
                x[(5 * k + s) % N] = a * y[k] * c[k]
                active = self.activated(active, (5 * k + s) % N)
        elif op == "listed":
            y = np.where(active, y + a * x * y, y)
        elif op == "asks":
            y = np.where(active, y * y * a, 0.9 * y)
        elif op == "carries":
            v = before
            for k in range(3):
                v = v * v * 0.2 + a * c[k]
            y = np.where(active, y + v, y)
        elif op == "activate":
            active = self.activated(active, s)
        elif op == "write":
            x[s] = a
            active = self.activated(active, s)
        elif op == "fill":
            x = np.where(active, a + 0 * x, x)
        else:
            gone = np.ones(N, bool)  # a list goes as a whole
            if op == "deactivate" and self.block:
                gone = i // self.block == s // self.block
            active = active & ~gone
            x = np.where(active, x, 0)
        return c, x, y, active


def sequence(choice):
    ops = ["square", "scatter", "gather", "store", "listed", "asks", "carries", "activate",
           "deactivate", "clear", "write", "fill"]  # fmt: skip
    return [
        (choice.choice(ops), round(choice.uniform(0.2, 0.9), 2), choice.randrange(N))
        for _ in range(choice.randint(2, 9))
    ]


def try_sequence(scene, choice):
    """Runs one sequence and compares; returns what differs, or None."""
    ops, saving = sequence(choice), choice.choice(SAVING)
    scene.top.deactivate_all()
    c, y = ([choice.uniform(0.3, 0.9) for _ in range(N)] for _ in range(2))
    x, active = np.zeros(N), np.zeros(N, bool)
    for s in choice.sample(range(N // 2), 3):
        active = scene.activated(active, s)
        x[s] = choice.uniform(0.3, 0.9)
        scene.x[s] = x[s]
    c, y = np.array(c), np.array(y)
    scene.c.from_numpy(c)
    scene.y.from_numpy(y)

    def refer(c, x, y):
        state = (c, x, y, active)
        total = 0.1 * np.sum(x * y)
        for op in ops:
            state = scene.refer(state, *op)
        _, x, y, last = state
        weights = 1.0 + 0.1 * np.arange(N)
        return total + np.sum(0.1 * y * y) + np.sum(np.where(last, x * weights, 0)), last

    with ti.ad.Tape(scene.loss, **saving):
        scene.begin()
        for op in ops:
            scene.do(*op)
        scene.total()
    value, last = refer(c, x, y)
    held = scene.x.to_numpy()
    if not np.isclose(scene.loss[None], value, rtol=1e-12):
        return f"{ops} {saving}: loss {scene.loss[None]} and not {value}"
    for name, field, place in (("c", scene.c, 0), ("x", scene.x, 1), ("y", scene.y, 2)):
        expected = np.zeros(N)
        for i in range(N):
            start = [c.astype(complex), x.astype(complex), y.astype(complex)]
            start[place][i] += 1e-30j
            expected[i] = refer(*start)[0].imag / 1e-30
        actual = field.grad.to_numpy()
        # Where a cell is inactive at either end, its gradient is not kept.
        compared = active & last if name == "x" else np.ones(N, bool)
        if not np.allclose(actual[compared], expected[compared], rtol=1e-10, atol=1e-12):
            wrong = [i for i in range(N) if compared[i] and not np.isclose(actual[i], expected[i])]
            return f"{ops} {saving}: {name}.grad{wrong} {actual[wrong]} and not {expected[wrong]}"
    if not np.array_equal(scene.x.to_numpy(), held) or not np.all(held[~last] == 0):
        return f"{ops} {saving}: the sweep has changed the field"
    return None


@pytest.mark.filterwarnings("ignore:the gradient .* is lost")
@pytest.mark.parametrize("layout", LAYOUTS)
def test_random_sequences(layout, count=25):
    ti.init(arch=ti.cpu, offline_cache=False, default_fp=ti.f64)
    scene = Scene(layout)
    for seed in range(count):
        problem = try_sequence(scene, random.Random(f"{layout} {seed}"))
        assert problem is None, f"seed {seed}: {problem}"


if __name__ == "__main__":
    import warnings

    warnings.simplefilter("ignore", ti.ad.TaiGradientWarning)
    for name in LAYOUTS:
        test_random_sequences(name, int(sys.argv[1]))
        print(name, "agrees")
