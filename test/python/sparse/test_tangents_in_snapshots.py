"""Snapshots of a sweep in forward mode put values back, and leave the gradients' tangents."""

import numpy as np
import pytest
import tai as ti
from tai._impl.ad.mode import derivatives_of_gradients

N, CELLS = 6, 16


class Particles:
    """They meet on a grid that is emptied in each step."""

    def __init__(self, level, how, steps):
        x, v, loss = self.x, self.v, self.loss = both(N), both(N), both()
        m = ti.field(ti.f64)
        if level == "dynamic":
            cells = ti.root.dense(ti.i, CELLS).dynamic(ti.j, 2)
            cells.place(m)
        else:
            cells = getattr(ti.root, level)(ti.i, CELLS)
            cells.dense(ti.j, 2).place(m)
        # A second tree, which is emptied beside it.
        other, k = ti.root.pointer(ti.i, CELLS), ti.field(ti.f64)
        other.place(k)
        ti.root.lazy_grad()
        ti.root.lazy_dual()
        self.how, self.steps, self.m = how, steps, m

        @ti.kernel
        def scatter():
            for p in x:
                base = int(x[p] * 8)
                f = x[p] * 8 - base
                m[base, 1] += (1 - f) * v[p]
                m[base + 1, 1] += f * v[p]
                k[base] += v[p] * v[p]

        @ti.kernel
        def gather():
            for p in x:
                base = int(x[p] * 8)
                f = x[p] * 8 - base
                met = (1 - f) * m[base, 1] + f * m[base + 1, 1] + k[base]
                v[p] = 0.9 * v[p] + 0.1 * ti.sin(met)

        @ti.kernel
        def measure():
            for p in x:
                loss[None] += v[p] ** 2

        @ti.kernel
        def empty():
            for i in range(CELLS):
                ti.deactivate(cells, [i])
                ti.deactivate(other, [i])

        def fill(*fields):
            for field in fields:
                field.fill(0)

        self.empty = {
            "host": lambda: (cells.deactivate_all(), other.deactivate_all()),
            "kernel": empty,
            "values": lambda: fill(m, k),
            "duals": lambda: fill(m, k, m.dual, k.dual),
            "tangents of gradients": lambda: fill(m, k, m.dual, k.dual, m.grad.dual, k.grad.dual),
        }[how]
        self.scatter, self.gather, self.measure = scatter, gather, measure

    def run(self):
        for _ in range(self.steps):
            self.empty()
            self.scatter()
            self.gather()
        self.measure()

    def begin(self):
        generator = np.random.default_rng(0)
        for field in (self.x, self.v):
            field.from_numpy(generator.uniform(0.55, 0.95, N))
        self.m.fill(0)
        self.loss[None] = 0

    def product(self, sweep):
        generator = np.random.default_rng(1)
        self.begin()
        pairs = [(field, generator.standard_normal(N)) for field in (self.x, self.v)]
        return derivatives_of_gradients(sweep, self.loss, pairs)


def both(*shape):
    return ti.field(ti.f64, shape=shape, needs_grad=True, needs_dual=True)


POLICIES = [(1, 6), ("binomial", 3), ("periodic", 9)]
CASES = [
    *(("pointer", how, *policy) for how in ("host", "kernel") for policy in POLICIES),
    *((level, "host", 1, 6) for level in ("bitmasked", "hash", "dynamic")),
    *((level, "kernel", "binomial", 3) for level in ("bitmasked", "dynamic")),
    *(("pointer", how, 1, 6) for how in ("values", "duals", "tangents of gradients")),
]


@pytest.mark.parametrize(("level", "how", "policy", "steps"), CASES)
@pytest.mark.parametrize("arch", ["cpu", "emulated"])
def test_they_are_those_without_snapshots(arch, level, how, policy, steps, monkeypatch):
    """The tape was recorded in forward mode, or before it."""
    if arch == "emulated":
        monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    ti.init(ti.cuda if arch == "emulated" else ti.cpu, default_fp=ti.f64, offline_cache=False)
    program = Particles(level, how, steps)

    def record(**options):
        with ti.ad.Tape(program.loss, **options) as tape:
            program.run()
        return tape

    expected = program.product(record)
    assert all(np.abs(e).max() > 1 for e in expected)

    def agree(found):
        for f, e in zip(found, expected, strict=True):
            np.testing.assert_allclose(f, e, rtol=0, atol=1e-12 * np.abs(e).max())

    agree(program.product(lambda: record(checkpoint=policy)))
    program.begin()
    tape = record(checkpoint=policy)
    gradients = [program.x.grad.to_numpy(), program.v.grad.to_numpy()]
    for _ in range(2):
        agree(program.product(tape.replay))
    # Out of forward mode, it gives the same gradient as before.
    program.begin()
    tape.replay()
    for field, before in zip((program.x, program.v), gradients, strict=True):
        np.testing.assert_allclose(field.grad.to_numpy(), before, rtol=1e-13)
