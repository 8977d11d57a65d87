"""The text of `kernel.explain()` on loops, branches and memory; the page on loops."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import tai as ti

PAGE = Path(__file__).resolve().parents[3] / "docs" / "guides" / "loops.md"
PROGRAMS = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)


def line_of(kernel, text):
    """The number of the first line of a kernel that holds the text."""
    code = kernel.__wrapped__.__code__ if hasattr(kernel, "__wrapped__") else None
    source = Path(__file__).read_text().splitlines()
    first = code.co_firstlineno if code else 1
    return next(n for n, line in enumerate(source, 1) if n >= first and text in line)


def test_classes_lines_and_bytes():
    ti.init(default_fp=ti.f64, offline_cache=False)
    x = ti.field(ti.f64, shape=4, needs_grad=True, name="x")
    v = ti.Vector.field(3, ti.f64, shape=4, needs_grad=True, name="v")
    loss = ti.field(ti.f64, shape=(), needs_grad=True, name="loss")

    @ti.kernel
    def kernel(n: ti.i32):
        for i in x:
            value, u, total, at, seed, other = x[i], v[i], 0.0, 0, 7, 3
            for j in range(n):  # the first loop
                value = ti.sin(value) + 0.1 * at * (seed % 5)
                u = u * 2.0
                total += value * x[j % 4]
                at += 2
                seed = seed * 5 + j
                other = other * other + j
            while value < 2.0:  # the second loop
                value *= 1.5
            w = v[i]
            for _ in range(6):  # the third loop
                w = w.cross(u) + ti.cos(w)
            loss[None] += total + w.sum() + value

    text = kernel.explain()
    first, second, third = re.split(r"  loop at ", text)[1:]
    assert first.startswith(f"test_explain.py:{line_of(kernel, '# the first loop')}: iterations")
    assert "value: f64, trajectory: 8 bytes of history for each iteration" in first
    assert "u: vector<3xf64>, linear: no history" in first
    assert "total: f64, linear: no history" in first
    assert "at: i32, closed form" in first
    assert "seed: i32, invertible" in first
    assert "other" not in first or "other: i32, not needed" in first
    assert second.startswith(f"test_explain.py:{line_of(kernel, '# the second loop')}: iterations")
    assert "history: none" in second
    assert third.startswith(f"test_explain.py:{line_of(kernel, '# the third loop')}: 6 iterations")
    assert "w: vector<3xf64>, trajectory: 24 bytes of history for each iteration\n" in third
    assert "the gradient reads the values of: x, v\n" in text
    assert "adds to: " in text
    assert "x_grad" in text


def test_branches():
    x = ti.field(ti.f32, shape=4, needs_grad=True)
    y = ti.field(ti.f32, shape=4, needs_grad=True)

    @ti.kernel
    def kernel():
        for i in x:
            value = x[i]
            if value > 0.5:  # cheap
                value = value * 2.0
            if value > 1.5:  # dear
                value = ti.sqrt(value)
            y[i] = value

    text = kernel.explain()
    assert f"branch at test_explain.py:{line_of(kernel, '# cheap')}: flattened\n" in text
    kept = f"branch at test_explain.py:{line_of(kernel, '# dear')}: kept, because a value or"
    assert kept in text


def test_methods_and_what_has_no_gradient():
    @ti.data_oriented
    class Thing:
        def __init__(self):
            self.x = ti.field(ti.f32, shape=4, needs_grad=True)
            self.n = ti.field(ti.i32, shape=4)

        @ti.kernel
        def double(self, factor: ti.f32):
            for i in self.x:
                self.x[i] += factor

        @ti.kernel
        def count(self):
            for i in self.n:
                self.n[i] += 1

    thing = Thing()
    assert thing.double.explain(2.0).startswith("kernel 'double")
    assert "kernel 'count" in thing.count.explain()


def test_kernels_that_cannot_be_differentiated_say_so():
    x = ti.field(ti.f32, shape=4, needs_grad=True)
    y = ti.field(ti.f32, shape=4, needs_grad=True)

    @ti.kernel
    def kernel():
        for i in x:
            y[i] = x[i] * x.grad[i]  # which the gradient adds to

    with pytest.raises(ti.TaiAutodiffError):
        kernel.explain()


@pytest.mark.parametrize("number", range(len(PROGRAMS)))
def test_programs_of_the_page(number, tmp_path):
    file = tmp_path / "program.py"
    file.write_text(PROGRAMS[number])
    done = subprocess.run([sys.executable, str(file)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
    if number == 0:
        for line in re.search(r"prints \(among others\)\n\n```\n(.*?)```", PAGE.read_text(),
                              re.DOTALL).group(1).splitlines():  # fmt: skip
            assert line in done.stdout


def test_loops_of_threads_and_of_one_thread():
    ti.init(arch=ti.cpu, offline_cache=False)
    x = ti.field(ti.f32, shape=(4, 5), needs_grad=True)
    n = ti.field(ti.i32, shape=())

    @ti.kernel
    def kernel():
        for i, j in x:  # all elements
            x[i, j] += 1.0
        for i in range(n[None]):  # a run-time bound
            x[i, 0] *= 2.0
        ti.loop_config(serialize=True)
        for i in range(3):  # in order
            x[i + 1, 0] = x[i, 0]
        for _ in range(1):  # one iteration
            for i in range(3):
                x[i + 1, 1] += x[i, 1]

    text = kernel.explain()

    def at(mark):
        return f"test_explain.py:{line_of(kernel, mark)}: "

    assert f"parallel loop at {at('# all elements')}20 iterations\n" in text
    bound = "a number of iterations that is known at run time\n"
    assert f"parallel loop at {at('# a run-time bound')}{bound}" in text
    order = f"serial loop at {at('# in order')}one thread runs it\n"
    assert order in text or order.replace("serial", "parallel", 1) in text
    assert f"parallel loop at {at('# one iteration')}1 iteration\n" in text


def test_the_estimated_cost_of_loops():
    """Numbers of the cost model, for an iteration, and for the loop if its bounds are known."""
    ti.init(arch=ti.cpu, offline_cache=False)
    x = ti.field(ti.f32, shape=1000)

    @ti.kernel
    def kernel(n: ti.i32):
        for i in x:
            x[i] = ti.sin(x[i])
        for i in range(n):
            x[i] = 2.0

    found = re.findall(
        r"estimated at ([\d.]+) ns for an iteration(?:, ([\d.]+) us in all)?, on one core\n",
        kernel.explain(),
    )
    assert [bool(total) for _, total in found] == [True, False]
    assert float(found[0][1]) == pytest.approx(float(found[0][0]), abs=0.11)
    assert float(found[0][0]) > float(found[1][0])


def test_versions_for_values_of_the_launch():
    """Versions have a line, and so do loops that are too long for them."""
    ti.init(arch=ti.cpu, offline_cache=False)
    n = 100
    x = ti.field(ti.f32, shape=(4, n), needs_grad=True)
    y = ti.field(ti.f32, shape=n, needs_grad=True)

    @ti.kernel
    def three(a: ti.i32, b: ti.i32, c: ti.i32):
        for i in range(n - 1):  # three slots
            x[c, i] = x[a, i + 1] - x[b, i]

    @ti.kernel
    def four(a: ti.i32, b: ti.i32, c: ti.i32, d: ti.i32):
        for i in range(n - 1):  # four slots
            x[d, i] = x[a, i + 1] - x[b, i] * x[c, i]

    @ti.kernel
    def bound(m: ti.i32):
        for i in range(m):  # a bound
            y[i] = x[0, (i + 1) % m]

    def line(kernel, mark):
        return f"at test_explain.py:{line_of(kernel, mark)}: "

    at = line(three, "# three slots")
    assert f"gradient {at}versions of the loop for slots that differ\n" in three.explain(0, 1, 2)
    at = line(four, "# four slots")
    why = "no versions of the loop for slots that differ, because more than 3 may be equal\n"
    assert f"gradient {at}{why}" in four.explain(0, 1, 2, 3)
    at = line(bound, "# a bound")
    for values in ("arguments that are extents of fields", "ranges that are longer than their"):
        assert f"kernel {at}versions of the loop for {values}" in bound.explain(9)


def test_one_thread_of_a_gpu():
    """A serial loop on a GPU is named, with a way out."""
    program = Path(__file__).with_name("explain_on_a_device.py")
    environment = {"TAI_CUDA_EMULATION": "1", "TI_ARCH": "cuda"}
    run = subprocess.run(
        [sys.executable, program], capture_output=True, text=True, env={**os.environ, **environment}
    )
    assert run.returncode == 0, run.stderr
    serial, short = run.stdout.split("---")
    assert "one thread runs it, on a GPU many times slower than a core of the CPU" in serial
    assert "use arch=ti.cpu" in serial
    assert "64 iterations; so few threads, each with a serial loop" in short


def test_gathers_and_scatters():
    """The gradient says for each field why its additions are scattered, with the line."""
    ti.init(offline_cache=False)
    n = 3000
    x, y, z = (ti.field(ti.f32, n, needs_grad=True, name=name) for name in "xyz")
    at = ti.field(ti.i32, n, name="at")

    @ti.kernel
    def gathered():
        for i in range(n):
            y[i] = x[(i + 1) % n] - x[i]  # shifts

    @ti.kernel
    def scattered():
        for i in range(n):
            z[i] = x[at[i]]  # data

    @ti.kernel
    def short(m: ti.i32):
        for i in range(m):
            y[i] = x[i + 1] - x[i]  # bounds

    @ti.kernel
    def strided(m: ti.i32):
        for i in range(m):  # strides
            y[i] = x[2 * i] + x[2 * i + 3]

    def where(kernel, mark):
        return f"gradient at test_explain.py:{line_of(kernel, mark)}: additions to x_grad are "

    assert where(gathered, "# shifts") + "gathered\n" in gathered.explain()
    line = line_of(scattered, "# data")
    reason = f"scattered: an index comes from data (line {line})\n"
    assert where(scattered, "# data") + reason in scattered.explain()
    assert where(short, "# bounds") + "gathered\n" in short.explain(n - 1)
    text = strided.explain(n // 3)
    assert "scattered: the bounds of the loop are known at run time" in text
    assert f"(line {line_of(strided, '# strides')})" in text
