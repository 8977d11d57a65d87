"""Whole numbers divided by zero, and the smallest by -1: defined, or an error, never the end."""

import os
import warnings
from pathlib import Path

import numpy as np
import pytest
import tai as ti

LINE = next(
    number
    for number, line in enumerate(Path(__file__).read_text().splitlines(), 1)
    if line.endswith("# LINE")
)
TYPES = ["i8", "i16", "i32", "i64", "u8", "u16", "u32", "u64"]


@pytest.fixture(params=["cpu", "device"])
def device(request, monkeypatch):
    if request.param == "device":
        monkeypatch.setenv("TI_ARCH", "cuda")
        if not os.environ.get("TAI_CUDA_EMULATION"):
            monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    ti.init(offline_cache=False)
    return request.param


def operands(dtype):
    info = np.iinfo(dtype)
    some = [0, 1, 7, info.max, info.min, info.max - 1]
    if info.min:
        some += [-1, -7, info.min + 1]
    pairs = np.array([(a, b) for a in some for b in some], dtype=dtype)
    return pairs[:, 0].copy(), pairs[:, 1].copy()


@pytest.mark.parametrize("name", TYPES)
def test_every_type(device, name: str):
    """The results of NumPy, and C's for the raw forms."""
    dtype = getattr(ti, name)
    a, b = operands(np.dtype(name.replace("i", "int").replace("u", "uint")))
    n = len(a)
    x, y = ti.field(dtype, n), ti.field(dtype, n)
    out = ti.field(dtype, (4, n))
    x.from_numpy(a)
    y.from_numpy(b)

    @ti.kernel
    def divide():
        for i in x:
            out[0, i] = x[i] // y[i]
            out[1, i] = x[i] % y[i]
            out[2, i] = ti.raw_div(x[i], y[i])
            out[3, i] = ti.raw_mod(x[i], y[i])

    divide()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        quotient, rest = np.floor_divide(a, b), np.mod(a, b)
        toward_zero = np.where((rest != 0) & ((a < 0) != (b < 0)), quotient + 1, quotient)
    found = out.to_numpy()
    assert np.array_equal(found[0], quotient)
    assert np.array_equal(found[1], rest)
    assert np.array_equal(found[2], toward_zero.astype(a.dtype))
    assert np.array_equal(found[3], np.fmod(a, np.where(b == 0, 1, b)))


def test_updates_and_vectors(device):
    x = ti.field(ti.i32, ())
    v = ti.Vector.field(3, ti.i32, ())

    @ti.kernel
    def run(n: ti.i32, m: ti.i32):
        x[None] = 7
        x[None] //= n
        x[None] += 3
        x[None] %= n
        v[None] = ti.Vector([5, 6, -7]) // ti.Vector([n, m, n])
        v[None] += ti.Vector([5, 6, -7]) % ti.Vector([n, m, n])

    run(0, 4)
    assert x[None] == 0
    assert v[None].to_numpy().tolist() == [0, 3, 0]


def test_index_expressions(device):
    """The index of an access, the bound of a loop, and the number of steps."""
    x = ti.field(ti.i32, 8)

    @ti.kernel
    def run(n: ti.i32):
        for i in x:
            x[(i * 3) % n] += 1
        for i in range(8 // n):
            x[i] += 1000
        for i, _ in ti.ndrange(8 // n, n):
            x[i] += 1000

    run(0)
    assert x.to_numpy().tolist() == [8, 0, 0, 0, 0, 0, 0, 0]


def test_gradient(device):
    """Where to read is computed again by the adjoint."""
    x = ti.field(ti.f64, 8, needs_grad=True)
    loss = ti.field(ti.f64, (), needs_grad=True)
    n = ti.field(ti.i32, 8)
    n.from_numpy(np.array([0, 1, 2, 0, 3, 0, -1, 5], np.int32))
    x.from_numpy(np.arange(1.0, 9.0))

    @ti.kernel
    def run():
        for i in x:
            s = 1.0
            for k in range(2):
                s *= x[(i + k) % n[i]] if n[i] > 0 else x[(9 // n[i] + 9) // 9]
            loss[None] += s

    with ti.ad.Tape(loss):
        run()
    # 0: x[1] twice; 1: x[0]; 2: x[0] x[1]; 3: x[1]; 4: x[1] x[2]; 5, 6: x[1], x[0]; 7: x[2] x[3]
    assert loss[None] == 4 + 1 + 2 + 4 + 6 + 4 + 1 + 12
    assert x.grad.to_numpy().tolist() == [2 + 2 + 2, 4 + 1 + 4 + 3 + 4, 2 + 4, 3, 0, 0, 0, 0]


def test_debug_mode_names_the_line(device):
    ti.init(debug=True, offline_cache=False)
    x = ti.field(ti.i32, 4)

    @ti.kernel
    def quotient(n: ti.i32):
        for i in x:
            x[i] = i // n  # LINE

    @ti.kernel
    def rest(a: ti.i64, n: ti.i64) -> ti.i64:
        return a % n

    @ti.kernel
    def guarded(n: ti.i32):
        for i in x:
            if n != 0:
                x[i] = i // n
            else:
                x[i] = 5

    with pytest.raises(ti.TaiRuntimeError, match="a whole number is divided by zero") as error:
        quotient(0)
    assert error.value.lineno == LINE
    assert "^" in str(error.value)
    quotient(2)
    assert x.to_numpy().tolist() == [0, 0, 1, 1]
    guarded(0)
    assert x.to_numpy().tolist() == [5] * 4
    with pytest.raises(ti.TaiRuntimeError, match="the smallest i64 is divided by -1"):
        rest(-(2**63), -1)
    assert rest(-(2**63), 3) == (-(2**63)) % 3


def test_debug_mode_in_adjoints(device):
    """An operation that a condition protects is not computed again without it."""
    ti.init(debug=True, default_fp=ti.f64, offline_cache=False)
    x = ti.field(ti.f64, 8, needs_grad=True)
    loss = ti.field(ti.f64, (), needs_grad=True)
    x.fill(3)

    @ti.kernel
    def run(n: ti.i32):
        for i in x:
            if n != 0:
                loss[None] += x[i % n] ** 2
            else:
                loss[None] += x[i]

    for n, expected in ((0, [1] * 8), (4, [12] * 4 + [0] * 4)):
        with ti.ad.Tape(loss):
            run(n)
        assert x.grad.to_numpy().tolist() == expected
