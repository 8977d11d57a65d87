"""Copies of NumPy arrays in pieces give the numbers that one call of NumPy gives."""

import numpy as np
import pytest
from tai._impl.base import pieces


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch):
    monkeypatch.setattr(pieces, "PIECE", 64)
    monkeypatch.setattr(pieces, "_MANY", 10)


def numbers(shape, dtype=np.float32):
    return np.arange(np.prod(shape, dtype=int)).reshape(shape).astype(dtype)


@pytest.mark.parametrize(
    "shape", [(), (0,), (1,), (5,), (1000,), (1, 1000), (1, 1, 700), (3, 5, 7), (300, 2), (2, 0, 9)]
)
@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int8])
def test_a_copy(shape, dtype):
    source, made = numbers(shape), np.full(shape, 99, dtype)
    pieces.copy(made, source)
    assert np.array_equal(made, source.astype(dtype))
    pieces.copy(made, 3)
    assert (made == 3).all()


def test_parts_of_arrays():
    whole, source = np.zeros((40, 30)), numbers((40, 15))
    pieces.copy(whole[:, ::2], source)
    assert np.array_equal(whole[:, ::2], source) and not whole[:, 1::2].any()
    turned = np.zeros((15, 40))
    pieces.copy(turned, source.T)
    assert np.array_equal(turned, source.T)
    assert pieces.copied(source.T).flags.c_contiguous
    assert np.array_equal(pieces.copied(source.T), source.T)


def test_a_source_with_fewer_dimensions():
    made = np.zeros((50, 3))
    pieces.copy(made, np.array([1.0, 2.0, 3.0]))
    assert (made == [1.0, 2.0, 3.0]).all()
    with pytest.raises(ValueError, match="broadcast"):
        pieces.copy(made, np.zeros(4))


def test_an_array_that_is_fit_is_itself():
    source = numbers((100,))
    assert pieces.row_major(source) is source
    assert pieces.row_major(source, np.float32) is source
    assert pieces.row_major(source, np.float64).dtype == np.float64
    assert pieces.row_major(source[::2]).flags.c_contiguous


@pytest.mark.parametrize("elements", [1, 1000])
def test_work_beside(elements):
    assert pieces.beside(lambda: 5, elements) == 5
    with pytest.raises(ZeroDivisionError):
        pieces.beside(lambda: 1 // 0, elements)
