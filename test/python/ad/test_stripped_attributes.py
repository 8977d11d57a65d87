"""Any pass may drop discardable attributes: with all of them gone, results are the same."""

import numpy as np
import pytest
import tai as ti

N = 64


def real(*shape):
    return ti.field(ti.f64, shape=shape, needs_grad=True)


def filled(*shape):
    x = real(*shape)
    x.from_numpy(np.linspace(0.25, 1.75, int(np.prod(shape))).reshape(shape))
    return x


def gradient(loss, *fields):
    return [loss.to_numpy(), *(f.grad.to_numpy() for f in fields)]


def an_update_in_place():
    """Reads the former values; the tape restores them, and zeroes the adjoints of overwritten
    elements."""
    x, loss = filled(N), real()

    @ti.kernel
    def step():
        for i in x:
            x[i] = x[i] * x[i] + ti.sin(x[i])

    @ti.kernel
    def total():
        for i in x:
            loss[None] += x[i]

    with ti.ad.Tape(loss):
        for _ in range(3):
            step()
        total()
    return gradient(loss, x)


def a_sequence_that_is_executed_again():
    x, loss = filled(8), real()

    @ti.kernel
    def sweeps():
        for _ in range(1):
            for k in range(3):
                for i in range(1, 8):
                    x[i] = x[i] * x[i - 1] + 0.1 * k
            loss[None] += x[7]

    with ti.ad.Tape(loss):
        sweeps()
    return gradient(loss, x)


def stores_that_collide():
    x, y, p, loss = filled(N), filled(N), ti.field(ti.i32, shape=N), real()
    p.from_numpy(np.arange(N, dtype=np.int32) * 7 % 5)

    @ti.kernel
    def store():
        for i in x:
            y[p[i]] = x[i] * x[i]
        for i in x:
            loss[None] += (i + 1) * y[i]

    with ti.ad.Tape(loss):
        store()
    return gradient(loss, x, y)


def loops_that_are_launched_one_by_one():
    x, y, loss = filled(N), filled(N), real()

    @ti.kernel
    def twice():
        for i in x:
            x[i] = x[i] * y[i]
        for i in x:
            x[i] = x[i] * x[i] + y[(i + 1) % N]
        for i in x:
            loss[None] += x[i]

    with ti.ad.Tape(loss):
        twice()
    return gradient(loss, x, y)


def values_that_the_kernel_has_stored():
    x, y, loss = filled(N), filled(2, N), real()

    @ti.kernel
    def layer(t: ti.i32):
        for i in x:
            y[t, i] = ti.exp(ti.sin(ti.sqrt(x[i]) * ti.cos(x[i])))

    @ti.kernel
    def total():
        for i in x:
            loss[None] += y[1, i] ** 2

    with ti.ad.Tape(loss):
        layer(1)
        total()
    return gradient(loss, x, y)


def scatters_over_sparse_cells():
    """The adjoint makes nothing active, and visits cells around those that have an adjoint."""
    x, y, loss = (ti.field(ti.f64, needs_grad=True) for _ in range(3))
    block = ti.root.pointer(ti.i, 16)
    block.dense(ti.i, 4).place(x, y)
    ti.root.place(loss)
    ti.root.lazy_grad()

    @ti.kernel
    def fill():
        for i in range(8, 24):
            x[i] = 0.1 * i
        for i in range(8, 20):
            y[i] = 0.0

    @ti.kernel
    def scatter():
        for i in x:
            for k in ti.static(range(3)):
                y[i + k - 1] += (k + 1) * x[i] ** 2

    @ti.kernel
    def total():
        for i in y:
            loss[None] += y[i] ** 2

    fill()
    with ti.ad.Tape(loss):
        scatter()
        total()
    return [*gradient(loss, x), np.array(block.active_cells())]


def sums_in_a_fixed_order():
    x = filled(3000)
    weights, loss = filled(7), real()

    @ti.kernel
    def run():
        for i in x:
            loss[None] += ti.sin(x[i]) * weights[i % 7] ** 2

    with ti.ad.Tape(loss):
        run()
    return gradient(loss, x, weights)


def a_choice_at_a_tie():
    x, loss = filled(4), real()

    @ti.kernel
    def run():
        for i in x:
            loss[None] += ti.max(x[i], x[i] * 1.0) * 3 + abs(x[i])

    with ti.ad.Tape(loss):
        run()
    return gradient(loss, x)


def arguments_that_are_differentiated():
    a, out = np.linspace(0, 1, 6), np.zeros(6)
    a_grad, loss = np.zeros(6), real()

    @ti.kernel
    def run(a: ti.types.ndarray(), out: ti.types.ndarray()):
        for i in range(6):
            out[i] = a[i] ** 3
            loss[None] += out[i]

    run(a, out)
    return [out, a_grad, loss.to_numpy()]


CASES = [
    (an_update_in_place, {}),
    (a_sequence_that_is_executed_again, {}),
    (stores_that_collide, {}),
    (loops_that_are_launched_one_by_one, {}),
    (values_that_the_kernel_has_stored, {}),
    (scatters_over_sparse_cells, {}),
    (scatters_over_sparse_cells, {"deterministic": True}),
    (sums_in_a_fixed_order, {"deterministic": True}),
    (a_choice_at_a_tie, {}),
    (arguments_that_are_differentiated, {}),
]


def result_of(case, options):
    ti.init(arch=ti.cpu, offline_cache=False, default_fp=ti.f64, **options)
    return case()


def compare_stripped(case, options, monkeypatch):
    monkeypatch.delenv("TAI_STRIP_ATTRIBUTES", raising=False)
    expected = result_of(case, options)
    monkeypatch.setenv("TAI_STRIP_ATTRIBUTES", "1")
    for kept, whole in zip(result_of(case, options), expected):
        if options:  # Their order is part of the result.
            np.testing.assert_array_equal(kept, whole)
        else:
            np.testing.assert_allclose(kept, whole, rtol=1e-12)


@pytest.mark.parametrize(("case", "options"), CASES, ids=lambda v: getattr(v, "__name__", ""))
def test_results_stay(case, options, monkeypatch):
    compare_stripped(case, options, monkeypatch)


@pytest.mark.parametrize(("case", "options"), CASES, ids=lambda v: getattr(v, "__name__", ""))
def test_results_stay_on_a_device(case, options, monkeypatch):
    """Blocks of several warps, so that lanes exchange partial sums."""
    monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    monkeypatch.setenv("TAI_EMULATED_THREADS", "96")
    monkeypatch.setenv("TI_ARCH", "cuda")
    compare_stripped(case, options, monkeypatch)


def what_modes_change(**modes):
    """A product and a sum, functions, a sum that cancels, denormal products, and gradients."""
    n = 100_352
    rng = np.random.default_rng(3)
    x, y, tiny = (ti.field(ti.f32, shape=n, needs_grad=True) for _ in range(3))
    total, loss = (ti.field(ti.f32, shape=(), needs_grad=True) for _ in range(2))
    values = rng.uniform(0.5, 1.5, n).astype(np.float32)
    x.from_numpy(values * np.where(np.arange(n) % 2, 1, -1).astype(np.float32))

    @ti.kernel(**modes)
    def run():
        for i in x:
            y[i] = x[i] * x[i] + ti.sin(10 * x[i]) + ti.tanh(x[i]) + ti.atan2(x[i], 0.3)
            tiny[i] = x[i] * 1e-20 * 1e-20
        for i in x:
            total[None] += x[i]
            loss[None] += y[i] ** 2

    with ti.ad.Tape(loss):
        run()
    return [f.to_numpy() for f in (y, tiny, x.grad)], [f.to_numpy() for f in (total, loss)]


MODES = [
    {"precision": "f64"},
    {"sums": "compensated"},
    {"sums": "deterministic"},
    {"math": "fast"},
    {"math": "strict"},
    {"math": "accurate"},
    {"ftz": True},
]


def compare_modes(modes, monkeypatch, **options):
    def results(**modes):
        ti.init(offline_cache=False, **options)
        return what_modes_change(**modes)

    monkeypatch.delenv("TAI_STRIP_ATTRIBUTES", raising=False)

    # Where a loop is cut, few elements are rounded otherwise; unless their order is kept, sums are.
    def are_same(these, those):
        fields = all(np.mean(a == b) > 0.999 for a, b in zip(these[0], those[0], strict=True))
        return fields and ("sums" not in modes or these[1] == those[1])

    plain, expected = results(), results(**modes)
    assert not are_same(plain, expected), "losing a mode that changes nothing here would go unseen"
    monkeypatch.setenv("TAI_STRIP_ATTRIBUTES", "1")
    assert are_same(results(**modes), expected)


@pytest.mark.parametrize("modes", MODES, ids=str)
def test_modes_stay(modes, monkeypatch):
    compare_modes(modes, monkeypatch, arch=ti.cpu, cpu_max_num_threads=3)


@pytest.mark.parametrize("modes", [m for m in MODES if "sums" not in m], ids=str)
def test_modes_stay_on_a_device(modes, monkeypatch):
    monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    monkeypatch.setenv("TI_ARCH", "cuda")
    compare_modes(modes, monkeypatch)


def test_checks_and_messages_stay(monkeypatch, capfd):
    """An index is checked, and a message has the vector that it was given."""
    monkeypatch.setenv("TAI_STRIP_ATTRIBUTES", "1")
    ti.init(arch=ti.cpu, offline_cache=False, bounds="check")
    x = ti.field(ti.f32, shape=8)
    index = ti.field(ti.i32, shape=8)

    @ti.kernel
    def read() -> ti.f32:
        total = 0.0
        for i in range(8):
            total += x[index[i]]
        return total

    @ti.kernel
    def say():
        print(ti.Vector([1, 2, 3]))

    say()
    ti.sync()
    assert "[1, 2, 3]" in capfd.readouterr().out
    index[3] = 9
    with pytest.raises(ti.TaiError, match=r"index \[9\] is out of range"):
        read()


def test_a_gradient_without_its_guards_is_not_differentiated(monkeypatch):
    """A guard that is taken for a branch would have a derivative of zero where it is not."""
    monkeypatch.setenv("TAI_STRIP_ATTRIBUTES", "1")
    ti.init(arch=ti.cpu, offline_cache=False, default_fp=ti.f64)
    x, loss = (ti.field(ti.f64, shape=(), needs_grad=True, needs_dual=True) for _ in range(2))

    @ti.kernel
    def kernel():
        loss[None] = (ti.sqrt(x[None]) - 1) ** 2

    x[None] = 1
    with pytest.raises(ti.TaiError, match="guard of this gradient has lost its mark"):
        ti.ad.hvp(kernel, loss, x, 1.0)
