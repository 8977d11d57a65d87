"""Elements that several launches store: each gradient belongs to one of the values."""

import numpy as np
import tai as ti


def real_field(*shape):
    return ti.field(ti.f64, shape=shape, needs_grad=True)


def test_the_last_store_counts():
    x, y, loss = real_field(4), real_field(4), real_field()

    @ti.kernel
    def scale(a: ti.f64):
        for i in x:
            y[i] = a * x[i]

    @ti.kernel
    def total():
        for i in y:
            loss[None] += y[i] * (i + 1)

    x.fill(1)
    for _ in range(2):  # also when the tape is recorded anew
        with ti.ad.Tape(loss):
            scale(2.0)
            scale(3.0)
            total()
        assert x.grad.to_numpy().tolist() == [3, 6, 9, 12]


def test_sums_that_are_used_again():
    x, total, y, loss = real_field(4), real_field(), real_field(3), real_field()

    @ti.kernel
    def clear():
        total[None] = 0

    @ti.kernel
    def add(t: ti.i32):
        for i in x:
            total[None] += x[i] * (t + 1)

    @ti.kernel
    def keep(t: ti.i32):
        y[t] = total[None] * (t + 2)

    @ti.kernel
    def sum_up():
        for i in y:
            loss[None] += y[i] * (i + 1)

    with ti.ad.Tape(loss):
        for t in range(3):
            clear()
            add(t)
            keep(t)
        sum_up()
    # The sum over t of (t + 1) (t + 1) (t + 2).
    assert x.grad.to_numpy().tolist() == [2 + 12 + 36] * 4


def test_state_without_time():
    # Linear, so that the values which were overwritten are not needed.
    x, new, loss = real_field(5), real_field(5), real_field()

    @ti.kernel
    def smooth():
        for i in x:
            new[i] = 0.5 * x[i] + 0.5 * x[(i + 1) % 5]

    @ti.kernel
    def back():
        for i in x:
            x[i] = new[i] * 2

    @ti.kernel
    def total():
        for i in x:
            loss[None] += x[i] * (i * i)

    with ti.ad.Tape(loss):
        for _ in range(3):
            smooth()
            back()
        total()
    step = np.eye(5) + np.roll(np.eye(5), 1, axis=1)
    weights = np.arange(5.0) ** 2
    np.testing.assert_allclose(
        x.grad.to_numpy(), weights @ np.linalg.matrix_power(step, 3), rtol=1e-14
    )


def test_some_slots_are_stored_again():
    x, loss = real_field(3), real_field()
    ring = real_field(2, 3)

    @ti.kernel
    def put(t: ti.i32):
        for i in x:
            ring[t % 2, i] = x[i] * (t + 1)

    @ti.kernel
    def take(slot: ti.i32, a: ti.f64):
        for i in x:
            loss[None] += a * ring[slot, i]

    @ti.kernel
    def put_at(slot: ti.i32, a: ti.f64):
        for i in x:
            ring[slot, i] = x[i] * a

    with ti.ad.Tape(loss):
        for t in range(4):
            put(t)
            take(t % 2, 10.0**t)
    assert x.grad.to_numpy().tolist() == [4321] * 3
    with ti.ad.Tape(loss):
        put_at(0, 1.0)
        put_at(1, 2.0)
        take(0, 1.0)
        put_at(0, 3.0)
        take(1, 10.0)
        take(0, 100.0)
    assert x.grad.to_numpy().tolist() == [1 + 20 + 300] * 3


def test_branches_say_what_was_stored():
    x, y, loss = real_field(4), real_field(4), real_field()

    @ti.kernel
    def first():
        for i in x:
            y[i] = 5 * x[i]

    @ti.kernel
    def second():
        for i in x:
            if i % 2 == 0:
                y[i] = 7 * x[i]

    @ti.kernel
    def total():
        for i in x:
            loss[None] += y[i]

    with ti.ad.Tape(loss):
        first()
        second()
        total()
    assert x.grad.to_numpy().tolist() == [7, 5, 7, 5]


def test_components_and_vectors():
    x, loss = real_field(2), real_field()
    v = ti.Vector.field(2, ti.f64, shape=2, needs_grad=True)

    @ti.kernel
    def whole():
        for i in x:
            v[i] = ti.Vector([x[i], 2 * x[i]])

    @ti.kernel
    def part():
        for i in x:
            v[i][1] = 10 * x[i]

    @ti.kernel
    def total():
        for i in x:
            loss[None] += v[i][0] + v[i][1]

    with ti.ad.Tape(loss):
        whole()
        part()
        total()
    assert x.grad.to_numpy().tolist() == [11, 11]


def test_gradients_by_hand():
    x, y = real_field(3), real_field(3)

    @ti.kernel
    def triple():
        for i in x:
            y[i] = 3 * x[i]

    @ti.kernel
    def move(t: ti.i32):
        y[t] = 2 * x[t]

    y.grad.fill(1)
    triple.grad()
    assert x.grad.to_numpy().tolist() == [3, 3, 3]
    assert y.grad.to_numpy().tolist() == [0, 0, 0]
    triple.grad()
    assert x.grad.to_numpy().tolist() == [3, 3, 3]
    # Only the elements that the launch stores lose their gradient, however their index is written.
    y.grad.fill(1)
    move.grad(1)
    assert x.grad.to_numpy().tolist() == [3, 5, 3]
    assert y.grad.to_numpy().tolist() == [1, 0, 1]
