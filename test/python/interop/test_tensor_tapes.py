"""Tapes over kernels that take tensors of a GPU, against closed forms.

On a GPU with torch these are its tensors; elsewhere stand-ins on the emulated device.
"""

import gc
import weakref

import numpy as np
import pytest
import tai as ti


@ti.kernel
def square(x: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        y[i] = x[i] * x[i]


@ti.kernel
def total(x: ti.types.ndarray(), loss: ti.template()):
    for i in range(x.shape[0]):
        loss[None] += x[i]


@ti.kernel
def triple(x: ti.types.ndarray()):
    for i in range(x.shape[0]):
        x[i] = 3 * x[i] + 1


def scalar_loss():
    return ti.field(ti.f64, shape=(), needs_grad=True, name="loss")


def array(library, values, requires_grad=True, **options):
    return library.tensor(np.array(values, np.float64), requires_grad, **options)


def test_gradient_through_two_kernels(library):
    x, y, loss = array(library, [1, 2, -3]), array(library, [0, 0, 0]), scalar_loss()
    with ti.ad.Tape(loss):
        square(x, y)
        total(y, loss)
    assert loss[None] == 14
    np.testing.assert_allclose(library.numpy(x.grad), [2, 4, -6])
    # The store ended the life of the earlier values of y.
    assert library.numpy(y.grad).tolist() == [0, 0, 0]
    assert library.numpy(y).tolist() == [1, 4, 9]


def test_the_stream_is_waited_for_and_waits(library):
    x, y, loss = array(library, [1, 2]), array(library, [0, 0]), scalar_loss()
    counts = [library.parts()]
    with ti.ad.Tape(loss) as tape:
        square(x, y)
        counts.append(library.parts())
        total(y, loss)
        counts.append(library.parts())
    counts.append(library.parts())
    x.detach().add_(2)
    x.grad.zero_()
    loss[None] = 0
    tape.replay()
    counts.append(library.parts())
    assert loss[None] == 25
    assert library.numpy(x.grad).tolist() == [6, 8]
    x.grad.add_(1)
    tape.grad()
    counts.append(library.parts())
    assert library.numpy(x.grad).tolist() == [13, 17]
    if library.torch is None:
        assert counts == sorted(set(counts))


def test_gradients_add_up_in_the_tensor(library):
    """No tape clears what belongs to torch; on the CPU neither."""
    x, loss = array(library, [1, 2]), scalar_loss()
    for n in range(1, 4):
        with ti.ad.Tape(loss):
            total(x, loss)
        assert library.numpy(x.grad).tolist() == [n, n]
    x.grad.zero_()
    with ti.ad.Tape(loss):
        total(x, loss)
    assert library.numpy(x.grad).tolist() == [1, 1]


def test_constants_have_no_gradient(library):
    x, w, loss = array(library, [1, 2]), array(library, [3, 5], False), scalar_loss()

    @ti.kernel
    def weigh(x: ti.types.ndarray(), w: ti.types.ndarray()):
        for i in range(x.shape[0]):
            loss[None] += x[i] * w[i]

    with ti.ad.Tape(loss):
        weigh(x, w)
    assert library.numpy(x.grad).tolist() == [3, 5]
    assert w.grad is None
    host = np.array([7.0, 9.0])
    x.grad.zero_()
    with ti.ad.Tape(loss):
        weigh(x, host)
    assert library.numpy(x.grad).tolist() == [7, 9]


def test_a_tensor_changed_in_place(library):
    x, loss = array(library, [1, 2, 3]), scalar_loss()
    with ti.ad.Tape(loss):
        triple(x)
        triple(x)
        total(x, loss)
    assert library.numpy(x).tolist() == [13, 22, 31]
    assert library.numpy(x.grad).tolist() == [9, 9, 9]


def test_a_tensor_that_is_written_again(library):
    """The adjoint of the first kernel reads elements that the second one overwrites."""
    x, y, z = (array(library, values) for values in ([1, 2], [0, 0], [0, 0]))
    loss = scalar_loss()

    def run():
        square(x, y)  # y = x²
        square(y, z)  # z = x⁴
        total(z, loss)
        square(z, y)  # y = x⁸
        total(y, loss)

    with ti.ad.Tape(loss) as tape:
        run()
    values = np.array([1.0, 2.0])

    def check(factor):
        expected = 4 * values**3 + 8 * values**7
        np.testing.assert_allclose(library.numpy(x.grad), factor * expected)
        np.testing.assert_allclose(library.numpy(y), values**8)  # as the kernels left it
        np.testing.assert_allclose(library.numpy(z), values**4)

    check(1)
    tape.grad()
    check(2)
    for n in range(4):
        values = np.array([1.0 + n, 0.5])
        x.detach().copy_(library.tensor(values))
        x.grad.zero_()
        tape.replay()
        check(1)
        assert loss[None] == pytest.approx((values**4 + values**8).sum())
    tape.replay(backward=False)
    np.testing.assert_allclose(library.numpy(y), values**8)


def test_long_sequences_are_replayed_as_one(library):
    """Launches on tensors and fields, and copies, replay as one sequence."""
    n, steps = 50, 12
    x = ti.field(ti.f64, shape=(steps + 1, n), needs_grad=True)
    a, loss = array(library, np.linspace(0.5, 1.5, n)), scalar_loss()

    @ti.kernel
    def step(t: ti.i32, a: ti.types.ndarray()):
        for i in range(n):
            x[t + 1, i] = x[t, i] * a[i]

    @ti.kernel
    def last():
        for i in range(n):
            loss[None] += x[steps, i]

    x.from_numpy(np.ones((steps + 1, n)))
    with ti.ad.Tape(loss) as tape:
        for t in range(steps):
            step(t, a)
        last()
    for factor in (1.0, 1.1, 0.7):
        values = factor * np.linspace(0.5, 1.5, n)
        a.detach().copy_(library.tensor(values))
        a.grad.zero_()
        tape.replay()
        np.testing.assert_allclose(loss[None], (values**steps).sum())
        np.testing.assert_allclose(library.numpy(a.grad), steps * values ** (steps - 1))
    assert "step" in tape.explain()


def test_the_tape_keeps_tensors_alive(library):
    x, loss = ti.field(ti.f64, shape=4, needs_grad=True), scalar_loss()

    @ti.kernel
    def weigh(w: ti.types.ndarray()):
        for i in range(4):
            loss[None] += w[i] * x[i] ** 2

    x.from_numpy(np.arange(4.0))
    with ti.ad.Tape(loss) as tape:
        weigh(array(library, [1, 2, 3, 4], False))
    gc.collect()
    others = [array(library, [9, 9, 9, 9], False) for _ in range(8)]
    loss[None] = 0
    tape.replay()
    assert loss[None] == 2 + 12 + 36
    assert x.grad.to_numpy().tolist() == [0, 4, 12, 24]
    assert all(library.numpy(t).tolist() == [9] * 4 for t in others)


def test_an_optimiser_that_forgets_gradients(library):
    x, loss = array(library, [1, 2]), scalar_loss()
    with ti.ad.Tape(loss) as tape:
        total(x, loss)
    x.grad = None
    tape.replay()
    assert library.numpy(x.grad).tolist() == [1, 1]
    x.grad = array(library, [0, 0], False)
    with pytest.raises(ti.TaiRuntimeError, match="has another gradient now"):
        tape.replay()


def test_changes_that_the_tape_does_not_see(library):
    x, y, loss = array(library, [1, 2]), array(library, [0, 0]), scalar_loss()
    with (
        pytest.raises(ti.TaiRuntimeError, match="has recorded launches on was changed"),
        ti.ad.Tape(loss),
    ):
        square(x, y)
        x.detach().add_(1)
        square(x, y)
    with ti.ad.Tape(loss) as tape:
        x.detach().add_(-1)  # before anything has used it
        square(x, y)
        total(y, loss)
    assert library.numpy(x.grad).tolist() == [2, 4]
    x.detach().add_(1)
    with pytest.raises(ti.TaiRuntimeError, match="after the tape had recorded") as caught:
        tape.grad()
    assert "tape.replay()" in caught.value.hint
    x.grad.zero_()
    tape.replay()
    assert library.numpy(x.grad).tolist() == [4, 6]
    tape.grad()
    assert library.numpy(x.grad).tolist() == [8, 12]


def test_a_value_that_is_gone_in_the_same_kernel(library):
    x, loss = array(library, [1, 2, 3]), scalar_loss()

    @ti.kernel
    def step(x: ti.types.ndarray()):
        for i in range(x.shape[0]):
            x[i] = x[i] * x[i]

    with pytest.raises(ti.TaiAutodiffError, match="is overwritten") as caught, ti.ad.Tape(loss):
        step(x)
        total(x, loss)
    assert caught.value.filename == __file__


def test_tensors_that_overlap(library):
    x, loss = array(library, [1, 2, 3, 4]), scalar_loss()

    @ti.kernel
    def products(x: ti.types.ndarray(), y: ti.types.ndarray()):
        for i in range(x.shape[0]):
            loss[None] += x[i] * y[i]

    with (
        pytest.raises(ti.TaiAutodiffError, match="arrays 'x' and 'y' .* overlap"),
        ti.ad.Tape(loss),
    ):
        products(x.detach()[1:], x)
    with ti.ad.Tape(loss):
        products(x, x)
    assert library.numpy(x.grad).tolist() == [2, 4, 6, 8]
    constant = x.detach()
    loss[None] = 0
    products(constant[:2], constant[1:3])
    assert loss[None] == 2 + 6


def test_parts_of_a_tensor(library):
    """A part that starts where the whole does is not the whole."""
    whole, loss = array(library, [1, 2, 3, 4], False), scalar_loss()
    y = array(library, [0, 0, 0, 0])
    w = ti.field(ti.f64, shape=4, needs_grad=True)
    w.fill(1.0)

    @ti.kernel
    def weigh(x: ti.types.ndarray(), y: ti.types.ndarray()):
        for i in range(x.shape[0]):
            y[i] += w[i] * x[i]

    with ti.ad.Tape(loss):
        weigh(whole, y)
        weigh(whole[:2], y)
        triple(whole[2:])
        triple(whole[1:])
        total(y, loss)
    assert w.grad.to_numpy().tolist() == [2, 4, 3, 4]
    assert library.numpy(whole).tolist() == [1, 7, 31, 40]


def test_a_function_with_a_gradient_of_its_own(library):
    x, y, loss = array(library, [1, 2]), array(library, [0, 0]), scalar_loss()

    @ti.ad.grad_replaced
    def run():
        square(x, y)

    @ti.ad.grad_for(run)
    def run_grad():
        square.grad(x, y)

    with ti.ad.Tape(loss):
        run()
        total(y, loss)
    # The tape has not seen the function's arrays, only that of the sum.
    assert library.numpy(x.grad).tolist() == [2, 4]


def test_less_memory(library):
    n, steps = 20, 16
    x = ti.field(ti.f64, shape=n, needs_grad=True)
    a, loss = array(library, np.full(n, 0.9)), scalar_loss()

    @ti.kernel
    def step(a: ti.types.ndarray()):
        for i in range(n):
            x[i] = ti.sin(x[i]) * a[i] + 0.5

    @ti.kernel
    def add():
        for i in range(n):
            loss[None] += x[i]

    def run(**options):
        x.from_numpy(np.linspace(0, 1, n))
        a.grad = None
        with ti.ad.Tape(loss, **options):
            for _ in range(steps):
                step(a)
            add()
        return library.numpy(a.grad)

    expected = run()
    values, tangents = np.linspace(0, 1, n), np.zeros(n)
    for _ in range(steps):
        values, tangents = (
            np.sin(values) * 0.9 + 0.5,
            np.cos(values) * tangents * 0.9 + np.sin(values),
        )
    np.testing.assert_allclose(expected, tangents, rtol=1e-12)
    for checkpoint in ("periodic", 3):
        np.testing.assert_allclose(run(checkpoint=checkpoint), expected, rtol=1e-12)


# Launches that only read arrays the tape knows


STEPS, N = 6, 5


class Scene:
    """x[t + 1] = x[t] * a + b, where a has a gradient."""

    def __init__(self, a, b):
        self.x = ti.field(ti.f64, shape=(STEPS + 1, N), needs_grad=True)
        self.a, self.b, self.loss = a, b, scalar_loss()
        x, loss = self.x, self.loss

        @ti.kernel
        def step(t: ti.i32, a: ti.types.ndarray(), b: ti.types.ndarray()):
            for i in range(N):
                x[t + 1, i] = x[t, i] * a[i] + b[i]

        @ti.kernel
        def last():
            for i in range(N):
                loss[None] += x[STEPS, i]

        self.step, self.last = step, last
        x.fill(1.0)

    def run(self):
        for t in range(STEPS):
            self.step(t, self.a, self.b)
        self.last()


def expected(a, b):
    """The loss and its gradient by a."""
    x, dx = np.ones(N), np.zeros(N)
    for _ in range(STEPS):
        x, dx = x * a + b, dx * a + x
    return x.sum(), dx


def test_later_launches_are_recorded_without_python(library, slow_calls):
    a, b = np.linspace(0.5, 1.5, N), np.linspace(0, 1, N)
    scene = Scene(array(library, a), array(library, b, False))
    for n in range(1, 4):
        with ti.ad.Tape(scene.loss) as tape:
            scene.run()
        loss, gradient = expected(a, b)
        assert scene.loss[None] == pytest.approx(loss)
        np.testing.assert_allclose(library.numpy(scene.a.grad), gradient)
        # The first launch of each tape, and those of a new kernel.
        assert slow_calls == ["step", "last"] + ["step"] * (n - 1)
        scene.a.grad = None
    a += 0.25
    scene.a.detach().add_(0.25)
    tape.replay()
    np.testing.assert_allclose(library.numpy(scene.a.grad), expected(a, b)[1])
    assert tape.num_records == STEPS + 1


def test_arrays_of_the_host_are_recorded_without_python(slow_calls):
    a, b = np.linspace(0.5, 1.5, N), np.linspace(0, 1, N)
    given = ti.ndarray(ti.f64, N, needs_grad=True)
    given.from_numpy(a)
    scene = Scene(given, b)
    for n in range(1, 3):
        with ti.ad.Tape(scene.loss):
            scene.run()
        np.testing.assert_allclose(given.grad.to_numpy(), expected(a, b)[1])
        assert slow_calls == ["step", "last"] + ["step"] * (n - 1)


def test_what_changes_between_is_seen(library, slow_calls):
    a, b = np.linspace(0.5, 1.5, N), np.linspace(0, 1, N)
    scene = Scene(array(library, a), array(library, b, False))

    @ti.kernel
    def change(b: ti.types.ndarray()):
        for i in range(N):
            b[i] = 0.5

    # A kernel changes the array: its former contents are restored for the launches before.
    with ti.ad.Tape(scene.loss):
        for t in range(STEPS):
            if t == 3:
                change(scene.b)
            scene.step(t, scene.a, scene.b)
        scene.last()
    assert slow_calls == ["step", "change", "last"]
    x, dx = np.ones(N), np.zeros(N)
    for t in range(STEPS):
        x, dx = x * a + (b if t < 3 else 0.5), dx * a + x
    np.testing.assert_allclose(library.numpy(scene.a.grad), dx)
    # By torch.
    with (
        pytest.raises(ti.TaiRuntimeError, match="has recorded launches on was changed"),
        ti.ad.Tape(scene.loss),
    ):
        scene.step(0, scene.a, scene.b)
        scene.step(1, scene.a, scene.b)
        scene.b.detach().add_(1)
        scene.step(2, scene.a, scene.b)
    # Another gradient.
    with (
        pytest.raises(ti.TaiRuntimeError, match="has another gradient now"),
        ti.ad.Tape(scene.loss),
    ):
        scene.step(0, scene.a, scene.b)
        scene.a.grad = None
        scene.step(1, scene.a, scene.b)
        scene.last()
    # Where nothing is recorded, nothing is known.
    scene.a.grad = None
    with ti.ad.Tape(scene.loss) as tape:
        scene.step(0, scene.a, scene.b)
        ti.ad.no_grad(scene.step)(5, scene.a, scene.b)
        for t in range(1, STEPS):
            scene.step(t, scene.a, scene.b)
        scene.last()
    b = library.numpy(scene.b)
    np.testing.assert_allclose(library.numpy(scene.a.grad), expected(a, b)[1])
    assert tape.num_records == STEPS + 2


def test_a_tape_lets_go_of_arrays_that_it_knew():
    class Array(np.ndarray):
        pass

    loss = scalar_loss()
    given = np.ones(3).view(Array)
    gone = weakref.ref(given)
    with ti.ad.Tape(loss) as tape:
        total(given, loss)
        total(given, loss)
    del given
    gc.collect()
    assert gone() is not None
    del tape
    gc.collect()
    assert gone() is None
