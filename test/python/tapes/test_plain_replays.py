"""Replays that call their launches one after another, without a look between them."""

import numpy as np
import pytest
import tai as ti

PLAIN = "one after another, without a look between them"


def make_chain(steps: int, **options):
    """x[t + 1] from x[t], with sums and random numbers, and the tape of it.

    Returns the tape and the fields x, w, noise and loss.
    """
    ti.init(arch=ti.cpu, random_seed=5, **options)
    x = ti.field(ti.f32, shape=(steps + 1, 6), needs_grad=True)
    w = ti.field(ti.f32, shape=6, needs_grad=True)
    noise = ti.field(ti.f32, shape=(steps + 1, 6))
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def shake(t: ti.i32):
        for i in range(6):
            noise[t, i] = ti.random()

    @ti.kernel
    def step(t: ti.i32):
        for i in range(6):
            x[t + 1, i] = ti.tanh(x[t, i] * w[i] + x[t, (i + 1) % 6]) + 0.1 * noise[t, i]

    @ti.kernel
    def add():
        for i in range(6):
            loss[None] += x[steps, i] ** 2

    x.from_numpy(np.linspace(-1.0, 1.0, 6 * (steps + 1)).reshape(steps + 1, 6))
    w.from_numpy(np.linspace(0.5, 1.5, 6))
    with ti.ad.Tape(loss) as tape:
        for t in range(steps):
            shake(t)
            step(t)
        add()
    return tape, x, w, noise, loss


def results(fields) -> list[np.ndarray]:
    x, w, noise, loss = fields
    return [f.to_numpy() for f in (x, noise, loss, x.grad, w.grad)]


@pytest.mark.parametrize("deterministic", [False, True])
def test_same_bits(deterministic):
    """Values, random numbers and gradients, from replay to replay."""
    found = {}
    for fuse in (False, True):
        tape, *fields = make_chain(9, fuse_launches=fuse, deterministic=deterministic)
        found[fuse] = results(fields)
        for _ in range(3):
            tape.replay()
            found[fuse] += results(fields)
        tape.replay(forward=False)
        found[fuse] += results(fields)
        tape.replay(backward=False)
        found[fuse] += results(fields)
        assert (PLAIN in tape.explain()) == fuse
    for plain, looked in zip(found[True], found[False], strict=True):
        np.testing.assert_array_equal(plain, looked)
    # The random numbers are drawn anew.
    assert (found[True][1] != found[True][6]).any()


def test_says_how_many():
    tape, *_ = make_chain(9)
    lines = tape.explain().splitlines()
    assert sum(f"calls the 19 launches {PLAIN}" in line for line in lines) == 1
    # The adjoints of `shake` are skipped.
    assert sum(f"calls the 10 adjoints {PLAIN}" in line for line in lines) == 1


def test_values_that_are_put_back():
    """Each launch overwrites elements that the adjoint of the one before reads."""
    ti.init(arch=ti.cpu)
    x = ti.field(ti.f64, shape=3, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def square():
        for i in x:
            x[i] = x[i] * x[i]

    @ti.kernel
    def add():
        for i in x:
            loss[None] += x[i]

    start = np.array([0.5, -1.25, 2.0])
    x.from_numpy(start)
    with ti.ad.Tape(loss) as tape:
        square()
        square()
        add()
    assert PLAIN not in tape.explain()
    for _ in range(2):
        x.from_numpy(start)
        tape.replay()
        np.testing.assert_allclose(x.grad.to_numpy(), 4 * start**3, rtol=1e-14)


def test_new_kernels_and_fields():
    """A tree that goes, and one that comes, between two replays."""
    tape, *fields = make_chain(4)
    tape.replay()
    other = ti.field(ti.f32)
    tree = ti.FieldsBuilder()
    tree.dense(ti.i, 5).place(other)
    built = tree.finalize()
    tape.replay()
    before = fields[1].grad.to_numpy()
    built.destroy()
    tape.replay(forward=False)
    np.testing.assert_array_equal(fields[1].grad.to_numpy(), before)


def test_what_fails():
    """A failure ends the replay, and the next one is whole."""
    ti.init(arch=ti.cpu, debug=True)
    x = ti.field(ti.f32, shape=4, needs_grad=True)
    limit = ti.field(ti.f32, shape=())
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def add(t: ti.i32):
        for i in x:
            assert x[i] < limit[None], "too much"
            loss[None] += x[i] * x[i]

    limit[None] = 10.0
    x.fill(2.0)
    with ti.ad.Tape(loss) as tape:
        add(0)
        add(1)
    assert PLAIN in tape.explain()
    x.fill(20.0)
    with pytest.raises(ti.TaiAssertionError, match="too much"):
        tape.replay()
    x.fill(3.0)
    tape.replay()
    np.testing.assert_array_equal(x.grad.to_numpy(), np.full(4, 12.0))
    assert loss[None] == 72.0
