"""One program for many worlds: `ti.batch`."""

import gc
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tai as ti


def pendulums(size, masked=False, dtype=ti.f64):
    worlds = ti.batch(size, masked=masked)
    x = worlds.field(dtype, needs_grad=True)
    v = worlds.field(dtype, needs_grad=True)
    loss = worlds.field(dtype, needs_grad=True)

    @worlds.kernel
    def step(dt: ti.f64):
        v[None] -= dt * ti.sin(x[None])
        x[None] += dt * v[None]
        loss[None] += x[None] ** 2

    return worlds, x, v, loss, step


def reference(x, steps, dt=0.1):
    v, loss = 0 * x, 0 * x
    for _ in range(steps):
        v = v - dt * np.sin(x)
        x = x + dt * v
        loss = loss + x**2
    return loss


@pytest.mark.parametrize("size", [1, 5, 65537])
@pytest.mark.parametrize("threads", [1, 2])
def test_losses_and_gradients_of_each_world(size, threads):
    ti.init(cpu_max_num_threads=threads)
    worlds, x, v, loss, step = pendulums(size)
    start = np.linspace(-1, 2, size)
    x.from_numpy(start)
    loss.fill(7)
    with worlds.tape(loss) as tape:
        for _ in range(4):
            step(0.1)
    np.testing.assert_allclose(loss.to_numpy(), reference(start, 4), rtol=1e-12)
    slope = (reference(start + 1e-6, 4) - reference(start - 1e-6, 4)) / 2e-6
    np.testing.assert_allclose(x.grad.to_numpy(), slope, atol=1e-7)
    x.from_numpy(2 * start)
    v.fill(0)
    tape.replay()
    np.testing.assert_allclose(loss.to_numpy(), reference(2 * start, 4), rtol=1e-12)


def test_weights_of_worlds():
    ti.init()
    worlds, x, _, loss, step = pendulums(3)
    x.fill(0.5)
    with worlds.tape(loss, weights=[1, 0, -2]):
        step(0.1)
    g = x.grad.to_numpy()
    assert g[1] == 0 and g[2] == -2 * g[0] and g[0] > 0


def test_same_as_the_axis_by_hand():
    # Loops of each kind, a function, a struct, a vector, a table and an array for all worlds.
    ti.init()
    size, n = 3, 4
    worlds = ti.batch(size)
    p = worlds.field(ti.types.vector(2, ti.f64), n)
    q = worlds.field(ti.types.struct(a=ti.f64, b=ti.math.vec2), (n, 2))
    total = worlds.field(ti.f64)
    table = ti.field(ti.f64, shape=n)
    table.from_numpy(np.arange(1.0, n + 1))

    @ti.func
    def weight(i):
        return table[i] + p[i][1]

    @worlds.kernel
    def run(scale: ti.f64, extra: ti.types.ndarray()):
        c = 2 * scale
        for i in p:
            p[i] += c * ti.Vector([1.0, table[i]])
        total[None] = 0
        for i in range(0, n, 2):
            p[i][0] += extra[i]
        for i, j in q:
            q[i, j].a = weight(i) + j
            q[i, j].b[0] += total[None] + p.shape[0]
        for at in ti.grouped(p):
            p[at] += at[0]
        for k in ti.static(range(2)):
            for i in ti.ndrange((1, 3)):
                p[i][k] *= 2
        if p[0][0] > 2:
            total[None] += 1
        for i in table:
            total[None] += p[i].sum()

    start = np.random.default_rng(0).uniform(0, 2, (size, n, 2))
    p.from_numpy(start)
    extra = np.arange(n) * 0.5
    run(0.5, extra)

    w = start.copy()
    w += np.stack([np.ones(n), np.arange(1.0, n + 1)], -1)
    w[:, ::2, 0] += extra[::2]
    a = (np.arange(1.0, n + 1) + w[..., 1])[..., None] + np.arange(2)
    w += np.arange(n)[:, None]
    w[:, 1:3] *= 2
    sums = (w[:, 0, 0] > 2) + w.sum((1, 2))
    np.testing.assert_allclose(p.to_numpy(), w)
    np.testing.assert_allclose(q.a.to_numpy(), a)
    np.testing.assert_array_equal(q.b.to_numpy()[..., 0], n)
    np.testing.assert_allclose(total.to_numpy(), sums)


def test_masks():
    ti.init()
    worlds, x, _, loss, step = pendulums(4, masked=True)
    x.fill(1)
    worlds.mask.from_numpy(np.array([1, 0, 0, 1], np.int32))
    with worlds.tape(loss):
        step(0.1)
    moved = x.to_numpy() != 1
    assert moved.tolist() == [True, False, False, True]
    g = x.grad.to_numpy()
    assert g[0] == g[3] != 0 and g[1] == g[2] == 0
    worlds.mask.fill(1)
    step(0.1)
    assert (x.to_numpy() != 1).all()


def test_resets():
    ti.init()
    worlds, x, v, _, step = pendulums(4)
    with pytest.raises(ti.TaiRuntimeError, match="nothing was saved"):
        worlds.reset()
    x.from_numpy(np.arange(4.0) + 1)
    worlds.save()
    step(0.1)
    after = x.to_numpy()
    worlds.reset(np.array([True, False, True, False]))
    np.testing.assert_array_equal(x.to_numpy(), [1, after[1], 3, after[3]])
    assert v[0] == 0 != v[1]
    done = ti.field(ti.i32, shape=4)
    done[1] = 1
    worlds.reset(done)
    assert x[1] == 2 and x[3] == after[3]
    worlds.reset()
    np.testing.assert_array_equal(x.to_numpy(), np.arange(4.0) + 1)
    with pytest.raises(ti.TaiRuntimeTypeError, match="for each of 4 worlds"):
        worlds.reset([1, 0])


def test_random_numbers_of_a_world():
    ti.init(cpu_max_num_threads=2)

    def draw(size, seeds):
        worlds = ti.batch(size)
        x = worlds.field(ti.f32, 3)
        worlds.seed(seeds)

        @worlds.kernel
        def fill():
            for _ in range(1):
                for i in range(3):
                    x[i] = worlds.random()

        fill()
        first = x.to_numpy()
        fill()
        assert (first != x.to_numpy()).all()
        return first

    many = draw(1000, np.arange(1000))
    np.testing.assert_array_equal(draw(2, [5, 9]), many[[5, 9]])
    assert len(np.unique(many)) > 2900
    assert 0 <= many.min() and many.max() < 1
    assert abs(many.mean() - 0.5) < 0.03
    np.testing.assert_array_equal(draw(10, 3), draw(10, 3))


def test_random_numbers_without_a_seed():
    ti.init()
    worlds = ti.batch(100)
    x = worlds.field(ti.f32)

    @worlds.kernel
    def fill():
        x[None] = worlds.random()

    fill()
    assert len(np.unique(x.to_numpy())) == 100


def test_kernels_of_a_class():
    ti.init()

    @ti.data_oriented
    class Model:
        worlds = ti.batch(3)

        def __init__(self, scale):
            self.scale = scale
            self.x = self.worlds.field(ti.f64, 2)

        @ti.func
        def value(self, i):
            return self.scale * (i + self.x[i])

        @worlds.kernel
        def fill(self):
            for i in self.x:
                self.x[i] = self.value(i)

    models = [Model(2), Model(3)]
    for model in models:
        model.fill()
    assert [m.x.to_numpy().tolist() for m in models] == [[[0, 2]] * 3, [[0, 3]] * 3]


def test_two_batches_and_other_kernels():
    ti.init()
    one, two = ti.batch(2), ti.batch(3)
    a, b = one.field(ti.i32), two.field(ti.i32)

    @one.kernel
    def first():
        a[None] += 1
        b[1] = 5  # of the other batch: its memory

    @ti.kernel
    def by_hand():
        for w in a:
            a[w] += 10 * w

    first()
    by_hand()
    assert a.to_numpy().tolist() == [1, 11]
    assert b.to_numpy().tolist() == [0, 5, 0]


def test_fields_of_other_layouts():
    ti.init()
    worlds = ti.batch(8)
    x = ti.field(ti.f32)
    ti.root.dense(ti.j, 3).dense(ti.i, 8).place(x)
    worlds.adopt(x)

    @worlds.kernel
    def fill():
        for j in x:
            x[j] = j

    fill()
    np.testing.assert_array_equal(x.to_numpy(), np.tile(np.arange(3.0), (8, 1)))


def test_mistakes():
    ti.init()
    worlds = ti.batch(4)
    x = worlds.field(ti.f64, 3, name="x")
    plain = ti.field(ti.f64, shape=4, needs_grad=True)

    @worlds.kernel
    def shares():
        s = 0.0
        for i in x:
            s += x[i]

    @worlds.kernel
    def between():
        a = x[0]
        for i in x:
            x[i] += a

    @worlds.kernel
    def extra():
        x[0, 1] = 1

    @worlds.kernel
    def serial():
        ti.loop_config(serialize=True)
        for i in x:
            x[i] = 1

    kind = ti.TaiSyntaxError
    cases = [
        (shares, kind, "'s' would be one variable for all worlds"),
        (between, kind, "this statement is none of a world's"),
        (extra, ti.TaiIndexError, "has 1 dimension in each world, but got 2 indices"),
        (serial, kind, "runs in parallel over the worlds"),
        (lambda: ti.batch(0), ti.TaiRuntimeTypeError, "takes the number of worlds"),
        (lambda: worlds.mask, ti.TaiRuntimeError, "has no mask"),
        (lambda: worlds.tape(plain), ti.TaiRuntimeTypeError, "a number for each world"),
        (
            lambda: worlds.adopt(ti.field(ti.f32, shape=3)),
            ti.TaiRuntimeTypeError,
            "first dimension",
        ),
        (lambda: worlds.seed([1, 2]), ti.TaiRuntimeTypeError, "one for each of 4 worlds"),
    ]
    for call, error, message in cases:
        with pytest.raises(error, match=message):
            call()
    with pytest.raises(kind, match="there are 4 worlds"):

        @worlds.kernel
        def gives() -> ti.f64:
            return x[0]


PAGE = Path(__file__).resolve().parents[3] / "docs" / "guides" / "batches.md"
PROGRAMS = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)


@pytest.mark.parametrize("number", range(2))
def test_programs_of_the_page(number, tmp_path):
    assert len(PROGRAMS) == 2
    if "gymnasium" in PROGRAMS[number]:
        pytest.importorskip("gymnasium", reason="gymnasium is not installed: pip install gymnasium")
    file = tmp_path / "program.py"
    file.write_text(PROGRAMS[number])
    subprocess.run([sys.executable, str(file)], check=True)


def test_hints_where_kernels_and_tapes_of_the_batch_are_forgotten():
    ti.init()
    worlds = ti.batch(4)
    x = worlds.field(ti.f32, 3, needs_grad=True)
    loss = worlds.field(ti.f32, needs_grad=True)

    @ti.kernel
    def plain():
        for i in x:
            x[i] = 1

    @worlds.kernel
    def with_worlds():
        for w, i in x:
            x[w, i] = 1

    @worlds.kernel
    def with_worlds_in_ranges():
        for w, i, j in ti.ndrange(2, 3):
            x[i] = w + j

    @ti.kernel
    def wrong_otherwise():
        for i, j, k in x:
            x[i, j] = k

    for kernel, hint in (
        (plain, "is that of the worlds of its batch, which kernels marked @batch.kernel leave"),
        (with_worlds, "leave the index of the world away"),
        (with_worlds_in_ranges, "leave the index of the world away"),
        (wrong_otherwise, "give one variable for each dimension"),
    ):
        with pytest.raises(ti.TaiTypeError, match="but runs over") as caught:
            kernel()
        assert hint in caught.value.hint

    @worlds.kernel
    def measure():
        for i in x:
            loss[None] += x[i] ** 2

    def record():
        with ti.ad.Tape(loss):
            measure()

    with pytest.warns(ti.ad.TaiGradientWarning, match=r"with batch\.tape\(loss\)"):
        record()
        gc.collect()
