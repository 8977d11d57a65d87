"""Adjoints that load what kernels have stored: only where it still stands there.

The references are complex steps through the same program in numpy, which are exact to the last
digits, and closed forms.
"""

import numpy as np
import pytest
import tai as ti

N, H, T = 5, 4, 6
RNG = np.random.default_rng(11)
W = RNG.uniform(-0.6, 0.6, (H, N))
X0 = RNG.uniform(-1, 1, N)
C = RNG.uniform(0.5, 1.5, N)


@pytest.fixture(autouse=True)
def double():
    ti.init(arch=ti.cpu, default_fp=ti.f64)


def real(*shape, **options):
    return ti.field(ti.f64, shape=shape, needs_grad=True, **options)


def forward(w, x):
    """The loss of the program below."""
    for t in range(T):
        h = np.tanh(0.1 * t + w @ x)
        x = 0.9 * x + 0.2 * (w.T @ h)
    return np.sum(C * x * x)


def complex_step(function, value):
    """The gradient of a function of one array."""
    gradient = np.empty(value.shape)
    for index in np.ndindex(value.shape):
        moved = value.astype(complex)
        moved[index] += 1e-30j
        gradient[index] = function(moved).imag / 1e-30
    return gradient


class Network:
    """A layer with a tanh and a step, T times; the layer stores to slot `slot(t)`."""

    def __init__(self, slots=T):
        self.w, self.x, self.h = w, x, h = real(H, N), real(T + 1, N), real(slots, H)
        self.c = c = ti.field(ti.f64, shape=N)
        self.loss = loss = real()

        @ti.kernel
        def layer(t: ti.i32, slot: ti.i32):
            for i in range(H):
                total = 0.1 * t
                for j in ti.static(range(N)):
                    total += w[i, j] * x[t, j]
                h[slot, i] = ti.tanh(total)

        @ti.kernel
        def step(t: ti.i32, slot: ti.i32):
            for j in range(N):
                push = 0.0
                for i in ti.static(range(H)):
                    push += w[i, j] * h[slot, i]
                x[t + 1, j] = 0.9 * x[t, j] + 0.2 * push

        @ti.kernel
        def measure():
            for j in range(N):
                loss[None] += c[j] * x[T, j] ** 2

        @ti.kernel
        def scribble(slot: ti.i32):
            for i in range(H):
                h[slot, i] = 3.0

        self.layer, self.step, self.measure, self.scribble = layer, step, measure, scribble
        w.from_numpy(W)
        c.from_numpy(C)
        self.start(X0)

    def start(self, x0):
        x = np.zeros((T + 1, N))
        x[0] = x0
        self.x.from_numpy(x)

    def run(self, slot=lambda t: t, after=lambda t: None):
        for t in range(T):
            self.layer(t, slot(t))
            self.step(t, slot(t))
            after(t)
        self.measure()

    def tape(self, *args, **options):
        with ti.ad.Tape(self.loss, **options) as tape:
            self.run(*args)
        return tape

    def check(self, x0=X0):
        assert np.isclose(self.loss[None], forward(W, x0), rtol=1e-13)
        expected = complex_step(lambda w: forward(w, x0), W)
        assert np.allclose(self.w.grad.to_numpy(), expected, rtol=1e-11, atol=1e-13)
        expected = complex_step(lambda x: forward(W, x), x0)
        assert np.allclose(self.x.grad.to_numpy()[0], expected, rtol=1e-11, atol=1e-13)


def forms(tape):
    """The number of launches whose stored results the tape loads, and of those that it computes
    again."""
    text = tape.explain()
    return text.count("; loads what it stored"), text.count("; computes again what it")


def test_a_layer_loads_its_output():
    network = Network()
    tape = network.tape()
    network.check()
    assert forms(tape) == (T, 0)
    assert tape.memory == 0


def test_a_slot_that_is_used_again_is_computed_again():
    network = Network(slots=2)
    tape = network.tape(lambda t: t % 2)
    network.check()
    assert forms(tape) == (2, T - 2)


def test_what_is_computed_again_keeps_no_more_than_it_did():
    """`h` is saved for the adjoint of `step`, and for nobody else."""
    network = Network(slots=1)
    tape = network.tape(lambda t: 0)
    network.check()
    assert forms(tape) == (1, T - 1)
    assert tape.memory == (T - 1) * H * 8


@pytest.mark.parametrize("how", ["kernel", "element", "fill", "array", "no_grad"])
def test_outputs_that_are_overwritten_within_the_tape(how):
    network = Network()

    @ti.ad.no_grad
    def hidden(t):
        network.scribble(t)

    def after(t):
        if t % 2:
            return
        if how == "kernel":
            network.scribble(t)
        elif how == "element":
            network.h[t, 1] = -2.0
        elif how == "fill":
            network.h.fill(0.5)
        elif how == "array":
            network.h.from_numpy(np.full((T, H), 4.0))
        else:
            hidden(t)

    tape = network.tape(lambda t: t, after)
    network.check()
    loads, computes = forms(tape)
    assert loads + computes == T
    lost = {"kernel": T // 2, "element": T // 2, "fill": T - 1, "array": T - 1, "no_grad": T}
    assert computes == lost[how]


def test_half_a_slot_may_be_stored_by_another_launch():
    """The tape knows slabs: the second launch takes the slab of the first."""
    x, y, loss = real(N), real(1, N), real()

    @ti.kernel
    def part(t: ti.i32, begin: ti.i32, end: ti.i32):
        for i in range(begin, end):
            y[t, i] = ti.exp(ti.sin(x[i]))

    @ti.kernel
    def total():
        for i in range(N):
            loss[None] += y[0, i]

    x.from_numpy(X0)
    with ti.ad.Tape(loss) as tape:
        part(0, 0, 2)
        part(0, 2, N)
        total()
    assert np.allclose(x.grad.to_numpy(), np.exp(np.sin(X0)) * np.cos(X0), rtol=1e-14)
    assert forms(tape) == (1, 1)


def test_outputs_that_another_adjoint_reads_may_not_change_after_the_tape():
    network = Network()
    tape = network.tape()
    network.h.fill(9.0)
    with pytest.raises(ti.TaiRuntimeError, match="changed by the host"):
        tape.grad()


@pytest.mark.parametrize("how", ["host", "kernel"])
def test_outputs_that_nobody_else_reads_may_change_after_the_tape(how):
    x, y, loss = real(N), real(N), real()

    @ti.kernel
    def both():
        for i in range(N):
            e = ti.exp(ti.sin(x[i]))
            y[i] = e
            loss[None] += e

    @ti.kernel
    def scribble():
        for i in range(N):
            y[i] = -1.0

    x.from_numpy(X0)
    expected = np.exp(np.sin(X0)) * np.cos(X0)
    with ti.ad.Tape(loss) as tape:
        both()
    assert forms(tape) == (1, 0)
    assert np.allclose(x.grad.to_numpy(), expected, rtol=1e-14)
    if how == "host":
        y.fill(-1.0)
    else:
        scribble()
    with pytest.warns(ti.ad.TaiGradientWarning):
        tape.grad()
    assert np.allclose(x.grad.to_numpy(), expected, rtol=1e-14)
    tape.replay()
    assert forms(tape) == (1, 0)
    assert np.allclose(x.grad.to_numpy(), expected, rtol=1e-14)


def test_a_gradient_launched_by_hand_reads_fields_as_they_are_now():
    network = Network()
    network.layer(2, 2)
    # Neither the stored values nor the inputs of that time.
    network.h.fill(0.25)
    x = RNG.uniform(-1, 1, (T + 1, N))
    network.x.from_numpy(x)
    seed = RNG.uniform(-1, 1, (T, H))
    network.h.grad.from_numpy(seed)
    network.layer.grad(2, 2)
    slope = seed[2] * (1 - np.tanh(0.2 + W @ x[2]) ** 2)
    assert np.allclose(network.w.grad.to_numpy(), np.outer(slope, x[2]), rtol=1e-13)
    assert np.allclose(network.x.grad.to_numpy()[2], W.T @ slope, rtol=1e-13)


def test_a_gradient_launched_by_hand_after_a_tape():
    network = Network()
    tape = network.tape()
    assert forms(tape) == (T, 0)
    network.h.fill(0.0)
    ti.ad.clear_all_gradients()
    seed = np.ones((T, H))
    network.h.grad.from_numpy(seed)
    network.layer.grad(0, 0)
    slope = 1 - np.tanh(W @ X0) ** 2
    assert np.allclose(network.w.grad.to_numpy(), np.outer(slope, X0), rtol=1e-13)


def test_an_output_that_the_kernel_reads_again():
    """The tape saves it anyway: it may be overwritten, and still be loaded."""
    x, y, loss = real(N), real(N), real()

    @ti.kernel
    def layer():
        for i in range(N):
            y[i] = ti.exp(ti.sin(x[i]))
        for i in range(N):
            loss[None] += y[i] ** 2

    expected = 2 * np.exp(np.sin(X0)) ** 2 * np.cos(X0)
    x.from_numpy(X0)
    with ti.ad.Tape(loss) as tape:
        layer()
        y.fill(0.0)
    assert forms(tape) == (1, 0)
    assert np.allclose(x.grad.to_numpy(), expected, rtol=1e-13)
    # By hand, all of it is as it is now.
    ti.ad.clear_all_gradients()
    y.fill(3.0)
    loss.grad[None] = 1.0
    layer.grad()
    slope = 6.0 * np.exp(np.sin(X0)) * np.cos(X0)
    assert np.allclose(x.grad.to_numpy(), slope, rtol=1e-13)


def test_a_function_with_its_own_gradient():
    """It launches gradients by hand, and may change fields without the tape's knowledge."""
    network = Network()

    @ti.ad.grad_replaced
    def steps(t):
        network.layer(t, t)
        network.step(t, t)

    @ti.ad.grad_for(steps)
    def steps_grad(t):
        network.scribble(max(t - 1, 0))
        network.layer(t, t)
        network.step.grad(t, t)
        network.layer.grad(t, t)

    with ti.ad.Tape(network.loss) as tape:
        for t in range(T):
            if t % 2:
                steps(t)
            else:
                network.layer(t, t)
                network.step(t, t)
        network.measure()
    assert forms(tape) == (0, T // 2)
    expected = complex_step(lambda w: forward(w, X0), W)
    # The adjoint of the earlier `step` reads values that it wrote in reverse.
    assert not np.allclose(network.w.grad.to_numpy(), expected, rtol=1e-11)
    assert np.allclose(
        network.x.grad.to_numpy()[0],
        complex_step(lambda x: forward(W, x), X0),
        rtol=1e-11,
    )


@pytest.mark.parametrize("slots", [1, 2, T])
@pytest.mark.parametrize("checkpoint", ["periodic", "binomial", "mixed", 1, 3])
def test_recomputing_gives_the_same_bits(checkpoint, slots):
    ti.init(arch=ti.cpu, default_fp=ti.f64, deterministic=True)
    network = Network(slots)
    network.tape(lambda t: t % slots)
    network.check()
    expected = network.w.grad.to_numpy()
    network.start(X0)
    tape = network.tape(lambda t: t % slots, checkpoint=checkpoint)
    assert tape.stats().recomputed > 0
    assert np.array_equal(network.w.grad.to_numpy(), expected)
    tape.grad()
    assert np.array_equal(network.w.grad.to_numpy(), expected)


@pytest.mark.parametrize("slots", [1, T])
def test_replays(slots):
    network = Network(slots)
    tape = network.tape(lambda t: t % slots)
    for scale in [0.5, -1.0, 2.0]:
        network.start(scale * X0)
        tape.replay()
        network.check(scale * X0)


def test_launches_that_take():
    """The stored elements were used before: their adjoints end with the store."""
    x, y, loss = real(N), real(2, N), real()

    @ti.kernel
    def collect(t: ti.i32):
        for i in range(N):
            loss[None] += (i + 1) * y[t, i]

    @ti.kernel
    def store(t: ti.i32):
        for i in range(N):
            y[t, i] = ti.exp(ti.sin(x[i]))

    x.from_numpy(X0)
    y.from_numpy(np.ones((2, N)))
    with ti.ad.Tape(loss) as tape:
        collect(0)
        store(0)
        collect(0)
    weights = np.arange(1, N + 1)
    assert forms(tape) == (1, 0)
    assert np.allclose(x.grad.to_numpy(), weights * np.exp(np.sin(X0)) * np.cos(X0), rtol=1e-14)
    assert np.allclose(y.grad.to_numpy()[0], weights)


def test_a_rounded_output_is_not_loaded():
    x, low, loss = real(N), ti.field(ti.f32, shape=N), real()

    @ti.kernel
    def layer():
        for i in range(N):
            h = ti.tanh(ti.sin(x[i]))
            low[i] = ti.cast(h, ti.f32)
            loss[None] += h

    x.from_numpy(X0)
    with ti.ad.Tape(loss) as tape:
        layer()
    assert forms(tape) == (0, 0)
    expected = (1 - np.tanh(np.sin(X0)) ** 2) * np.cos(X0)
    assert np.allclose(x.grad.to_numpy(), expected, rtol=1e-14)


def test_vectors_and_their_components():
    x = ti.Vector.field(2, ti.f64, shape=N, needs_grad=True)
    y = ti.Vector.field(2, ti.f64, shape=(2, N), needs_grad=True)
    m = ti.Matrix.field(2, 2, ti.f64, shape=(2, N), needs_grad=True)
    loss = real()

    @ti.kernel
    def layer(t: ti.i32):
        for i in range(N):
            y[t, i] = ti.exp(ti.sin(x[i]))
            a = ti.tanh(x[i][0])
            b = ti.tanh(x[i][1] * x[i][0])
            m[t, i] = ti.Matrix([[a, b], [b * a, 1.0]])

    @ti.kernel
    def total(t: ti.i32):
        for i in range(N):
            loss[None] += y[t, i][0] + 2.0 * y[t, i][1]
            for k, j in ti.static(ti.ndrange(2, 2)):
                loss[None] += (1 + 2 * k + j) * m[t, i][k, j]

    start = RNG.uniform(-1, 1, (N, 2))

    def reference(x):
        a, b = np.tanh(x[:, 0]), np.tanh(x[:, 0] * x[:, 1])
        y = np.exp(np.sin(x))
        return np.sum(y[:, 0] + 2 * y[:, 1] + a + 2 * b + 3 * a * b + 4)

    x.from_numpy(start)
    with ti.ad.Tape(loss) as tape:
        layer(1)
        total(1)
    assert forms(tape) == (1, 0)
    names = tape.explain().splitlines()[0].split("stored in ")[1].split(", ")
    assert sorted(names) == ["@field_1", "@field_2"]
    assert np.allclose(x.grad.to_numpy(), complex_step(reference, start), rtol=1e-12)


def test_serial_loops():
    """Each iteration loads values that it has stored itself."""
    x, y, loss = real(N), real(2, N, 3), real()

    @ti.kernel
    def chain(t: ti.i32):
        for i in range(N):
            state = x[i]
            for k in range(3):
                state = ti.exp(ti.sin(state * x[i]))
                y[t, i, k] = state
            loss[None] += state

    def reference(x):
        state = x
        for _ in range(3):
            state = np.exp(np.sin(state * x))
        return np.sum(state)

    x.from_numpy(X0)
    with ti.ad.Tape(loss):
        chain(1)
    assert np.allclose(x.grad.to_numpy(), complex_step(reference, X0), rtol=1e-12)


@pytest.mark.parametrize("count", [0, 1, 7])
def test_results_of_loops(count):
    """Values carried by a loop are recorded or computed; values after it are loaded."""
    x, y, loss = real(N), real(2, 2, N), real()

    @ti.kernel
    def power(t: ti.i32, n: ti.i32):
        for i in range(N):
            state = 1.0
            for _ in range(n):
                state = state * ti.sin(state + x[i])
            y[t, 0, i] = state
            y[t, 1, i] = ti.exp(state)
            loss[None] += y[t, 0, i] * y[t, 1, i] ** 2

    def reference(x):
        state = np.ones(N)
        for _ in range(count):
            state = state * np.sin(state + x)
        return np.sum(state * np.exp(state) ** 2)

    x.from_numpy(X0)
    with ti.ad.Tape(loss) as tape:
        power(1, count)
    assert forms(tape) == (1, 0)
    assert np.allclose(x.grad.to_numpy(), complex_step(reference, X0), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("last", [0, 2])
def test_stores_that_a_later_iteration_repeats(last):
    """All iterations of the serial loop store to one element."""
    x, y, loss = real(N), real(2, N, 3), real()

    @ti.kernel
    def chain(t: ti.i32):
        for i in range(N):
            for k in range(3):
                h = ti.exp(ti.sin((k + 1) * x[i]))
                y[t, i, last] = h
                loss[None] += h

    x.from_numpy(X0)
    with ti.ad.Tape(loss) as tape:
        chain(1)
    assert forms(tape) == (0, 0)
    expected = complex_step(
        lambda x: sum(np.sum(np.exp(np.sin((k + 1) * x))) for k in range(3)), X0
    )
    assert np.allclose(x.grad.to_numpy(), expected, rtol=1e-12)


def test_in_place():
    """The adjoint of the argument reads the former values, and so does the rest."""
    x, w, loss = real(N), real(N), real()

    @ti.kernel
    def squash():
        for i in range(N):
            x[i] = ti.tanh(w[i] * x[i])

    @ti.kernel
    def total():
        for i in range(N):
            loss[None] += x[i] ** 2

    def reference(w):
        x = X0
        for _ in range(3):
            x = np.tanh(w * x)
        return np.sum(x * x)

    x.from_numpy(X0)
    w.from_numpy(C)
    with ti.ad.Tape(loss):
        for _ in range(3):
            squash()
        total()
    assert np.allclose(w.grad.to_numpy(), complex_step(reference, C), rtol=1e-12)


def test_tangents_of_outputs_come_from_what_they_were_computed_from():
    """`y` has no dual: a second derivative must not take it for a constant."""
    x = ti.field(ti.f64, shape=N, needs_grad=True, needs_dual=True)
    y = ti.field(ti.f64, shape=N)
    loss = ti.field(ti.f64, shape=(), needs_grad=True, needs_dual=True)

    @ti.kernel
    def layer():
        for i in range(N):
            e = ti.exp(ti.sin(x[i]))
            y[i] = e
            loss[None] += e

    x.from_numpy(X0)
    v = RNG.uniform(-1, 1, N)
    product = ti.ad.hvp(layer, loss, x, v)
    s, c, e = np.sin(X0), np.cos(X0), np.exp(np.sin(X0))
    assert np.allclose(product, (e * c * c - e * s) * v, rtol=1e-13)
