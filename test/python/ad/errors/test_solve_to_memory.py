"""`ti.solve_to`: which values its tape keeps, by memory and time, and f64 where it is faster."""

import numpy as np
import pytest
import tai as ti
from tai._impl.ad import density, solve
from tai.errors import TaiAutodiffError, TaiMemoryError, TaiRuntimeTypeError


def rope(n=512, steps=40):
    """Numbers that are changed in place many times, and the gradient in NumPy by complex steps."""
    x, v, loss = (ti.field(float, shape=s, needs_grad=True) for s in (n, n, ()))

    @ti.kernel
    def push():
        for i in v:
            v[i] -= 0.05 * ti.sin(x[i])

    @ti.kernel
    def move():
        for i in x:
            x[i] += 0.05 * v[i] * v[i]

    @ti.kernel
    def measure():
        for i in x:
            loss[None] += x[i] ** 2

    def run():
        for _ in range(steps):
            push()
            move()
        measure()

    start = np.linspace(0.1, 1, n, dtype=np.float32)
    x.from_numpy(start)
    v.fill(0.5)

    def in_numpy(p):
        q = np.full_like(p, 0.5)
        for _ in range(steps):
            q = q - 0.05 * np.sin(p)
            p = p + 0.05 * q * q
        return p**2

    start = start.astype(float)
    gradient = in_numpy(start + 1e-30j).imag / 1e-30
    return run, loss, x, in_numpy(start).sum(), gradient


def is_right(found, loss, gradient, error):
    off = np.linalg.norm(found.gradients[0] - gradient) / np.linalg.norm(gradient)
    return max(abs(found.loss - loss) / loss, off) <= error


def test_a_small_tape_keeps_everything():
    ti.init(offline_cache=False)
    run, loss, x, value, gradient = rope()
    found = ti.solve_to(run, loss=loss, wrt=[x], error=1e-4)
    assert found.modes["tape"] == "everything"
    with ti.ad.Tape(loss) as tape:
        run()
    # Either type may be the fastest.
    wide = 2 if found.modes["precision"] == "f64" else 1
    assert found.memory == wide * tape.memory
    assert is_right(found, value, gradient, 1e-4)
    assert "the tape keeps" in str(found)


@pytest.mark.parametrize("error", [1e-4, 1e-10])
@pytest.mark.parametrize("budget", [60_000, 20_000])
def test_a_budget_is_kept(budget, error):
    ti.init(default_fp=ti.f64, offline_cache=False)
    run, loss, x, value, gradient = rope()
    with ti.ad.Tape(loss) as tape:
        run()
    assert tape.memory > 2 * budget
    run, loss, x, value, gradient = rope()
    found = ti.solve_to(run, loss=loss, wrt=[x], error=error, memory_budget=budget)
    assert found.modes["tape"] == "snapshots"
    assert found.modes["precision"] == ("f64" if error < 1e-6 else found.modes["precision"])
    assert 0 < found.memory <= budget
    assert found.iterations <= 20
    assert is_right(found, value, gradient, error)
    found.run()
    np.testing.assert_allclose(x.grad.to_numpy(), gradient, rtol=1e-3)


def test_a_budget_that_holds_everything():
    """Then both are measured, and the faster one is taken."""
    ti.init(offline_cache=False)
    run, loss, x, value, gradient = rope()
    found = ti.solve_to(run, loss=loss, wrt=[x], error=1e-4, memory_budget=10**8)
    assert found.modes["tape"] in ("everything", "snapshots")
    assert found.memory <= 10**8
    assert is_right(found, value, gradient, 1e-4)


def test_a_budget_that_holds_nothing():
    ti.init(offline_cache=False)
    run, loss, x, _, _ = rope()
    with pytest.raises(TaiMemoryError, match="is too small for this tape"):
        ti.solve_to(run, loss=loss, wrt=[x], error=1e-4, memory_budget=1000)
    for budget in (0, -1, True, 1.5):
        with pytest.raises(TaiRuntimeTypeError, match="memory"):
            ti.solve_to(run, loss=loss, wrt=[x], error=1e-4, memory_budget=budget)


class FakeClock:
    """Time that passes in steps which a test says, one for each iteration."""

    def __init__(self, search_seconds):
        self.now, self.seconds, self.is_open = 0.0, search_seconds, False

    def perf_counter(self):
        if self.is_open:
            self.now += self.seconds()
        self.is_open = not self.is_open
        return self.now


@pytest.mark.parametrize("snapshots_take", [0.5, 2.0])
def test_snapshots_where_they_are_faster(monkeypatch, snapshots_take):
    ti.init(offline_cache=False)
    run, loss, x, value, gradient = rope()
    searches = []

    class Search(solve._Search):
        def __init__(self, *args):
            super().__init__(*args)
            searches.append(self)

    def seconds():
        versions = searches[-1]._versions
        return snapshots_take if any(v.checkpoint for v in versions) else 1.0

    monkeypatch.setattr(density, "LEAST_KEPT", 1024)
    monkeypatch.setattr(solve, "_Search", Search)
    monkeypatch.setattr(solve, "time", FakeClock(seconds))
    found = ti.solve_to(run, loss=loss, wrt=[x], error=1e-4)
    with ti.ad.Tape(loss) as tape:
        run()
    is_faster = snapshots_take < 1
    assert found.modes["tape"] == ("snapshots" if is_faster else "everything")
    assert found.memory <= tape.memory / 8 if is_faster else found.memory == tape.memory
    assert found.time == (snapshots_take if is_faster else 1.0)
    assert is_right(found, value, gradient, 1e-4)
    assert found.iterations <= 20


@pytest.mark.parametrize("wide_takes", [0.5, 2.0])
def test_f64_where_it_is_faster(monkeypatch, wide_takes):
    ti.init(offline_cache=False)
    run, loss, x, value, gradient = rope(64, 4)
    clock = FakeClock(lambda: 1.0)
    entered = solve.Version._enter

    def enter(self):
        clock.seconds = lambda: wide_takes if self.modes.get("precision") == "f64" else 1.0
        return entered(self)

    monkeypatch.setattr(solve.Version, "_enter", enter)
    monkeypatch.setattr(solve, "time", clock)
    found = ti.solve_to(run, loss=loss, wrt=[x], error=1e-3)
    assert found.modes["precision"] == ("f64" if wide_takes < 1 else "f32")
    assert found.time == min(wide_takes, 1.0)
    # A device adds in another order each time.
    assert is_right(found, value, gradient, max(2 * found.error, 1e-14))
    assert found.iterations <= 20


def test_steps_that_are_too_many_name_the_number_that_was_measured():
    ti.init(default_fp=ti.f64, offline_cache=False)
    x, loss = ti.field(float, shape=(), needs_grad=True), ti.field(float, (), needs_grad=True)
    y = ti.field(float, shape=(), needs_grad=True)

    @ti.kernel
    def begin():
        y[None] = x[None]

    @ti.kernel
    def step(dt: float):
        y[None] -= dt * y[None] ** 2

    @ti.kernel
    def end():
        loss[None] += y[None]

    def run(steps=8):
        begin()
        for _ in range(steps):
            step(1.0 / steps)
        end()

    x[None] = 1.0
    with pytest.raises(TaiAutodiffError, match=r"would take about \d+ steps \(order .* with 8\)"):
        ti.solve_to(run, loss=loss, wrt=[x], error=1e-6)
