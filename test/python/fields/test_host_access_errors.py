"""Refused accesses to fields and arrays from Python: errors of the package, which name them."""

import numpy as np
import pytest
import tai as ti


@pytest.fixture(autouse=True)
def scene():
    ti.init(offline_cache=False)
    x = ti.field(ti.f32, shape=4, name="x")
    v = ti.Vector.field(2, ti.f32, shape=3, name="v")
    return x, v, ti.ndarray(ti.f32, shape=3)


def put(target, key, value):
    target[key] = value


@ti.kernel
def take(a: ti.types.ndarray(), b: ti.f32):
    for i in range(3):
        a[i] = b


CASES = {
    "slice": (lambda x, v, a: x[0:2], "field 'x' has no slices"),
    "ellipsis": (lambda x, v, a: x[...], "field 'x' has no slices"),
    "store to a slice": (lambda x, v, a: put(x, slice(2), 1.0), "field 'x' has no slices"),
    "slice of vectors": (lambda x, v, a: v[1:], "field 'v' has no slices"),
    "store to a slice of vectors": (lambda x, v, a: put(v, slice(2), [1, 2]), "'v' has no slices"),
    "text": (lambda x, v, a: x["a"], "field 'x': an index is a whole number"),
    "fraction": (lambda x, v, a: x[0.5], "field 'x': an index is a whole number"),
    "fraction in a list": (lambda x, v, a: x[[1.7]], "field 'x': an index is a whole number"),
    "fraction in an array": (lambda x, v, a: x[np.array([1.7])], "'x': an index is a whole number"),
    "element": (lambda x, v, a: put(v, 0, "a"), "field 'v' holds numbers of type f32, not 'a'"),
    "fill": (lambda x, v, a: x.fill(None), "field 'x' is filled by a number of type f32, not None"),
    "fill by text": (lambda x, v, a: v.fill("a"), "field 'v' is filled by a number"),
    "fill of vectors": (lambda x, v, a: v.fill([1, 2, 3]), r"element of shape \(2,\), not by"),
    "array index": (lambda x, v, a: a[5], r"array of f32 and shape \(3,\) has no element 5"),
    "array key": (lambda x, v, a: a["a"], "has no element 'a'"),
    "two for one": (lambda x, v, a: a[0, 0], r"has no element \(0, 0\)"),
    "store far": (lambda x, v, a: put(a, 9, 1.0), "has no element 9"),
    "array value": (lambda x, v, a: put(a, 0, "abc"), "cannot take 'abc'"),
    "array fill": (lambda x, v, a: a.fill("abc"), "cannot take 'abc'"),
    "ragged": (lambda x, v, a: a.from_numpy([[1], [1, 2]]), "cannot take"),
    "negative shape": (lambda x, v, a: ti.ndarray(ti.f32, -1), r"shape \(-1,\) does not exist"),
    "far index": (lambda x, v, a: x[2**64], "field 'x': index 18446744073709551616 is out of"),
    "store far away": (lambda x, v, a: put(x, -(2**70), 1.0), "field 'x': index -118.* is out of"),
    "far vector": (lambda x, v, a: v[2**64][0], "field 'v': index"),
    "array for one": (lambda x, v, a: put(x, 0, np.zeros(2)), "field 'x' holds one number an elem"),
    "huge number": (lambda x, v, a: put(x, 0, 10**400), "'x': a whole number of 1329 bits is too"),
    "huge fill": (lambda x, v, a: x.fill(10**400), "'x': a whole number of 1329 bits is too"),
    "complex": (lambda x, v, a: x.from_numpy(np.zeros(4, complex)), "but the array complex128"),
    "complex array": (lambda x, v, a: a.from_numpy(np.zeros(3, complex)), "complex128"),
    "dates": (lambda x, v, a: x.from_numpy(np.zeros(4, "M8[s]")), "but the array datetime64"),
    "huge array": (lambda x, v, a: ti.ndarray(ti.f32, 2**64), "no memory for an array of f32"),
    "array of 2**60": (lambda x, v, a: ti.ndarray(ti.f32, 2**60), "no memory for an array of f32"),
    "name": (lambda x, v, a: ti.field(ti.f32, shape=2, name=5), "name of a field is text, not 5"),
    "far offset": (lambda x, v, a: ti.field(ti.f32, shape=2, offset=2**64), "of less than 62 bits"),
    "offset": (lambda x, v, a: ti.field(ti.f32, shape=2, offset=0.5), "an offset is a whole num"),
    "text for a shape": (lambda x, v, a: ti.ndarray(ti.f32, "a"), "made of whole numbers"),
    "array for a number": (lambda x, v, a: take(a, np.ones(3)), "'b' of kernel 'take' expects a"),
}


@pytest.mark.parametrize("name", CASES)
def test_misuse(scene, name):
    action, message = CASES[name]
    for _ in range(2):
        with pytest.raises(ti.TaiError, match=message):
            action(*scene)
    x, v, a = scene
    assert not x.to_numpy().any() and not v.to_numpy().any() and not a.to_numpy().any()


def test_numbers_of_numpy_are_numbers(scene):
    x, v, a = scene
    x[np.int64(1)] = np.float32(2)
    x[[2]] = np.array(3.0)
    assert x[np.array(2)] == 3
    v[np.array([1])] = np.array([1, 2])
    take(a, np.array(4.0))
    assert x.to_numpy().tolist() == [0, 2, 3, 0] and v[1][1] == 2 and a[-1] == 4


@pytest.mark.parametrize("words", [["a", "b"], [{}, {}], ["2020-01-01"] * 2])
def test_arrays_that_hold_no_numbers(words):
    ti.init(arch=ti.cpu)
    x = ti.field(ti.f32, 2)
    with pytest.raises(ti.TaiRuntimeTypeError, match="holds numbers of type f32, but"):
        x.from_numpy(np.array(words))
    assert not x.to_numpy().any()


def test_members_that_a_struct_lacks():
    s = ti.Struct.field({"a": ti.f32, "b": ti.i32}, shape=3, name="s")
    for refused in (
        lambda: put(s, 0, {"a": 1.0, "c": 2}),
        lambda: s.from_numpy({"c": np.zeros(3, np.float32)}),
    ):
        with pytest.raises(ti.errors.TaiRuntimeTypeError, match="'s' has no member 'c'"):
            refused()
    assert s.a[0] == 0
    with pytest.raises(ti.errors.TaiRuntimeTypeError, match="a dictionary of arrays, not ndarray"):
        s.from_numpy(np.zeros(3))
    with pytest.raises(ti.errors.TaiRuntimeTypeError, match="a dictionary of arrays, not list"):
        s.from_torch([])


def test_parents_end_at_the_root(scene):
    x = scene[0]
    assert x.parent(2**70) is None and x.parent(1) is not None
