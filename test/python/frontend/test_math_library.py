"""`ti.math`: complex numbers, rotations and bits, in kernels and in Python."""

import cmath

import numpy as np
import pytest
import tai as ti

tm = ti.math

POINTS = [1.5 - 2j, -0.3 + 0.7j, -4 + 0j, 2 + 0j, 1j, -1j, 1e-160 - 1e-160j, -1e150 + 1e160j, 0j]
UNARY = {
    "cconj": lambda z: z.conjugate(),
    "cinv": lambda z: 1 / z if abs(z) < 1e100 else z.conjugate() / abs(z) / abs(z),
    "csqrt": cmath.sqrt,
    "cexp": cmath.exp,
    "clog": cmath.log,
}


def defined(name, z):
    if name == "cexp":
        return abs(z) < 100
    return z != 0 or name in ("cconj", "csqrt")


@pytest.fixture(autouse=True)
def doubles(fresh_program):
    ti.init(default_fp=ti.f64, offline_cache=False)


@pytest.mark.parametrize("name", UNARY)
def test_functions_of_one_complex_number(name):
    function, points = getattr(tm, name), [z for z in POINTS if defined(name, z)]
    result = ti.Vector.field(2, ti.f64, shape=len(points))
    given = ti.Vector.field(2, ti.f64, shape=len(points))
    given.from_numpy(np.array([(z.real, z.imag) for z in points]))

    @ti.kernel
    def run():
        for i in given:
            result[i] = function(given[i])

    run()
    for z, (real, imaginary) in zip(points, result.to_numpy(), strict=True):
        expected = UNARY[name](z)
        assert complex(real, imaginary) == pytest.approx(expected, rel=4e-16, abs=0), z
        in_python = function(ti.Vector([z.real, z.imag]))
        assert complex(*in_python) == pytest.approx(expected, rel=4e-16, abs=0), z


@pytest.mark.parametrize("w", [0.3 + 0.7j, -2 + 0j, 1e-200j, 3e180 + 4e180j])
def test_products_and_quotients(w):
    result = ti.Vector.field(2, ti.f64, shape=2)

    @ti.kernel
    def run(a: tm.vec2, b: tm.vec2):
        result[0] = tm.cmul(a, b)
        result[1] = tm.cdiv(a, b)

    z = 1.5 - 2j
    run(tm.vec2(z.real, z.imag), tm.vec2(w.real, w.imag))
    assert complex(*result[0]) == pytest.approx(z * w, rel=4e-16)
    assert complex(*result[1]) == pytest.approx(z / w, rel=6e-16)


@pytest.mark.parametrize("exponent", [1.3, -0.5, 2.0, 0.0])
def test_powers(exponent):
    result = ti.Vector.field(2, ti.f64, shape=2)

    @ti.kernel
    def run(z: tm.vec2, n: ti.f64):
        result[0] = tm.cpow(z, n)
        result[1] = tm.cpow(0.0 * z, n)

    run(tm.vec2(-1.5, 2.0), exponent)
    assert complex(*result[0]) == pytest.approx((-1.5 + 2j) ** exponent, rel=1e-15)
    assert list(result[1]) == [0, 0]


@pytest.mark.parametrize(
    ("name", "derivative"),
    [
        ("csqrt", lambda z: 0.5 / cmath.sqrt(z)),
        ("cexp", cmath.exp),
        ("clog", lambda z: 1 / z),
        ("cinv", lambda z: -1 / z**2),
    ],
)
@pytest.mark.parametrize("z", [1.5 - 2j, -0.3 + 0.7j, 2 + 0j])
def test_derivatives_are_those_of_holomorphic_functions(name, derivative, z):
    function = getattr(tm, name)
    x = ti.Vector.field(2, ti.f64, shape=(), needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    x[None] = [z.real, z.imag]

    @ti.kernel
    def real_part():
        loss[None] += function(x[None])[0]

    with ti.ad.Tape(loss):
        real_part()
    expected = derivative(z)
    assert x.grad[None][0] == pytest.approx(expected.real, rel=1e-14, abs=1e-15)
    assert x.grad[None][1] == pytest.approx(-expected.imag, rel=1e-14, abs=1e-15)


def test_rotations():
    """Row vectors turn: the first axis towards the second, about the third."""
    m = ti.Matrix.field(4, 4, ti.f64, shape=7)

    @ti.kernel
    def run(a: ti.f64):
        m[0] = tm.rot_by_axis(tm.vec3(0.0, 0.0, 5.0), a)
        m[1] = tm.rot_yaw_pitch_roll(0.0, 0.0, a)
        m[2] = tm.rot_yaw_pitch_roll(0.1, 0.2, 0.3)
        m[3] = tm.rotation3d(0.2, 0.3, 0.1)
        m[4] = tm.rot_by_axis(tm.vec3(1.0, 2.0, 2.0), a)
        m[5] = tm.scale(1.0, 2.0, 3.0) @ tm.translate(4.0, 5.0, 6.0)
        m[6] = tm.rotation3d(a, 0.0, 0.0)

    run(0.5)
    given = m.to_numpy()
    c, s = np.cos(0.5), np.sin(0.5)
    about_third = np.array([[c, s, 0, 0], [-s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    np.testing.assert_allclose(given[0], about_third, atol=1e-16)
    np.testing.assert_allclose(given[1], about_third, atol=1e-16)
    np.testing.assert_allclose(given[2], given[3], atol=1e-16)
    for matrix in given[[2, 4]]:
        np.testing.assert_allclose(matrix @ matrix.T, np.eye(4), atol=1e-15)
        assert np.linalg.det(matrix) == pytest.approx(1)
    axis = np.array([1, 2, 2, 0]) / 3
    np.testing.assert_allclose(axis @ given[4], axis, atol=1e-16)
    assert np.trace(given[4]) == pytest.approx(2 + 2 * c)
    np.testing.assert_allclose(given[5] @ [1, 1, 1, 1], [5, 12, 21, 1])
    # The results of Taichi 1.7.4.
    np.testing.assert_allclose(given[2][0], [0.956425, 0.289629, -0.036957, 0], atol=5e-7)
    np.testing.assert_allclose(given[2][2], [0.097843, -0.198669, 0.97517, 0], atol=5e-7)
    np.testing.assert_allclose(given[6] @ given[6].T, np.eye(4), atol=1e-16)


def test_directions():
    result = ti.Vector.field(2, ti.f64, shape=())

    @ti.kernel
    def run(a: ti.f64):
        result[None] = tm.vdir(a)

    run(0.5)
    assert list(result[None]) == pytest.approx([np.cos(0.5), np.sin(0.5)])
    assert list(tm.vdir(0.5)) == pytest.approx([np.cos(0.5), np.sin(0.5)])


@pytest.mark.parametrize("dtype", ["i8", "u8", "i16", "u16", "i32", "u32", "i64", "u64"])
def test_bits(dtype):
    dt = getattr(ti, dtype)
    bits, signed = int(dtype[1:]), dtype[0] == "i"
    values = [0, 1, 5, 100, 2 ** (bits - 1) - 1, -1 if signed else 2**bits - 1]
    values.append(-(2 ** (bits - 1)) if signed else 2 ** (bits - 1))
    x, ones, zeros = (ti.field(dt, shape=len(values)) for _ in range(3))
    x.from_numpy(np.array(values, dtype=x.to_numpy().dtype))

    @ti.kernel
    def run():
        for i in x:
            ones[i] = tm.popcnt(x[i])
            zeros[i] = tm.clz(x[i])

    run()
    patterns = [value % 2**bits for value in values]
    assert ones.to_numpy().tolist() == [pattern.bit_count() for pattern in patterns]
    assert zeros.to_numpy().tolist() == [bits - pattern.bit_length() for pattern in patterns]


def test_bits_of_vectors_and_of_constants():
    result = ti.Vector.field(3, ti.i32, shape=2)

    @ti.kernel
    def run(v: tm.ivec3):
        result[0] = tm.popcnt(v)
        result[1] = ti.Vector([tm.clz(255), tm.popcnt(ti.u8(255)), tm.clz(0)])

    run(tm.ivec3(7, -1, 0))
    assert result[0].to_list() == [3, 32, 0]
    assert result[1].to_list() == [24, 8, 32]


def test_bits_of_a_float_are_refused():
    @ti.kernel
    def run(x: ti.f64) -> ti.i32:
        return tm.popcnt(x)

    with pytest.raises(ti.TaiTypeError, match="popcnt takes whole numbers") as info:
        run(1.0)
    assert "tm.popcnt(x)" in str(info.value)
    with pytest.raises(ti.TaiSyntaxError, match="kernels and functions only"):
        tm.clz(5)
