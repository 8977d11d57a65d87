"""Random expression trees over all operations, at special points.

Forward and reverse mode give the same, and nothing is NaN where the value is finite and the slopes
of the sides that exist are finite, as mpmath finds them at a distance of 2^-1200.
"""

import itertools
import math

import numpy as np
import pytest
import tai as ti
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from points import Points

SPECIAL = [0.0, -0.0, 1.0, -1.0, 0.5, 2.0, 5e-324, -1e-310, 1e200, -1e200, math.pi / 2, math.nan]
POINTS = np.array(list(itertools.product(SPECIAL, SPECIAL)))

UNARY = {
    "neg": lambda a: -a, "abs": lambda a: abs(a), "square": lambda a: a * a,
    "sqrt": lambda a: ti.sqrt(a), "rsqrt": lambda a: ti.rsqrt(a), "exp": lambda a: ti.exp(a),
    "log": lambda a: ti.log(a), "sin": lambda a: ti.sin(a), "cos": lambda a: ti.cos(a),
    "tan": lambda a: ti.tan(a), "tanh": lambda a: ti.tanh(a), "asin": lambda a: ti.asin(a),
    "acos": lambda a: ti.acos(a), "floor": lambda a: ti.floor(a), "ceil": lambda a: ti.ceil(a),
}  # fmt: skip
BINARY = {
    "add": lambda a, b: a + b, "sub": lambda a, b: a - b, "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b, "max": lambda a, b: ti.max(a, b), "min": lambda a, b: ti.min(a, b),
    "atan2": lambda a, b: ti.atan2(a, b), "pow": lambda a, b: a**b, "mod": lambda a, b: a % b,
    "norm": lambda a, b: ti.Vector([a, b]).norm(),
}  # fmt: skip

leaves = st.one_of(
    st.sampled_from(["x", "y"]), st.sampled_from(["x", "y"]), st.sampled_from([0.0, 1.0, -1.0, 2.0])
)


def grow(trees):
    return st.one_of(
        st.tuples(st.sampled_from(sorted(UNARY)), trees),
        st.tuples(st.sampled_from(sorted(BINARY)), trees, trees),
        st.tuples(st.just("select"), trees, trees, trees),
    )


TREES = st.recursive(leaves, grow, max_leaves=5).filter(lambda tree: has_input(tree))


def has_input(tree):
    return tree in ("x", "y") or (isinstance(tree, tuple) and any(map(has_input, tree[1:])))


def traced(tree, v):
    """The value of the tree in a kernel."""
    if isinstance(tree, float):
        return ti.cast(tree, ti.f64)
    if isinstance(tree, str):
        return v[0] if tree == "x" else v[1]
    if tree[0] == "select":
        a, b, c = (traced(t, v) for t in tree[1:])
        return ti.select(a > 0.5, b, c)
    function = UNARY.get(tree[0]) or BINARY[tree[0]]
    return function(*(traced(t, v) for t in tree[1:]))


class Undefined(Exception):
    """No real value, or one that is out of all range."""


def exact(mp, tree, x, y):
    """The value of the tree by mpmath; arms that are not taken are not computed."""
    if isinstance(tree, float):
        return mp.mpf(tree)
    if isinstance(tree, str):
        return x if tree == "x" else y
    name, *rest = tree
    if name == "select":
        return exact(mp, rest[1] if exact(mp, rest[0], x, y) > 0.5 else rest[2], x, y)
    a, *b = (exact(mp, t, x, y) for t in rest)
    b = b[0] if b else None
    if name in ("exp", "tanh") and abs(a) > 1e6:
        raise Undefined
    if (name in ("sqrt", "pow") and a < 0) or (name in ("log", "rsqrt") and a <= 0):
        raise Undefined
    if (name in ("asin", "acos") and abs(a) > 1) or (name in ("div", "mod") and b == 0):
        raise Undefined
    if name == "pow" and ((a == 0 and b <= 0) or (a and abs(b * mp.log(a)) > 1e6)):
        raise Undefined
    if name == "atan2" and a == 0 and b <= 0:
        raise Undefined
    return {
        "neg": lambda: -a, "abs": lambda: abs(a), "square": lambda: a * a,
        "rsqrt": lambda: 1 / mp.sqrt(a), "add": lambda: a + b, "sub": lambda: a - b,
        "mul": lambda: a * b, "div": lambda: a / b, "max": lambda: max(a, b),
        "min": lambda: min(a, b), "pow": lambda: a**b, "norm": lambda: mp.sqrt(a * a + b * b),
        "mod": lambda: a - b * mp.floor(a / b),
    }.get(name, lambda: getattr(mp, name)(*((a,) if b is None else (a, b))))()  # fmt: skip


def slopes(mp, tree, point, k):
    """The slopes of the sides that exist by one input, or None where one of them is infinite."""
    found = []
    try:
        middle = exact(mp, tree, *map(mp.mpf, point))
    except Undefined:
        return None
    for side in (1, -1):
        pair = []
        for digits in (1200, 1300):
            h = side * mp.ldexp(1, -digits)
            moved = [mp.mpf(p) + (h if i == k else 0) for i, p in enumerate(point)]
            try:
                pair.append((exact(mp, tree, *moved) - middle) / h)
            except Undefined:
                break
        if len(pair) < 2:
            continue
        if abs(pair[1] - pair[0]) > 1e-6 * max(1, abs(pair[0])) or abs(pair[1]) > 1e250:
            return None
        found.append(float(pair[1]))
    return found or None


def disagreement(forward, reverse):
    """Where the modes differ by more than rounding, as a mask."""
    with np.errstate(all="ignore"):
        size = np.maximum(1.0, np.maximum(np.abs(forward), np.abs(reverse)))
        close = np.abs(forward - reverse) <= 1e-9 * size
    return ~(close | (forward == reverse) | (np.isnan(forward) & np.isnan(reverse)))


def subtrees(tree):
    """The tree and all that it consists of."""
    yield tree
    if isinstance(tree, tuple):
        for part in tree[1:]:
            yield from subtrees(part)


# Their partials are quotients, which overflow beside denormals.
QUOTIENTS = {"div", "mod", "atan2", "log", "rsqrt", "pow", "norm"}


def is_moderate(mp, tree, point):
    """Whether each part is of a moderate size there, and has finite slopes on its sides."""
    parts = list(subtrees(tree))
    low = 1e-150 if any(t[0] in QUOTIENTS for t in parts if isinstance(t, tuple)) else 0.0
    for part in parts:
        try:
            value = abs(exact(mp, part, *map(mp.mpf, point)))
        except Undefined:
            return False
        if value > 1e150 or 0 < value < low:
            return False
        if isinstance(part, tuple) and any(slopes(mp, part, point, k) is None for k in (0, 1)):
            return False
    return True


def examine(tree, points=POINTS, moderate=False):
    """The errors of the derivatives of a tree, in words; perhaps at moderate points alone."""
    mpmath = pytest.importorskip("mpmath")
    ti.init(offline_cache=False, default_fp=ti.f64)
    results = [
        Points(lambda v: traced(tree, v), 2, len(points), "f64", mode)(points)
        for mode in ("forward", "reverse")
    ]
    (values, forward), (again, reverse) = results
    np.testing.assert_array_equal(values, again)
    wrong = []
    suspects = np.isnan(forward) | np.isnan(reverse) | disagreement(forward, reverse)
    suspects &= np.isfinite(values)[:, None] & np.isfinite(points).all(axis=1)[:, None]
    with mpmath.workprec(4000):
        for i, k in np.argwhere(suspects):
            sides = slopes(mpmath.mp, tree, points[i], k)
            if sides is None or (moderate and not is_moderate(mpmath.mp, tree, points[i])):
                continue
            wrong.append(
                f"d/d{'xy'[k]} at {points[i].tolist()}: forward {forward[i, k]}, "
                f"reverse {reverse[i, k]}, slopes {sides}, value {values[i]}"
            )
    return wrong


# Small ones that cover each operation once, whatever is drawn.
EACH = [
    *[(name, ("square", "x")) for name in UNARY],
    *[(name, "x", ("mul", "x", "y")) for name in BINARY],
    *[("mul", "y", (name, "x")) for name in UNARY],
    ("select", "x", ("sqrt", "x"), ("log", "y")),
    ("select", "x", ("div", "y", "x"), ("rsqrt", "x")),
]

# The limit of the whole is finite, but a partial of one step is not, or not within f64: what
# both operands share is taken from them.
SHARED = [
    ("div", "x", ("mul", "x", "y")), ("atan2", "x", ("mul", "x", "y")), ("atan2", "x", "x"),
    ("mod", ("acos", "y"), ("acos", "y")), ("div", ("mul", "x", "y"), "x"),
    ("div", ("mul", "x", "y"), ("mul", "y", "x")), ("atan2", ("mul", "x", "y"), ("mul", "x", "y")),
    ("div", "x", ("square", "x")), ("atan2", ("square", "x"), "x"),
]  # fmt: skip


def name_of(tree):
    if isinstance(tree, tuple):
        return f"{tree[0]}({','.join(map(name_of, tree[1:]))})"
    return str(tree)


@pytest.mark.parametrize("tree", EACH, ids=name_of)
def test_trees_of_each_operation(tree):
    assert examine(tree) == []


@pytest.mark.parametrize("tree", SHARED, ids=name_of)
def test_trees_whose_operands_share_a_factor(tree):
    """No infinite partials of opposite sign meet."""
    assert examine(tree) == []


@pytest.mark.parametrize("mode", ["forward", "reverse"])
@pytest.mark.parametrize("x", [5e-324, -1e-310, 3.0, 1e200])
def test_a_shared_factor_has_no_slope(x, mode):
    """x / (x y), atan2(x, x y) and (x y) / (x y y): the slope by y is right to rounding."""
    ti.init(offline_cache=False, default_fp=ti.f64)
    y = 2.0
    functions = [
        (lambda v: v[0] / (v[0] * v[1]), -1 / y**2),
        (lambda v: ti.atan2(v[0], v[0] * v[1]), -1 / (1 + y**2)),
        (lambda v: (v[0] * v[1]) / (v[0] * (v[1] * v[1])), -1 / y**2),
    ]
    for function, slope in functions:
        _, found = Points(function, 2, 1, "f64", mode)(np.array([[x, y]]))
        assert found[0, 0] == 0
        assert abs(found[0, 1] - slope) <= 1e-15 * abs(slope)


def test_a_small_seed_keeps_adjoints_in_range():
    """x / ((x y) y) at the least number, where no rule sees the factor: the sweep is linear."""
    ti.init(offline_cache=False, default_fp=ti.f64)
    x, y = (ti.field(ti.f64, shape=(), needs_grad=True) for _ in range(2))
    r = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def divide():
        r[None] = x[None] / ((x[None] * y[None]) * y[None])

    x[None], y[None] = 2.0**-1070, 1.0
    with ti.ad.Tape(r):
        divide()
    assert math.isnan(x.grad[None])
    with ti.ad.Tape(r, seed=2.0**-600):
        divide()
    assert x.grad[None] == 0
    assert y.grad[None] * 2.0**600 == -2


def test_drawn_trees(long):
    """At points where each part is of a moderate size and has slopes."""

    @settings(
        max_examples=400 if long else 12, deadline=None, derandomize=True, database=None,
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(TREES)
    def run(tree):
        assert examine(tree, moderate=True) == [], tree

    run()
