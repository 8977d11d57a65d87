"""The parts of a kernel, each by itself: signature, kinds of arguments, specialisations, slots."""

import struct

import numpy as np
import pytest
import tai as ti
from tai._impl.base.program import get_program
from tai._impl.launch.launch import pack
from tai._impl.launch.signature import Parameter, Signature
from tai._impl.launch.specialization import Specializations
from tai._impl.launch.specs import ResultSpec, spec_of
from tai._impl.values.types import ScalarType


@pytest.fixture(autouse=True)
def program():
    ti.init(offline_cache=False)


def scale(a: ti.f32, n: ti.i32 = 3, y: ti.types.ndarray() = None) -> ti.f32:
    for i in range(n):
        y[i] *= a
    return a


# Signature


def test_a_signature_binds_by_place_name_and_default():
    signature = Signature(scale, False)
    assert (signature.kernel, signature.names) == ("scale", ["a", "n", "y"])
    assert [p.has_default for p in signature.parameters] == [False, True, True]
    assert signature.result.dtype is ti.f32 and not signature.is_known
    assert signature.bind((1.5,), {"y": 7}) == [1.5, 3, 7]
    assert signature.bind((1.5, 2, 4), {}) == [1.5, 2, 4]


@pytest.mark.parametrize(
    "args, kwargs, said",
    [
        ((), {}, "kernel 'scale' needs an argument 'a'"),
        ((1, 2, 3, 4), {}, "takes 3 arguments, but got 4"),
        ((1,), {"m": 2}, "has no parameter 'm'"),
        ((1,), {"a": 2}, "gets two values for parameter 'a'"),
    ],
)
def test_what_a_signature_refuses(args, kwargs, said):
    with pytest.raises(ti.TaiRuntimeTypeError, match=said):
        Signature(scale, False).bind(args, kwargs)


# Kinds of arguments


def test_kinds_of_arguments():
    a, n, y = Signature(scale, False).parameters
    assert spec_of("scale", a, 1.0).mlir_types == ["f32"]
    assert spec_of("scale", n, 1).description() == ("i", 32, False)
    plain = spec_of("scale", y, np.zeros((4, 2), np.float64))
    assert (plain.mlir_types, plain.has_gradient, plain.ndim) == (["memref<?x?xf64>"], False, 2)
    kept = spec_of("scale", y, ti.ndarray(ti.f32, 5, needs_grad=True))
    assert kept.mlir_types == ["memref<?xf32>"] * 2 and kept.names("y") == ["y", "y.grad"]
    vectors = spec_of("scale", y, ti.Vector.ndarray(3, ti.f32, 5))
    assert (vectors.ndim, vectors.element_shape, vectors.mlir_type) == (1, (3,), "memref<?x3xf32>")
    constant = spec_of("scale", Parameter("t", ti.template(), False, None), "text")
    assert (constant.kind, constant.constant, constant.mlir_types) == ("template", "text", [])


@pytest.mark.parametrize(
    "annotation, value, said",
    [
        (ti.types.ndarray(), "text", "'y' of kernel 'k' expects an array, but got str"),
        (ti.types.ndarray(), np.array(["a"]), "expects numbers"),
        (ti.types.ndarray(ti.f32), np.zeros(3), "expects an array of f32, but got f64"),
        (ti.types.ndarray(ndim=2), np.zeros(3), "expects 2 dimensions, but got 1"),
        (ti.types.ndarray(ti.math.vec3), np.zeros((2, 2), np.float32), "elements of shape"),
        (ti.types.ndarray(needs_grad=True), ti.ndarray(ti.f32, 3), "an array with a gradient"),
    ],
)
def test_arguments_that_do_not_fit(annotation, value, said):
    with pytest.raises(ti.TaiRuntimeTypeError, match=said):
        spec_of("k", Parameter("y", annotation, False, None), value)


def test_results():
    assert ResultSpec(ScalarType(ti.u8)).description() == ("u", 8, 1, None)
    kind, bits, count, wrap = ResultSpec(ti.types.matrix(2, 2, ti.f64)).description()
    assert (kind, bits, count) == ("d", 64, 4)
    assert wrap((1.0, 2.0, 3.0, 4.0)).to_numpy().tolist() == [[1, 2], [3, 4]]


# Specialisations


class Owner(ti.Kernel):
    """A kernel whose specialisations are asked for without a launch."""


def specializations(function):
    owner = Owner(function, False)
    return owner, Specializations(owner, function, {}), Signature(function, False)


def test_one_specialisation_for_each_kind():
    owner, store, signature = specializations(scale)
    program = get_program()
    first = store.get(program, signature, [1.0, 2, np.zeros(4, np.float32)])
    assert store.get(program, signature, [7.0, 9, np.ones(9, np.float32)]) is first
    other = store.get(program, signature, [1.0, 2, np.zeros(4)])
    assert other is not first and len(store) == 2 and store.last is other
    assert [spec.is_written for spec in first.specs] == [False, False, True]
    store.clear()
    assert len(store) == 0 and store.last is None
    assert owner._specializations is not store and len(owner._specializations) == 0


def test_a_tree_that_is_freed_takes_its_specialisations_along():
    x = ti.field(ti.f32)
    builder = ti.FieldsBuilder()
    builder.dense(ti.i, 4).place(x)
    tree = builder.finalize()

    def clear():
        for i in x:
            x[i] = 0

    owner, store, signature = specializations(clear)
    store.get(get_program(), signature, [])
    assert len(store) == 1
    tree.destroy()
    assert len(store) == 0 and store.last is None


# Launches


def bits(number: float) -> int:
    return int.from_bytes(struct.pack("f", number), "little")


def test_arguments_become_slots():
    owner, store, signature = specializations(scale)
    array = np.arange(6, dtype=np.float32)
    found = store.get(get_program(), signature, [1.5, 3, array])
    slots, kept = pack(signature, found, [1.5, 3, array], False)
    assert slots == [bits(1.5), 3, array.ctypes.data, 6]
    assert [(h.array is array, h.launched is array, h.slot) for h in kept] == [(True, True, 2)]
    strided = array[::2]
    slots, (held,) = pack(signature, found, [-1.0, 2, strided], False)
    assert held.array is strided and held.launched is not strided
    assert slots == [bits(-1.0), 2, held.launched.ctypes.data, 3]
    frozen = array.copy()
    frozen.flags.writeable = False
    with pytest.raises(ti.TaiRuntimeTypeError, match="'y' of kernel 'scale' is written"):
        pack(signature, found, [1.0, 1, frozen], False)
    with pytest.raises(ti.TaiRuntimeTypeError, match="expects a whole number"):
        pack(signature, found, [1.0, 1.5, array], False)
