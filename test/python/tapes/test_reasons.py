"""The reasons of `tape.explain()`: which record needs another one, and how gradients add."""

import re

import numpy as np
import tai as ti


def test_a_record_names_its_reader():
    ti.init()
    x = ti.field(ti.f32, shape=(4, 8), needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def step(t: ti.i32):
        for i in range(8):
            x[t + 1, i] = 2 * x[t, i]

    @ti.kernel
    def measure(t: ti.i32):
        for i in range(8):
            loss[None] += x[t, i]

    x.fill(1.0)
    with ti.ad.Tape(loss) as tape:
        for t in range(3):
            step(t)
        measure(2)
    first, second, third, last = tape.explain().splitlines()[:4]
    name = re.search(r"@\S+\[", first).group()
    assert f"record 1 reads {name}1, :]" in first
    assert f"record 3 reads {name}2, :]" in second
    assert "skipped: no adjoint reaches" in third
    assert "replayed" in last and "record" not in last


def test_whole_fields_have_a_reason():
    ti.init()
    x = ti.field(ti.f32, shape=(4, 8), needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def step(t: ti.i32):
        for i in range(8):
            x[t + 1, i] = 2 * x[t, i]

    @ti.kernel
    def step_everywhere():
        for t, i in ti.ndrange(4, 8):
            x[t, i] *= 3.0

    @ti.kernel
    def measure():
        for t, i in x:
            loss[None] += x[t, i]

    x.fill(1.0)
    with ti.ad.Tape(loss) as tape:
        step(0)
        measure()
    assert "(all of it: no index is the same in all iterations)" in tape.explain()

    @ti.kernel
    def measure_one(t: ti.i32):
        for i in range(8):
            loss[None] += x[t, i]

    with ti.ad.Tape(loss) as tape:
        step_everywhere()
        measure_one(1)
    text = tape.explain().splitlines()[0]
    assert "and this one writes all of it: no index is the same in all iterations" in text


def test_gradients_that_scatter_say_why():
    ti.init()
    x, y = (ti.field(ti.f32, shape=64, needs_grad=True) for _ in range(2))
    p = ti.field(ti.i32, shape=64)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def shifts():
        for i in range(63):
            y[i] = x[i + 1] - x[i]  # shifts

    @ti.kernel
    def data():
        for i in range(64):
            y[i] += x[p[i]]  # data

    @ti.kernel
    def measure():
        for i in y:
            loss[None] += y[i] * y[i]

    p.from_numpy(np.arange(64, dtype=np.int32)[::-1].copy())
    with ti.ad.Tape(loss) as tape:
        shifts()
        data()
        measure()
    text = tape.explain()
    assert re.search(r"gradient of @shifts\S* at test_reasons.py:\d+: .* are gathered\n", text)
    assert re.search(
        r"gradient of @data\S* at test_reasons.py:\d+: additions to \S+ are scattered: "
        r"an index comes from data \(line \d+\)",
        text,
    )


def test_a_tape_without_launches_has_no_text():
    ti.init()
    loss = ti.field(ti.f32, shape=(), needs_grad=True)
    with ti.ad.Tape(None) as tape:
        pass
    assert loss.grad[None] == 0
    assert "record" not in tape.explain() and "gradient of" not in tape.explain()
