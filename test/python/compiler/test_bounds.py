"""Indices out of range: cases that are refused before a kernel runs, and cases that must not be."""

import numpy as np
import pytest
import tai as ti

from refused_indices import refused

AXES = (ti.i, ti.ij, ti.ijk)


def fields(*shapes, dtype=None, **options):
    """A fresh program with one field for each shape, side by side in one tree."""
    ti.init(arch=ti.cpu, offline_cache=False, **options)
    made = [ti.field(dtype or ti.f64) for _ in shapes]
    for field, shape in zip(made, shapes, strict=True):
        ti.root.dense(AXES[len(shape) - 1], shape).place(field)
    return made


# Axes


def test_axes_in_another_order():
    """Indices come in the order of the letters of the axes: x has one row of four steps."""
    ti.init(arch=ti.cpu, offline_cache=False)
    x = ti.field(ti.f64, needs_grad=True)
    loss = ti.field(ti.f64, (), needs_grad=True)
    ti.root.dense(ti.l, 4).dense(ti.i, 1).place(x, x.grad)
    assert x.shape == (1, 4)

    @ti.kernel
    def step(t: ti.i32):
        x[t + 1, 0] = 2 * x[t, 0]

    @ti.kernel
    def in_order(t: ti.i32):
        x[0, t + 1] = 2 * x[0, t]

    @ti.kernel
    def end():
        loss[None] = x[0, 3]

    refused(step, 0, index="1, 0", line="x[t + 1, 0] = 2 * x[t, 0]")
    x[0, 0] = 1
    with ti.ad.Tape(loss):
        for t in range(3):
            in_order(t)
        end()
    assert loss[None] == 8 and x.grad[0, 0] == 8


# Refused


def test_store_next_to_a_field():
    x, y = fields((8,), (8,))
    y.fill(7)

    @ti.kernel
    def store(i: ti.i32):
        x[i] = 1.0

    for i in (8, 9, -1, 1 << 30, -(1 << 31)):
        refused(store, i, index=str(i), line="x[i] = 1.0")
    store(7)
    assert x[7] == 1 and (y.to_numpy() == 7).all()


def test_nothing_is_stored_by_a_launch_that_is_refused():
    x, y = fields((8,), (8,))

    @ti.kernel
    def shift(n: ti.i32):
        for i in range(n):
            y[i] = 1.0
        for i in range(n):
            x[i + 1] = 1.0

    refused(shift, 8, index="8", line="x[i + 1]")
    assert not y.to_numpy().any() and not x.to_numpy().any()
    shift(7)
    assert y.to_numpy().sum() == 7 and x.to_numpy().sum() == 7


def test_strides_dimensions_and_ranges():
    x, m = fields((16,), (4, 8))

    @ti.kernel
    def strides(n: ti.i32, by: ti.i32):
        for i in range(n):
            x[3 * i - 2 + by] += 1.0

    strides(6, 2)
    refused(strides, 7, 0, index="-2")
    refused(strides, 6, 3, index="16")

    @ti.kernel
    def rectangle(a: ti.i32, b: ti.i32, c: ti.i32, d: ti.i32):
        for i, j in ti.ndrange((a, b), (c, d)):
            m[i, j] += 1.0

    rectangle(0, 4, 0, 8)
    rectangle(3, 3, 100, 200)
    refused(rectangle, 0, 5, 0, 8, index="4, 0")
    refused(rectangle, 0, 4, -1, 8, index="0, -1")
    refused(rectangle, 2, 4, 5, 9, index="2, 8")
    assert m.to_numpy().sum() == 32


def test_serial_loops_and_steps():
    (m,) = fields((8, 8))

    @ti.kernel
    def lower(n: ti.i32):
        for i in range(n):
            for j in range(i + 1, n):
                m[i, j - i - 1] += 1.0

    lower(8)
    lower(9)
    refused(lower, 10, index="8, 0")

    @ti.kernel
    def steps(n: ti.i32):
        for i in range(8):
            for j in range(1, n, 3):
                m[i, j] += 1.0
            for j in range(n - 1, -1, -2):
                m[i, j] += 1.0

    steps(8)
    refused(steps, 9, index="0, 8")
    refused(steps, 11, index="0, 10")

    @ti.kernel
    def unrolled(i: ti.i32):
        for j in ti.static(range(3)):
            m[i + j, j] += 1.0

    unrolled(5)
    refused(unrolled, 6, index="8, 2")


def test_constants():
    (x,) = fields((8,))

    @ti.kernel
    def all_of_it():
        for i in range(8):
            x[i] = 1.0

    @ti.kernel
    def more():
        for i in range(8):
            x[i + 1] = 2.0

    all_of_it()
    refused(more, index="8", line="x[i + 1] = 2.0")
    assert (x.to_numpy() == 1).all()


def test_numbers_that_wrap_around():
    (x,) = fields((8,))

    @ti.kernel
    def plus(n: ti.i32, by: ti.i32):
        for i in range(n):
            x[i + by] = 1.0

    @ti.kernel
    def times(by: ti.i32):
        for i in range(2):
            x[i * 1073741824 + by] = 1.0

    refused(plus, 2, 2**31 - 1, index=str(2**31 - 1))
    refused(times, 0, index=str(2**30))
    assert not x.to_numpy().any()

    @ti.kernel
    def wide(lo: ti.i64, hi: ti.i64):
        for i in range(lo, hi):
            x[i - lo] = 1.0

    wide(2**32, 2**32 + 8)
    assert x.to_numpy().sum() == 8
    refused(wide, 2**32, 2**32 + 9, index="8")


def test_conditions_on_arguments():
    (x,) = fields((8,))

    @ti.kernel
    def store(i: ti.i32, on: ti.i32):
        if on > 0:
            x[i] = 1.0

    store(100, 0)
    refused(store, 100, 1, index="100")
    store(3, 1)


def test_wrong_guard():
    x, y = fields((64,), (64,))

    @ti.kernel
    def lap():
        for i in x:
            if i > 0 and i <= 63:
                y[i] = x[i - 1] + x[i + 1]

    refused(lap, index="64", line="y[i] = x[i - 1] + x[i + 1]")


# Not refused

N = 64


def stencils():
    """Kernels that stay in range, in ways that programs have of doing so."""
    x, y = fields((N,), (N,))

    @ti.kernel
    def branch():
        for i in x:
            s = 0.0
            if i > 0:
                s += x[i - 1]
            if i < N - 1:
                s += x[i + 1]
            y[i] = s

    @ti.kernel
    def both():
        for i in x:
            if i > 0 and i < N - 1:
                y[i] = x[i - 1] + x[i + 1]

    @ti.kernel
    def neither():
        for i in x:
            if i == 0 or i == N - 1:
                y[i] = 0.0
            else:
                y[i] = x[i - 1] + x[i + 1]

    @ti.kernel
    def negated():
        for i in x:
            if not (i == 0):
                y[i] = x[i - 1]

    @ti.kernel
    def clamped():
        for i in x:
            y[i] = x[ti.max(i - 1, 0)] + x[ti.min(i + 1, N - 1)]

    @ti.kernel
    def modulo():
        for i in x:
            y[i] = x[(i - 1) % N] + x[(i + N // 2) % N]

    @ti.kernel
    def select():
        for i in x:
            y[i] = x[i - 1 if i > 0 else 0] + x[ti.select(i < N - 1, i + 1, N - 1)]

    @ti.kernel
    def skip():
        for i in x:
            if i == N - 1:
                continue
            y[i] = x[i + 1]

    @ti.kernel
    def ghost():
        for i in range(-1, N + 1):
            if i < 0:
                y[0] += 1.0
            elif i >= N:
                y[N - 1] += 1.0
            else:
                y[i] += x[i]

    @ti.kernel
    def stops():
        for i in range(N):
            for k in range(1, N):
                if i + k >= N:
                    break
                y[i] += x[i + k]

    @ti.kernel
    def returns(n: ti.i32):
        for i in range(N):
            j = i
            while j < N and x[j] < 2.0:
                j += 7
            if j < N:
                y[j] = 1.0

    @ti.kernel
    def halves():
        for i in range(2 * N):
            y[i // 2] += x[i % N]

    @ti.kernel
    def checkerboard():
        for i in range(N // 2):
            y[2 * i + 1 - i % 2] = x[2 * i]

    @ti.kernel
    def data(limit: ti.f64):
        for i in x:
            if x[i] > limit:
                y[i + N] = 1.0

    @ti.kernel
    def early(n: ti.i32):
        for i in range(n):
            if i >= N:
                continue
            y[i] = x[i]

    return x, y, {
        "branch": (branch,), "both": (both,), "neither": (neither,), "negated": (negated,),
        "clamped": (clamped,), "modulo": (modulo,), "select": (select,), "skip": (skip,),
        "ghost": (ghost,), "stops": (stops,), "returns": (returns, 5), "halves": (halves,),
        "checkerboard": (checkerboard,), "data": (data, 1e9), "early": (early, 3 * N),
    }  # fmt: skip


GUARDED = [
    "branch", "both", "neither", "negated", "clamped", "modulo", "select", "skip", "ghost",
    "stops", "returns", "halves", "checkerboard", "data", "early",
]  # fmt: skip


@pytest.mark.parametrize("bounds", ["off", "check", "clamp"])
def test_guarded_stencils_are_not_refused(bounds):
    results = {}
    for mode in ("off", bounds):
        x, y, kernels = stencils() if mode == "off" else with_bounds(mode)
        assert list(kernels) == GUARDED
        for name, (kernel, *args) in kernels.items():
            x.from_numpy(np.sin(np.arange(N)))
            y.fill(0)
            kernel(*args)
            results.setdefault(name, []).append(y.to_numpy())
    for name, (before, after) in results.items():
        assert np.array_equal(before, after), name


def with_bounds(mode):
    init = ti.init
    try:
        ti.init = lambda **options: init(bounds=mode, **options)
        return stencils()
    finally:
        ti.init = init


def test_what_is_known_costs_nothing():
    """The code of a kernel that needs no check is that of one without checks."""
    codes = []
    for options in ({}, {"bounds": "check"}, {"bounds": "clamp"}, {"debug": True}):
        x, y = fields((64, 64), (64, 64), **options)

        @ti.kernel
        def lap(n: ti.i32):
            for i, j in x:
                if i > 0 and j < 63:
                    y[i, j] = x[i - 1, j] + x[i, j + 1]
            for i in range(n):
                y[i, 0] = 2 * x[i, 0]

        lap(64)
        codes.append(lap.mlir(64, stage="asm"))
    assert codes[1:] == codes[:1] * 3


# Data


def gather_program(bounds):
    ti.init(arch=ti.cpu, offline_cache=False, bounds=bounds)
    x = ti.field(ti.f64, 8, needs_grad=True)
    y = ti.field(ti.f64, 8, needs_grad=True)
    loss = ti.field(ti.f64, (), needs_grad=True)
    k = ti.field(ti.i32, 8)

    @ti.kernel
    def gather():
        for i in y:
            y[i] = x[k[i]] * (i + 1)

    @ti.kernel
    def total():
        for i in y:
            loss[None] += y[i]

    return x, y, k, loss, gather, total


def test_check_names_line_field_and_index():
    x, y, k, _, gather, _ = gather_program("check")
    x.fill(1)
    k.from_numpy(np.arange(8, dtype=np.int32))
    gather()
    assert y[7] == 8
    for wrong in (8, -1, 1 << 30):
        k[5] = wrong
        refused(gather, index=str(wrong), line="y[i] = x[k[i]] * (i + 1)")


def test_clamp_reads_the_same_element_in_the_gradient():
    x, y, k, loss, gather, total = gather_program("clamp")
    indices = np.array([0, -5, 3, 100, 7, 8, -(1 << 31), 2], dtype=np.int32)
    values = np.sin(np.arange(8) + 1.0)
    k.from_numpy(indices)
    x.from_numpy(values)
    with ti.ad.Tape(loss):
        gather()
        total()
    at = np.clip(indices, 0, 7)
    assert np.allclose(y.to_numpy(), values[at] * np.arange(1, 9))
    expected = np.zeros(8)
    np.add.at(expected, at, np.arange(1.0, 9))
    assert np.allclose(x.grad.to_numpy(), expected)


def test_clamped_iterations_meet():
    """Without a clamp, no two iterations reach one element, and a plain store would do."""
    (x,) = fields((8,), bounds="clamp")
    k = ti.field(ti.i32, 64)
    k.fill(1)

    @ti.kernel
    def scatter():
        for i in k:
            if k[i] > 0:
                x[i] += 1.0

    scatter()
    assert x.to_numpy().tolist() == [1] * 7 + [57]


@pytest.mark.parametrize("bounds", ["off", "clamp", "check"])
@pytest.mark.parametrize("number", [float("nan"), float("inf"), -float("inf"), 1e30, -1e30])
def test_floats_that_are_no_index(bounds, number):
    (x,) = fields((8,), bounds=bounds)
    p = ti.field(ti.f64, 4)
    y = ti.field(ti.f64, 4)
    x.fill(3)
    p.fill(2.5)
    p[1] = number

    @ti.kernel
    def gather():
        for i in p:
            if bounds_on or i != 1:
                y[i] = x[int(p[i])]

    bounds_on = bounds != "off"
    if bounds == "check":
        with pytest.raises(ti.TaiAssertionError, match="is no index") as caught:
            gather()
            ti.sync()
        assert "x[int(p[i])]" in str(caught.value)
    else:
        gather()
        assert y.to_numpy().tolist() == [3, 3 if bounds_on else 0, 3, 3]


def test_check_of_debug_modes():
    for options in ({"debug": True}, {"check_out_of_bound": True}):
        (x,) = fields((8,), dtype=ti.i32, **options)

        @ti.kernel
        def chase():
            for _ in range(1):
                x[x[0]] = 1

        x[0] = 9
        refused(chase, index="9")
    with pytest.raises(ti.TaiRuntimeError, match="bounds is 'off' or 'clamp' or 'check'"):
        ti.init(bounds="on")


# Arrays


@pytest.mark.parametrize("bounds", ["off", "check"])
def test_arrays(bounds):
    ti.init(arch=ti.cpu, offline_cache=False, bounds=bounds)

    @ti.kernel
    def shift(a: ti.types.ndarray(), b: ti.types.ndarray(), by: ti.i32):
        for i in range(a.shape[0]):
            b[i + by] = a[i]

    a, b = np.arange(6.0), np.zeros(8)
    shift(a, b, 2)
    assert b.tolist() == [0, 0, 0, 1, 2, 3, 4, 5]
    refused(shift, a, b, 3, index="8", line="b[i + by] = a[i]")
    refused(shift, a, b, -1, index="-1")
    shift(np.zeros(0), b, 100)

    @ti.kernel
    def vectors(a: ti.types.ndarray(dtype=ti.types.vector(2, ti.f64), ndim=1), n: ti.i32):
        for i in range(n):
            a[i] = ti.Vector([1.0, 2.0])

    v = ti.Vector.ndarray(2, ti.f64, 4)
    vectors(v, 4)
    refused(vectors, v, 5, index="4, 0")


# Sparse levels


def test_sparse_levels():
    ti.init(arch=ti.cpu, offline_cache=False)
    x = ti.field(ti.f64)
    block = ti.root.pointer(ti.i, 4)
    block.dense(ti.i, 4).place(x)

    @ti.kernel
    def activate(i: ti.i32):
        ti.activate(block, i)

    @ti.kernel
    def fill(n: ti.i32):
        for i in range(n):
            x[i] = 1.0

    @ti.kernel
    def inner():
        for i in x:
            if i < 8:
                x[i + 8] += 1.0

    activate(3)
    refused(activate, 4, index="16", line="ti.activate(block, i)")
    refused(fill, 17, index="16")
    fill(6)
    inner()
    assert x.to_numpy().tolist() == [1] * 6 + [0] * 2 + [1] * 8


# Gradients


@pytest.mark.parametrize("bounds", ["off", "check", "clamp"])
def test_gradients_of_checked_kernels(bounds):
    ti.init(arch=ti.cpu, offline_cache=False, bounds=bounds)
    x = ti.field(ti.f64, 9, needs_grad=True, needs_dual=True)
    y = ti.field(ti.f64, 8, needs_grad=True, needs_dual=True)
    loss = ti.field(ti.f64, (), needs_grad=True, needs_dual=True)

    @ti.kernel
    def smooth(n: ti.i32):
        for i in range(n):
            for k in range(2):
                y[i] += x[i + k] ** 2

    @ti.kernel
    def total(n: ti.i32):
        for i in range(n):
            loss[None] += y[i]

    values = np.cos(np.arange(9.0))
    x.from_numpy(values)
    tape = ti.ad.Tape(loss)
    with pytest.raises(ti.TaiAssertionError, match=r"index \[9\]"), ti.ad.Tape(loss):
        smooth(9)
    y.fill(0)
    with tape:
        smooth(8)
        total(8)
    expected = 4 * values
    expected[[0, 8]] /= 2
    assert np.allclose(x.grad.to_numpy(), expected)
    # An adjoint that is launched by hand.
    with pytest.raises(ti.TaiAssertionError, match="out of range"):
        smooth.grad(9)
    with ti.ad.FwdMode(loss=loss, param=x, seed=[1.0] * 9):
        y.fill(0)
        smooth(8)
        total(8)
    assert np.allclose(loss.dual[None], expected.sum())


def test_replays_check_new_arguments():
    ti.init(arch=ti.cpu, offline_cache=False)
    x = ti.field(ti.f64, 8, needs_grad=True)
    loss = ti.field(ti.f64, (), needs_grad=True)

    @ti.kernel
    def take(i: ti.i32):
        loss[None] += x[i]

    for i in range(8):
        with ti.ad.Tape(loss):
            take(i)
        assert x.grad[i] == 1
    with pytest.raises(ti.TaiAssertionError, match=r"index \[8\]"), ti.ad.Tape(loss):
        take(8)
    with ti.ad.Tape(loss):
        take(0)
    assert x.grad[0] == 1


# Emulated device


def test_on_a_device(monkeypatch):
    monkeypatch.setenv("TI_ARCH", "cuda")
    monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    x, y = fields((8,), (8,))

    @ti.kernel
    def shift(n: ti.i32):
        s = 0.0
        for i in range(n):
            y[i] = x[i + 1]
        s = y[0]
        x[0] = s

    shift(7)
    refused(shift, 8, index="8", line="y[i] = x[i + 1]")
    shift(3)
    ti.sync()


# Against NumPy


def random_program(random):
    """The text of a kernel with data-dependent and affine accesses, and its model."""
    rows, cols = random.integers(1, 6, 2)
    # Without the first, the index would follow from constants, and be refused before.
    scale, shift, back = random.choice([-2, -1, 1, 2]), *random.integers(-2, 3, 2)
    return (int(rows), int(cols)), (int(scale), int(shift), int(back))


@pytest.mark.parametrize("seed", range(6))
def test_random_programs_agree_with_numpy(seed):
    random = np.random.default_rng(seed)
    (rows, cols), (scale, shift, back) = random_program(random)
    length = int(random.integers(1, 12))
    data = random.integers(-3, max(rows, cols) + 3, length).astype(np.int32)
    weights = random.random(length)

    def build(bounds):
        ti.init(arch=ti.cpu, offline_cache=False, bounds=bounds)
        m = ti.field(ti.f64, (rows, cols))
        k = ti.field(ti.i32, length)
        w = ti.field(ti.f64, length)
        k.from_numpy(data)
        w.from_numpy(weights)

        @ti.kernel
        def run():
            for i in k:
                m[k[i], scale * k[i] + shift] += w[i]
                if k[i] > 0:
                    m[k[i] - back, 0] += 2 * w[i]

        return m, run

    def model(clip):
        expected, wrong = np.zeros((rows, cols)), False
        for k, w in zip(data.astype(int), weights, strict=True):
            at = [((k, scale * k + shift), w)] + ([((k - back, 0), 2 * w)] if k > 0 else [])
            for (a, b), amount in at:
                inside = 0 <= a < rows and 0 <= b < cols
                wrong |= not inside
                if inside or clip:
                    expected[np.clip(a, 0, rows - 1), np.clip(b, 0, cols - 1)] += amount
        return expected, wrong

    m, run = build("clamp")
    run()
    assert np.allclose(m.to_numpy(), model(True)[0])
    m, run = build("check")
    expected, wrong = model(False)
    if wrong:
        with pytest.raises(ti.TaiAssertionError, match="out of range"):
            run()
            ti.sync()
    else:
        run()
    # Components in range are stored all the same.
    assert np.allclose(m.to_numpy(), expected)


# Caches


def test_cached_code_reports_the_line_of_this_program(tmp_path):
    """Code of a kernel is found again at another line, and says that line."""
    text = """
import tai as ti

@ti.kernel
def store(x: ti.template(), i: ti.i32):
    x[i] = 1.0
"""
    lines = []
    for number, blanks in enumerate((0, 5, 0)):
        file = tmp_path / f"program{number % 2}.py"
        file.write_text("\n" * blanks + text)
        ti.init(arch=ti.cpu, offline_cache=True, offline_cache_file_path=str(tmp_path / "cache"))
        x = ti.field(ti.f64, 8)
        scope = {"__name__": "program"}
        exec(compile(file.read_text(), str(file), "exec"), scope)  # noqa: S102
        with pytest.raises(ti.TaiAssertionError, match=r"index \[9\]") as caught:
            scope["store"](x, 9)
            ti.sync()
        lines.append(str(caught.value))
    assert "program0.py:6:" in lines[0]
    assert "program1.py:11:" in lines[1]
    assert lines[2] == lines[0]


def test_arrays_that_are_clamped():
    """`boundary="clamp"` moves indices to the nearest element; the gradient goes there, too."""
    ti.init(default_fp=ti.f64)
    clamped = ti.types.ndarray(dtype=ti.f64, ndim=1, boundary="clamp")
    vectors = ti.types.ndarray(dtype=ti.types.vector(2, ti.f64), ndim=2, boundary="clamp")

    @ti.kernel
    def gather(a: clamped, b: vectors, k: ti.types.ndarray(dtype=ti.i32, ndim=1)) -> ti.f64:
        s = a[-1] + a[100]
        for i in k:
            s += 10 * a[k[i]] + b[k[i], 1 - k[i]][1]
        b[-5, 99] = ti.Vector([7.0, 8.0])
        return s

    a, b = np.array([1.0, 2, 4]), np.arange(12.0).reshape(2, 3, 2)
    k = np.array([-3, 0, 1, 2, 3, 10**9, -(2**31) + 2], np.int32)
    rows, columns = np.clip(k, 0, 1), np.clip(1 - k.astype(np.int64), 0, 2)
    wanted = 5 + 10 * a[np.clip(k, 0, 2)].sum() + b[rows, columns, 1].sum()
    assert gather(a, b, k) == wanted
    assert b[0, 2].tolist() == [7, 8]

    x = ti.ndarray(ti.f64, 3, needs_grad=True)
    x.from_numpy(a)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def measure(a: clamped):
        for i in range(5):
            loss[None] += (a[i - 1] - a[i]) ** 2 + i * a[7 * i - 3]

    with ti.ad.Tape(loss):
        measure(x)
    assert loss[None] == 45
    assert x.grad.to_numpy().tolist() == [-2, -2, 14]


def test_a_boundary_of_another_name_is_refused():
    with pytest.raises(ti.errors.TaiRuntimeTypeError, match="'unsafe' or 'clamp', but got 'wrap'"):
        ti.types.ndarray(boundary="wrap")
