"""precision, sums, math, ftz and adjoints: of ti.init and of @ti.kernel."""

import math
import os
from fractions import Fraction

import numpy as np
import pytest
import tai as ti

NPT = {ti.f32: np.float32, ti.f64: np.float64}


def skip_on_gpu(why):
    if os.environ.get("TI_ARCH") == "cuda":
        pytest.skip(why)


@pytest.fixture
def on_cpu():
    skip_on_gpu("a GPU has no such mode: test_what_a_gpu_cannot_do")


def conditioned(n, npt, condition, seed=0):
    """Numbers whose sum is smaller than that of their sizes by `condition`, and their sum."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(0.5, 1.5, n // 2).astype(npt)
    values = np.concatenate([x, -x])
    wanted = np.abs(values).sum(dtype=np.float64) / condition
    values = np.append(values, npt(wanted))
    rng.shuffle(values)
    return values, float(sum(map(Fraction, map(float, values[values == npt(wanted)]))))


def sum_of(values, dt, **modes):
    n = len(values)
    x, s = ti.field(dt, shape=n), ti.field(dt, shape=())

    @ti.kernel(**modes)
    def add():
        for i in x:
            s[None] += x[i]

    x.from_numpy(values)
    add()
    return float(s[None])


@pytest.mark.parametrize("n", [3, 100, 65537, 1_000_001])
@pytest.mark.parametrize("where", ["context", "kernel"])
def test_compensated_sums_of_f32(n, where):
    """At condition 1e6 they are right to the last place of f32."""
    modes = {"sums": "compensated"}
    ti.init(arch=ti.cpu, **(modes if where == "context" else {}))
    values, exact = conditioned(n, np.float32, 1e6)
    got = sum_of(values, ti.f32, **(modes if where == "kernel" else {}))
    assert abs(got - exact) <= 1e-7 * abs(exact)


def test_default_sums_are_not_compensated():
    """Otherwise the test above could not fail."""
    skip_on_gpu("a GPU adds up f32 in f64")
    ti.init(arch=ti.cpu)
    values, exact = conditioned(1_000_001, np.float32, 1e6)
    assert abs(sum_of(values, ti.f32) - exact) > 1e-6 * abs(exact)


@pytest.mark.parametrize("n", [3, 65537, 300_001])
def test_compensated_sums_of_f64(n):
    """At condition 1e14, where plain f64 keeps one or two digits."""
    ti.init(arch=ti.cpu, sums="compensated")
    values, exact = conditioned(n, np.float64, 1e14)
    assert abs(sum_of(values, ti.f64) - exact) <= 1e-13 * abs(exact)


@pytest.mark.parametrize("shape", [(3, 1100), (700, 90), (40, 33), (5, 2, 64), (9000, 2)])
@pytest.mark.parametrize("length", ["known", "run-time"])
def test_compensated_sums_of_f64_over_rows(shape, length):
    """Rows that end within a block of terms, with terms that not all cells have, and several."""
    ti.init(arch=ti.cpu, sums="compensated")
    count = math.prod(shape)
    values, exact = conditioned(count - 1 + count % 2, np.float64, 1e12)
    values = np.resize(np.append(values, 0.0), count).reshape(shape)
    x, s, t = ti.field(ti.f64, shape=shape), ti.field(ti.f64, shape=()), ti.field(ti.f64, shape=())
    x.from_numpy(values)
    kept = values > 0
    kept_sum = float(sum(map(Fraction, values[kept].tolist())))

    @ti.kernel
    def over_field():
        for I in ti.grouped(x):
            s[None] += x[I]
            s[None] += 1.0
            if x[I] > 0:
                t[None] -= x[I]

    @ti.kernel
    def over_range(n: ti.i32, m: ti.i32):
        for i, j in ti.ndrange(n, m):
            s[None] += x[i, j]
            s[None] += 1.0
            if x[i, j] > 0:
                t[None] -= x[i, j]

    s[None] = -count
    if length == "run-time" and len(shape) == 2:
        over_range(*shape)
    else:
        over_field()
    assert abs(s[None] - exact) <= 1e-13 * abs(exact)
    assert abs(t[None] + kept_sum) <= 1e-15 * kept_sum


@pytest.mark.parametrize("shape", [(999_999,), (1999, 501), (501, 1999)])
def test_default_sums_of_f32(shape):
    """At condition 1e6, of 10⁶ numbers, the median of sets: terms are added in f32 four at a
    time, and all else in f64."""
    skip_on_gpu("sums of blocks are added in f32")
    errors = []
    for seed in range(8):
        ti.init(arch=ti.cpu)
        values, exact = conditioned(math.prod(shape) - 1, np.float32, 1e6, seed)
        x, s = ti.field(ti.f32, shape=shape), ti.field(ti.f32, shape=())
        x.from_numpy(np.resize(np.append(values, 0).astype(np.float32), shape))

        @ti.kernel
        def add(x: ti.template(), s: ti.template()):
            for I in ti.grouped(x):
                s[None] += x[I]

        add(x, s)
        errors.append(abs(s[None] - exact) / abs(exact))
    assert np.median(errors) <= 7e-5


def test_compensated_sums_keep_infinities():
    for dt in (ti.f32, ti.f64):
        ti.init(arch=ti.cpu, sums="compensated")
        assert sum_of(np.array([1, np.inf, 2], NPT[dt]), dt) == math.inf
        ti.init(arch=ti.cpu, sums="compensated")
        assert math.isnan(sum_of(np.array([1, np.nan, 2], NPT[dt]), dt))


@pytest.mark.usefixtures("on_cpu")
@pytest.mark.parametrize("dt", [ti.f32, ti.f64])
@pytest.mark.parametrize("shape", ["scalar", "vector"])
@pytest.mark.parametrize("deterministic", [False, True])
def test_compensated_scatters(dt, shape, deterministic):
    """Many updates of few cells through an index field, and what stood there before."""
    ti.init(arch=ti.cpu, sums="compensated", deterministic=deterministic)
    n, cells = 300_001, 3
    rng = np.random.default_rng(1)
    values = rng.uniform(0, 1, n).astype(NPT[dt])
    at = rng.integers(0, cells, n).astype(np.int32)
    x, index = ti.field(dt, shape=n), ti.field(ti.i32, shape=n)
    grid = ti.field(dt, cells) if shape == "scalar" else ti.Vector.field(2, dt, cells)

    @ti.kernel
    def scatter():
        for i in x:
            if ti.static(shape == "scalar"):
                grid[index[i]] += x[i]
            else:
                grid[index[i]] -= ti.Vector([x[i], 2 * x[i]])

    x.from_numpy(values)
    index.from_numpy(at)
    grid.fill(5)
    scatter()
    sums = np.array([math.fsum(values[at == c].tolist()) for c in range(cells)])
    got = grid.to_numpy()
    eps = np.finfo(NPT[dt]).eps
    if shape == "scalar":
        np.testing.assert_allclose(got, 5 + sums, rtol=eps)
    else:
        np.testing.assert_allclose(got, 5 - np.stack([sums, 2 * sums], 1), rtol=eps)


def test_compensated_adjoints():
    """The gradient of what all iterations read is a sum over them."""
    ti.init(arch=ti.cpu, sums="compensated")
    n = 1_000_001
    values, exact = conditioned(n, np.float32, 1e6)
    w = ti.field(ti.f32, shape=n)
    a = ti.field(ti.f32, shape=(), needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def measure():
        for i in w:
            loss[None] += a[None] * w[i]

    w.from_numpy(values)
    a[None] = 1
    with ti.ad.Tape(loss):
        measure()
    assert abs(a.grad[None] - exact) <= 1e-7 * abs(exact)


@pytest.mark.usefixtures("on_cpu")
@pytest.mark.parametrize("dt", [ti.f32, ti.f64])
def test_one_kernel_is_deterministic(dt):
    """Its bits are those of other numbers of threads, and of a context that is so throughout."""
    found = set()
    n = 200_003
    values = np.random.default_rng(0).uniform(-1, 1, n).astype(NPT[dt])
    at = np.random.default_rng(1).integers(0, 7, n).astype(np.int32)
    for threads, whole in ((1, False), (2, False), (3, False), (2, True)):
        ti.init(arch=ti.cpu, cpu_max_num_threads=threads, deterministic=whole)
        x, index = ti.field(dt, shape=n), ti.field(ti.i32, shape=n)
        s, cells = ti.field(dt, shape=()), ti.field(dt, shape=7)

        @ti.kernel(sums="deterministic")
        def add(x: ti.template(), index: ti.template(), s: ti.template(), cells: ti.template()):
            for i in x:
                s[None] += x[i]
                cells[index[i]] += ti.sin(x[i])

        x.from_numpy(values)
        index.from_numpy(at)
        add(x, index, s, cells)
        found.add((s[None], *cells.to_numpy().tolist()))
    assert len(found) == 1


def test_what_cannot_be_compensated_is_refused_at_its_line():
    ti.init(arch=ti.cpu)
    s, x = ti.field(ti.f32, shape=()), ti.field(ti.f32, shape=1000)

    @ti.kernel(sums="compensated")
    def numbered():
        for i in x:
            x[i] = ti.atomic_add(s[None], 1.0)

    with pytest.raises(ti.TaiError, match='sums="compensated" cannot be had') as caught:
        numbered()
    assert caught.value.lineno == numbered.__wrapped__.__code__.co_firstlineno + 3


# Denormal numbers


@pytest.mark.parametrize("dt", [ti.f32, ti.f64])
@pytest.mark.parametrize("n", [1, 100_003])
def test_ftz_of_one_kernel(dt, n):
    """Operands and results that are denormal become zero, in no other kernel nor in Python."""
    ti.init(arch=ti.cpu)
    tiny = float(np.finfo(NPT[dt]).tiny)
    x, y, z = (ti.field(dt, shape=n) for _ in range(3))

    def body():
        for i in x:
            y[i] = x[i] * 0.5
            z[i] = y[i] * 4.0 + x[i]

    plain, flushed = ti.kernel(body), ti.kernel(ftz=True)(body)
    for kernel, half, sum_ in ((plain, tiny / 2, 3 * tiny), (flushed, 0, tiny)):
        x.fill(tiny)
        kernel()
        assert set(y.to_numpy().tolist()) == {half}
        assert set(z.to_numpy().tolist()) == {sum_}
    # A denormal operand.
    x.fill(tiny / 2)
    for kernel, sum_ in ((flushed, 0), (plain, 1.5 * tiny)):
        kernel()
        assert set(z.to_numpy().tolist()) == {sum_}
    small = np.full(3, tiny, NPT[dt]) * NPT[dt](0.5)
    assert (small != 0).all()


def test_ftz_of_a_context_and_its_gradients():
    for ftz, expected in ((False, 0.75e-38), (True, 0)):
        ti.init(arch=ti.cpu, ftz=ftz)
        x = ti.field(ti.f32, shape=(), needs_grad=True)
        loss = ti.field(ti.f32, shape=(), needs_grad=True)

        @ti.kernel
        def scale(x: ti.template(), loss: ti.template()):
            loss[None] += x[None] * 0.75e-38

        x[None] = 1
        with ti.ad.Tape(loss):
            scale(x, loss)
        assert loss[None] == pytest.approx(expected)
        assert x.grad[None] == pytest.approx(expected)


@pytest.mark.parametrize("dt", [ti.f32, ti.f64])
@pytest.mark.parametrize("n", [1, 65])
def test_ftz_of_functions(dt, n):
    """The library, which takes numbers apart, treats a denormal argument as zero, too."""
    ti.init(arch=ti.cpu, default_fp=dt, ftz=True)
    x, y = ti.field(dt, shape=n), ti.field(dt, shape=(11, n))

    @ti.kernel
    def evaluate():
        for i in x:
            y[0, i] = ti.log(x[i])
            y[1, i] = ti.math.log2(x[i])
            y[2, i] = ti.pow(x[i], -0.3)
            y[3, i] = ti.pow(x[i], 0.3)
            y[4, i] = ti.atan2(x[i], x[i] * 3.0)
            y[5, i] = ti.pow(2.0, x[i])
            y[6, i] = ti.rsqrt(x[i])
            y[7, i] = ti.sin(x[i])
            y[8, i] = ti.tan(x[i])
            y[9, i] = ti.asin(x[i])
            y[10, i] = ti.tanh(x[i])

    x.fill(float(np.finfo(NPT[dt]).tiny) / 3)
    evaluate()
    expected = [-np.inf, -np.inf, np.inf, 0, 0, 1, np.inf, 0, 0, 0, 0]
    assert y.to_numpy().T.tolist() == [expected] * n


# Math


def test_math_of_one_kernel():
    """One kernel is strict beside one that is not."""
    ti.init(arch=ti.cpu)
    n = 65537
    rng = np.random.default_rng(0)
    a, b, c = (rng.standard_normal(n).astype(np.float32) for _ in range(3))
    x, y, z, out = (ti.field(ti.f32, shape=n) for _ in range(4))
    for field, values in ((x, a), (y, b), (z, c)):
        field.from_numpy(values)

    def body():
        for i in x:
            out[i] = x[i] * y[i] + z[i]

    plain, strict = ti.kernel(body), ti.kernel(math="strict")(body)
    strict()
    assert np.array_equal(out.to_numpy(), a * b + c)
    plain()
    assert not np.array_equal(out.to_numpy(), a * b + c)


@pytest.mark.parametrize("where", ["context", "kernel"])
def test_what_is_accurate_stays_strict(where):
    """In a strict context, operations are rounded one by one, and functions are accurate."""
    accurate = {"math": "accurate"}
    ti.init(arch=ti.cpu, strict=True, **(accurate if where == "context" else {}))
    n = 1000
    a, b, c = (np.random.default_rng(i).standard_normal(n).astype(np.float32) for i in range(3))
    x, y, z, out = (ti.field(ti.f32, shape=n) for _ in range(4))
    for field, values in ((x, a), (y, b), (z, c)):
        field.from_numpy(values)

    @ti.kernel(**(accurate if where == "kernel" else {}))
    def add():
        for i in x:
            out[i] = x[i] * y[i] + z[i]

    @ti.kernel(**(accurate if where == "kernel" else {}))
    def curve():
        for i in x:
            out[i] = ti.tanh(x[i])

    add()
    assert np.array_equal(out.to_numpy(), a * b + c)
    curve()
    exact = np.tanh(a.astype(np.float64))
    assert (
        np.abs(out.to_numpy() - exact) <= 0.501 * np.spacing(np.abs(exact.astype(np.float32)))
    ).all()


ONE_ULP = ("sin", "cos", "tan", "asin", "acos", "exp", "log", "tanh")


@pytest.mark.parametrize("name", ONE_ULP)
def test_accurate_functions_of_f32(name):
    """Against those of f64: hardly more than half a unit in the last place."""
    ti.init(arch=ti.cpu, math="accurate")
    n = 200_001
    rng = np.random.default_rng(2)
    x = rng.uniform(-1, 1, n) * np.exp2(rng.uniform(-20, 0 if name in ("asin", "acos") else 6, n))
    x = np.abs(x).astype(np.float32) if name == "log" else x.astype(np.float32)
    a, b = ti.field(ti.f32, shape=n), ti.field(ti.f32, shape=n)
    function = getattr(ti, name)

    @ti.kernel
    def apply():
        for i in a:
            b[i] = function(a[i])

    a.from_numpy(x)
    apply()
    names = {"asin": "arcsin", "acos": "arccos"}
    exact = getattr(np, names.get(name, name))(x.astype(np.float64))
    got = b.to_numpy()
    ulps = np.abs(got - exact) / np.spacing(np.abs(exact).astype(np.float32))
    assert ulps[np.isfinite(exact)].max() <= 0.51


@pytest.mark.usefixtures("on_cpu")
@pytest.mark.parametrize("name", ["tanh", "rsqrt"])
def test_accurate_functions_of_f64(name):
    """Two that the library has within 1.6 units only; the reference has 64 bits or more."""
    ti.init(arch=ti.cpu, math="accurate", default_fp=ti.f64)
    n = 20_001
    x = np.exp2(np.random.default_rng(0).uniform(-8, 4, n))
    a, b = ti.field(ti.f64, shape=n), ti.field(ti.f64, shape=n)
    function = getattr(ti, name)

    @ti.kernel
    def apply():
        for i in a:
            b[i] = function(a[i])

    a.from_numpy(x)
    apply()
    wide = x.astype(np.longdouble)
    exact = np.tanh(wide) if name == "tanh" else 1 / np.sqrt(wide)
    assert (np.abs(b.to_numpy() - exact) / np.spacing(exact.astype(np.float64))).max() <= 0.51


# Contradictory options, and unknown ones


@pytest.mark.parametrize(
    ("options", "first", "second"),
    [
        ({"math": "strict", "fast_math": True}, 'math="strict"', "fast_math"),
        ({"strict": True, "math": "fast"}, "strict", 'math="fast"'),
        ({"math": "accurate", "fast_math": True}, 'math="accurate"', "fast_math"),
        ({"sums": "compensated", "math": "fast"}, 'sums="compensated"', 'math="fast"'),
        ({"precision": "f64", "default_fp": ti.f32}, 'precision="f64"', "default_fp=ti.f32"),
        ({"math": "fast", "fast_math": False}, 'math="fast"', "fast_math=False"),
        (
            {"sums": "deterministic", "deterministic": False},
            'sums="deterministic"',
            "deterministic=False",
        ),
    ],
)
def test_contradictions_name_both(options, first, second):
    with pytest.raises(ti.TaiRuntimeError, match="contradict") as caught:
        ti.init(arch=ti.cpu, **options)
    assert f"'{first}'" in str(caught.value) and f"'{second}'" in str(caught.value)
    ti.init(arch=ti.cpu)


def test_contradiction_of_a_kernel_and_its_context():
    ti.init(arch=ti.cpu, fast_math=True)
    x = ti.field(ti.f32, shape=4)

    @ti.kernel(sums="compensated")
    def run():
        for i in x:
            x[i] = 1.0

    with pytest.raises(ti.TaiCompilationError, match="'fast_math' contradict") as caught:
        run()
    assert caught.value.filename == __file__

    @ti.kernel(sums="compensated", math="strict")
    def both():
        for i in x:
            x[i] = 1.0

    both()


@pytest.mark.parametrize(
    ("modes", "message"),
    [
        ({"sum": "compensated"}, "no mode 'sum'"),
        ({"sums": "kahan"}, "'sums' of kernel 'run' is"),
        ({"adjoints": "f64"}, "no mode 'adjoints'"),
        ({"precision": "f16"}, "is of fields"),
        ({"ftz": "yes"}, "'ftz' of kernel"),
    ],
)
def test_unknown_modes_of_kernels(modes, message):
    def run():
        pass

    with pytest.raises(ti.TaiSyntaxError, match=message) as caught:
        ti.kernel(**modes)(run)
    assert caught.value.filename == __file__


def test_modes_without_code_are_refused():
    if os.environ.get("TI_ARCH"):
        pytest.skip("the target is another one, whatever the program says")
    for options in ({"ftz": True}, {"sums": "compensated"}, {"math": "accurate"}):
        with pytest.raises(ti.TaiRuntimeError, match="no code is made"):
            ti.init(arch=ti.python, **options)
    ti.init(arch=ti.cpu)


def test_what_a_gpu_cannot_do():
    """Each is an error at the line that asks for it."""
    if os.environ.get("TI_ARCH") != "cuda":
        pytest.skip("only there")
    ti.init(arch=ti.cuda)
    x, y, s = ti.field(ti.f32, shape=99), ti.field(ti.f64, shape=99), ti.field(ti.f64, shape=())

    @ti.kernel(sums="deterministic")
    def fixed():
        for i in x:
            s[None] += x[i]

    @ti.kernel(math="accurate")
    def wave():
        for i in y:
            y[i] = ti.sin(y[i])

    for kernel, message in (
        (fixed, "cannot be had for one kernel on a GPU"),
        (wave, "cannot be had for 'sin' of f64 on a GPU"),
    ):
        with pytest.raises(ti.TaiError, match=message) as caught:
            kernel()
        assert caught.value.filename == __file__


def test_modes_are_seen_in_the_ir():
    ti.init(arch=ti.cpu, math="strict")
    x = ti.field(ti.f32, shape=4)

    @ti.kernel(sums="compensated", ftz=True)
    def run():
        for i in x:
            x[i] = 1.0

    text = run.mlir()
    assert 'modes = {ftz = true, math = "strict", sums = "compensated"}' in text
