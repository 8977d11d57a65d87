"""Functions of vectors: of glibc, within 4 units in the last place, under fast_math, else of SLEEF
and the runtime, whose results test/unit/CodeGen/Passes/VectorMathTest.cpp looks at."""

import ctypes
import math
import platform
import re

import numpy as np
import pytest
import tai as ti


def need(library: str) -> None:
    if platform.machine() != "x86_64":
        pytest.skip("there are none for this processor that are used")
    try:
        ctypes.CDLL(library)
    except OSError:
        pytest.skip(f"no {library} here")


@pytest.mark.parametrize("name", ["sin", "cos", "exp", "log", "pow"])
@pytest.mark.parametrize("dtype", [ti.f32, ti.f64])
@pytest.mark.parametrize("fast", [True, False])
def test_loops_call_them_under_fast_math(name, dtype, fast):
    """A call for each element takes ten times as long."""
    need("libmvec.so.1")
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
    # Powers of f32 by the runtime take two thirds of the time of glibc's.
    ours = dtype == ti.f32 and name == "pow"
    code = apply.mlir(stage="llvmir")
    calls = re.search(r"call .* <\d+ x \w+> @_ZGV", code)
    assert bool(calls) == (fast and not polynomial and not ours)
    assert not ours or re.search(r"call .*<\d+ x float> @tai_wide_pow_", code)
    exact = x.to_numpy().astype(np.float64)
    exact = exact**2.3 if name == "pow" else getattr(np, name)(exact)
    result = y.to_numpy()
    assert np.all(np.abs(result - exact) <= 4.5 * np.spacing(np.abs(exact).astype(result.dtype)))


def forms_called(function, **options) -> set[str]:
    """The vector forms that a loop over f64 calls."""
    ti.init(arch=ti.cpu, default_fp=ti.f64, target_cpu="x86-64-v3", **options)
    x, y = ti.field(ti.f64, 1037), ti.field(ti.f64, 1037)

    @ti.kernel
    def apply():
        for i in x:
            y[i] = function(x[i])

    text = apply.mlir(stage="llvmir")
    return set(re.findall(r"call .*<\d+ x double> @(Sleef_\w+|tai_wide_\w+)\(", text))


def test_default_deterministic_and_accurate_loops_call_those_of_sleef():
    need("libsleef.so.3")
    assert forms_called(ti.acos) == {"Sleef_finz_acosd4_u10avx2"}
    assert forms_called(ti.acos, deterministic=True) == {"Sleef_finz_acosd4_u10avx2"}
    assert forms_called(ti.math.expm1, math="accurate") == {"Sleef_finz_expm1d4_u10avx2"}


@pytest.mark.parametrize("name", ["sin", "cos", "exp"])
@pytest.mark.parametrize("options", [{}, {"deterministic": True}, {"math": "accurate"}], ids=str)
def test_loops_over_f64_call_those_of_the_runtime(name, options):
    if platform.machine() != "x86_64":
        pytest.skip("there are none for this processor that are used")
    assert forms_called(getattr(ti, name), **options) == {f"tai_wide_{name}_f64_4"}


@pytest.mark.parametrize("name", ["asin", "acos", "tanh"])
def test_fast_loops_call_those_that_glibc_has_not(name):
    """Else fast code would call libm for each element, several times slower than the default."""
    need("libsleef.so.3")
    assert forms_called(getattr(ti, name), fast_math=True) == {f"Sleef_finz_{name}d4_u10avx2"}


@pytest.mark.parametrize("dtype", [ti.f32, ti.f64])
def test_fast_arctangents_of_two(dtype):
    need("libsleef.so.3")
    ti.init(arch=ti.cpu, fast_math=True, default_fp=dtype)
    n = 1037
    x, y, z = (ti.field(dtype, n) for _ in range(3))
    kind = x.to_numpy().dtype
    values = np.random.default_rng(1).uniform(-3, 3, (2, n)).astype(kind)
    x.from_numpy(values[0])
    y.from_numpy(values[1])

    @ti.kernel
    def apply():
        for i in x:
            z[i] = ti.atan2(x[i], y[i])

    apply()
    assert re.search(r"call .*<\d+ x \w+> @Sleef_finz_atan2", apply.mlir(stage="llvmir"))
    exact = np.arctan2(*values.astype(np.float64))
    assert np.all(np.abs(z.to_numpy() - exact) <= 4 * np.spacing(np.abs(exact).astype(kind)))


@pytest.mark.parametrize("options", [{"fast_math": True}, {"math": "strict"}, {"opt_level": 0}])
def test_others_do_not(options):
    need("libsleef.so.3")
    assert not forms_called(ti.sin, **options)


def test_older_processors_call_libm():
    ti.init(arch=ti.cpu, default_fp=ti.f64, target_cpu="x86-64")
    x = ti.field(ti.f64, 1037)

    @ti.kernel
    def apply():
        for i in x:
            x[i] = ti.sin(x[i])

    code = apply.mlir(stage="llvmir")
    assert "Sleef" not in code and "tai_wide" not in code


def test_both_kinds_of_kernel_in_one_program():
    """A strict kernel beside a default one keeps the bits of libm, and its gradient, too."""
    need("libsleef.so.3")
    ti.init(arch=ti.cpu, default_fp=ti.f64)
    x = ti.field(ti.f64, 1037, needs_grad=True)
    y = ti.field(ti.f64, (2, 1037))
    loss = ti.field(ti.f64, (), needs_grad=True)
    values = np.random.default_rng(3).uniform(-9, 9, 1037)
    x.from_numpy(values)

    @ti.kernel(math="strict")
    def strict():
        for i in x:
            y[0, i] = ti.sin(x[i])
            loss[None] += ti.sin(x[i])

    @ti.kernel
    def default():
        for i in x:
            y[1, i] = ti.sin(x[i])

    with ti.ad.Tape(loss):
        strict()
    default()
    by_libm = np.array([math.sin(v) for v in values])
    np.testing.assert_array_equal(y.to_numpy()[0], by_libm)
    np.testing.assert_array_equal(x.grad.to_numpy(), [math.cos(v) for v in values])
    np.testing.assert_allclose(y.to_numpy()[1], by_libm, rtol=3e-16)


@pytest.mark.parametrize("dt", [ti.f32, ti.f64, ti.i32], ids=str)
def test_loops_that_draw_are_vectors(dt):
    if platform.machine() != "x86_64":
        pytest.skip("names an x86 processor")
    ti.init(arch=ti.cpu, target_cpu="x86-64-v3")
    x = ti.field(dt, shape=1000)

    @ti.kernel
    def draw():
        for i in x:
            x[i] = ti.random(dt)

    draw()
    code = draw.mlir(stage="llvmir")
    assert "tai_rt_random" not in code
    assert re.search(r"mul nuw <\d+ x i64>", code)


@pytest.mark.parametrize("name", ["sinh", "cosh"])
@pytest.mark.parametrize("dtype", [ti.f32, ti.f64])
@pytest.mark.parametrize("mode", ["default", "accurate", "strict", "fast"])
def test_results_next_to_the_largest_number_are_finite(name, dtype, mode):
    """The exponential overflows a factor of two before them; so for the gradient."""
    ti.init(arch=ti.cpu, math=mode, default_fp=dtype)
    real = np.float32 if dtype == ti.f32 else np.float64
    n = 1037
    x = ti.field(dtype, n, needs_grad=True)
    y = ti.field(dtype, n, needs_grad=True)
    loss = ti.field(dtype, (), needs_grad=True)
    end = 89.415 if dtype == ti.f32 else 710.4758
    values = np.concatenate([np.linspace(-end, end, n - 200), np.linspace(end - 1, end, 200)])
    x.from_numpy(values.astype(real))
    function = getattr(ti, name)

    @ti.kernel
    def apply():
        for i in x:
            y[i] = function(x[i])

    @ti.kernel
    def add():
        for i in x:
            loss[None] += 1e-10 * y[i]

    with ti.ad.Tape(loss):
        apply()
        add()
    at = x.to_numpy().astype(np.longdouble)
    slope = "cosh" if name == "sinh" else "sinh"
    for found, exact in ((y, getattr(np, name)(at)), (x.grad, getattr(np, slope)(at) * 1e-10)):
        np.testing.assert_allclose(found.to_numpy(), exact, rtol=4 * np.finfo(real).eps)
