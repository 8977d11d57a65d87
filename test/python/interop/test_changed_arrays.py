"""Arrays, fields and numbers that change between a launch and its gradient."""

import numpy as np
import pytest
import tai as ti


@pytest.fixture(autouse=True)
def start():
    ti.init(default_fp=ti.f64, offline_cache=False)


def make_fields(n):
    x = ti.field(ti.f64, shape=n, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    x.from_numpy(np.arange(n) + 1.0)
    return x, loss


@ti.kernel
def weigh(x: ti.template(), w: ti.types.ndarray(), loss: ti.template()):
    for i in x:
        loss[None] += x[i] * w[i]


@ti.kernel
def gather(x: ti.template(), at: ti.types.ndarray(), loss: ti.template()):
    for i in range(at.shape[0]):
        loss[None] += (i + 1) * x[at[i]]


@ti.kernel
def add_all(x: ti.template(), w: ti.types.ndarray(), loss: ti.template()):
    for i in x:
        loss[None] += x[i] + w[i]


def as_ndarray(values):
    made = ti.ndarray(ti.f64, shape=values.shape)
    made.from_numpy(values)
    return made


def set_to(array, value):
    getattr(array, "array", array)[...] = value


@pytest.mark.parametrize("n", [1, 5, 65_537])
@pytest.mark.parametrize("make", [np.copy, as_ndarray, lambda v: np.repeat(v, 2)[::2]])
def test_a_constant_array_that_changes_in_the_block(n, make):
    """Each launch is differentiated with the contents of the array at that time."""
    x, loss = make_fields(n)
    w = make(np.full(n, 2.0))
    with ti.ad.Tape(loss) as tape:
        weigh(x, w, loss)
        for factor in (3.0, 5.0, 5.0, 2.0):
            set_to(w, factor)
            weigh(x, w, loss)
        set_to(w, 100)
    assert loss[None] == 17 * n * (n + 1) / 2
    assert (x.grad.to_numpy() == 17).all()
    with pytest.raises(ti.TaiRuntimeError, match="array 'w' of kernel 'weigh' was changed") as info:
        tape.replay()
    assert "of its own" in info.value.hint
    set_to(w, 2)  # its contents at the last launch
    tape.replay()
    assert loss[None] == 17 * n * (n + 1) / 2
    assert (x.grad.to_numpy() == 17).all()


@pytest.mark.parametrize("make", [np.copy, as_ndarray])
def test_a_constant_array_that_changes_after_the_block(make):
    x, loss = make_fields(3)
    w = make(np.full(3, 2.0))
    with ti.ad.Tape() as tape:
        weigh(x, w, loss)
    set_to(w, 7)
    tape.backward({loss: 1.0})
    assert (x.grad.to_numpy() == 2).all()
    loss[None] = 0
    tape.replay(backward=False)
    assert loss[None] == 7 * 6
    tape.backward({loss: 1.0})
    assert (x.grad.to_numpy() == 7).all()


def test_indices_that_change():
    x, loss = make_fields(3)
    at = np.array([0, 0, 1], np.int32)
    with ti.ad.Tape(loss):
        gather(x, at, loss)
        at[:] = 2
        gather(x, at, loss)
        at[:] = 0
    assert x.grad.to_numpy().tolist() == [3, 3, 6]


@pytest.mark.parametrize("checkpoint", [None, "periodic", 2])
def test_a_control_that_changes_in_each_step(checkpoint):
    steps = 12
    x = ti.field(ti.f64, shape=(), needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def step(u: ti.types.ndarray()):
        x[None] = ti.sin(x[None]) * u[0]

    @ti.kernel
    def measure():
        loss[None] += x[None]

    u, factors = np.ones(1), np.linspace(1, 2, steps)
    x[None] = 0.7
    with ti.ad.Tape(loss, checkpoint=checkpoint):
        for t in range(steps):
            u[:] = factors[t]
            step(u)
        measure()
    value, slope = 0.7, 1.0
    for factor in factors:
        slope *= np.cos(value) * factor
        value = np.sin(value) * factor
    np.testing.assert_allclose([loss[None], x.grad[None]], [value, slope], rtol=1e-13)


N = 6
ARRAY = ti.types.ndarray()


@ti.func
def neighbours(w: ti.template(), i):
    return w[i] * w[(i + 1) % N]


@ti.kernel
def in_a_branch(x: ti.template(), y: ti.template(), w: ARRAY):
    for i in x:
        if w[i] > 2:
            y[i] = x[i] * x[i]


@ti.kernel
def as_a_bound(x: ti.template(), y: ti.template(), w: ARRAY):
    for i in x:
        for j in range(w[i]):
            y[i] += x[i] * j


@ti.kernel
def as_an_index_of_stores(x: ti.template(), y: ti.template(), w: ARRAY):
    for i in x:
        y[w[i]] = 2 * x[i]


@ti.kernel
def as_an_index_of_constants(x: ti.template(), y: ti.template(), w: ARRAY):
    for i in x:
        if i < 2:
            y[w[i]] = 1.0


@ti.kernel
def as_an_index_of_sums(x: ti.template(), y: ti.template(), w: ARRAY):
    for i in x:
        y[w[i]] += 3 * x[i]


@ti.kernel
def as_a_power(x: ti.template(), y: ti.template(), w: ARRAY):
    for i in x:
        y[i] = x[i] ** w[i]


@ti.kernel
def in_a_recurrence(x: ti.template(), y: ti.template(), w: ARRAY):
    ti.loop_config(serialize=True)
    for i in range(1, N):
        y[i] = y[i - 1] * w[i] + x[i]


@ti.kernel
def in_a_while_loop(x: ti.template(), y: ti.template(), w: ARRAY):
    for i in x:
        s, k = x[i], w[i]
        while k > 0:
            s *= 1.5
            k -= 1
        y[i] = s


@ti.kernel
def in_a_function(x: ti.template(), y: ti.template(), w: ARRAY):
    for i in x:
        y[i] += x[i] * neighbours(w, i)


@pytest.mark.parametrize("checkpoint", [None, "periodic"])
@pytest.mark.parametrize(
    "kernel",
    [in_a_branch, as_a_bound, as_an_index_of_stores, as_an_index_of_constants, as_an_index_of_sums,
     as_a_power, in_a_recurrence, in_a_while_loop, in_a_function],
    ids=lambda kernel: getattr(kernel, "__name__", None),
)  # fmt: skip
def test_all_that_an_array_may_decide(kernel, checkpoint):
    """One array that changes gives what arrays of their own give."""
    rng = np.random.default_rng(0)
    x, y = (ti.field(ti.f64, shape=N, needs_grad=True) for _ in range(2))
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    start = rng.uniform(0.5, 1.5, (2, N))
    contents = [rng.permutation(N).astype(np.int32) for _ in range(4)]

    @ti.kernel
    def measure():
        for i in y:
            loss[None] += (i + 1) * y[i] * y[i]

    def run(is_shared):
        x.from_numpy(start[0])
        y.from_numpy(start[1])
        shared = np.zeros(N, np.int32)
        with ti.ad.Tape(loss, checkpoint=checkpoint):
            for content in contents:
                shared[:] = content
                kernel(x, y, shared if is_shared else content)
            shared[:] = 0
            measure()
        return np.concatenate([x.grad.to_numpy(), y.grad.to_numpy(), [loss[None]]])

    np.testing.assert_allclose(run(True), run(False), rtol=1e-13)


def test_an_array_whose_values_no_gradient_reads_is_not_copied():
    x, loss = make_fields(3)
    w = np.ones(3)
    with ti.ad.Tape(loss) as tape:
        add_all(x, w, loss)
        set_to(w, 4)
        add_all(x, w, loss)
    assert not tape._values.arrays._frozen and not tape._values.arrays._watched
    assert (x.grad.to_numpy() == 2).all()
    loss[None] = 0
    tape.replay()
    assert loss[None] == 2 * (6 + 12)


@ti.kernel
def square(x: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        y[i] = x[i] * x[i]


@pytest.mark.parametrize("is_loop", [False, True])
def test_what_kernels_have_written_must_stay(is_loop):
    """There is one array, and kernels write to it: the tape has no other copy."""
    x, loss = make_fields(3)

    @ti.kernel
    def fill(w: ti.types.ndarray(), value: ti.f64):
        for i in range(w.shape[0]):
            w[i] = value

    w = np.zeros(3)
    with ti.ad.Tape(loss) as tape:
        fill(w, 2.0)
        weigh(x, w, loss)
        fill(w, 3.0)
        for _ in range(2):
            weigh(x, w, loss)
    assert (x.grad.to_numpy() == 8).all()
    tape.grad()
    assert (x.grad.to_numpy() == 8).all()
    before = w.copy()
    w[1] = 7
    what = "array 'w' of kernel 'weigh' was changed after the tape had recorded"
    with pytest.raises(ti.TaiRuntimeError, match=what) as caught:
        tape.grad()
    assert "in a recorded kernel" in caught.value.hint
    tape.replay()  # fills it again
    assert (x.grad.to_numpy() == 8).all() and (w == before).all()
    tape.grad()
    for change in (lambda: set_to(w, 1), lambda: ti.ad.no_grad(fill)(w, 1.0)):
        with pytest.raises(ti.TaiRuntimeError, match=what), ti.ad.Tape(loss):
            fill(w, 2.0)
            weigh(x, w, loss)
            change()
            if is_loop:
                weigh(x, w, loss)


def test_an_array_with_a_gradient_that_changes():
    x = ti.ndarray(ti.f64, shape=3, needs_grad=True)
    y = ti.ndarray(ti.f64, shape=3, needs_grad=True)
    loss = ti.ndarray(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def total(x: ti.types.ndarray(), loss: ti.types.ndarray()):
        for i in range(x.shape[0]):
            loss[None] += x[i]

    x.fill(2)
    with ti.ad.Tape(loss) as tape:
        square(x, y)
        total(y, loss)
    x.fill(5)
    tape.grad()
    assert x.grad.to_numpy().tolist() == [4, 4, 4]
    tape.replay()
    assert x.grad.to_numpy().tolist() == [10, 10, 10]
    with (
        pytest.raises(ti.TaiRuntimeError, match="array 'x' of kernel 'square' was changed"),
        ti.ad.Tape(loss),
    ):
        square(x, y)
        x.array[:] = 3
        square(x, y)
    with ti.ad.Tape(loss):
        square(x, y)
        with pytest.raises(ti.TaiRuntimeError, match="array 'x' of kernel 'square' is changed"):
            x[0] = 1.0
        total(y, loss)
    w = ti.ndarray(ti.f64, shape=3)
    with ti.ad.Tape(loss):
        w.fill(2)
        square(w, y)
        w.fill(3)  # constant, and each launch has its own


def test_fields_that_gradients_of_results_and_arrays_read():
    """Kernels overwrite them before the sweep."""
    n = 4
    x, loss = make_fields(n)
    y = ti.ndarray(ti.f64, shape=n, needs_grad=True)

    @ti.kernel
    def to_array(y: ti.types.ndarray()):
        for i in x:
            y[i] = x[i] ** 2

    @ti.kernel
    def total(y: ti.types.ndarray()):
        for i in range(n):
            loss[None] += y[i]

    @ti.kernel
    def squares() -> ti.f64:
        s = 0.0
        for i in x:
            s += x[i] ** 2
        return s

    @ti.kernel
    def clear():
        for i in x:
            x[i] = 0

    numbers = x.to_numpy()
    with ti.ad.Tape(loss):
        to_array(y)
        clear()
        total(y)
    assert (x.grad.to_numpy() == 2 * numbers).all()
    x.from_numpy(numbers)
    with ti.ad.Tape() as tape:
        result = squares()
        x.fill(7)
        clear()
    tape.backward(result)
    assert (x.grad.to_numpy() == 2 * numbers).all()


def test_a_tensor_on_the_host():
    torch = pytest.importorskip("torch")
    x, loss = make_fields(3)
    w = torch.full((3,), 2.0, dtype=torch.float64)
    with ti.ad.Tape() as tape:
        weigh(x, w, loss)
    w.fill_(3)
    with pytest.raises(ti.TaiRuntimeError, match="changed by its library"):
        tape.backward({loss: 1.0})
