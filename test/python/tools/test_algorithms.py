"""Sorting and prefix sums, and Taichi's names of arrays and of levels of a log."""

import numpy as np
import pytest
import tai as ti


@pytest.fixture(autouse=True)
def program():
    ti.init()


@pytest.mark.parametrize("count", [1, 2, 3, 7, 64, 1000])
@pytest.mark.parametrize("dtype", [ti.i32, ti.f64])
def test_sorting(count, dtype):
    generator = np.random.default_rng(count)
    numbers = generator.integers(-count, count, size=count).astype(dtype.numpy)
    keys, values = ti.field(dtype, shape=count), ti.field(ti.i32, shape=count)
    keys.from_numpy(numbers)
    values.from_numpy(np.arange(count))
    ti.algorithms.parallel_sort(keys, values)
    np.testing.assert_array_equal(keys.to_numpy(), np.sort(numbers))
    # Each value is still that of its key, and none is there twice.
    order = values.to_numpy()
    np.testing.assert_array_equal(numbers[order], keys.to_numpy())
    assert sorted(order) == list(range(count))
    keys.from_numpy(numbers)
    ti.algorithms.parallel_sort(keys)
    np.testing.assert_array_equal(keys.to_numpy(), np.sort(numbers))


@pytest.mark.parametrize("count", [1, 2, 1024, 1025, 5000])
def test_prefix_sums(count):
    numbers = np.random.default_rng(count).integers(-9, 9, size=count)
    sums = ti.algorithms.PrefixSumExecutor(count)
    for dtype in (ti.i32, ti.f64, ti.i32):
        x = ti.field(dtype, shape=count)
        x.from_numpy(numbers)
        sums.run(x)
        np.testing.assert_array_equal(x.to_numpy(), np.cumsum(numbers))


def test_gradients_of_both():
    x, y = (ti.field(ti.f64, shape=1500, needs_grad=True) for _ in range(2))
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    weights = np.random.default_rng(0).normal(size=1500)
    weight = ti.field(ti.f64, shape=1500)
    weight.from_numpy(weights)

    @ti.kernel
    def copy():
        for i in x:
            y[i] = x[i]

    @ti.kernel
    def add():
        for i in y:
            loss[None] += weight[i] * y[i]

    numbers = np.random.default_rng(1).normal(size=1500)
    x.from_numpy(numbers)
    with ti.ad.Tape(loss):
        copy()
        ti.algorithms.parallel_sort(y)
        add()
    expected = np.empty(1500)
    expected[np.argsort(numbers)] = weights
    np.testing.assert_allclose(x.grad.to_numpy(), expected)
    sums = ti.algorithms.PrefixSumExecutor(1500)
    with ti.ad.Tape(loss):
        copy()
        sums.run(y)
        add()
    np.testing.assert_allclose(x.grad.to_numpy(), np.cumsum(weights[::-1])[::-1], rtol=1e-9)


def test_what_is_no_row_of_numbers():
    square, short = ti.field(ti.i32, shape=(2, 2)), ti.field(ti.i32, shape=3)
    for call in (ti.algorithms.parallel_sort, ti.algorithms.PrefixSumExecutor(4).run):
        for wrong in (square, ti.Vector.field(2, ti.f32, shape=4), np.zeros(4)):
            with pytest.raises(ti.TaiRuntimeTypeError, match="a field of numbers with one index"):
                call(wrong)
    with pytest.raises(ti.TaiRuntimeTypeError, match="one of 4 numbers, but the field has 3"):
        ti.algorithms.PrefixSumExecutor(4).run(short)
    with pytest.raises(ti.TaiRuntimeTypeError, match="as many values as keys: 3, but got 4"):
        ti.algorithms.parallel_sort(short, ti.field(ti.i32, shape=4))


def test_arrays_by_their_elements():
    kinds = ti.ScalarNdarray, ti.VectorNdarray, ti.MatrixNdarray
    made = (
        ti.ndarray(ti.f32, 3), ti.Vector.ndarray(2, ti.f32, 3), ti.Matrix.ndarray(2, 2, ti.f32, 3),
    )  # fmt: skip
    for array, own in zip(made, kinds, strict=True):
        assert [isinstance(array, kind) for kind in kinds] == [kind is own for kind in kinds]
    assert not isinstance(np.zeros(3), ti.ScalarNdarray)
    assert ti.ScalarNdarray(ti.i32, (2, 3)).shape == (2, 3)
    assert ti.VectorNdarray(3, ti.f32, 4).element_shape == (3,)
    assert ti.MatrixNdarray(2, 3, ti.f32, 4).element_shape == (2, 3)


def test_levels_of_a_log():
    try:
        ti.set_logging_level("warn")
        assert ti.is_logging_effective("error") and not ti.is_logging_effective("info")
    finally:
        ti.set_logging_level("info")
    assert ti.is_logging_effective("info") and not ti.is_logging_effective("debug")
    with pytest.raises(ti.TaiRuntimeTypeError, match="no level 'loud'"):
        ti.set_logging_level("loud")


def test_names_that_are_missing_say_what_to_take():
    with pytest.raises(AttributeError, match="ti.ArgPack is not built in yet") as info:
        _ = ti.ArgPack
    assert info.value.__notes__ == ["hint: ti.types.argpack(…) makes the type, and that the pack"]
