"""Kernels whose bodies are huge are compiled, and compute what small ones do."""

import linecache
import re

import numpy as np
import pytest
import tai as ti


def make(body, scope, name="<huge kernel>"):
    """A kernel with a loop over `x` that has these lines for its body."""
    text = "@ti.kernel\ndef run():\n    for i in x:\n" + "".join(
        f"        {line}\n" for line in body
    )
    linecache.cache[name] = (len(text), None, text.splitlines(keepends=True), name)
    scope = {"ti": ti, **scope}
    exec(compile(text, name, "exec"), scope)
    return scope["run"]


@pytest.fixture(autouse=True)
def start():
    ti.init(default_fp=ti.f64)


@pytest.fixture
def fields():
    x, y = (ti.field(ti.f64, 37, needs_grad=True) for _ in range(2))
    x.from_numpy(np.linspace(0.1, 1.9, 37))
    y.grad.fill(1.0)
    return {"x": x, "y": y}


def chain(n):
    return ["c = x[i]", "b = c", *["b = ti.sin(b) * 1.0001 + c"] * n, "y[i] = b"]


def test_a_chain_of_thousands(fields):
    x, y = fields["x"], fields["y"]
    run = make(chain(3000), fields)
    run()
    run.grad()
    value = start = x.to_numpy()
    slope = np.ones(37)
    for _ in range(3000):
        slope = np.cos(value) * 1.0001 * slope + 1
        value = np.sin(value) * 1.0001 + start
    assert np.allclose(y.to_numpy(), value, rtol=1e-12, atol=1e-12)
    assert np.allclose(x.grad.to_numpy(), slope, rtol=1e-11, atol=1e-11)


def test_a_sum_of_hundreds_of_terms(fields):
    x, y = fields["x"], fields["y"]
    lines = ["s = 0.0", "for k in ti.static(range(400)):"]
    lines += ["    s += ti.sin(x[i] * (k + 1)) * ti.exp(-x[i] * k) + ti.sqrt(x[i] + k)"]
    run = make([*lines, "y[i] = s"], fields)
    run()
    run.grad()
    k = np.arange(400.0)
    at = x.to_numpy()[:, None]
    decay, wave = np.exp(-at * k), at * (k + 1)
    expected = np.sum(np.sin(wave) * decay + np.sqrt(at + k), axis=1)
    slopes = (np.cos(wave) * (k + 1) - np.sin(wave) * k) * decay + 0.5 / np.sqrt(at + k)
    assert np.allclose(y.to_numpy(), expected, rtol=1e-12)
    assert np.allclose(x.grad.to_numpy(), np.sum(slopes, axis=1), rtol=1e-10)


def test_as_many_values_at_once(fields):
    """Far more than a machine has registers, all of which each part of the body may need."""
    n, x, y = 1500, fields["x"], fields["y"]
    lines = [f"v{k} = ti.sin(x[i] + {k}.0)" for k in range(n)]
    lines += [f"v{k} = v{k} * v{(k * 7 + 1) % n} + x[i]" for k in range(n)]
    lines += ["b = 0.0", *[f"b += v{k}" for k in range(n)], "y[i] = b"]
    make(lines, fields)()
    at = x.to_numpy()
    values = [np.sin(at + k) for k in range(n)]
    for k in range(n):
        values[k] = values[k] * values[(k * 7 + 1) % n] + at
    assert np.allclose(y.to_numpy(), np.sum(values, axis=0), rtol=1e-11, atol=1e-9)


def test_a_thousand_reads_and_writes():
    """The reads and writes are of a field that the body itself writes."""
    n = 1200
    x = ti.field(ti.f64, 5, needs_grad=True)
    z = ti.field(ti.f64, (5, n + 1), needs_grad=True)
    x.fill(0.5)
    z.fill(2.0)
    make([f"z[i, {k + 1}] = z[i, {k}] * 0.5 + x[i]" for k in range(n)], {"x": x, "z": z})()
    expected = [2.0]
    for _ in range(n):
        expected.append(expected[-1] * 0.5 + 0.5)
    assert np.allclose(z.to_numpy(), np.tile(expected, (5, 1)), rtol=1e-13)


@pytest.mark.parametrize(("n", "is_vectorized"), [(20, True), (1000, False)])
def test_huge_loops_call_a_function_once_for_each_call(n, is_vectorized):
    """The vectoriser would make some twenty of each."""
    ti.init(arch=ti.cpu, default_fp=ti.f32)
    x, y = (ti.field(ti.f32, 64) for _ in range(2))
    run = make(chain(n), {"x": x, "y": y})
    ir = run.mlir(stage="llvmir")
    assert bool(re.search(r"x float> @(llvm\.|tai_wide_)sin", ir)) == is_vectorized
    code = run.mlir(stage="asm")
    calls = code.count("sinf") + code.count("tai_wide_sin")
    assert calls <= (30 if is_vectorized else 1.1) * n


def test_code_of_huge_blocks_is_in_parts():
    ti.init(arch=ti.cpu, default_fp=ti.f32)
    x, y = (ti.field(ti.f32, 64) for _ in range(2))

    def parts(n):
        lines = ["b = x[i]", *["b = b * b + x[i]"] * n, "y[i] = b"]
        return make(lines, {"x": x, "y": y}).mlir(stage="asm").count(".part")

    assert parts(500) == 0
    assert parts(16000) > 0


def test_a_chain_of_hundreds_of_loops(fields):
    """Each loop goes on with the results of the one before."""
    n, x, y = 210, fields["x"], fields["y"]
    lines = ["b = x[i]"]
    for k in range(n):
        lines += [f"for _ in range({k % 4 + 1}):", "    b = ti.sin(b) + x[i]"]
    run = make([*lines, "y[i] = b"], fields)
    run()
    run.grad()
    value = start = x.to_numpy()
    slope = np.ones(37)
    for k in range(n):
        for _ in range(k % 4 + 1):
            slope = np.cos(value) * slope + 1
            value = np.sin(value) + start
    assert np.allclose(y.to_numpy(), value, rtol=1e-12, atol=1e-12)
    assert np.allclose(x.grad.to_numpy(), slope, rtol=1e-11, atol=1e-11)


def test_code_of_hundreds_of_loops_is_in_parts():
    ti.init(arch=ti.cpu, default_fp=ti.f32)
    x, y = (ti.field(ti.f32, 64) for _ in range(2))
    counts = ti.field(ti.i32, 64)

    def parts(n):
        lines = ["b = x[i]"]
        for k in range(n):
            lines += [f"for _ in range(counts[{k % 60}]):", "    b = ti.sin(b) + x[i]"]
        fields = {"x": x, "y": y, "counts": counts}
        code = make([*lines, "y[i] = b"], fields).mlir(stage="asm")
        return len(set(re.findall(r"\S+\.loops[.\d]*(?=:)", code)))

    assert parts(100) == 0
    assert parts(300) >= 300 // 32
