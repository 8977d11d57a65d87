"""Fields and arrays as NumPy and other libraries see them, and numbers in NumPy's functions."""

import copy
import math
from unittest import mock

import numpy as np
import pytest
import tai as ti
from tai._impl.interop import sharing

Pair = ti.types.vector(2, ti.f32)


@pytest.fixture(autouse=True)
def program(fresh_program):
    ti.init(offline_cache=False)


def _everything():
    x = ti.field(ti.f32, shape=(2, 3), name="x")
    x.from_numpy(np.arange(6, dtype=np.float32).reshape(2, 3))
    v = ti.Vector.field(2, ti.f64, shape=3)
    v.fill(4.0)
    i = ti.field(ti.i8, shape=5)
    s = ti.types.struct(pos=Pair, mass=ti.f64).field(shape=3)
    s.mass.fill(2)
    array = ti.Vector.ndarray(2, ti.i32, 4)
    array.fill(7)
    number = ti.field(ti.f64, shape=())
    number[None] = 1.5
    return [x, v, i, s.mass, s.pos, array, number]


def test_copies_by_each_protocol():
    for each in _everything():
        copy = np.asarray(each)
        wanted = each.to_numpy()
        assert copy.dtype == wanted.dtype and np.array_equal(copy, wanted)
        assert np.array(each, dtype=np.float64).dtype == np.float64
        assert np.array_equal(each.__array__(), wanted)
        if wanted.ndim:
            assert each.__array_interface__["shape"] == wanted.shape
        with pytest.raises(ValueError, match="makes a copy"):
            each.__array__(copy=False)
        copy += 1  # the copy is the caller's own
        assert np.array_equal(each.to_numpy(), wanted)


def test_copies_of_sparse_fields_and_of_none_of_the_elements():
    x = ti.field(ti.i32)
    ti.root.pointer(ti.i, 4).dense(ti.i, 2).place(x)
    x[3] = 5
    assert np.asarray(x).tolist() == [0, 0, 0, 5, 0, 0, 0, 0]
    assert np.asarray(ti.ndarray(ti.f32, (0, 3))).shape == (0, 3)


def test_structs_are_structured_arrays(tmp_path):
    Inner = ti.types.struct(a=ti.i32)
    s = ti.types.struct(pos=Pair, inner=Inner).field(shape=(2, 2))
    s[0, 1].pos = [1, 2]
    s[1, 1].inner.a = 3
    array = np.asarray(s)
    assert array.shape == (2, 2) and array.dtype.names == ("pos", "inner")
    assert array["pos"][0, 1].tolist() == [1, 2] and array["inner"]["a"][1, 1] == 3
    x = ti.field(ti.f32, shape=3)
    np.savez(tmp_path / "a.npz", s=s, x=x)
    with np.load(tmp_path / "a.npz") as loaded:
        assert np.array_equal(loaded["x"], x.to_numpy())
        s.fill(0)
        s.from_numpy(loaded["s"])
    assert s[1, 1].inner.a == 3 and s[0, 1].pos[1] == 2


def test_functions_of_numpy():
    x = _everything()[0]
    array = x.to_numpy()
    assert np.max(x) == 5 and np.mean(x) == 2.5 and np.sum(x, axis=0).tolist() == [3, 5, 7]
    assert np.array_equal(np.sqrt(x), np.sqrt(array))
    assert np.allclose(x, array) and np.linalg.norm(x) == np.linalg.norm(array)
    np.testing.assert_array_equal(x, array)
    with pytest.raises(ti.TaichiRuntimeTypeError, match="cannot write"):
        np.sqrt(array, out=x)


def test_pictures_of_fields():
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    from matplotlib import pyplot

    x = _everything()[0]
    shown = pyplot.imshow(x)
    assert np.array_equal(shown.get_array(), x.to_numpy())
    pyplot.close("all")


@pytest.mark.parametrize(
    "code, line",
    [
        ("x + y", "z[i, j] = x[i, j] + y[i, j]"),
        ("x * 2", "z[i, j] = x[i, j] * 2"),
        ("2 / x", "z[i, j] = 2 / x[i, j]"),
        ("np.ones((2, 3)) - x", "z[i, j] = y[i, j] - x[i, j]"),
        ("np.float32(2) ** x", "** x[i, j]"),
        ("np.add(x, 1)", "z[i, j] = x[i, j] + 1"),
        ("x < 3", "z[i, j] = x[i, j] < 3"),
        ("-x", "z[i, j] = -x[i, j]"),
        ("loss + 1", "z[None] = loss[None] + 1"),
        ("~i", "z[ii] = ~i[ii]"),
        ("i & 1", "z[ii] = i[ii] & 1"),
        ("array * 2", "z[i] = x[i] * 2"),
        ("x == 1", "z[i, j] = x[i, j] == 1"),
        ("1 == x", "z[i, j] = x[i, j] == 1"),
        ("x != 0.5", "z[i, j] = x[i, j] != 0.5"),
        ("x == np.ones((2, 3))", "z[i, j] = x[i, j] == y[i, j]"),
        ("np.float32(2) == x", "z[i, j] = 2.0 == x[i, j]"),
        ("y == [1, 2]", "z[i, j] = y[i, j] == x[i, j]"),
        ("x == x.to_numpy().tolist()", "z[i, j] = x[i, j] == y[i, j]"),
        ("array != 1", "z[i] = x[i] != 1"),
        ("loss == 0", "z[None] = loss[None] == 0"),
        ("vector == 1", "z[i] = vector[i] == 1"),
        ("vector == ti.Vector([1, 2])", "z[i] = vector[i] == y[i]"),
        ("struct == 1", "z[i] = struct[i] == 1"),
        ("1 in [x, 2]", "z[i, j] = x[i, j] == 1"),
    ],
)
def test_operators_show_the_kernel_to_write(code, line):
    x, y = (ti.field(ti.f32, shape=(2, 3), name=name) for name in "xy")
    i = ti.field(ti.i32, shape=4, name="i")
    loss = ti.field(ti.f32, shape=(), name="loss")
    array = ti.ndarray(ti.f32, 3)
    vector = ti.Vector.field(2, ti.f32, shape=3, name="vector")
    struct = ti.types.struct(pos=Pair, mass=ti.f64).field(shape=3, name="struct")
    names = {"x": x, "y": y, "i": i, "loss": loss, "array": array, "np": np, "ti": ti}
    names |= {"vector": vector, "struct": struct}
    with pytest.raises(ti.TaichiRuntimeTypeError, match="no number in Python") as caught:
        eval(code, names)
    assert line in str(caught.value) and "@ti.kernel" in str(caught.value)


def test_two_fields_are_equal_if_they_are_the_same():
    things = [*_everything(), ti.ndarray(ti.f32, 3)]
    for a in things:
        for b in things:
            assert (a == b) is (a is b) and (a != b) is (a is not b)
        assert a in things and things.index(a) == [b is a for b in things].index(True)
        assert a != "x" and not a == "x" and a != None and a != object()  # noqa: E711
        assert a == mock.ANY
    assert len(set(things)) == len(things) and dict.fromkeys(things, 1)[things[0]] == 1
    assert copy.copy(things) == things and (things[0], 1) == (things[0], 1)


def test_a_field_of_one_number_is_read_by_float():
    number, whole = ti.field(ti.f64, shape=(), name="number"), ti.field(ti.i32, shape=())
    array = ti.ndarray(ti.f32, ())
    number[None], whole[None], array[None] = 1.75, -3, 0.5
    assert [float(t) for t in (number, whole, array)] == [1.75, -3.0, 0.5]
    assert [int(t) for t in (number, whole, array)] == [1, -3, 0]
    assert math.sqrt(number) == math.sqrt(1.75) and type(float(whole)) is float
    x, v = ti.field(ti.f32, shape=3, name="x"), ti.Vector.field(2, ti.f32, shape=(), name="v")
    s = ti.types.struct(a=ti.f32).field(shape=(), name="s")
    refused = ((x, "float(x[i])"), (v, "v[None]"), (ti.ndarray(ti.f32, 1), "float(x[i])"),
               (s, "s[None]"))  # fmt: skip
    for thing, hint in refused:
        for function in (float, int, math.sqrt):
            with pytest.raises(ti.TaiRuntimeTypeError, match="is no number in Python") as caught:
                function(thing)
            assert hint.removeprefix("float") in caught.value.hint.removeprefix("read an element: ")
    with pytest.raises(ti.TaiRuntimeError, match="is not placed"):
        float(ti.field(ti.f32))


@pytest.mark.parametrize("dt", [ti.f32, ti.f64, ti.i32])
def test_a_field_is_no_argument_of_a_number(dt):
    """Its gradient would be lost. The first launch with a number is checked in Python, later ones
    in C++."""
    number, x = ti.field(dt, shape=(), name="number"), ti.field(dt, shape=3, name="x")

    @ti.kernel
    def store(a: dt):
        for i in x:
            x[i] = a

    for _ in range(3):
        for thing in (number, x, ti.ndarray(dt, ())):
            with pytest.raises(ti.TaiRuntimeTypeError, match="expects a (whole )?number"):
                store(thing)
        store(2)
    for store_to in (lambda v: x.fill(v), lambda v: x.__setitem__(0, v)):
        with pytest.raises(ti.TaiRuntimeTypeError, match="number"):
            store_to(number)
    assert x.to_numpy().tolist() == [2, 2, 2]


def test_arrays_fill_fields():
    x, *_ = _everything()
    x.fill(np.full((2, 3), 7))
    assert np.all(x.to_numpy() == 7)
    v = ti.Vector.field(2, ti.f32, shape=3)
    v.fill(np.arange(6).reshape(3, 2))
    assert v.to_numpy().tolist() == [[0, 1], [2, 3], [4, 5]]
    v.fill([8, 9])
    assert v[2].to_list() == [8, 9]
    for field, shape in ((x, (3,)), (x, (3, 2)), (v, (4, 2)), (v, (2, 3))):
        with pytest.raises(ti.TaichiRuntimeTypeError) as caught:
            field.fill(np.ones(shape))
        whole = field.shape + field.element_shape
        assert f"has shape {whole}" in str(caught.value) and f"fills it {shape}" in str(
            caught.value
        )
    with pytest.raises(ti.TaichiRuntimeTypeError, match="is filled by a number or by an element"):
        v.fill([1, 2, 3])


def test_formats_of_vectors_and_fields():
    v, m = ti.Vector([1.0, 2.5]), ti.Matrix([[1, 2], [3, 4]])
    assert f"{v:.2f} {m:2d}" == "[1.00, 2.50] [[ 1,  2], [ 3,  4]]"
    assert f"{v}" == str(v)
    x = ti.field(ti.f32, shape=2)
    x[1] = 0.125
    loss = ti.field(ti.f32, shape=())
    assert f"{x:.1e} {loss:.3f} {x}" == f"[0.0e+00, 1.2e-01] 0.000 {x}"


def test_memory_is_shared_by_dlpack_alone():
    x = ti.field(ti.f32, shape=4)
    shared, copied = np.from_dlpack(x), np.asarray(x)
    x[1] = 3
    assert shared[1] == 3 and copied[1] == 0
    array = ti.ndarray(ti.f32, 4)
    np.from_dlpack(array)[2] = 5
    assert array[2] == 5
    assert not hasattr(x, "__cuda_array_interface__")  # there is no GPU


@pytest.mark.skipif(
    np.lib.NumpyVersion(np.__version__) < "2.1.0", reason="older NumPy does not say that it asks"
)
@pytest.mark.parametrize("options", [{}, {"device": "cpu"}])
def test_a_view_of_a_field_on_a_gpu_is_refused(options, monkeypatch):
    """NumPy's own error would name neither the field nor the way out."""
    monkeypatch.setattr(sharing, "field_device", lambda field: (sharing.CUDA, 0))
    x = ti.field(ti.f32, shape=4, name="x")
    with pytest.raises(BufferError, match=r"'x' is on the GPU, where .*copy it, by to_numpy\(\)"):
        np.from_dlpack(x, **options)
    assert x.to_numpy().tolist() == [0, 0, 0, 0]


def test_how_a_gpu_describes_the_memory_of_a_field():
    """`__cuda_array_interface__` has the keys of NumPy's own interface, and a stream."""
    x = ti.Vector.field(2, ti.f32, shape=(2, 3))
    x.from_numpy(np.arange(12).reshape(2, 3, 2))
    found, owner = sharing.cuda_interface(x)
    assert found.pop("stream") == 1 and owner is not None

    class Described:
        __array_interface__ = found

    view = np.asarray(Described())
    np.testing.assert_array_equal(view, x.to_numpy())
    view[1, 2, 0] = 5  # not read-only
    assert x[1, 2][0] == 5
    with pytest.raises(AttributeError, match="field 'y' holds bf16"):
        sharing.cuda_interface(ti.field(ti.bf16, shape=3, name="y"))


def test_how_a_gpu_describes_members_of_structs_and_parts_of_trees():
    points = ti.types.struct(a=ti.f32, v=ti.types.vector(3, ti.f64)).field(shape=7)
    inside, sparse, single = ti.field(ti.i32), ti.field(ti.f32), ti.field(ti.f64, shape=())
    ti.root.dense(ti.ij, (5, 3)).place(inside)
    ti.root.pointer(ti.i, 4).dense(ti.i, 2).place(sparse)
    points.v.from_numpy(np.arange(21.0).reshape(7, 3))
    for field in (points.a, points.v, inside, single):
        found, _ = sharing.cuda_interface(field)
        assert found["version"] == 3 and found["data"][1] is False

        class Described:
            __array_interface__ = {name: found[name] for name in found if name != "stream"}

        view = np.asarray(Described())
        view.flat[-1] = 5  # not read-only, and of the field
        np.testing.assert_array_equal(view, field.to_numpy())
        assert view.dtype == field.dtype.numpy
    with pytest.raises(AttributeError):
        sharing.cuda_interface(sparse)
    # Memory of the host, as that of the emulated device is, so that other libraries copy it.
    arrays = (ti.ndarray(ti.f32, 4), ti.Vector.ndarray(2, ti.f64, 5))
    for thing in (points, points.a, points.v, inside, single, sparse, *arrays):
        assert not hasattr(thing, "__cuda_array_interface__")


def _energy():
    g = ti.field(ti.f64, shape=3, needs_grad=True)
    g.fill(0.3)

    @ti.kernel
    def energy() -> ti.f64:
        total = ti.f64(0.0)
        for i in g:
            total += g[i] ** 2
        return total

    return g, energy


UNARY = [
    "sqrt", "cbrt", "exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "sin", "cos", "tan",
    "sinh", "cosh", "tanh", "arcsin", "arccos", "arctan", "arcsinh", "arctanh", "square",
    "reciprocal", "negative", "absolute", "fabs", "degrees", "radians",
]  # fmt: skip


@pytest.mark.parametrize("name", UNARY)
def test_gradients_of_functions_of_one_number(name):
    g, energy = _energy()
    function = getattr(np, name)
    with ti.ad.Tape() as tape:
        value = function(energy())
    tape.backward(value)
    at = 0.27
    slope = (function(at + 1e-6) - function(at - 1e-6)) / 2e-6
    assert float(value) == pytest.approx(function(at), rel=1e-12)
    assert g.grad[0] == pytest.approx(0.6 * slope, rel=1e-6)


@pytest.mark.parametrize("name", ["maximum", "minimum", "hypot", "arctan2", "add", "multiply",
                                  "power", "divide", "subtract", "remainder", "fmax"])  # fmt: skip
@pytest.mark.parametrize("is_first", [True, False])
def test_gradients_of_functions_of_two_numbers(name, is_first):
    g, energy = _energy()
    function = getattr(np, name)

    def of(a):
        return function(a, 0.25) if is_first else function(np.float64(0.7), a)

    with ti.ad.Tape() as tape:
        value = of(energy())
    if hasattr(type(value), "grad"):
        tape.backward(value)
    slope = (of(0.27 + 1e-6) - of(0.27 - 1e-6)) / 2e-6
    assert float(value) == pytest.approx(float(of(0.27)), rel=1e-12)
    assert g.grad[0] == pytest.approx(0.6 * slope, rel=1e-5, abs=1e-9)


@pytest.mark.parametrize(
    "of",
    [
        lambda a: np.clip(a, 0, 1), lambda a: np.clip(a, 0.5, 1), lambda a: np.clip(a, None, 0.2),
        lambda a: np.clip(0.9, 0, a), lambda a: np.clip(3 * a, a_min=0, a_max=0.7),
        lambda a: np.where(a > 0.1, 3 * a, 0.0), lambda a: np.where(a > 1, a, 2.0), np.sinc,
        lambda a: np.logaddexp(a, 1.0), lambda a: np.logaddexp2(0.5, a), lambda a: np.fmod(a, 0.1),
        lambda a: np.copysign(a, -2.0),
    ],
)  # fmt: skip
def test_gradients_of_functions_of_several_numbers(of):
    g, energy = _energy()
    with ti.ad.Tape() as tape:
        value = of(energy())
    if hasattr(type(value), "grad"):
        tape.backward(value)
    slope = (of(0.27 + 1e-6) - of(0.27 - 1e-6)) / 2e-6
    assert float(value) == pytest.approx(float(of(0.27)), rel=1e-12)
    assert g.grad[0] == pytest.approx(0.6 * slope, rel=1e-5, abs=1e-9)


def test_numbers_are_saved_rounded_and_compared_under_a_tape(tmp_path):
    g, energy = _energy()
    with ti.ad.Tape() as tape:
        number = energy()
        np.savez(tmp_path / "a.npz", number=number)
        np.savetxt(tmp_path / "a.txt", [number])
        assert np.isclose(number, 0.27) and np.allclose(number, number) and np.round(number, 1)
        assert f"{number:.2f} {number}" == f"0.27 {float(number)}"
        assert number > 0.2 and int(number) == 0 and not math.isnan(number)
    tape.backward(number)
    assert np.load(tmp_path / "a.npz")["number"] == number
    assert g.grad[0] == pytest.approx(0.6)


def test_what_would_lose_a_gradient_is_refused():
    g, energy = _energy()
    with ti.ad.Tape():
        number = energy()
        lost = [
            lambda: np.clip(number, np.zeros(2), 1), lambda: np.where([True, False], number, 0),
            lambda: np.ones(2) * number, lambda: np.stack([number, number]),
            lambda: np.interp(number, [0, 1], [0, 1]), lambda: np.nextafter(number, 1),
        ]  # fmt: skip
        for call in lost:
            with pytest.raises(ti.TaiAutodiffError, match="knows no gradient"):
                call()
        assert np.isfinite(number) and np.floor(number) == 0 and np.ndim(number) == 0
        assert np.clip(float(number), 0, 0.1) == 0.1
    assert np.clip(number, 0, 0.1) == 0.1  # no tape records


def test_vectors_with_a_gradient_are_refused_too():
    g, _ = _energy()

    @ti.kernel
    def both() -> Pair:
        return ti.Vector([g[0], 2 * g[1]])

    with ti.ad.Tape():
        vector = both()
        for call in (lambda: np.sin(vector), lambda: np.linalg.norm(vector)):
            with pytest.raises(ti.TaiAutodiffError, match="have a gradient"):
                call()
        assert np.asarray(vector.to_numpy()).shape == (2,)
    assert np.sin(vector).shape == (2,)
