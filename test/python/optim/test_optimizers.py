"""SGD and Adam on fields, arrays and sparse layouts, against NumPy."""

import pickle

import numpy as np
import pytest
import tai as ti


def adam(x, gradients, lr=0.1, betas=(0.9, 0.999), eps=1e-8):
    """The parameters after each step, in f64."""
    m, v, found = np.zeros_like(x), np.zeros_like(x), []
    for t, g in enumerate(gradients, 1):
        m = betas[0] * m + (1 - betas[0]) * g
        v = betas[1] * v + (1 - betas[1]) * g**2
        step = m / (1 - betas[0] ** t) / (np.sqrt(v / (1 - betas[1] ** t)) + eps)
        x = x - lr * step
        found.append(x)
    return found


def sgd(x, gradients, lr=0.1, momentum=0.0, nesterov=False):
    m, found = np.zeros_like(x), []
    for g in gradients:
        m = momentum * m + g
        x = x - lr * (g + momentum * m if nesterov else m)
        found.append(x)
    return found


RULES = {
    "sgd": (lambda p: ti.optim.SGD(p, lr=0.1), lambda x, g: sgd(x, g)),
    "momentum": (
        lambda p: ti.optim.SGD(p, lr=0.1, momentum=0.9),
        lambda x, g: sgd(x, g, momentum=0.9),
    ),
    "nesterov": (
        lambda p: ti.optim.SGD(p, lr=0.1, momentum=0.9, nesterov=True),
        lambda x, g: sgd(x, g, momentum=0.9, nesterov=True),
    ),
    "adam": (lambda p: ti.optim.Adam(p, lr=0.1), adam),
}


def sparse_field(dtype):
    x = ti.field(dtype)
    ti.root.pointer(ti.i, 16).dense(ti.i, 8).place(x)
    ti.root.lazy_grad()
    for i in (3, 70):
        x[i] = 0.5
    return x


KINDS = {
    "number": lambda dtype: ti.field(dtype, shape=(), needs_grad=True),
    "one": lambda dtype: ti.field(dtype, shape=1, needs_grad=True),
    "odd": lambda dtype: ti.field(dtype, shape=65537, needs_grad=True),
    "offset": lambda dtype: ti.field(dtype, shape=(3, 5), offset=(-1, 2), needs_grad=True),
    "vectors": lambda dtype: ti.Vector.field(3, dtype, shape=(4, 2), needs_grad=True),
    "vector": lambda dtype: ti.Vector.field(3, dtype, shape=(), needs_grad=True),
    "matrices": lambda dtype: ti.Matrix.field(2, 3, dtype, shape=5, needs_grad=True),
    "soa": lambda dtype: ti.Vector.field(3, dtype, shape=7, needs_grad=True, layout=ti.Layout.SOA),
    "array": lambda dtype: ti.ndarray(dtype, (3, 4), needs_grad=True),
    "array_of_vectors": lambda dtype: ti.Vector.ndarray(3, dtype, 5, needs_grad=True),
    "sparse": sparse_field,
}


def store(field, values):
    """Stores to the active elements alone."""
    if getattr(field, "snode", None) is not None and field.shape == (128,):
        for i in np.flatnonzero(values):
            field[int(i)] = values[i]
    else:
        field.from_numpy(values)


# Each layout with Adam and one of the others; each rule in both types.
CASES = [(kind, "adam", "f32") for kind in KINDS]
CASES += [(kind, "nesterov", "f64") for kind in ("odd", "soa", "array", "sparse")]
CASES += [("number", "sgd", "f32"), ("offset", "sgd", "f64"), ("vectors", "momentum", "f32")]
CASES += [("array_of_vectors", "sgd", "f32"), ("offset", "adam", "f64")]


@pytest.mark.parametrize(("kind", "rule", "dtype"), CASES)
def test_steps(kind, rule, dtype):
    ti.init()
    dtype = getattr(ti, dtype)
    x = KINDS[kind](dtype)
    make, reference = RULES[rule]
    rng = np.random.default_rng(1)
    start = x.to_numpy().astype(np.float64)
    active = start != 0 if kind == "sparse" else np.ones_like(start)
    gradients = [rng.normal(size=start.shape) * 10.0**k * active for k in (0, -2, 2, 0, 1)]
    optimizer = make([x])
    for gradient, expected in zip(gradients, reference(start, gradients), strict=True):
        store(x.grad, gradient.astype(x.dtype.numpy))
        optimizer.step()
        rounding = 3e-5 if dtype is ti.f32 else 1e-9
        np.testing.assert_allclose(
            x.to_numpy(), expected, rtol=rounding, atol=rounding * max(1, abs(expected).max())
        )
    assert optimizer.steps == 5


@pytest.mark.parametrize("rule", RULES)
def test_several_parameters_and_two_optimizers(rule):
    ti.init(cpu_max_num_threads=2)
    x = ti.field(ti.f32, shape=3, needs_grad=True)
    y = ti.Vector.field(2, ti.f64, shape=4, needs_grad=True)
    z = ti.field(ti.f32, shape=3, needs_grad=True)
    make, reference = RULES[rule]
    both, alone = make([x, y]), make(z)
    for _ in range(3):
        x.grad.fill(1)
        y.grad.fill(-2)
        z.grad.fill(1)
        both.step()
        alone.step()
    expected = reference(np.zeros(()), [np.ones(())] * 3)[-1]
    np.testing.assert_allclose(x.to_numpy(), expected, rtol=1e-5)
    np.testing.assert_array_equal(x.to_numpy(), z.to_numpy())
    np.testing.assert_allclose(
        y.to_numpy(), reference(np.zeros(()), [-2 * np.ones(())] * 3)[-1], rtol=1e-6
    )


def test_replayed_steps():
    ti.init()
    n = 50
    x = ti.field(ti.f64, shape=n, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def compute():
        for i in x:
            loss[None] += (x[i] - i) ** 2

    optimizer = ti.optim.Adam([x], lr=0.5)
    with ti.ad.Tape(loss) as tape:
        compute()
    optimizer.step()
    expected, gradients = np.zeros(n), []
    for _ in range(30):
        tape.replay()
        optimizer.step()
    for _ in range(31):
        gradients.append(2 * (expected - np.arange(n)))
        expected = adam(np.zeros(n), gradients, lr=0.5)[-1]
    np.testing.assert_allclose(x.to_numpy(), expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("rule", ["momentum", "adam"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_gradients_that_are_not_finite(rule, bad):
    ti.init()
    x = ti.field(ti.f32, shape=5, needs_grad=True)
    y = ti.field(ti.f64, shape=3, needs_grad=True, name="y")
    optimizer = RULES[rule][0]([x, y])
    x.grad.fill(1)
    y.grad.fill(1)
    optimizer.step()
    before = pickle.dumps((optimizer.state_dict()["memory"], x.to_numpy(), y.to_numpy()))
    y.grad[2] = bad
    with pytest.raises(ti.TaiAutodiffError, match=r"gradient of field 'y' is -?\w+ at \[2\]"):
        optimizer.step()
    after = pickle.dumps((optimizer.state_dict()["memory"], x.to_numpy(), y.to_numpy()))
    assert before == after
    assert (optimizer.steps, optimizer.skipped) == (1, 1)
    y.grad[2] = 1
    optimizer.step()
    np.testing.assert_allclose(
        x.to_numpy(), RULES[rule][1](np.zeros(5), [np.ones(5)] * 2)[-1], rtol=1e-5
    )


def test_skipped_steps():
    ti.init()
    x = ti.field(ti.f32, shape=5, needs_grad=True)
    optimizer = ti.optim.Adam([x], lr=0.1, nonfinite="skip")
    x.grad.fill(np.nan)
    optimizer.step()
    assert not x.to_numpy().any()
    x.grad.fill(1)
    optimizer.step()
    np.testing.assert_allclose(x.to_numpy(), -0.1, rtol=1e-5)
    assert (optimizer.steps, optimizer.skipped) == (1, 1)


@pytest.mark.parametrize("size", [1e30, 1e-30, 1e38])
def test_adam_of_huge_and_tiny_gradients(size):
    ti.init()
    x = ti.field(ti.f32, shape=4, needs_grad=True)
    optimizer = ti.optim.Adam([x], lr=0.1, eps=1e-30)
    for _ in range(3):
        x.grad.fill(size)
        optimizer.step()
    np.testing.assert_allclose(x.to_numpy(), -0.3 if size > 1 else -0.15, rtol=1e-3)


def test_step_out_of_range():
    ti.init()
    x = ti.field(ti.f32, shape=2, needs_grad=True)
    optimizer = ti.optim.SGD([x], lr=10.0, momentum=0.5)
    x.grad.from_numpy(np.array([3e38, 1.0], np.float32))
    with pytest.raises(ti.TaiRuntimeError, match="leaves the range of the type at 1 element,"):
        optimizer.step()
    assert x.to_numpy().tolist() == [0, -10]
    assert np.isfinite(optimizer.state_dict()["memory"][0]["mean"]).all()
    x.grad.fill(1)
    optimizer.step()
    assert np.isfinite(x.to_numpy()).all()


def test_half_floats():
    ti.init()
    x = ti.field(ti.f16, shape=8, needs_grad=True)
    optimizer = ti.optim.Adam([x], lr=0.25)
    x.grad.fill(1)
    optimizer.step()
    np.testing.assert_allclose(x.to_numpy(), -0.25, rtol=1e-3)


@pytest.mark.parametrize("kind", ["odd", "vectors", "array_of_vectors", "sparse"])
def test_state(kind):
    ti.init()
    x = KINDS[kind](ti.f32)
    first = ti.optim.Adam([x], lr=0.1)
    gradient = np.where(x.to_numpy() != 0, 1.0, 0.0 if kind == "sparse" else 2.0)
    store(x.grad, gradient.astype(np.float32))
    first.step()
    middle = x.to_numpy()
    state = pickle.loads(pickle.dumps(first.state_dict()))
    first.step()
    expected = x.to_numpy()
    store(x, middle)
    second = ti.optim.Adam([x], lr=0.5)
    second.load_state_dict(state)
    second.step()
    np.testing.assert_array_equal(x.to_numpy(), expected)
    assert (second.steps, second.lr) == (2, 0.1)
    if kind == "sparse":
        assert x.snode.parent(2).num_active == 2


def test_state_of_another_kind():
    ti.init()
    x = ti.field(ti.f32, shape=3, needs_grad=True)
    y = ti.field(ti.f32, shape=4, needs_grad=True)
    optimizer = ti.optim.Adam(x)
    with pytest.raises(ti.TaiRuntimeTypeError, match=r"loads the state of a ti\.optim\.Adam"):
        optimizer.load_state_dict(ti.optim.SGD(x).state_dict())
    with pytest.raises(ti.TaiRuntimeTypeError, match="parameters of other shapes"):
        optimizer.load_state_dict(ti.optim.Adam(y).state_dict())
    with pytest.raises(ti.TaiRuntimeTypeError, match="pickle its state_dict"):
        pickle.dumps(optimizer)


def test_learning_rate_changes():
    ti.init()
    x = ti.field(ti.f64, shape=2, needs_grad=True)
    optimizer = ti.optim.SGD(x, lr=1.0)
    x.grad.fill(1)
    optimizer.step()
    optimizer.lr = 0.5
    optimizer.step()
    assert x.to_numpy().tolist() == [-1.5] * 2
    optimizer.zero_grad()
    assert not x.grad.to_numpy().any()


def test_bad_arguments():
    ti.init()
    x = ti.field(ti.f32, shape=3, needs_grad=True)
    whole = ti.field(ti.i32, shape=3)
    lists = ti.field(ti.f32)
    ti.root.dense(ti.i, 2).dynamic(ti.j, 8).place(lists)
    ti.root.lazy_grad()
    x.fill(0)  # The tree is in use, so lazy_grad reaches none of the others.
    plain = ti.field(ti.f32, shape=3, name="plain")
    struct = ti.types.struct(a=ti.f32).field(shape=3)
    cases = [
        (lambda: ti.optim.Adam([]), ti.TaiRuntimeTypeError, "has no parameters"),
        (lambda: ti.optim.Adam([x, x]), ti.TaiRuntimeTypeError, "given twice"),
        (lambda: ti.optim.Adam(np.zeros(3)), ti.TaiRuntimeTypeError, "changes fields and arrays"),
        (lambda: ti.optim.Adam(struct), ti.TaiRuntimeTypeError, "changes fields and arrays"),
        (lambda: ti.optim.Adam(plain), ti.TaiAutodiffError, "'plain' has no gradient"),
        (lambda: ti.optim.Adam(whole), ti.TaiAutodiffError, "type i32"),
        (lambda: ti.optim.Adam(ti.ndarray(ti.f32, 3)), ti.TaiAutodiffError, "no gradient"),
        (lambda: ti.optim.Adam(lists), ti.TaiRuntimeError, "lies in a dynamic level"),
        (lambda: ti.optim.Adam(x, lr=-1), ti.TaiRuntimeTypeError, "lr must be"),
        (lambda: ti.optim.Adam(x, lr=np.nan), ti.TaiRuntimeTypeError, "lr must be"),
        (lambda: ti.optim.Adam(x, betas=(0.9, 1)), ti.TaiRuntimeTypeError, r"betas\[1\] must be"),
        (lambda: ti.optim.Adam(x, eps=0), ti.TaiRuntimeTypeError, "eps must be"),
        (lambda: ti.optim.SGD(x, nesterov=True), ti.TaiRuntimeTypeError, "needs a momentum"),
        (lambda: ti.optim.SGD(x, nonfinite="no"), ti.TaiRuntimeTypeError, "'raise' or 'skip'"),
    ]
    for call, error, message in cases:
        with pytest.raises(error, match=message):
            call()


def test_in_a_tape():
    ti.init()
    x = ti.field(ti.f32, shape=3, needs_grad=True, needs_dual=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True, needs_dual=True)
    optimizer = ti.optim.Adam(x)
    with pytest.raises(ti.TaiAutodiffError, match="while a tape records"), ti.ad.Tape(loss):
        optimizer.step()
    with (
        pytest.raises(ti.TaiAutodiffError, match="while forward mode is on"),
        ti.ad.FwdMode(loss, x, [1, 0, 0]),
    ):
        optimizer.step()
    optimizer.step()
