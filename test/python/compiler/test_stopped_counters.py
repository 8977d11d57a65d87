"""Counters in types of 16 bits, which stop where a step is less than the distance of numbers."""

import warnings

import pytest
import tai as ti
from tai.errors import TaiCompilationWarning

STOPS = "stops growing at about"


def warned(launch):
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        launch()
    return [str(w.message) for w in found if issubclass(w.category, TaiCompilationWarning)]


def counter(dtype, trips, step=1.0, sign=1):
    """Counts in an element, in one thread; returns the warnings and the count."""
    c = ti.field(dtype, shape=())

    @ti.kernel
    def count():
        for _ in range(1):
            for _ in range(trips):
                if ti.static(sign > 0):
                    c[None] += step
                else:
                    c[None] -= step

    return warned(count), c[None]


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(("dtype", "most"), [(ti.f16, 2048), (ti.bf16, 256)])
@pytest.mark.parametrize("step", [1.0, 0.5])
def test_counts_that_stop_are_warned_of(dtype, most, step, sign):
    ti.init()
    lines, value = counter(dtype, 4 * most, step, sign)
    assert value == sign * most * step
    (line,) = lines
    assert f"steps of {step:g} in {dtype} {STOPS} {most * step:g}" in line
    assert "count in ti.i32" in line
    # A count that fits is right, and nothing is said.
    lines, value = counter(dtype, most, step, sign)
    assert value == sign * most * step and not lines


@pytest.mark.parametrize("dtype", [ti.f32, ti.f64, ti.i32])
def test_other_types_are_not(dtype):
    ti.init()
    assert counter(dtype, 5000, 1) == ([], 5000)


def test_the_line_is_named():
    ti.init()
    c = ti.field(ti.f16, shape=4)

    @ti.kernel
    def count(n: ti.i32):
        for i in c:
            for _ in range(n):
                c[i] += 1  # as often as the run says

    with pytest.warns(TaiCompilationWarning, match="kernel 'count'") as found:
        count(3)
    line = count.__wrapped__.__code__.co_firstlineno + 4
    assert [w.lineno for w in found] == [line] and c[0] == 3


def test_only_loops_that_repeat_the_place_count():
    """One of 60 cells gets one step of each outer iteration, and a variable begins anew."""
    ti.init()
    c = ti.field(ti.bf16, shape=60)
    total = ti.field(ti.f32, shape=())

    @ti.kernel
    def count():
        for _ in range(1):
            for i in range(60):
                part = ti.cast(0, ti.bf16)
                for _ in range(200):
                    part += 1
                    c[i] += 1
                total[None] += part

    assert warned(count) == []
    assert total[None] == 60 * 200 and c[59] == 200


@pytest.mark.parametrize("form", ["variable", "while", "nested"])
def test_variables_and_while(form):
    ti.init()
    out = ti.field(ti.f32, shape=())

    @ti.kernel
    def variable():
        for _ in range(1):
            s = ti.cast(0, ti.bf16)
            for _ in range(1000):
                s += 1
            out[None] = s

    @ti.kernel
    def looped():
        for _ in range(1):
            s, n = ti.cast(0, ti.bf16), 0
            while n < 1000:
                s += 1
                n += 1
            out[None] = s

    @ti.kernel
    def nested():
        for _ in range(1):
            s = ti.cast(0, ti.bf16)
            for _ in range(100):
                for _ in range(10):
                    s += 1
            out[None] = s

    launch = {"variable": variable, "while": looped, "nested": nested}[form]
    lines = warned(launch)
    assert out[None] == 256
    assert len(lines) == 1 and f"{STOPS} 256" in lines[0]


def test_steps_that_the_run_computes_are_not_warned_of():
    ti.init()
    x = ti.field(ti.f16, shape=4)
    c = ti.field(ti.f16, shape=())

    @ti.kernel
    def add():
        for _ in range(1):
            for j in range(5000):
                c[None] += x[j % 4]

    assert warned(add) == []
