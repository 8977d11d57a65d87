"""`ti.frexp`, and the operators of `ti.lang.ops`."""

import math
import operator

import numpy as np
import pytest
import tai as ti
from tai.lang import impl, ops

VALUES = [1.0, -1.0, 0.5, 3.7, -1e-3, 1e30, 0.0, math.inf, -math.inf, math.nan, 2.0**-126, 6.0]


@pytest.mark.parametrize("dtype", [ti.f32, ti.f64], ids=["f32", "f64"])
def test_frexp(dtype):
    limits = np.finfo(dtype.numpy)
    numbers = np.array(
        [*VALUES, *np.random.default_rng(3).normal(size=50), limits.max, limits.tiny,
         limits.smallest_subnormal, 3 * limits.smallest_subnormal, 0.7 * limits.tiny],
        dtype.numpy,
    )  # fmt: skip
    n = len(numbers)
    x, m = ti.field(dtype, n), ti.field(dtype, n)
    e = ti.field(ti.i32, n)
    x.from_numpy(numbers)

    @ti.kernel
    def take_apart():
        for i in range(n):
            m[i], e[i] = ti.frexp(x[i])

    take_apart()
    mantissas, exponents = np.frexp(numbers)
    finite = np.isfinite(numbers)
    np.testing.assert_array_equal(m.to_numpy(), mantissas)
    np.testing.assert_array_equal(e.to_numpy()[finite], exponents[finite])
    assert not e.to_numpy()[~finite].any()


def test_frexp_of_vectors_and_halves():
    half = ti.field(ti.f16, shape=())
    half[None] = 6.0

    @ti.kernel
    def of_half() -> ti.math.vec2:
        m, e = ti.frexp(half[None])
        return ti.Vector([m, e])

    assert list(of_half()) == [0.75, 3]

    @ti.kernel
    def of_vector(v: ti.math.vec3) -> ti.math.vec3:
        m, e = ti.frexp(v)
        return m * ti.Vector([2.0 ** e[0], 2.0 ** e[1], 2.0 ** e[2]])

    assert list(of_vector([1.25, -3e-3, 7e5])) == [1.25, pytest.approx(-3e-3), pytest.approx(7e5)]


def test_derivative_of_frexp():
    x = ti.field(ti.f64, shape=3, needs_grad=True)
    y = ti.field(ti.f64, shape=(), needs_grad=True)
    x.from_numpy(np.array([3.0, -0.1, 1e-310]))

    @ti.kernel
    def add_mantissas():
        for i in range(2):
            m, e = ti.frexp(x[i])
            y[None] += m * (1 + e)

    with ti.ad.Tape(y):
        add_mantissas()
    # 3 = 0.75 · 2², -0.1 = -0.8 · 2⁻³
    np.testing.assert_allclose(x.grad.to_numpy(), [3 / 4, -2 * 8, 0])


def test_frexp_in_python():
    assert ti.frexp(6.0) == (0.75, 3)
    m, e = ti.frexp(ti.Vector([6.0, 0.25]))
    assert list(m) == [0.75, 0.5] and list(e) == [3, -1]
    with pytest.raises(ti.TaiTypeError, match=r"ti\.frexp takes a float, but got 'six'"):
        ti.frexp("six")


def test_frexp_of_integers_is_refused():
    @ti.kernel
    def wrong(n: ti.i32) -> ti.i32:
        _, e = ti.frexp(n)
        return e

    with pytest.raises(ti.TaiTypeError, match=r"ti\.frexp takes a float, but got a value of type"):
        wrong(3)


PAIRS = {
    "add": operator.add, "sub": operator.sub, "mul": operator.mul, "floordiv": operator.floordiv,
    "mod": operator.mod, "bit_and": operator.and_, "bit_or": operator.or_, "bit_xor": operator.xor,
    "bit_shl": operator.lshift, "bit_sar": operator.rshift, "cmp_lt": operator.lt,
    "cmp_le": operator.le, "cmp_gt": operator.gt, "cmp_ge": operator.ge, "cmp_eq": operator.eq,
    "cmp_ne": operator.ne,
}  # fmt: skip


@pytest.mark.parametrize("name", PAIRS)
def test_operators_as_functions(name):
    function, plain = getattr(ops, name), PAIRS[name]

    @ti.kernel
    def launched(a: ti.i32, b: ti.i32) -> ti.i32:
        return int(function(a, b))

    for a, b in [(13, 4), (4, 4), (-13, 3), (0, 5)]:
        assert launched(a, b) == int(plain(a, b))
        assert function(a, b) == plain(a, b)
    assert function.__doc__ and function.__name__ == name


def test_operators_of_floats_and_vectors():
    @ti.kernel
    def launched(v: ti.math.vec2, s: ti.f32) -> ti.math.vec2:
        return ops.neg(ops.truediv(ops.add(v, s), ops.mul(2.0, s)))

    assert list(launched([1.0, 3.0], 2.0)) == [-0.75, -1.25]
    assert ops.truediv(3, 2) == 1.5 and ops.neg(3) == -3
    assert list(ops.add(ti.Vector([1.0, 2.0]), 1.0)) == [2, 3]


def test_logical_operators_as_functions():
    @ti.kernel
    def launched(a: ti.i32, b: ti.i32) -> ti.i32:
        both = ops.logical_and(a, b)
        one = ops.logical_or(a, b)
        return int(ops.logical_not(a)) + 2 * int(both) + 4 * int(one)

    assert [launched(a, b) for a in (0, 2) for b in (0, 1)] == [1, 5, 4, 6]
    assert ops.logical_not(0) is True


def test_names_of_ops_are_all_there():
    assert all(callable(getattr(ops, name)) for name in ops.__all__)
    with pytest.raises(AttributeError, match="has no attribute 'addd'"):
        _ = ops.addd


def test_compute_capability(monkeypatch):
    assert isinstance(impl.get_cuda_compute_capability(), int)

    def missing(name):
        raise OSError(name)

    monkeypatch.setattr(impl.ctypes, "CDLL", missing)
    assert impl.get_cuda_compute_capability() == 0


def test_ref_names_a_replacement():
    with pytest.raises(AttributeError, match=r"ti\.ref is not built in yet") as caught:
        _ = ti.ref
    assert "pass the field as ti.template()" in str(caught.value.__notes__)
