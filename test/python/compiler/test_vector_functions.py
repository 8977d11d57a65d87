"""Functions of vectors from glibc, which fast_math may use: within 4 units in the last place."""

import ctypes
import platform
import re

import numpy as np
import pytest
import tai as ti


@pytest.fixture(autouse=True)
def library():
    if platform.machine() != "x86_64":
        pytest.skip("glibc has none for this processor that are used")
    try:
        ctypes.CDLL("libmvec.so.1")
    except OSError:
        pytest.skip("this glibc has no libmvec")


@pytest.mark.parametrize("name", ["sin", "cos", "exp", "log", "pow"])
@pytest.mark.parametrize("dtype", [ti.f32, ti.f64])
@pytest.mark.parametrize("fast", [True, False])
def test_loops_call_them_under_fast_math(name, dtype, fast):
    """A call for each element takes ten times as long."""
    ti.init(arch=ti.cpu, fast_math=fast, default_fp=dtype)
    n = 1037
    x, y = ti.field(dtype, n), ti.field(dtype, n)
    values = np.random.default_rng(1).uniform(0.1, 20, n)
    x.from_numpy(values.astype(x.to_numpy().dtype))
    function = getattr(ti, name)

    @ti.kernel
    def apply():
        for i in x:
            y[i] = function(x[i], 2.3) if ti.static(name == "pow") else function(x[i])

    apply()
    # In f32 there are polynomials for exp and log, which are arithmetic.
    polynomial = dtype == ti.f32 and name in ("exp", "log")
    calls = re.search(r"call .* <\d+ x \w+> @_ZGV", apply.mlir(stage="llvmir"))
    assert bool(calls) == (fast and not polynomial)
    exact = x.to_numpy().astype(np.float64)
    exact = exact**2.3 if name == "pow" else getattr(np, name)(exact)
    result = y.to_numpy()
    assert np.all(np.abs(result - exact) <= 4.5 * np.spacing(np.abs(exact).astype(result.dtype)))
