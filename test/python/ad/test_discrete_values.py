"""A value made from one with a derivative has a derivative too, or is refused."""

import numpy as np
import pytest
import tai as ti


@pytest.fixture(autouse=True)
def double_precision():
    ti.init(default_fp=ti.f64, offline_cache=False)


def _program():
    x = ti.field(ti.f64, shape=(), needs_grad=True, needs_dual=True)
    y = ti.field(ti.f64, shape=(), needs_grad=True, needs_dual=True)
    x[None] = 1.25
    return x, y


def _tape(kernel, loss):
    with ti.ad.Tape(loss):
        kernel()


def _forward(kernel, loss, param):
    with ti.ad.FwdMode(loss=loss, param=param):
        kernel()


def _both_refuse(kernel, loss, param, text):
    for run in (lambda: _tape(kernel, loss), lambda: _forward(kernel, loss, param)):
        with pytest.raises(ti.TaiAutodiffError, match=text) as error:
            run()
        assert "test_discrete_values.py" in str(error.value)


def test_bits_and_back():
    x, y = _program()

    @ti.kernel
    def square():
        bits = ti.bit_cast(x[None], ti.i64)
        same = ti.bit_cast(bits + 1, ti.f64)
        y[None] = same * same

    _both_refuse(square, y, x, "arith.bitcast")


def test_bits_that_are_stored():
    x, y = _program()
    kept = ti.field(ti.i64, shape=())

    @ti.kernel
    def store():
        kept[None] = ti.bit_cast(x[None] * x[None], ti.i64)
        y[None] = x[None]

    _both_refuse(store, y, x, "a derivative is lost")


def test_bits_that_are_loaded():
    x, y = _program()
    kept = ti.field(ti.i64, shape=())

    @ti.kernel
    def load():
        y[None] = ti.bit_cast(kept[None], ti.f64) * x[None]

    _both_refuse(load, y, x, "not followed")


def test_what_is_discrete_stays():
    x, y = _program()
    kept = ti.field(ti.i64, shape=())

    @ti.kernel
    def scaled():
        low = ti.bit_cast(x[None], ti.i64) & 7
        kept[None] = ti.bit_cast(ti.stop_grad(x[None]), ti.i64)
        factor = 3.0
        if low > 3:
            factor = 5.0
        y[None] = x[None] * factor * ti.cast(ti.cast(x[None], ti.i32), ti.f64)

    _tape(scaled, y)
    factor = 5.0 if np.float64(1.25).view(np.int64) & 7 > 3 else 3.0
    assert x.grad[None] == factor
    _forward(scaled, y, x)
    assert y.dual[None] == factor
