"""Shadow execution: which line loses digits. Values are those without shadows."""

import math
import subprocess
import sys

import numpy as np
import pytest
import tai as ti
from tai.errors import TaiError, TaiRuntimeError


def init(**options):
    ti.init(arch=ti.cpu, shadow=True, **{"default_fp": ti.f32, **options})


def line_of(kernel, text):
    """The line of the source of a kernel that holds a text."""
    import inspect

    lines, start = inspect.getsourcelines(getattr(kernel, "func", kernel.__wrapped__))
    return start + next(i for i, line in enumerate(lines) if text in line)


@pytest.mark.parametrize("type_, small", [(ti.f32, 1e-4), (ti.f64, 1e-11)])
def test_finds_the_line_of_a_cancellation(type_, small):
    init(default_fp=type_)
    x = ti.field(type_, 8)
    y = ti.field(type_, 8)

    @ti.kernel
    def cancel(step: type_):
        for i in x:
            near = x[i] * 1000 + step  # rounds
            y[i] = near - x[i] * 1000  # loses

    for i in range(8):
        x[i] = 1.1 + i
    cancel(small)
    (row,) = ti.tools.shadow_report()
    assert (row.lineno, row.operation, row.kernel) == (line_of(cancel, "# loses"), "-", "cancel")
    assert row.filename == __file__
    assert row.lost == row.cancellations == 8
    assert row.flips == row.non_finite == 0
    # The table says the same.
    _, line = str(ti.tools.shadow_report()).splitlines()
    numbers = [f"{row.digits_lost:.1f}", f"{row.error:.1e}", f"{row.error_in:.1e}"]
    assert line.split()[:7] == [*numbers, "8", "8", "0", "0"]
    assert line.endswith(f":{row.lineno} - in cancel")
    # Bits are lost from the rounding of the type to the remainder.
    worst = max(abs(y[i] - small) / small for i in range(8))
    bits = 24 if type_ == ti.f32 else 53
    assert row.error == pytest.approx(min(worst, 1), rel=2e-2)
    assert row.digits_lost == pytest.approx(math.log10(row.error / max(row.error_in, 2.0**-bits)))
    # It is the rounding of the operands that makes the error: a half unit of them.
    assert abs(row.digits_lost - math.log10(row.error * 2**bits)) < 0.5
    assert "8 by cancellation" in report_on_source()


def report_on_source():
    return ti.tools.shadow_report().on_source()


def test_well_behaved_kernels_report_nothing():
    init()
    x = ti.field(ti.f32, (16, 16))
    total = ti.field(ti.f32, ())
    m = ti.Matrix.field(3, 3, ti.f32, shape=16)

    @ti.kernel
    def run():
        for i, j in x:
            x[i, j] = ti.sin(i * 0.1) + ti.exp(-0.1 * j) + 2
            total[None] += x[i, j]
        for i in m:
            m[i] = m[i] @ m[i].transpose() + ti.Matrix.identity(ti.f32, 3)
            if m[i].determinant() > 0.5:
                m[i] = m[i] * 0.5

    for _ in range(3):
        run()
    report = ti.tools.shadow_report()
    assert list(report) == []
    assert str(report).startswith("no digits lost")
    assert report.on_source() == ""


def test_sum_that_cancels_is_found_in_serial_and_parallel_loops():
    init()
    n = 65537
    x = ti.field(ti.f32, n)
    y = ti.field(ti.f32, 2)
    rng = np.random.default_rng(0)
    half = rng.random(n // 2).astype(np.float32)
    terms = np.concatenate([half, -half, [np.float32(0.01)]])
    rng.shuffle(terms)
    x.from_numpy(terms)

    @ti.kernel
    def serial():
        ti.loop_config(serialize=True)
        for i in range(n):
            y[0] += x[i]  # serial

    @ti.kernel
    def parallel():
        for i in x:
            y[1] += x[i]  # parallel

    serial()
    parallel()
    rows = {row.lineno: row for row in ti.tools.shadow_report()}
    # The partial sums of threads are added up where the loop begins.
    wanted = {line_of(serial, "# serial"), line_of(parallel, "# parallel")}
    assert wanted <= set(rows) <= wanted | {line_of(parallel, "for i in x")}
    assert all(row.operation == "+" and row.lost for row in rows.values())


@pytest.mark.parametrize("threads", [1, 4])
@pytest.mark.parametrize("deterministic", [False, True])
@pytest.mark.parametrize("size", [1, 4])
def test_sums_over_parallel_loops_have_shadows(threads, deterministic, size):
    init(cpu_max_num_threads=threads, deterministic=deterministic)
    y = ti.field(ti.f32, size)
    rest = ti.field(ti.f32, size)
    # One thread alone loses digits among the terms, where they are many.
    terms = 1024 if threads == 1 else 65536
    n = terms * size

    @ti.kernel
    def add(a: ti.f32):
        for i in range(n):
            y[i % size] += a

    @ti.kernel
    def take(a: ti.f32):
        for i in y:
            rest[i] = y[i] - a  # takes

    y.fill(1e4)
    term = 0.7 / terms
    add(term)
    take(1e4)
    report = ti.tools.shadow_report()
    assert [row.lineno for row in report] == [line_of(take, "# takes")], str(report)
    row = report[0]
    exact = terms * float(np.float32(term))
    worst = np.abs(rest.to_numpy() - exact).max() / exact
    assert worst > 2**-12
    assert row.error == pytest.approx(min(worst, 1), rel=1e-3)


def test_quadratic_formula():
    init()
    r = ti.field(ti.f32, 2)

    @ti.kernel
    def solve(b: ti.f32, c: ti.f32):
        d = ti.sqrt(b * b - 4 * c)
        r[0] = (d - b) / 2  # naive
        r[1] = -2 * c / (b + d)

    solve(1000.0, 1.0)
    (row,) = ti.tools.shadow_report()
    assert row.lineno == line_of(solve, "# naive")
    assert row.operation == "-"
    exact = -0.001000001
    assert row.error == pytest.approx(abs(r[0] - exact) / abs(exact), rel=1e-3)
    assert abs(r[1] - exact) < 1e-9


def test_flips_are_found_and_control_follows_the_floats():
    init()
    x = ti.field(ti.f32, 3)
    y = ti.field(ti.i32, 3)

    @ti.kernel
    def decide(a: ti.f32, b: ti.f32):
        for i in y:
            y[i] = 0
            x[i] = a
        for i in y:
            if x[i] + b > x[i]:  # flips
                y[i] = 1
            if x[i] + a > b:
                y[i] += 2
            y[i] += 10 * ti.cast((x[i] + b) * 0.5, ti.i32)  # converts

    # In f32 the sum is a; with more digits it is greater.
    decide(2.0**24, 1.0)
    assert y.to_numpy().tolist() == [2 + 10 * 2**23] * 3
    rows = {(row.lineno, row.operation): row.flips for row in ti.tools.shadow_report()}
    assert rows == {(line_of(decide, "# flips"), "comparison"): 3}
    ti.tools.clear_shadow_report()
    # The sum is rounded up to a multiple of 4, and its half is another integer.
    decide(2.0**24 + 2, 1.0)
    assert y.to_numpy().tolist() == [1 + 2 + 10 * (2**23 + 2)] * 3
    rows = {(row.lineno, row.operation): row.flips for row in ti.tools.shadow_report()}
    assert rows == {(line_of(decide, "# converts"), "conversion to an integer"): 3}
    assert "3 come out otherwise" in report_on_source()


def test_overflow_where_more_digits_are_finite():
    init()
    y = ti.field(ti.f32, 2)

    @ti.kernel
    def run(a: ti.f32):
        y[0] = ti.sqrt(a * a)  # overflows
        y[1] = 1 / (a * a)

    run(1e30)
    (row,) = [row for row in ti.tools.shadow_report() if row.non_finite]
    assert row.lineno == line_of(run, "# overflows")
    # Nothing was lost there: the columns of digits stay empty.
    _, *lines = str(ti.tools.shadow_report()).splitlines()
    (line,) = [line for line in lines if f":{row.lineno} " in line]
    assert line.split()[:4] == ["0", "0", "0", str(row.non_finite)]


def test_shadows_in_fields_follow_kernels_and_host_writes():
    init()
    x = ti.field(ti.f32, 4)
    y = ti.field(ti.f32, 4)

    @ti.kernel
    def add(a: ti.f32):
        for i in x:
            x[i] += a

    @ti.kernel
    def take(a: ti.f32):
        for i in x:
            y[i] = x[i] - a  # takes

    x.fill(1e4)
    add(1e-3)
    take(1e4)
    # The sum of an earlier launch was rounded.
    (row,) = ti.tools.shadow_report()
    assert row.lineno == line_of(take, "# takes")
    assert row.lost == 4
    ti.tools.clear_shadow_report()
    # Values that the host writes are exact.
    x.from_numpy(np.full(4, 1e4 + 0.0625, np.float32))
    take(1e4)
    x[0] = 5e3
    take(1e4)
    assert ti.tools.shadow_report() == []


def test_sparse_fields_and_atomic_updates_on_several_threads():
    init(cpu_max_num_threads=4)
    n = 4096
    cells = ti.root.pointer(ti.i, n // 16).dense(ti.i, 16)
    x = ti.field(ti.f32)
    cells.place(x)
    y = ti.field(ti.f32, n)
    index = ti.field(ti.i32, n)
    index.from_numpy((np.arange(n) % 8 * 64).astype(np.int32))

    @ti.kernel
    def scatter(a: ti.f32):
        for i in range(n):
            x[index[i]] += a

    @ti.kernel
    def take(a: ti.f32):
        for i in x:
            y[i] = x[i] - a  # takes

    scatter(1e4)
    for _ in range(2):
        scatter(1e-4)
    # 512 * 1e4 each: 1e-4 is lost in it.
    take(512e4)
    found = {row.lineno: row for row in ti.tools.shadow_report()}
    row = found[line_of(take, "# takes")]
    assert row.lost == 8
    # All of the 1024 small terms are in the shadow.
    assert row.error == 1
    assert set(found) == {row.lineno}


def make_program(type_):
    """A program with loops, branches, matrices, sums and a gradient; its results."""
    n = 100
    x = ti.field(type_, n, needs_grad=True)
    m = ti.Matrix.field(2, 2, type_, shape=n, needs_grad=True)
    loss = ti.field(type_, (), needs_grad=True)

    @ti.kernel
    def step():
        for i in x:
            s = ti.cast(0.0, type_)
            j = 0
            while s < 3 and j < 20:
                s += ti.abs(ti.sin(x[i] * j)) + x[(i + 1) % n] / (1 + j)
                j += 1
            m[i] = ti.Matrix([[s, x[i]], [ti.exp(-s), ti.max(s, x[i])]]) @ ti.Matrix(
                [[1.0, 0.25], [x[i], 2.0]]
            )

    @ti.kernel
    def measure():
        for i in m:
            u, sig, v = ti.svd(m[i])
            loss[None] += sig[0, 0] * 0.01 + m[i].norm() + ti.atan2(m[i][0, 1], s_of(i))

    @ti.func
    def s_of(i):
        return m[i].determinant() + ti.pow(ti.abs(x[i]), 1.5) + ti.tan(x[i] * 0.1) + ti.floor(x[i])

    x.from_numpy((np.arange(n) * 0.037 - 1).astype(np.float32))
    with ti.ad.Tape(loss):
        step()
        measure()
    return loss.to_numpy(), x.grad.to_numpy(), m.to_numpy()


@pytest.mark.parametrize("type_", [ti.f32, ti.f64])
@pytest.mark.parametrize("threads", [1, 3])
def test_values_are_those_without_shadows(type_, threads):
    results = []
    for options in ({"strict": True}, {"shadow": True}):
        ti.init(
            arch=ti.cpu,
            default_fp=type_,
            deterministic=True,
            cpu_max_num_threads=threads,
            **options,
        )
        results.append(make_program(type_))
    for plain, shadowed in zip(*results, strict=True):
        assert plain.tobytes() == shadowed.tobytes()


def test_adjoints_have_rows_of_their_own():
    init()
    x = ti.field(ti.f32, 16, needs_grad=True)
    y = ti.field(ti.f32, (), needs_grad=True)

    @ti.kernel
    def f():
        for i in x:
            y[None] += x[i] * 1e4 - ti.sin(x[i]) * 1e4

    x.from_numpy((0.013 + 0.0007 * np.arange(16)).astype(np.float32))
    with ti.ad.Tape(y):
        f()
    # 1e4 (1 - cos x) is small: the two parts of the gradient cancel.
    rows = [row for row in ti.tools.shadow_report() if row.lost]
    assert {row.kernel for row in rows} > {"f"}
    assert all(row.kernel.startswith("f") for row in rows)
    exact = 1e4 * (1 - np.cos(x.to_numpy().astype(np.float64)))
    worst = np.max(np.abs(x.grad.to_numpy() - exact) / exact)
    assert max(row.error for row in rows if row.kernel != "f") == pytest.approx(worst, rel=1e-2)


def test_two_contexts_of_reports_follow_one_another():
    for _ in range(2):
        init()

        @ti.kernel
        def f(a: ti.f32) -> ti.f32:
            return (a + 1e-5) - a

        f(1e3)
        assert [row.lost for row in ti.tools.shadow_report()] == [1]
        f(1e3)
        assert [row.lost for row in ti.tools.shadow_report()] == [2]


def test_options_that_do_not_go_together():
    with pytest.raises(TaiError, match="'shadow' and 'fast_math' contradict"):
        ti.init(arch=ti.cpu, shadow=True, fast_math=True)
    ti.init(arch=ti.cpu, shadow=True)

    @ti.kernel(math="fast")
    def run() -> float:
        return 1.0

    with pytest.raises(TaiError, match="'shadow' and 'math=\"fast\"' contradict"):
        run()
    ti.init(arch=ti.python)
    ti.reset()
    with pytest.raises(TaiError, match="choose arch cpu"):
        ti.init(arch=ti.python, shadow=True)
        ti.field(ti.f32, ())
    ti.init(arch=ti.cpu)
    with pytest.raises(TaiRuntimeError, match=r"ti\.init\(shadow=True\)"):
        ti.tools.shadow_report()


@pytest.mark.parametrize("threads", [1, 4])
@pytest.mark.parametrize("n", [3, 8, 37, 300])
def test_reports_of_vectors_are_those_of_single_iterations(n, threads):
    """Loops over consecutive f32 run on vectors; with an index from memory they do not."""
    init(cpu_max_num_threads=threads)
    x, y, z = (ti.field(ti.f32, (n, n)) for _ in range(3))
    place = ti.field(ti.i32, n)

    @ti.kernel
    def together():
        for i, j in ti.ndrange((1, n - 1), (1, n - 1)):
            y[i, j] = x[i, j + 1] * 3 - x[i, j - 1] * 3 + x[i + 1, j] / 7 - x[i - 1, j] / 7

    @ti.kernel
    def one_by_one():
        for i, j in ti.ndrange((1, n - 1), (1, n - 1)):
            k = place[j]
            z[i, k] = x[i, k + 1] * 3 - x[i, k - 1] * 3 + x[i + 1, k] / 7 - x[i - 1, k] / 7

    rng = np.random.default_rng(3)
    place.from_numpy(np.arange(n, dtype=np.int32))
    smooth = 1 + 1e-6 * rng.integers(0, 9, (n, n))
    smooth[n // 2, n // 3] = 3e38
    x.from_numpy(smooth.astype(np.float32))
    together()
    one_by_one()
    rows = {"together": [], "one_by_one": []}
    for row in ti.tools.shadow_report():
        numbers = (row.lost, row.cancellations, row.non_finite, row.digits_lost, row.error)
        rows[row.kernel].append((row.operation, row.column, *numbers))
    assert len(rows["together"]) == len(rows["one_by_one"]) > 0
    for one, other in zip(*(sorted(r, key=lambda row: row[1]) for r in rows.values()), strict=True):
        assert (one[0], *one[2:]) == (other[0], *other[2:])
    np.testing.assert_array_equal(y.to_numpy(), z.to_numpy())


VALUES = """
import sys

import numpy as np
import tai as ti

type_, wide = (ti.f32, np.float64) if sys.argv[1] == "f32" else (ti.f64, np.longdouble)
threads = int(sys.argv[2])
ti.init(arch=ti.cpu, shadow=True, default_fp=type_, cpu_max_num_threads=threads, deterministic=True)
x = ti.field(type_, 65, needs_grad=True)
v = ti.Vector.field(2, type_, shape=3)
w = ti.Vector.field(2, type_, shape=3, layout=ti.Layout.SOA)
loss = ti.field(type_, (), needs_grad=True)
x.from_numpy(np.linspace(0.1, 1, 65).astype(np.float32))


@ti.kernel
def run():
    for i in x:
        loss[None] += ti.sin(x[i]) * ti.exp(x[i])


@ti.kernel
def fill():
    for i in v:
        v[i] = ti.Vector([1.0, 2.0]) / (i + 3)
        w[i] = v[i]


with ti.ad.Tape(loss):
    run()
fill()
at = x.to_numpy().astype(wide)
thirds = np.array([1, 2], wide) / np.arange(3, 6).astype(wide)[:, None]
exact = [(loss, (np.sin(at) * np.exp(at)).sum()), (v, thirds), (w, thirds)]
exact.append((x.grad, np.exp(at) * (np.sin(at) + np.cos(at))))
for f, right in exact:
    found = ti.tools.shadow_values(f)
    assert found.dtype == wide and found.shape == right.shape
    size = np.linalg.norm(np.atleast_1d(right))
    off = np.linalg.norm(np.atleast_1d(found - right)) / size
    own = np.linalg.norm(np.atleast_1d(f.to_numpy() - right)) / size
    assert off <= 40 * np.finfo(wide).eps and own > 100 * off, (f.name, off, own)
# A number that the host writes is exact.
x.grad[5] = 0.25
assert ti.tools.shadow_values(x.grad)[5] == 0.25
"""


@pytest.mark.parametrize("type_", ["f32", "f64"])
@pytest.mark.parametrize("threads", [1, 2])
def test_values_have_the_digits_of_shadows(type_, threads, tmp_path):
    """Loss, gradient and vectors, against NumPy in the wider type, in a process of its own."""
    script = tmp_path / "values.py"
    script.write_text(VALUES)
    command = [sys.executable, str(script), type_, str(threads)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr


def test_values_without_shadows_are_refused():
    init()
    n = ti.field(ti.i32, 3)
    with pytest.raises(TaiError, match="fields of f32 and f64 have shadows in memory, but got"):
        ti.tools.shadow_values(n)
    ti.init(arch=ti.cpu)
    with pytest.raises(TaiRuntimeError, match="kernels have no shadows"):
        ti.tools.shadow_values(ti.field(ti.f32, 3))


# Blocks of a program that has no shadows otherwise


def chain(n=64):
    """A program whose second line loses digits, in both directions."""
    x, y, loss = (ti.field(ti.f32, shape, needs_grad=True) for shape in (n, n, ()))

    @ti.kernel
    def far():
        for i in x:
            y[i] = ti.sin(x[i]) + 10000.0

    @ti.kernel
    def near():
        for i in y:
            loss[None] += (y[i] - 10000.0) ** 2

    def run():
        with ti.ad.Tape(loss):
            far()
            near()
        return loss[None], x.grad.to_numpy()

    x.from_numpy(np.linspace(0.1, 1.3, n, dtype=np.float32))
    return run, loss


def test_a_block_with_shadows():
    ti.init(arch=ti.cpu, default_fp=ti.f32, strict=True, deterministic=True)
    run, loss = chain()
    plain = run()
    with pytest.raises(TaiRuntimeError, match="with ti.tools.shadows"):
        ti.tools.shadow_report()
    with ti.tools.shadows():
        shadowed = run()
        exact = np.sum(np.sin(np.linspace(0.1, 1.3, 64)) ** 2)
        assert abs(shadowed[0] / exact - 1) > 1e-5
        assert abs(ti.tools.shadow_values(loss) / exact - 1) < 1e-6
    report = ti.tools.shadow_report()
    assert {row.kernel.split(" ")[0] for row in report} >= {"near"} and report[0].lost
    with pytest.raises(TaiRuntimeError, match="ask for the values within it"):
        ti.tools.shadow_values(loss)
    ti.tools.clear_shadow_report()
    after = run()
    assert ti.tools.shadow_report() == []
    for found in (shadowed, after):
        assert found[0] == plain[0] and found[1].tobytes() == plain[1].tobytes()


@pytest.mark.parametrize("every, runs, expected", [(1, 3, 3), (4, 9, 3), (100, 7, 1)])
def test_each_so_many_runs_of_a_block_has_shadows(every, runs, expected):
    ti.init(arch=ti.cpu, default_fp=ti.f32)
    run, _ = chain()
    with ti.tools.shadows():
        run()
    (once,) = [row.lost for row in ti.tools.shadow_report() if row.lost][:1]
    ti.tools.clear_shadow_report()
    sample = ti.tools.shadows(every=every)
    for _ in range(runs):
        with sample:
            run()
    assert [row.lost for row in ti.tools.shadow_report() if row.lost][:1] == [expected * once]


def test_a_block_within_a_program_with_shadows():
    init()
    run, _ = chain()
    with ti.tools.shadows(every=2):
        pass
    run()
    assert any(row.lost for row in ti.tools.shadow_report())


def test_a_block_that_cannot_have_shadows():
    ti.init(arch=ti.cpu, fast_math=True)
    with pytest.raises(TaiError, match="contradict"), ti.tools.shadows():
        pass
    for every in (0, -1, True, 1.5):
        with pytest.raises(ti.TaiRuntimeTypeError, match="every is a number of runs"):
            ti.tools.shadows(every=every)
    with pytest.raises(TaiRuntimeError, match="kernels have no shadows"):
        ti.tools.shadow_report()
