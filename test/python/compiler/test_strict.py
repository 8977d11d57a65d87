"""ti.init(strict=True): each operation is rounded by itself, on every target alike."""

import re

import numpy as np
import pytest
import tai as ti

from same_bits import processors

DTYPES = {ti.f32: np.float32, ti.f64: np.float64}


def run_kernel(dt, a, b, c):
    """The results of two kernels that ask for fused operations, on three arrays."""
    n = len(a)
    x, y, z = (ti.field(dt, shape=n) for _ in range(3))
    sums, roots = ti.field(dt, shape=n), ti.field(dt, shape=n)
    for field, values in ((x, a), (y, b), (z, c)):
        field.from_numpy(values)

    @ti.kernel
    def products():
        for i in x:
            sums[i] = x[i] * y[i] + z[i]

    @ti.kernel
    def chain():
        for i in x:
            roots[i] = ti.sqrt(x[i] * x[i] + y[i] * y[i]) / (1.0 + z[i] * z[i]) - x[i] * z[i]

    products()
    chain()
    return sums.to_numpy(), roots.to_numpy()


@pytest.mark.parametrize("n", [1, 33, 65537])
@pytest.mark.parametrize("dt", [ti.f32, ti.f64], ids=["f32", "f64"])
def test_bits_are_those_of_numpy(dt, n):
    """NumPy rounds each operation of its own, and so do all targets with `strict`."""
    ti.init(strict=True, default_fp=dt)
    npt = DTYPES[dt]
    rng = np.random.default_rng(n)
    a, b, c = (rng.standard_normal(n).astype(npt) for _ in range(3))
    sums, roots = run_kernel(dt, a, b, c)
    assert np.array_equal(sums, a * b + c)
    expected = np.sqrt(a * a + b * b) / (npt(1) + c * c) - a * c
    assert np.array_equal(roots, expected)


def test_gradients_are_those_of_plain_operations():
    """The adjoint of x² y + x: 1, then twice the product of x and y, each rounded."""
    ti.init(strict=True)
    n = 4099
    rng = np.random.default_rng(0)
    a, b = (rng.standard_normal(n).astype(np.float32) for _ in range(2))
    x = ti.field(ti.f32, shape=n, needs_grad=True)
    y = ti.field(ti.f32, shape=n)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)
    x.from_numpy(a)
    y.from_numpy(b)

    @ti.kernel
    def measure():
        for i in x:
            loss[None] += x[i] * x[i] * y[i] + x[i]

    with ti.ad.Tape(loss):
        measure()
    assert np.array_equal(x.grad.to_numpy(), np.float32(1) + b * a + b * a)


def test_without_it_operations_are_fused():
    """Otherwise the tests above could not fail."""
    ti.init(strict=False)
    n = 65537
    rng = np.random.default_rng(1)
    a, b, c = (rng.standard_normal(n).astype(np.float32) for _ in range(3))
    sums, _ = run_kernel(ti.f32, a, b, c)
    assert not np.array_equal(sums, a * b + c)
    exact = a.astype(np.float64) * b + c
    assert np.abs(sums - exact).max() <= np.abs(a * b + c - exact).max()


def test_a_processor_without_fused_operations():
    """Code for an older processor rounds as that one does, also where it is not strict."""
    if "x86-64" not in processors():
        pytest.skip("code for other processors is made on x86-64 alone")
    n = 65537
    rng = np.random.default_rng(2)
    a, b, c = (rng.standard_normal(n).astype(np.float32) for _ in range(3))
    ti.init(arch=ti.cpu, target_cpu="x86-64")
    sums, _ = run_kernel(ti.f32, a, b, c)
    assert np.array_equal(sums, a * b + c)


def test_processors_that_cannot_be_had():
    # No processor has both AMD's own features and Intel's own.
    reasons = []
    for name in ("abacus", "znver4", "sapphirerapids"):
        try:
            ti.init(target_cpu=name)
            ti.field(ti.f32, shape=1).fill(1)
        except ti.TaiRuntimeError as error:
            head, reason = str(error).split(f"got '{name}': ")
            assert "'target_cpu' expects native, or the name" in head
            reasons.append(reason)
    ti.init()
    assert re.match("LLVM knows no 'abacus' here, but for example", reasons[0])
    if processors():
        assert len(reasons) > 1
        assert re.match(r"its code needs '\S+', which this processor, \S+, does not", reasons[1])


@pytest.mark.parametrize("first", ["strict", "fast_math"])
def test_it_contradicts_fast_math(first):
    names = ["strict", "fast_math"] if first == "strict" else ["fast_math", "strict"]
    with pytest.raises(ti.TaiRuntimeError, match="'strict' and 'fast_math' contradict"):
        ti.init(**dict.fromkeys(names, True))
    ti.init(strict=True)
