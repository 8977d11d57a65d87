"""In debug mode, functions that are computed where they have no value stop the run."""

import math

import numpy as np
import pytest
import tai as ti

# A function, arguments where it has a value, arguments where it has none, and the text of the
# error.
DOMAINS = {
    "log": (lambda x: ti.log(x), [1e-300, 2.0, math.inf], [0.0, -0.0, -2.0], "logarithm of"),
    "log2": (lambda x: ti.math.log2(x), [0.5], [0.0, -1.0], "logarithm of"),
    "log1p": (lambda x: ti.math.log1p(x), [-0.5], [-1.0, -3.0], r"logarithm of 1 \+"),
    "sqrt": (lambda x: ti.sqrt(x), [0.0, -0.0, 4.0], [-1e-300, -1.0], "square root of"),
    "rsqrt": (lambda x: ti.rsqrt(x), [0.0, 4.0], [-1.0], "square root of"),
    "asin": (lambda x: ti.asin(x), [1.0, -1.0, 0.5], [1.0 + 2**-52, -2.0], "arc sine of"),
    "acos": (lambda x: ti.acos(x), [1.0, -1.0, 0.5], [1.0 + 2**-52, -2.0], "arc cosine of"),
    "root": (lambda x: x**0.5, [0.0, 2.0], [-1.0], "square root of"),
    "power": (lambda x: x**0.3, [0.0, 2.0], [-1.0], "power of"),
    "vector": (lambda x: ti.log(ti.Vector([1.0, x])).sum(), [2.0], [-1.0], "logarithm of"),
}


def make(function, debug=True):
    ti.init(arch=ti.cpu, default_fp=ti.f64, offline_cache=False, debug=debug)
    x = ti.field(ti.f64, shape=(), needs_grad=True)
    y = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def run():
        y[None] = function(x[None])

    def at(number):
        x[None] = number
        with ti.ad.Tape(y):
            run()
        return y[None], x.grad[None]

    return at


@pytest.mark.parametrize("name", DOMAINS)
def test_outside_of_the_domain(name):
    function, inside, outside, message = DOMAINS[name]
    at = make(function)
    for number in [*inside, math.nan]:
        at(number)
    for number in outside:
        with pytest.raises(ti.TaichiAssertionError, match=message) as caught:
            at(number)
        assert caught.value.lineno is not None
        assert "test_domains.py" in str(caught.value)
    at = make(function, debug=False)
    for number in outside:
        assert not np.isfinite(at(number)[0])


def test_volume_that_vanishes():
    """log J of a material that has turned inside out, or to nothing."""
    at = make(lambda x: ti.log(ti.Matrix([[x, 0.0], [0.0, 2.0]]).determinant()))
    assert at(1.0) == (math.log(2.0), 1.0)
    for number in (0.0, -1.0):
        with pytest.raises(ti.TaichiAssertionError, match="logarithm of"):
            at(number)


def test_what_is_not_taken_counts_not():
    @ti.func
    def chosen(x):
        return ti.select(x > 0, ti.log(x), ti.sqrt(-x))

    @ti.func
    def nested(x):
        return ti.select(x > -1, ti.select(x < 1, ti.acos(x), 0.0), 2.0)

    @ti.func
    def branch(x):
        y = 0.0
        if x > 0:
            y = ti.log(x)
        return y

    @ti.func
    def expression(x):
        return ti.log(x) if x > 0 else 0.0

    at = make(chosen)
    assert at(1.0) == (0.0, 1.0)
    assert at(-4.0) == (2.0, -0.25)
    at = make(nested)
    assert at(2.0) == (0.0, 0.0)
    assert at(-2.0) == (2.0, 0.0)
    assert make(branch)(-1.0) == (0.0, 0.0)
    assert make(expression)(-1.0) == (0.0, 0.0)

    @ti.func
    def wrong(x):
        return ti.select(x > 0, ti.sqrt(-x), 0.0)

    with pytest.raises(ti.TaichiAssertionError, match="square root of -1"):
        make(wrong)(1.0)


def test_division_by_zero_passes():
    """It is meant often: as by a ray that runs along a slab."""
    at = make(lambda x: ti.min(1.0 / x, 5.0))
    assert at(0.0)[0] == 5.0
