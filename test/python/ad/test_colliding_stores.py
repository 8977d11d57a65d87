"""Stores of several iterations to one element: the gradient goes to the one whose value remains.

Under a tape that is the last iteration, as in a serial loop, which NumPy runs here.
"""

import numpy as np
import pytest
import tai as ti

pytestmark = pytest.mark.filterwarnings("ignore::tai.ad.TaiGradientWarning")

CONTEXTS = {
    "one": {"arch": ti.cpu, "cpu_max_num_threads": 1},
    "two": {"arch": ti.cpu, "cpu_max_num_threads": 2},
    "deterministic": {"arch": ti.cpu, "cpu_max_num_threads": 2, "deterministic": True},
    "emulated": {"arch": "emulated"},
    "emulated_deterministic": {"arch": "emulated", "deterministic": True},
}
SIZES = [1, 8, 1000, 65_537, 200_000]
FORMS = ["data", "halves", "digits", "sums", "ends", "condition", "unique"]


@pytest.fixture(params=CONTEXTS)
def context(request, monkeypatch):
    options = dict(CONTEXTS[request.param])
    if options["arch"] == "emulated":
        monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
        options["arch"] = ti.cuda

    def start(**more):
        ti.init(**options, offline_cache=False, **more)

    start.isEmulated = request.param.startswith("emulated")
    return start


def targets(form, n, x, p):
    """Where iteration i stores, -1 for nowhere; and how many elements there are."""
    i = np.arange(n)
    return {
        "data": (p % max(n // 3, 1), n),
        "halves": (i // 2, n),
        "digits": (i % 4, 4),
        "sums": (i // 8 + i % 8, n // 8 + 9),
        "ends": (np.minimum(i, 10), 11),
        "condition": (np.where(x > 0.25, 1, -1), 3),
        "unique": (p, n),
    }[form]


def make_kernel(form, x, y, p, n):
    m = max(n // 3, 1)
    if form == "data":

        @ti.kernel
        def store():
            for i in x:
                y[p[i] % m] = x[i] * 2
    elif form == "unique":

        @ti.kernel
        def store():
            for i in x:
                y[p[i]] = x[i] * 2
    elif form == "halves":

        @ti.kernel
        def store():
            for i in x:
                y[i // 2] = x[i] * 2
    elif form == "digits":

        @ti.kernel
        def store():
            for i in range(n):
                y[i % 4] = x[i] * 2
    elif form == "sums":

        @ti.kernel
        def store():
            for i, j in ti.ndrange((n + 7) // 8, 8):
                if i * 8 + j < n:
                    y[i + j] = x[i * 8 + j] * 2
    elif form == "ends":

        @ti.kernel
        def store():
            for i in x:
                y[ti.min(i, 10)] = x[i] * 2
    else:

        @ti.kernel
        def store():
            for i in x:
                if p[i] >= 0:
                    y[1] = x[i] * 2

    return store


def expect(at, size, n):
    """The iteration whose value remains in each element, or -1."""
    winner = np.full(size, -1)
    for i in range(n):
        if at[i] >= 0:
            winner[at[i]] = i
    return winner


def make_data(form, n):
    rng = np.random.default_rng(n)
    x = rng.random(n)
    p = rng.permutation(n).astype(np.int32)
    at, size = targets(form, n, x, p)
    if form == "condition":
        p = np.where(x > 0.25, p, -1).astype(np.int32)
    return x, p, at, size


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("real", [ti.f32, ti.f64], ids=["f32", "f64"])
def test_the_last_store_has_the_gradient(context, form, n, real):
    if n > 1000 and (context.isEmulated or real is ti.f64):
        n = 4099
    context(default_fp=real)
    values, p_values, at, size = make_data(form, n)
    x = ti.field(real, shape=n, needs_grad=True)
    y = ti.field(real, shape=size, needs_grad=True)
    w = ti.field(real, shape=size)
    p = ti.field(ti.i32, shape=n)
    loss = ti.field(real, shape=(), needs_grad=True)
    store = make_kernel(form, x, y, p, n)

    @ti.kernel
    def total():
        for i in y:
            loss[None] += w[i] * y[i]

    weights = np.random.default_rng(1).random(size) + 1
    x.from_numpy(values.astype(real.to_numpy() if hasattr(real, "to_numpy") else np.float64))
    p.from_numpy(p_values)
    w.from_numpy(weights)
    for _ in range(2):
        y.fill(7)
        with ti.ad.Tape(loss):
            store()
            total()
        winner = expect(at, size, n)
        is_stored = winner >= 0
        found = y.to_numpy()
        np.testing.assert_allclose(found[is_stored], 2 * values[winner[is_stored]], rtol=1e-6)
        assert (found[~is_stored] == 7).all()
        gradient = np.zeros(n)
        np.add.at(gradient, winner[is_stored], 2 * weights[is_stored])
        np.testing.assert_allclose(x.grad.to_numpy(), gradient, rtol=1e-6)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("n", [1, 8, 1000, 4099])
def test_a_tangent_is_of_the_value_beside_it(context, form, n):
    context(default_fp=ti.f64)
    values, p_values, at, size = make_data(form, n)
    x = ti.field(ti.f64, shape=n, needs_dual=True)
    y = ti.field(ti.f64, shape=size, needs_dual=True)
    p = ti.field(ti.i32, shape=n)
    store = make_kernel(form, x, y, p, n)
    x.from_numpy(values)
    p.from_numpy(p_values)
    y.fill(7)
    with ti.ad.FwdMode(loss=y, param=x, seed=list(values)):
        store()
    # The tangent of x is x, so that each tangent tells whose it is.
    winner = expect(at, size, n)
    is_stored = winner >= 0
    np.testing.assert_allclose(y.to_numpy()[is_stored], 2 * values[winner[is_stored]])
    np.testing.assert_allclose(y.dual.to_numpy()[is_stored], 2 * values[winner[is_stored]])
    assert (y.dual.to_numpy()[~is_stored] == 0).all()


def test_vectors_and_their_components(context):
    context(default_fp=ti.f64)
    n = 1000
    x = ti.Vector.field(2, ti.f64, shape=n, needs_grad=True)
    y = ti.Vector.field(2, ti.f64, shape=n, needs_grad=True)
    z = ti.Vector.field(2, ti.f64, shape=n, needs_grad=True)
    p = ti.field(ti.i32, shape=n)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def store():
        for i in x:
            y[p[i]] = 3 * x[i]
            z[p[i]][1] = x[i][0] * x[i][1]

    @ti.kernel
    def total():
        for i in y:
            loss[None] += y[i][0] + 2 * y[i][1] + (i + 1) * z[i][1]

    rng = np.random.default_rng(0)
    values, at = rng.random((n, 2)), rng.integers(0, 50, n).astype(np.int32)
    x.from_numpy(values)
    p.from_numpy(at)
    with ti.ad.Tape(loss):
        store()
        total()
    winner = expect(at, n, n)
    gradient = np.zeros((n, 2))
    for e, i in enumerate(winner):
        if i >= 0:
            gradient[i] += np.array([3, 6]) + (e + 1) * values[i][::-1]
    np.testing.assert_allclose(x.grad.to_numpy(), gradient)


def test_several_stores_of_one_iteration(context):
    """The iteration that wins an element is serial code: its last store counts."""
    context(default_fp=ti.f64)
    n = 500
    x = ti.field(ti.f64, shape=n, needs_grad=True)
    y = ti.field(ti.f64, shape=n + 8, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def store():
        for i in x:
            for j in range(3):
                y[i // 2 + j // 2] = x[i] * (j + 1)
            y[i // 2 + 1] = x[i] * x[i]

    @ti.kernel
    def total():
        for i in y:
            loss[None] += (i + 1) * y[i]

    values = np.random.default_rng(0).random(n)
    x.from_numpy(values)
    with ti.ad.Tape(loss):
        store()
        total()
    expected, slope = np.zeros(n + 8), np.zeros(n)
    owner, factor = np.full(n + 8, -1), np.zeros(n + 8)
    for i in range(n):
        for at, value, rate in [
            (i // 2, 2 * values[i], 2),
            (i // 2 + 1, values[i] ** 2, 2 * values[i]),
        ]:
            expected[at], owner[at], factor[at] = value, i, rate
    for e in range(n + 8):
        if owner[e] >= 0:
            slope[owner[e]] += (e + 1) * factor[e]
    np.testing.assert_allclose(y.to_numpy(), expected)
    np.testing.assert_allclose(x.grad.to_numpy(), slope)


def test_arrays_of_the_caller(context):
    context(default_fp=ti.f64)
    n = 1000

    @ti.kernel
    def store(x: ti.types.ndarray(), p: ti.types.ndarray(), y: ti.types.ndarray()):
        for i in range(x.shape[0]):
            y[p[i]] = x[i] * x[i]

    @ti.kernel
    def total(y: ti.types.ndarray(), loss: ti.types.ndarray(ndim=0)):
        for i in range(y.shape[0]):
            loss[None] += (i + 1) * y[i]

    rng = np.random.default_rng(0)
    values, at = rng.random(n), rng.integers(0, 50, n).astype(np.int32)
    x = ti.ndarray(ti.f64, n, needs_grad=True)
    y = ti.ndarray(ti.f64, 60, needs_grad=True)
    p = ti.ndarray(ti.i32, n)
    loss = ti.ndarray(ti.f64, (), needs_grad=True)
    x.from_numpy(values)
    p.from_numpy(at)
    with ti.ad.Tape(loss):
        store(x, p, y)
        total(y, loss)
    winner = expect(at, 60, n)
    gradient = np.zeros(n)
    for e, i in enumerate(winner):
        if i >= 0:
            gradient[i] += (e + 1) * 2 * values[i]
    np.testing.assert_allclose(x.grad.to_numpy(), gradient)


def test_a_read_of_what_another_iteration_stores_is_reported(context):
    context(default_fp=ti.f64)
    n = 64
    x = ti.field(ti.f64, shape=n, needs_grad=True)
    y = ti.field(ti.f64, shape=n, needs_grad=True)
    p = ti.field(ti.i32, shape=n)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def step():
        for i in x:
            y[p[i]] = 0.5 * y[p[i]] + ti.sin(x[i])

    @ti.kernel
    def total():
        for i in y:
            loss[None] += (i + 1) * y[i]

    x.fill(0.25)
    p.from_numpy(np.arange(n, dtype=np.int32)[::-1].copy())
    with ti.ad.Tape(loss):
        step()
        total()
    np.testing.assert_allclose(x.grad.to_numpy(), np.cos(0.25) * np.arange(n, 0, -1), rtol=1e-12)
    p.from_numpy(np.arange(n, dtype=np.int32) // 2)
    with pytest.raises(Exception, match="another iteration writes"):
        with ti.ad.Tape(loss):
            step()
            total()
        ti.sync()


def test_conditions_that_the_loop_changes_are_refused(context):
    """Whether an iteration stores is known neither before the loop nor behind it."""
    context(default_fp=ti.f64)
    n = 100
    x = ti.field(ti.f64, shape=n, needs_grad=True)
    y = ti.field(ti.f64, shape=n, needs_grad=True)
    k = ti.field(ti.i32, shape=n)
    q = ti.field(ti.i32, shape=n)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def step():
        for i in x:
            if k[i] % 2 == 0:
                y[i // 5] = x[i] * 3
            k[q[i]] = i // 3

    @ti.kernel
    def total():
        for i in y:
            loss[None] += (i + 1) * y[i]

    with pytest.raises(ti.errors.TaiAutodiffError, match=r"(?s)is overwritten.*k\[i\] % 2"):
        with ti.ad.Tape(loss):
            step()
            total()


def test_a_gradient_without_a_tape_is_refused(context):
    """Only a tape launches the kernel that decides which store remains."""
    context(default_fp=ti.f64)
    x = ti.field(ti.f64, shape=8, needs_grad=True)
    y = ti.field(ti.f64, shape=8, needs_grad=True)

    @ti.kernel
    def halves():
        for i in x:
            y[i // 2] = x[i] * 3

    @ti.kernel
    def in_order():
        ti.loop_config(serialize=True)
        for i in range(8):
            y[i // 2] = x[i] * 3

    halves()
    y.grad.fill(1)
    with pytest.raises(
        ti.errors.TaiRuntimeError, match="(?s)'halves.* may store to one element.*under a tape"
    ):
        halves.grad()
    in_order()
    in_order.grad()
    assert x.grad.to_numpy().tolist() == [0, 3] * 4


@pytest.mark.parametrize("form", ["bits", "flat"])
def test_indices_made_of_two_numbers_do_not_collide(context, form):
    """Masks and shifts are digits; a sum of digits names one pair of loop indices. Gradients of
    such stores need no tape."""
    context(default_fp=ti.f64)
    x = ti.field(ti.f64, shape=(6, 8), needs_grad=True)
    y = ti.field(ti.f64, shape=(6, 8), needs_grad=True)
    flat = ti.field(ti.f64, shape=64, needs_grad=True)

    @ti.kernel
    def store():
        for i, j in x:
            if ti.static(form == "bits"):
                y[i, (j >> 2 << 2) | (j & 3)] = x[i, j]
                flat[(i << 3) | j] = 3 * x[i, j]
            else:
                flat[i * 8 + j] = 3 * x[i, j]

    store()
    weights = np.random.default_rng(1).random(112)
    flat.grad.from_numpy(weights[:64])
    y.grad.from_numpy(weights[64:].reshape(6, 8))
    store.grad()
    expected = 3 * weights[:48] + (weights[64:] if form == "bits" else 0)
    np.testing.assert_allclose(x.grad.to_numpy(), expected.reshape(6, 8))
    assert (flat.grad.to_numpy()[:48] == 0).all()


def test_digits_of_a_loop_index_do_not_collide(context):
    """Nor do elements at a border: their gradients need no tape."""
    context(default_fp=ti.f64)
    x = ti.field(ti.f64, shape=60, needs_grad=True)
    y = ti.field(ti.f64, shape=(15, 2, 2), needs_grad=True)
    z = ti.field(ti.f64, shape=60, needs_grad=True)

    @ti.kernel
    def fold(m: ti.i32):
        for i in x:
            y[i // 4, i // 2 % 2, i % 2] = x[i] * 3
        for i in x:
            if i == 0:
                z[0] = x[i]
            elif i == x.shape[0] - 1:
                z[x.shape[0] - 1] = 5 * x[i]
            else:
                z[i] = x[i] * 3

    fold(4)
    weights = np.random.default_rng(0).random(120)
    y.grad.from_numpy(weights[:60].reshape(15, 2, 2))
    z.grad.from_numpy(weights[60:])
    fold.grad(4)
    factors = np.full(60, 3.0)
    factors[[0, -1]] = 1, 5
    np.testing.assert_allclose(x.grad.to_numpy(), 3 * weights[:60] + factors * weights[60:])


def test_a_sequence_of_launches_that_collide(context):
    """On a device they become one piece of work, in which the steps of each must wait."""
    context(default_fp=ti.f64)
    n, steps = 96, 4
    x = ti.field(ti.f64, shape=(steps + 1, n), needs_grad=True)
    p = ti.field(ti.i32, shape=n)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def step(t: ti.i32):
        for i in range(n):
            x[t + 1, p[i]] = x[t, i] * x[t, (i + 1) % n]

    @ti.kernel
    def total():
        for i in range(n):
            loss[None] += (i + 1) * x[steps, i]

    rng = np.random.default_rng(0)
    start = 0.5 + rng.random((steps + 1, n))
    at = rng.integers(0, n // 2, n).astype(np.int32)
    p.from_numpy(at)
    winner = expect(at, n, n)
    stored = winner >= 0
    values = start.copy()
    for t in range(steps):
        values[t + 1, stored] = (values[t] * np.roll(values[t], -1))[winner[stored]]
    slope = np.arange(1.0, n + 1)
    for t in reversed(range(steps)):
        new = np.zeros(n)
        for e in np.flatnonzero(stored):
            i = winner[e]
            new[i] += slope[e] * values[t, (i + 1) % n]
            new[(i + 1) % n] += slope[e] * values[t, i]
        slope = new
    for _ in range(6):
        x.from_numpy(start)
        with ti.ad.Tape(loss):
            for t in range(steps):
                step(t)
            total()
        np.testing.assert_allclose(x.to_numpy(), values)
        np.testing.assert_allclose(x.grad.to_numpy()[0], slope)


def test_blocks_of_one_field(context):
    """Iterations that would read what others write, were the loop longer than it is."""
    context(default_fp=ti.f64)
    n = 6
    x = ti.field(ti.f64, shape=(3, 3 * n), needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def double(count: ti.i32):
        for i in range(count):
            x[0, i] = 2.0 * x[0, i + n]

    @ti.kernel
    def shift(s: ti.i32, d: ti.i32):
        for i in range(n):
            x[d, i] = 3.0 * x[s, i + 1]

    @ti.kernel
    def total():
        for i, j in x:
            loss[None] += (i + 1) * (j + 1) * x[i, j]

    weights = np.outer(np.arange(1.0, 4.0), np.arange(1.0, 3 * n + 1.0))
    for count in [n, n, n - 2, 0, n]:
        with ti.ad.Tape(loss):
            double(count)
            shift(1, 2)
            total()
        expected = weights.copy()
        expected[0, n : n + count] += 2 * weights[0, :count]
        expected[1, 1 : n + 1] += 3 * weights[2, :n]
        expected[0, :count] = expected[2, :n] = 0
        np.testing.assert_allclose(x.grad.to_numpy(), expected)
    with pytest.raises(ti.errors.TaiRuntimeError, match="another iteration writes"):
        with ti.ad.Tape(loss):
            double(n + 1)
            total()
        ti.sync()
