"""Launches under a tape that write tensors, most of which run without Python code of tai.

The results are compared with closed forms, with differences, and with the same launches on
`ti.ndarray`, which Python code records.
"""

import gc
import weakref

import numpy as np
import pytest
import tai as ti

from host_tensors import LIBRARIES

N = 5
VALUES = np.linspace(0.5, 1.5, N)


@ti.kernel
def square_of(x: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        y[i] = x[i] * x[i]


@ti.kernel
def mix_into(x: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        y[i] = 0.5 * y[i] + x[i] * x[i]


@ti.kernel
def sum_of(y: ti.types.ndarray(), loss: ti.template()):
    for i in range(y.shape[0]):
        loss[None] += y[i]


@ti.kernel
def fill_with(y: ti.types.ndarray(), value: ti.f64):
    for i in range(y.shape[0]):
        y[i] = value


@ti.kernel
def sum_of_products(x: ti.types.ndarray(), y: ti.types.ndarray(), loss: ti.template()):
    for i in range(x.shape[0]):
        loss[None] += x[i] * y[i]


@pytest.fixture(params=LIBRARIES, ids=lambda one: one.__name__)
def host(request):
    return request.param


@pytest.fixture
def loss():
    return ti.field(ti.f64, shape=(), needs_grad=True, name="loss")


def array_of(values):
    made = ti.ndarray(ti.f64, len(values), needs_grad=True)
    made.from_numpy(np.array(values))
    return made


def numbers(array):
    return np.array(array.to_numpy() if hasattr(array, "to_numpy") else array.detach().numpy())


def test_new_tensors_of_each_tape_need_no_python(host, loss, slow_calls):
    for n in range(3):
        x, y, z = (
            host.tensor(VALUES, True),
            host.tensor(VALUES * 0, True),
            host.tensor([0] * N, True),
        )
        with ti.ad.Tape(loss):
            square_of(x, y)
            square_of(y, z)
            sum_of(z, loss)
        np.testing.assert_allclose(numbers(x.grad), 4 * VALUES**3)
        np.testing.assert_allclose(numbers(z), VALUES**4)
        if n == 0:
            slow_calls.clear()
    assert slow_calls == []


def test_overwritten_tensors_are_restored(host, loss, slow_calls):
    def run(x, y, z):
        with ti.ad.Tape(loss) as tape:
            square_of(x, y)
            for _ in range(4):
                square_of(y, z)  # whose gradient reads the contents of y
                mix_into(z, y)
                sum_of(z, loss)
            fill_with(y, 3.0)
            mix_into(x, y)
            sum_of(y, loss)
        return tape

    x, y, z = (array_of(values) for values in (VALUES, VALUES * 0, VALUES * 0))
    run(x, y, z)
    wanted, final, value = numbers(x.grad), numbers(y), loss[None]
    for n in range(2):
        x, y, z = (host.tensor(values, True) for values in (VALUES, VALUES * 0, VALUES * 0))
        tape = run(x, y, z)
        np.testing.assert_allclose(numbers(x.grad), wanted)
        # The contents of the end of the block are there again.
        np.testing.assert_array_equal(numbers(y), final)
        assert loss[None] == pytest.approx(value)
        if n == 0:
            slow_calls.clear()
    assert slow_calls == []
    for one in (x, y, z):
        one.grad.zero_()
    tape.grad()
    np.testing.assert_allclose(numbers(x.grad), wanted)
    np.testing.assert_array_equal(numbers(y), final)
    # Forward again, from other values.
    x.detach().add_(-0.25)
    for one in (x, y, z):
        one.grad.zero_()
    loss[None] = 0
    tape.replay()
    value = loss[None]
    shifted, *others = (array_of(values) for values in (VALUES - 0.25, VALUES * 0, VALUES * 0))
    run(shifted, *others)
    np.testing.assert_allclose(numbers(x.grad), numbers(shifted.grad))
    assert value == pytest.approx(loss[None])


def test_gradients_by_finite_differences(host, loss):
    def launch(x, y):
        square_of(x, y)
        mix_into(y, x)
        mix_into(x, y)
        sum_of_products(x, y, loss)

    def value_at(values):
        loss[None] = 0
        launch(host.tensor(values), host.tensor(VALUES))
        return loss[None]

    for _ in range(2):
        x, y = host.tensor(VALUES, True), host.tensor(VALUES, True)
        with ti.ad.Tape(loss):
            launch(x, y)
    h = 1e-6
    for i in range(N):
        step = h * (np.arange(N) == i)
        slope = (value_at(VALUES + step) - value_at(VALUES - step)) / (2 * h)
        # The gradient with respect to the contents before the tape, since x is overwritten.
        assert numbers(x.grad)[i] == pytest.approx(slope, rel=1e-6)


def test_large_tensors_are_saved_by_python(host, loss, slow_calls):
    n = (1 << 17) + 1  # more than a mebibyte of f64
    for _ in range(2):
        x, y = host.tensor([1.0] * n, True), host.tensor([0.0] * n, True)
        slow_calls.clear()
        with ti.ad.Tape(loss):
            square_of(x, y)
            mix_into(x, y)
            sum_of(y, loss)
        np.testing.assert_allclose(numbers(x.grad), np.full(n, 1 + 2))
    assert slow_calls == ["mix_into"]


def test_constants_are_read_without_python(host, loss, slow_calls):
    for _ in range(2):
        x, y = host.tensor(VALUES, True), host.tensor(VALUES + 1)
        slow_calls.clear()
        with ti.ad.Tape(loss):
            sum_of_products(x, y, loss)
        np.testing.assert_allclose(numbers(x.grad), VALUES + 1)
    assert slow_calls == []
    # One that a kernel overwrites: the gradient of the first launch reads its former contents.
    x, y = host.tensor(VALUES, True), host.tensor(VALUES + 1)
    with ti.ad.Tape(loss):
        sum_of_products(x, y, loss)
        fill_with(y, 10.0)
        sum_of_products(x, y, loss)
    np.testing.assert_allclose(numbers(x.grad), VALUES + 1 + 10)


def test_views_of_one_tensor(host, loss):
    """Views share memory, and each is an object of its own."""
    whole = host.tensor(np.arange(1.0, 9.0))
    first, second, again = whole[:4], whole[4:], whole[:4]
    x = host.tensor(np.ones(4), True)
    with ti.ad.Tape(loss):
        sum_of_products(x, first, loss)
        sum_of_products(x, second, loss)
        fill_with(again, 100.0)
        sum_of_products(x, first, loss)
        sum_of_products(x, whole[2:6], loss)
    np.testing.assert_allclose(
        numbers(x.grad), [1 + 5 + 100 + 100, 2 + 6 + 100 + 100, 3 + 7 + 100 + 5, 4 + 8 + 100 + 6]
    )
    assert numbers(whole).tolist() == [100] * 4 + [5, 6, 7, 8]


def test_memory_shared_with_an_array(host, loss):
    whole = host.tensor(VALUES)
    shared = whole.detach().numpy()
    x = host.tensor(np.ones(N), True)
    with ti.ad.Tape(loss):
        fill_with(whole, 2.0)
        sum_of_products(x, shared, loss)
        fill_with(whole, 3.0)
        sum_of_products(x, whole, loss)
        fill_with(shared, 5.0)
        sum_of_products(x, whole, loss)
    np.testing.assert_allclose(numbers(x.grad), np.full(N, 2 + 3 + 5))


def test_strided_memory_is_seen(host, loss):
    """A tensor that lies in the memory of an array with strides."""
    memory = np.arange(2.0 * N)
    x = host.tensor(np.ones(N), True)
    if host.__name__ == "Torch":
        torch = pytest.importorskip("torch")
        tensor = torch.from_numpy(memory)[:N]
    else:
        tensor = host.tensor(VALUES)
        tensor.values = memory[:N]
    with ti.ad.Tape(loss):
        sum_of_products(x, memory[::2], loss)
        fill_with(tensor, 7.0)
        sum_of_products(x, memory[::2], loss)
    before = np.arange(2.0 * N)[::2]
    after = np.where(np.arange(N) * 2 < N, 7.0, before)
    np.testing.assert_allclose(numbers(x.grad), before + after)


def test_one_tensor_for_two_parameters(host, loss):
    x = host.tensor(VALUES, True)
    with ti.ad.Tape(loss):
        sum_of_products(x, x, loss)
    np.testing.assert_allclose(numbers(x.grad), 2 * VALUES)
    y = host.tensor(VALUES)
    with pytest.raises(ti.TaiRuntimeTypeError, match="overlap, and it writes to"), ti.ad.Tape(loss):
        square_of(y, y)
    with pytest.raises(ti.TaiRuntimeTypeError, match="overlap, and it writes to"), ti.ad.Tape(loss):
        square_of(y, y[:])


def test_writes_of_the_library_are_reported(host, loss):
    def tapes(change):
        for _ in range(2):  # the first launch of a kernel runs Python code in any case
            x, y = host.tensor(VALUES, True), host.tensor(VALUES * 0, True)
            with ti.ad.Tape(loss) as tape:
                square_of(x, y)
                change(x, y)
                mix_into(x, y)
                sum_of(y, loss)
            yield tape, x, y

    def change_x(x, y):
        x.detach().add_(1)

    def change_y(x, y):
        y.detach().add_(1)

    def change_gradient(x, y):
        x.grad = x.new_zeros(x.shape)

    for change in (change_x, change_y):
        with pytest.raises(ti.TaiRuntimeError, match="has recorded launches on was changed"):
            list(tapes(change))
    with pytest.raises(ti.TaiRuntimeError, match="has another gradient now"):
        list(tapes(change_gradient))
    for tape, x, y in tapes(lambda x, y: None):
        x.detach().add_(1)
        with pytest.raises(ti.TaiRuntimeError, match="changed by its library after"):
            tape.grad()
        x.grad = y.grad = None
        tape.replay()
        np.testing.assert_allclose(numbers(x.grad), 3 * (VALUES + 1))


def test_a_failed_launch_changes_no_later_gradient(host, loss):
    x, y = host.tensor(VALUES, True), host.tensor(VALUES * 0, True)
    for _ in range(2):
        x.grad.zero_()
        y.grad.zero_()
        with ti.ad.Tape(loss):
            square_of(x, y)
            with pytest.raises(ti.TaiError):
                mix_into(x, None)
            sum_of(y, loss)
        np.testing.assert_allclose(numbers(x.grad), 2 * VALUES)


@pytest.mark.parametrize("options", [{"checkpoint": "periodic"}, {"memory_budget": 1 << 20}])
def test_a_tape_that_runs_kernels_again_refuses_overwritten_tensors(host, loss, options):
    for _ in range(2):
        x, y = host.tensor(VALUES, True), host.tensor(VALUES * 0, True)
        with (
            pytest.raises(ti.TaiAutodiffError, match="a tape with checkpoints"),
            ti.ad.Tape(loss, **options),
        ):
            square_of(x, y)
            mix_into(x, y)


def test_blocks_that_are_not_recorded(host, loss):
    for _ in range(2):
        x, y, z = host.tensor(VALUES, True), host.tensor(VALUES * 0, True), host.tensor(VALUES * 0)
        with ti.ad.Tape(loss):
            square_of(x, y)
            with ti.ad.no_grad():
                fill_with(z, 4.0)
            sum_of_products(y, z, loss)
        np.testing.assert_allclose(numbers(x.grad), 8 * VALUES)


def test_a_tape_lets_go_of_tensors(host, loss):
    gone = []
    for _ in range(2):
        x, y = host.tensor(VALUES, True), host.tensor(VALUES * 0, True)
        gone = [weakref.ref(x), weakref.ref(y)]
        with ti.ad.Tape(loss) as tape:
            square_of(x, y)
            mix_into(x, y)
            sum_of(y, loss)
        del x, y
        gc.collect()
        assert all(one() is not None for one in gone)
        tape.grad()
        del tape
        gc.collect()
        assert [one() for one in gone] == [None, None]


def test_records_are_named_and_counted(host, loss):
    for _ in range(2):
        x, y = host.tensor(VALUES, True), host.tensor(VALUES * 0, True)
        with ti.ad.Tape(loss) as tape:
            square_of(x, y)
            mix_into(x, y)
            sum_of(y, loss)
        # Three launches, and the saving of y.
        assert tape.num_records == 4
        assert "host function" in tape.explain() or "square_of" in tape.explain()
