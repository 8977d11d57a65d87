"""Loops that run on one thread of a GPU for long are said to, on a GPU and nowhere else."""

import warnings

import pytest
import tai as ti


@pytest.fixture
def gpu(monkeypatch):
    monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    monkeypatch.setenv("TI_ARCH", "cuda")
    ti.init(arch=ti.cuda, default_fp=ti.f32)


def make(steps, bodies):
    """Kernels with steps that need each other, and the warnings of each when it is compiled."""
    x = ti.field(ti.f32, 10)

    @ti.kernel
    def serial():
        ti.loop_config(serialize=True)
        for _ in range(steps):
            for i in range(bodies):
                x[i] = ti.sin(x[i]) + x[(i + 1) % 10] * 0.5

    @ti.kernel
    def nested():
        for _ in range(1):
            for _ in range(steps):
                for i in range(bodies):
                    x[i] = ti.sin(x[i]) + x[(i + 1) % 10] * 0.5

    @ti.kernel
    def over_field():
        ti.loop_config(serialize=True)
        for i in x:
            for _ in range(steps):
                x[i] = ti.sin(x[i]) + x[(i + 1) % 10] * 0.5

    @ti.kernel
    def many():
        for i in range(1000):
            for _ in range(steps):
                for k in range(bodies):
                    x[k] += i * 1e-9

    @ti.kernel
    def unknown(n: ti.i32):
        for i in range(n):
            for _ in range(steps):
                for k in range(bodies):
                    x[k] += i * 1e-9

    def said(kernel, *args):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            kernel.compile(*args)
        return [str(w.message) for w in caught]

    found = {k.__name__: said(k) for k in (serial, nested, over_field, many)}
    return {**found, "unknown": said(unknown, 1)}


def test_long_serial_loops_are_named(gpu):
    said = make(1000000, 5)
    for name in ("serial", "nested", "over_field"):
        (text,) = said[name]
        assert text.startswith(f"kernel '{name}': this loop runs on one thread of the GPU, some ")
        assert " million operations one after another\n  hint: a CPU is usually faster" in text
    # Loops over many threads suit a GPU.
    assert said["many"] == said["unknown"] == []


def test_short_ones_are_not(gpu):
    assert not any(make(100, 5).values())


def test_a_cpu_has_no_such_threads():
    ti.init(arch=ti.cpu, default_fp=ti.f32)
    assert not any(make(1000000, 5).values())


def test_the_line_is_that_of_the_loop(gpu):
    x = ti.field(ti.f32, 10)

    @ti.kernel
    def run():
        ti.loop_config(serialize=True)
        for _ in range(2000000):
            for i in range(9):
                x[i + 1] = ti.sin(x[i])

    with pytest.warns(UserWarning, match="one thread of the GPU") as caught:
        run.compile()
    assert len(caught) == 1
    assert caught[0].filename == __file__
    assert "range(2000000)" in open(__file__).read().splitlines()[caught[0].lineno - 1]
