"""Gradients of arrays that kernels take as arguments, against closed forms."""

import numpy as np
import pytest
import tai as ti


@pytest.fixture(autouse=True, params=["f32", "f64"])
def precision(request):
    ti.init(default_fp=getattr(ti, request.param), offline_cache=False)
    return {"f32": 1e-5, "f64": 1e-13}[request.param]


def scalar_loss():
    return ti.field(float, shape=(), needs_grad=True, name="loss")


def array(values, **options):
    values = np.asarray(values, dtype=np.float64)
    made = ti.ndarray(float, shape=values.shape, **{"needs_grad": True, **options})
    made.from_numpy(values.astype(made.dtype.numpy))
    return made


@ti.kernel
def square(x: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        y[i] = x[i] * x[i]


@ti.kernel
def total(x: ti.types.ndarray(), loss: ti.template()):
    for i in range(x.shape[0]):
        loss[None] += x[i]


def test_an_array_has_a_gradient_of_its_kind():
    a = ti.ndarray(float, shape=(2, 3), needs_grad=True)
    assert a.grad.shape == (2, 3) and a.grad.dtype is a.dtype and a.grad.grad is None
    assert ti.ndarray(float, shape=4).grad is None
    v = ti.Vector.ndarray(3, float, shape=5, needs_grad=True)
    assert v.grad.element_shape == (3,) and v.grad.shape == (5,)
    m = ti.Matrix.ndarray(3, 2, float, shape=(2, 2), needs_grad=True)
    assert m.grad.element_shape == (3, 2)
    w = ti.types.vector(2, float).ndarray(3, needs_grad=True)
    assert w.grad.element_shape == (2,)
    assert ti.ndarray(ti.math.vec3, shape=2, needs_grad=True).grad.element_shape == (3,)


def test_gradient_through_two_kernels(precision):
    x, y, loss = array([1, 2, -3]), array([0, 0, 0]), scalar_loss()
    with ti.ad.Tape(loss):
        square(x, y)
        total(y, loss)
    np.testing.assert_allclose(x.grad.to_numpy(), [2, 4, -6], rtol=precision)
    assert loss[None] == 14
    # The store ended the life of the earlier values of y.
    assert y.grad.to_numpy().tolist() == [0, 0, 0]


def test_a_tape_clears_gradients_unless_told_otherwise():
    x, loss = array([1, 2]), scalar_loss()

    def run(clear):
        with ti.ad.Tape(loss, clear_gradients=clear):
            total(x, loss)
        return x.grad.to_numpy().tolist()

    assert run(True) == [1, 1]
    assert run(False) == [2, 2]
    assert run(True) == [1, 1]
    ti.ad.clear_all_gradients()
    assert x.grad.to_numpy().tolist() == [0, 0]


def test_an_array_as_the_loss():
    x, loss = array([1, 2, 3]), ti.ndarray(float, shape=(), needs_grad=True)

    @ti.kernel
    def sum_of_squares(x: ti.types.ndarray(), loss: ti.types.ndarray()):
        for i in range(x.shape[0]):
            loss[None] += x[i] ** 2

    for _ in range(2):
        with ti.ad.Tape(loss) as tape:
            sum_of_squares(x, loss)
        assert loss[None] == 14
        assert x.grad.to_numpy().tolist() == [2, 4, 6]
    x.from_numpy(2 * x.to_numpy())
    tape.replay()
    assert loss[None] == 56
    assert x.grad.to_numpy().tolist() == [4, 8, 12]


def test_gradient_by_hand():
    x, y = array([1, 2, 3]), array([0, 0, 0])
    square(x, y)
    y.grad.from_numpy(np.array([1, 10, 100], y.dtype.numpy))
    square.grad(x, y)
    assert x.grad.to_numpy().tolist() == [2, 40, 600]
    assert y.grad.to_numpy().tolist() == [0, 0, 0]


def test_arrays_without_gradient_are_constant():
    x, loss = array([1, 2, 3]), scalar_loss()
    weights = np.array([3, 5, 7], x.dtype.numpy)

    @ti.kernel
    def weigh(x: ti.types.ndarray(), w: ti.types.ndarray()):
        for i in range(x.shape[0]):
            loss[None] += x[i] * w[i]

    with ti.ad.Tape(loss):
        weigh(x, weights)
    assert x.grad.to_numpy().tolist() == [3, 5, 7]
    with ti.ad.Tape(loss):
        weigh(weights, x)
    assert x.grad.to_numpy().tolist() == [3, 5, 7]
    with ti.ad.Tape(loss):
        weigh(weights, weights)
    assert x.grad.to_numpy().tolist() == [0, 0, 0]


def test_iterations_that_share_elements():
    """Additions to the gradient must not get lost."""
    n = 20000
    x, loss = array(np.arange(4)), scalar_loss()
    at = (np.arange(n) % 4).astype(np.int32)

    @ti.kernel
    def gather(x: ti.types.ndarray(), at: ti.types.ndarray()):
        for i in range(at.shape[0]):
            loss[None] += x[at[i]] * (1.0 + at[i])

    with ti.ad.Tape(loss):
        gather(x, at)
    assert x.grad.to_numpy().tolist() == [n / 4 * k for k in (1, 2, 3, 4)]


def test_vectors_and_matrices(precision):
    rng = np.random.default_rng(3)
    n = 50
    v = ti.Vector.ndarray(3, float, shape=n, needs_grad=True)
    m = ti.Matrix.ndarray(2, 3, float, shape=4, needs_grad=True)
    at = rng.integers(0, 4, n).astype(np.int32)
    vs, ms = rng.normal(size=(n, 3)), rng.normal(size=(4, 2, 3))
    v.from_numpy(vs.astype(v.dtype.numpy))
    m.from_numpy(ms.astype(m.dtype.numpy))
    loss = scalar_loss()

    @ti.kernel
    def apply(v: ti.types.ndarray(), m: ti.types.ndarray(), at: ti.types.ndarray()):
        for i in range(v.shape[0]):
            w = m[at[i]] @ v[i]
            loss[None] += w.dot(w)

    with ti.ad.Tape(loss):
        apply(v, m, at)
    w = np.einsum("nij,nj->ni", ms[at], vs)
    expected_v = 2 * np.einsum("nij,ni->nj", ms[at], w)
    expected_m = np.zeros_like(ms)
    np.add.at(expected_m, at, 2 * np.einsum("ni,nj->nij", w, vs))
    tolerance = {"rtol": 100 * precision, "atol": 100 * precision}
    np.testing.assert_allclose(v.grad.to_numpy(), expected_v, **tolerance)
    np.testing.assert_allclose(m.grad.to_numpy(), expected_m, **tolerance)


def test_the_same_array_for_two_parameters(precision):
    x, loss = array([1, 2, 3, 4]), scalar_loss()

    @ti.kernel
    def neighbours(x: ti.types.ndarray(), y: ti.types.ndarray()):
        for i in range(x.shape[0] - 1):
            loss[None] += x[i] * y[i + 1]

    with ti.ad.Tape(loss):
        neighbours(x, x)
    np.testing.assert_allclose(x.grad.to_numpy(), [2, 4, 6, 3], rtol=precision)
    y = array([1, 1, 1, 1])
    with ti.ad.Tape(loss):
        neighbours(x, y)
    assert x.grad.to_numpy().tolist() == [1, 1, 1, 0]
    assert y.grad.to_numpy().tolist() == [0, 1, 2, 3]


def test_an_array_that_is_read_and_written(precision):
    """Each step reads one part of the array and overwrites the other one."""
    x, loss = array([[1, 2, 3], [0, 0, 0]]), scalar_loss()

    @ti.kernel
    def add_up(x: ti.types.ndarray()):
        for i in range(3):
            loss[None] += x[0, i] + x[1, i]

    @ti.kernel
    def step(x: ti.types.ndarray(), source: ti.template(), target: ti.template()):
        for i in range(3):
            x[target, i] = x[source, i] ** 2 + 1

    for _ in range(2):
        x.from_numpy(np.array([[1, 2, 3], [7, 8, 9]], x.dtype.numpy))
        with ti.ad.Tape(loss):
            step(x, 0, 1)
            step(x, 1, 0)
            step(x, 0, 1)
            add_up(x)
        a = np.array([1.0, 2.0, 3.0])
        b = a**2 + 1
        c = b**2 + 1
        np.testing.assert_allclose(x.to_numpy(), [c, c**2 + 1], rtol=precision)
        expected = (1 + 2 * c) * 2 * b * 2 * a
        np.testing.assert_allclose(x.grad.to_numpy(), [expected, [0, 0, 0]], rtol=precision)


def test_an_array_changed_in_place(precision):
    x, loss = array([1, 2, 3]), scalar_loss()

    @ti.kernel
    def step(x: ti.types.ndarray()):
        for i in range(x.shape[0]):
            x[i] = 3 * x[i] + 1

    with ti.ad.Tape(loss):
        step(x)
        step(x)
        total(x, loss)
    np.testing.assert_allclose(x.to_numpy(), [13, 22, 31])
    np.testing.assert_allclose(x.grad.to_numpy(), [9, 9, 9], rtol=precision)


def test_a_value_of_an_array_that_is_gone_in_the_same_kernel():
    x, loss = array([1, 2, 3]), scalar_loss()

    @ti.kernel
    def step(x: ti.types.ndarray()):
        for i in range(x.shape[0]):
            x[i] = x[i] * x[i]

    with pytest.raises(ti.TaiAutodiffError, match="is overwritten"), ti.ad.Tape(loss):
        step(x)
        total(x, loss)


def test_a_constant_ends_what_an_array_held(precision):
    x, y, loss = array([1, 2, 3]), array([0, 0, 0]), scalar_loss()

    @ti.kernel
    def clear(y: ti.types.ndarray(), n: ti.i32):
        for i in range(n):
            y[i] = 1

    with ti.ad.Tape(loss):
        square(x, y)
        clear(y, 2)
        total(y, loss)
    np.testing.assert_allclose(x.grad.to_numpy(), [0, 0, 6], rtol=precision)


def test_an_array_that_is_written_again(precision):
    """The adjoint of the first kernel reads elements that the second one overwrites."""
    x, y, z, loss = array([1, 2]), array([0, 0]), array([0, 0]), scalar_loss()
    for _ in range(2):
        with ti.ad.Tape(loss):
            square(x, y)  # y = x²
            square(y, z)  # z = x⁴
            total(z, loss)
            square(z, y)  # y = x⁸
            total(y, loss)
        values = np.array([1.0, 2.0])
        expected = 4 * values**3 + 8 * values**7
        np.testing.assert_allclose(x.grad.to_numpy(), expected, rtol=precision)
        np.testing.assert_allclose(y.to_numpy(), values**8)  # as the kernels left it


def test_gradient_in_a_kernel():
    x, loss = array([1, 2, 3]), scalar_loss()

    @ti.kernel
    def descend(x: ti.types.ndarray(), rate: float):
        for i in range(x.shape[0]):
            x[i] -= rate * x.grad[i]

    y = array([0, 0, 0])
    with ti.ad.Tape(loss):
        square(x, y)
        total(y, loss)
    descend(x, 0.25)
    assert x.to_numpy().tolist() == [0.5, 1, 1.5]


def test_a_deterministic_gradient_has_the_same_bits(request):
    ti.init(default_fp=ti.f32, deterministic=True, offline_cache=False)
    rng = np.random.default_rng(5)
    n = 30000
    x = ti.ndarray(ti.f32, shape=7, needs_grad=True)
    x.from_numpy(rng.normal(size=7).astype(np.float32))
    loss = ti.field(ti.f32, shape=(), needs_grad=True)
    at = rng.integers(0, 7, n).astype(np.int32)
    factor = rng.normal(size=n).astype(np.float32)

    @ti.kernel
    def gather(x: ti.types.ndarray(), at: ti.types.ndarray(), factor: ti.types.ndarray()):
        for i in range(at.shape[0]):
            loss[None] += ti.sin(x[at[i]] * factor[i])

    def run():
        with ti.ad.Tape(loss):
            gather(x, at, factor)
        return x.grad.to_numpy()

    first = run()
    assert all(np.array_equal(first, run()) for _ in range(5))
    expected = np.zeros(7)
    values = x.to_numpy().astype(np.float64)
    np.add.at(expected, at, factor * np.cos(values[at] * factor))
    np.testing.assert_allclose(first, expected, rtol=1e-3, atol=1e-3)


def test_torch_tensors():
    torch = pytest.importorskip("torch")
    t = torch.tensor([1.0, 2.0, 3.0], requires_grad=True)
    constant = torch.tensor([3.0, 5.0, 7.0])
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def weigh(x: ti.types.ndarray(), w: ti.types.ndarray()):
        for i in range(x.shape[0]):
            loss[None] += x[i] ** 2 * w[i]

    with ti.ad.Tape(loss):
        weigh(t, constant)
    assert t.grad.tolist() == [6, 20, 42]
    assert constant.grad is None


# What is refused


def test_needs_grad_of_whole_numbers():
    with pytest.raises(ti.TaiRuntimeTypeError, match="an array of i32 has no gradient") as caught:
        ti.ndarray(ti.i32, shape=3, needs_grad=True)
    assert "float type" in caught.value.hint


def test_a_parameter_that_needs_a_gradient():
    @ti.kernel
    def kernel(x: ti.types.ndarray(needs_grad=True)):
        for i in range(x.shape[0]):
            x[i] += 1

    kernel(array([1, 2]))
    kernel(np.ones(3))  # constant, as ever
    with pytest.raises(ti.TaiRuntimeTypeError, match="expects an array with a gradient"):
        kernel(array([1, 2], needs_grad=False))


def test_gradient_of_an_array_without_one_in_a_kernel():
    @ti.kernel
    def kernel(x: ti.types.ndarray()):
        for i in range(x.shape[0]):
            x[i] -= x.grad[i]

    with pytest.raises(ti.TaiAutodiffError, match="array 'x' has no gradient") as caught:
        kernel(np.ones(3))
    assert "needs_grad=True" in caught.value.hint
    x, loss = array([1, 2]), scalar_loss()
    kernel(x)
    with (
        pytest.raises(ti.TaiAutodiffError, match="uses the gradient of array 'x'"),
        ti.ad.Tape(loss),
    ):
        kernel(x)
    with ti.ad.Tape(loss):
        ti.ad.no_grad(kernel)(x)
        total(x, loss)
    assert x.grad.to_numpy().tolist() == [1, 1]


def test_the_gradient_cannot_be_replaced():
    x = array([1, 2])
    with pytest.raises(ti.TaiRuntimeTypeError, match="cannot be replaced"):
        x.grad = np.ones(2)


def test_arrays_that_overlap():
    x, loss = array([1, 2, 3]), scalar_loss()

    @ti.kernel
    def kernel(x: ti.types.ndarray(), y: ti.types.ndarray()):
        for i in range(x.shape[0]):
            loss[None] += x[i] * y[i]

    kernel(x, x.array)
    with (
        pytest.raises(ti.TaiAutodiffError, match="arrays 'x' and 'y' .* overlap"),
        ti.ad.Tape(loss),
    ):
        kernel(x, x.array)


def test_a_change_from_python_that_the_tape_does_not_see():
    x, y, loss = array([1, 2]), array([0, 0]), scalar_loss()
    with ti.ad.Tape(loss):
        x.fill(3)  # before anything has used it
        square(x, y)
        for change in (lambda: x.fill(0), lambda: x.from_numpy(x.to_numpy())):
            with pytest.raises(ti.TaiRuntimeError, match="changed from Python"):
                change()
        total(y, loss)
    assert x.grad.to_numpy().tolist() == [6, 6]


def test_changes_from_python_of_arrays_whose_contents_no_sweep_reads():
    """The arrays of a linear kernel, one of them only written: a replay would find the change."""

    @ti.kernel
    def double(x: ti.types.ndarray(), y: ti.types.ndarray()):
        for i in range(x.shape[0]):
            y[i] = 2 * x[i]

    x, y, loss = array([1, 2]), array([0, 0]), scalar_loss()
    with ti.ad.Tape(loss):
        double(x, y)
        for name, given in (("x", x), ("y", y)):
            for change in (lambda g=given: g.fill(0), lambda g=given: g.__setitem__(0, 7.0)):
                with pytest.raises(ti.TaiRuntimeError, match=f"'{name}'.* changed from Python"):
                    change()
        total(y, loss)
    assert y.to_numpy().tolist() == [2, 4] and x.grad.to_numpy().tolist() == [2, 2]


def test_a_loss_of_several_numbers():
    with pytest.raises(ti.TaiRuntimeTypeError, match="must be one number"):
        ti.ad.Tape(array([1, 2]))


def test_arrays_that_change_under_checkpoints():
    """Kernels that run again would find what later ones have left."""
    x, loss = array([1, 2]), scalar_loss()
    b = ti.field(float, shape=2, needs_grad=True)

    @ti.kernel
    def step(x: ti.types.ndarray()):
        for i in b:
            b[i] = ti.sin(b[i]) * x[i]

    @ti.kernel
    def feed(x: ti.types.ndarray()):
        for i in b:
            x[i] = b[i]

    @ti.kernel
    def fill(x: ti.types.ndarray()):
        for i in b:
            x[i] = 2.0

    for change in (feed, lambda x: square(x, x)):
        with (
            pytest.raises(ti.TaiAutodiffError, match="runs kernels again") as caught,
            ti.ad.Tape(loss, checkpoint="periodic"),
        ):
            step(x)
            change(x)
        assert "in a field" in caught.value.hint
    b.fill(1)
    with ti.ad.Tape(loss, checkpoint="periodic"):
        fill(x)
        for _ in range(9):
            step(x)
        ti.ad.no_grad(feed)(array([0, 0]))


def test_an_array_written_as_the_second_of_two_parameters(precision):
    """The tape keeps its earlier contents, too."""
    x, loss = array([1, 2]), scalar_loss()

    @ti.kernel
    def shift(x: ti.types.ndarray(), y: ti.types.ndarray()):
        for i in range(2):
            y[i] = 3 * x[i]

    y = array([0, 0])
    with ti.ad.Tape(loss):
        square(x, y)  # reads what x holds
        shift(x, x)
        total(x, loss)
        total(y, loss)
    np.testing.assert_allclose(x.grad.to_numpy(), [3 + 2, 3 + 4], rtol=precision)
