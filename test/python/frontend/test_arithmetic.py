"""Numbers in kernels: types, promotion, division, powers, functions; against NumPy."""

import math

import numpy as np
import pytest
import tai as ti


def result_type(a, b, op):
    """The type of `p op q` for p of type a and q of type b."""
    seen = []

    @ti.kernel
    def kernel(p: a, q: b):
        if ti.static(op == "+"):
            ti.static(seen.append((p + q).dt))
        elif ti.static(op == "/"):
            ti.static(seen.append((p / q).dt))
        elif ti.static(op == "//"):
            ti.static(seen.append((p // q).dt))
        else:
            ti.static(seen.append((p < q).dt))

    kernel(1, 1)
    return seen[0]


@pytest.mark.parametrize(
    "a, b, expected",
    [
        (ti.i32, ti.i32, ti.i32),
        (ti.i8, ti.i32, ti.i32),
        (ti.i32, ti.i64, ti.i64),
        (ti.u8, ti.i16, ti.i16),
        (ti.i32, ti.u32, ti.u32),
        (ti.u32, ti.i64, ti.i64),
        (ti.i64, ti.u64, ti.u64),
        (ti.i64, ti.f32, ti.f32),
        (ti.f32, ti.f64, ti.f64),
        (ti.u1, ti.i8, ti.i8),
        (ti.u1, ti.u1, ti.i32),
        (ti.u1, ti.f32, ti.f32),
    ],
)
def test_promotion(a, b, expected):
    assert result_type(a, b, "+") is expected
    assert result_type(b, a, "+") is expected


def test_true_division_of_integers_gives_default_fp():
    assert result_type(ti.i32, ti.i32, "/") is ti.f32
    assert result_type(ti.i64, ti.i64, "/") is ti.f32
    assert result_type(ti.i32, ti.f64, "/") is ti.f64
    ti.init(default_fp=ti.f64, offline_cache=False)
    assert result_type(ti.i32, ti.i32, "/") is ti.f64


def test_other_operators_types():
    assert result_type(ti.i32, ti.i32, "//") is ti.i32
    assert result_type(ti.f32, ti.i32, "//") is ti.f32
    assert result_type(ti.i32, ti.f32, "<") is ti.u1


@pytest.mark.parametrize("a", [-7, -6, 0, 5, 7])
@pytest.mark.parametrize("b", [-3, -2, 1, 2, 3])
def test_integer_division_and_remainder_as_python(a, b):
    @ti.kernel
    def quotient(p: ti.i32, q: ti.i32) -> ti.i32:
        return p // q

    @ti.kernel
    def rest(p: ti.i32, q: ti.i32) -> ti.i32:
        return p % q

    assert quotient(a, b) == a // b
    assert rest(a, b) == a % b


@pytest.mark.parametrize("a", [-7, -1, 0, 5])
def test_division_by_constants(a):
    @ti.kernel
    def kernel(p: ti.i32) -> ti.types.vector(4, ti.i32):
        return ti.Vector([p // 3, p % 3, p // -3, p % -3])

    assert kernel(a).to_list() == [a // 3, a % 3, a // -3, a % -3]


@pytest.mark.parametrize("a, b", [(-7.5, 2.0), (7.5, -2.0), (5.25, 0.5), (-0.25, 3.0)])
def test_float_division_and_remainder_as_python(a, b):
    @ti.kernel
    def kernel(p: ti.f64, q: ti.f64) -> ti.types.vector(2, ti.f64):
        return ti.Vector([p // q, p % q])

    assert kernel(a, b).to_list() == pytest.approx([a // b, a % b])


@pytest.mark.parametrize("mode", [{}, {"math": "strict"}, {"sums": "deterministic"}])
@pytest.mark.parametrize("dt, np_dt", [(ti.f32, np.float32), (ti.f64, np.float64)])
def test_remainders_of_rounded_quotients(dt, np_dt, mode):
    """10.2 / 0.1 rounds to 102 in f32, and 10.2 is less than 102 times that number."""
    ti.init(arch=ti.cpu, default_fp=dt, **mode)
    a = (np.arange(-4000, 4000) * np_dt(0.1)).astype(np_dt)
    x, y = ti.field(dt, shape=a.size), ti.field(dt, shape=a.size)
    out = ti.Vector.field(7, dt, shape=a.size)
    tenth = float(np_dt(0.1))

    @ti.kernel
    def run():
        for i in x:
            pair = ti.Vector([x[i], -x[i]]) % ti.Vector([y[i], tenth])
            out[i] = ti.Vector([x[i] // y[i], x[i] % y[i], x[i] // tenth, x[i] % -tenth,
                                pair[0], pair[1], ti.math.mod(x[i], y[i])])  # fmt: skip

    x.from_numpy(a)
    for b in [np_dt(0.1), np_dt(-0.3)]:
        y.fill(b)
        run()
        t = np_dt(0.1)
        expected = [a // b, a % b, a // t, a % -t, a % b, -a % t, a % b]
        np.testing.assert_array_equal(out.to_numpy(), np.stack(expected, axis=1))


def test_powers():
    @ti.kernel
    def whole(p: ti.i32, q: ti.i32) -> ti.i32:
        return p**q

    @ti.kernel
    def constant(p: ti.f64) -> ti.types.vector(6, ti.f64):
        return ti.Vector([p**0, p**1, p**2, p**7, p**-2, p**0.5])

    @ti.kernel
    def real(p: ti.f64, q: ti.f64) -> ti.f64:
        return p**q

    for p, q in [(-3, 3), (2, 10), (5, 0), (0, 0), (7, 1)]:
        assert whole(p, q) == p**q
    assert constant(1.7).to_list() == pytest.approx([1.7**e for e in (0, 1, 2, 7, -2, 0.5)])
    assert real(1.3, 2.6) == pytest.approx(1.3**2.6)


def test_bits():
    @ti.kernel
    def kernel(p: ti.i32, q: ti.i32) -> ti.types.vector(6, ti.i32):
        return ti.Vector([p & q, p | q, p ^ q, ~p, p << 2, p >> 1])

    p, q = -13, 6
    assert kernel(p, q).to_list() == [p & q, p | q, p ^ q, ~p, p << 2, p >> 1]


def test_unsigned():
    @ti.kernel
    def half(p: ti.u32) -> ti.u32:
        return p // 2

    @ti.kernel
    def is_less(p: ti.u32, q: ti.u32) -> ti.i32:
        return p < q

    @ti.kernel
    def wraps(p: ti.u8) -> ti.u8:
        return p + ti.u8(200)

    big = 4_000_000_000
    assert half(big) == big // 2
    assert is_less(1, big) == 1
    assert wraps(100) == 44


def test_wide_integers():
    @ti.kernel
    def kernel(p: ti.i64) -> ti.i64:
        return p * 3 + 5_000_000_000

    assert kernel(2**40) == 2**40 * 3 + 5_000_000_000


@pytest.mark.parametrize(
    "name",
    ["sin", "cos", "tan", "tanh", "exp", "log", "sqrt", "floor", "ceil", "asin", "acos", "abs"],
)
def test_functions(name):
    function = getattr(ti, name)
    x = ti.field(ti.f64, shape=9)
    y = ti.field(ti.f64, shape=9)

    @ti.kernel
    def kernel():
        for i in x:
            y[i] = function(x[i])

    points = np.linspace(0.05, 0.95, 9)
    x.from_numpy(points)
    kernel()
    numpy_name = {"asin": "arcsin", "acos": "arccos"}.get(name, name)
    np.testing.assert_allclose(y.to_numpy(), getattr(np, numpy_name)(points), rtol=1e-14)
    assert function(0.5) == pytest.approx(getattr(np, numpy_name)(0.5))


def test_more_functions():
    @ti.kernel
    def kernel(p: ti.f64, q: ti.f64) -> ti.types.vector(8, ti.f64):
        return ti.Vector(
            [
                ti.atan2(p, q),
                ti.rsqrt(q),
                ti.pow(q, p),
                ti.max(p, q, 0.5),
                ti.min(p, q, 0.5),
                ti.select(p < q, 1.0, 2.0),
                max(p, q),
                abs(-p),
            ]
        )

    p, q = 0.3, 1.7
    expected = [math.atan2(p, q), q**-0.5, q**p, 1.7, 0.3, 1.0, 1.7, 0.3]
    assert kernel(p, q).to_list() == pytest.approx(expected)


def test_rounding():
    @ti.kernel
    def kernel(p: ti.f64) -> ti.types.vector(4, ti.f64):
        return ti.Vector([ti.round(p), ti.floor(p), ti.ceil(p), float(int(p))])

    for p in (-2.5, -1.2, 0.4, 2.5, 3.7):
        away = math.copysign(math.floor(abs(p) + 0.5), p)
        assert kernel(p).to_list() == [away, math.floor(p), math.ceil(p), int(p)]


def test_floor_with_type():
    seen = []

    @ti.kernel
    def kernel(p: ti.f32) -> ti.i32:
        r = ti.floor(p, ti.i32)
        ti.static(seen.append(r.dt))
        return r

    assert kernel(-3.7) == -4
    assert seen == [ti.i32]


def test_casts():
    @ti.kernel
    def kernel(p: ti.f64) -> ti.types.vector(4, ti.f64):
        return ti.Vector(
            [int(p), ti.cast(p, ti.i32), ti.cast(ti.cast(p, ti.f32), ti.f64), bool(p) * 1.0]
        )

    assert kernel(-3.7).to_list() == [-3, -3, float(np.float32(-3.7)), 1]


def test_constants_are_exact_in_wider_types():
    @ti.kernel
    def kernel(p: ti.f64) -> ti.f64:
        return p * 0.1

    assert kernel(1.0) == 0.1  # not the f32 that is nearest to it


def test_first_assignment_fixes_the_type():
    @ti.kernel
    def kernel() -> ti.types.vector(3, ti.f64):
        a = 1
        a = 2.7
        b = 1
        b += 2.7
        c = 1.5
        c = 3
        return ti.Vector([a, b, c / 2])

    with pytest.warns(UserWarning, match="drops its fraction"):
        assert kernel().to_list() == [2, 3, 1.5]


def test_annotated_assignment():
    @ti.kernel
    def kernel() -> ti.f64:
        a: ti.f64 = 0.1
        b: float = 0.1
        return a - b

    assert kernel() == pytest.approx(0.1 - float(np.float32(0.1)), rel=1e-3)


def test_logic():
    @ti.kernel
    def kernel(p: ti.i32, q: ti.i32) -> ti.types.vector(5, ti.i32):
        return ti.Vector(
            [p > 1 and q > 1, p > 1 or q > 1, not p > 1, 1 < p < q, p == 1 or p == 2 or p == 3]
        )

    for p in range(4):
        for q in range(4):
            expected = [p > 1 and q > 1, p > 1 or q > 1, not p > 1, 1 < p < q, p in (1, 2, 3)]
            assert kernel(p, q).to_list() == [int(e) for e in expected]


def test_and_does_not_evaluate_what_it_need_not():
    ti.init(debug=True, offline_cache=False)
    x = ti.field(ti.i32, shape=4)
    count = ti.field(ti.i32, shape=())

    @ti.kernel
    def kernel():
        for i in range(8):
            if i < 4 and x[i] == 0:
                count[None] += 1

    kernel()  # would fail on x[4] in debug mode
    assert count[None] == 4


def test_ternary_does_not_evaluate_the_other_arm():
    ti.init(debug=True, offline_cache=False)
    x = ti.field(ti.f32, shape=4)
    y = ti.field(ti.f32, shape=8)

    @ti.kernel
    def kernel():
        for i in range(8):
            y[i] = x[i] + 1 if i < 4 else -1.0

    kernel()
    assert y.to_numpy().tolist() == [1] * 4 + [-1] * 4


def test_in():
    @ti.kernel
    def kernel(p: ti.i32) -> ti.i32:
        return (p in [1, 5, 7]) * 10 + (p not in (1, 2))

    assert [kernel(p) for p in (1, 2, 5)] == [10, 0, 11]


def test_random_is_reproducible_and_uniform():
    x = ti.field(ti.f64, shape=20000)

    @ti.kernel
    def uniform():
        for i in x:
            x[i] = ti.random(ti.f64)

    @ti.kernel
    def normal():
        for i in x:
            x[i] = ti.randn(ti.f64)

    uniform()
    first = x.to_numpy()
    assert 0 <= first.min() < 0.001 and 0.999 < first.max() < 1
    assert abs(first.mean() - 0.5) < 0.01
    assert len(np.unique(first)) == len(first)
    normal()
    sample = x.to_numpy()
    assert abs(sample.mean()) < 0.03 and abs(sample.std() - 1) < 0.03


def test_random_seed():
    def draw(seed):
        ti.init(random_seed=seed, offline_cache=False)
        x = ti.field(ti.f32, shape=100)

        @ti.kernel
        def kernel():
            for i in x:
                x[i] = ti.random()

        kernel()
        return x.to_numpy()

    np.testing.assert_array_equal(draw(3), draw(3))
    assert not np.array_equal(draw(3), draw(4))


def test_python_function_is_traced():
    def double(x):
        return x * 2 + math.floor(1.5)

    @ti.kernel
    def kernel(p: ti.i32) -> ti.i32:
        return double(p)

    assert kernel(5) == 11


def test_math_module():
    @ti.kernel
    def kernel(p: ti.f64) -> ti.f64:
        return math.sin(p) + math.sqrt(p) + math.pi

    assert kernel(0.7) == pytest.approx(math.sin(0.7) + math.sqrt(0.7) + math.pi)


def test_bit_cast():
    @ti.kernel
    def kernel(p: ti.f32) -> ti.i32:
        return ti.bit_cast(p, ti.i32)

    assert kernel(1.0) == 0x3F800000


def test_raw_division():
    @ti.kernel
    def kernel(p: ti.i32, q: ti.i32) -> ti.types.vector(2, ti.i32):
        return ti.Vector([ti.raw_div(p, q), ti.raw_mod(p, q)])

    assert kernel(-7, 2).to_list() == [-3, -1]


def test_and_and_or_give_the_operand_that_decides():
    @ti.kernel
    def either(a: ti.i32, b: ti.i32) -> ti.i32:
        return a or b

    @ti.kernel
    def both(a: ti.f32, b: ti.i32) -> ti.f32:
        return a and b

    @ti.kernel
    def several(a: ti.i32, b: ti.f32) -> ti.f32:
        return (a > 2 and b) or a or 0.25

    for a in (0, 3):
        for b in (0, 7):
            assert either(a, b) == (a or b)
            assert both(a + 0.5 * a, b) == ((a + 0.5 * a) and b)
            assert several(a, b) == ((a > 2 and b) or a or 0.25)
    assert several(0, 2.5) == 0.25


def test_gradient_of_or_belongs_to_the_operand_that_decides():
    x = ti.field(ti.f32, shape=2, needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def kernel():
        loss[None] += (x[0] or 3 * x[1]) + 10 * (x[0] and x[1] ** 2)

    for first, expected in ((0.0, [10, 3]), (2.0, [1, 100])):
        x[0], x[1] = first, 5.0
        with ti.ad.Tape(loss):
            kernel()
        assert x.grad.to_numpy().tolist() == expected


def test_constants_out_of_range_are_as_at_run_time():
    ti.init(arch=ti.cpu, default_fp=ti.f64)
    out = ti.field(ti.f64, shape=13)

    @ti.kernel
    def run():
        out[0] = 1.0 / 0.0
        out[1] = -1 / 0
        out[2] = 0.0 / 0.0
        out[3] = 2.0**5000
        out[4] = (-8.0) ** 0.5
        out[5] = 5.0 % 0.0
        out[6] = 0.0**-1.0
        out[7] = 1e308 * 10
        out[8] = 7.0 // 0.0
        out[9] = 7.0 // 0
        out[10] = -7 // 0.0
        out[11] = 7.0 % 0
        out[12] = 7 % 0.0

    run()
    expected = [np.inf, -np.inf, np.nan, np.inf, np.nan, np.nan, np.inf, np.inf, np.inf]
    expected += [np.inf, -np.inf, np.nan, np.nan]
    np.testing.assert_array_equal(out.to_numpy(), expected)


@pytest.mark.parametrize("op", ["//", "%"])
def test_whole_constants_by_zero(op):
    ti.init(arch=ti.cpu)
    out = ti.field(ti.i32, shape=())

    @ti.kernel
    def divide():
        out[None] = 5 // 0

    @ti.kernel
    def remainder():
        out[None] = 5 % 0

    with pytest.raises(ti.TaiTypeError, match="by zero") as caught:
        (divide if op == "//" else remainder)()
    assert caught.value.lineno is not None


def test_the_angle_of_the_origin_is_zero_for_numbers_known_at_compile_time():
    angles = ti.field(ti.f32, 3)

    @ti.kernel
    def fill():
        a = 0.0
        b = 0.0
        angles[0] = ti.atan2(a, b)
        angles[1] = ti.atan2(0.0, 0.0)
        angles[2] = ti.atan2(a, -1.0)

    fill()
    assert angles.to_numpy().tolist() == [0.0, 0.0, np.float32(np.pi)]


def test_powers_of_truth_values():
    ti.init(arch=ti.cpu)
    base, exponent, out = (ti.field(ti.u1, shape=4) for _ in range(3))

    @ti.kernel
    def raise_all():
        for i in base:
            out[i] = base[i] ** exponent[i]

    @ti.kernel
    def raise_one(a: ti.u1, b: ti.u1) -> ti.u1:
        return a**b

    for i in range(4):
        base[i], exponent[i] = i & 1, i >> 1
    raise_all()
    # As in Python: only false to the power of true is false.
    assert out.to_numpy().tolist() == [True, True, False, True]
    assert [raise_one(a, b) for b in (False, True) for a in (False, True)] == [1, 1, 0, 1]


@pytest.mark.parametrize("dtype", [ti.i8, ti.i16, ti.i32, ti.i64, ti.u32])
def test_shifts_without_the_sign(dtype):
    bits = dtype.bits
    given, result = ti.field(dtype, shape=4), ti.field(dtype, shape=4)
    values = [-5, -1, 77, 0] if dtype.kind == "i" else [5, 1, 77, 0]
    for i, value in enumerate(values):
        given[i] = value

    @ti.kernel
    def run(by: ti.i32):
        for i in given:
            result[i] = ti.bit_shr(given[i], by)

    for by in (0, 1, 3):
        run(by)
        for i, value in enumerate(values):
            expected = (value % 2**bits) >> by
            if by == 0 and dtype.kind == "i":
                expected = value
            assert result[i] == expected, (by, value)


@pytest.mark.parametrize("value", [3.5, float("inf"), float("nan")])
def test_zeros_and_ones_of_any_value(value):
    """Not by a multiplication: the type alone counts."""
    x = ti.Vector.field(2, ti.f32, shape=2)
    y = ti.field(ti.f64, shape=2)

    @ti.kernel
    def run(v: ti.f64):
        y[0], y[1] = ti.zero(v), ti.one(v)
        x[0], x[1] = ti.zero(x[0]), ti.one(x[1])

    x.fill(value)
    run(value)
    assert y.to_numpy().tolist() == [0, 1]
    assert x.to_numpy().tolist() == [[0, 0], [1, 1]]
    assert ti.zero(value) == 0 and ti.one(value) == 1
    assert list(ti.zero(ti.Vector([value, 1.0]))) == [0, 0]


def test_promises_are_values():
    x = ti.field(ti.i32, shape=8)

    @ti.kernel
    def run():
        for i in x:
            x[ti.assume_in_range(i, 0, 0, 8)] = ti.loop_unique(i) + 1

    run()
    assert x.to_numpy().tolist() == list(range(1, 9))


@pytest.mark.filterwarnings("ignore:.*drops its fraction")
def test_variables_of_whole_numbers_take_whole_numbers():
    x = ti.field(ti.i32, shape=2)

    @ti.kernel
    def kernel(start: ti.i32) -> ti.i32:
        a = start
        a += 2.9
        a -= 0.5
        x[0] = start
        x[0] += 2.9
        x[0] -= 0.5
        b = start
        b *= 1.5
        x[1] = b
        return a

    for start, added, scaled in ((3, 5, 4), (-3, -1, -4), (0, 2, 0)):
        assert kernel(start) == added
        assert x.to_numpy().tolist() == [added, scaled]
