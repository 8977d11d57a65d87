"""Calls of kernels that go straight to C++, again and again."""

import numpy as np
import pytest
import tai as ti

# Py_TPFLAGS_HAVE_VECTORCALL and Py_TPFLAGS_METHOD_DESCRIPTOR of the C API.
VECTORCALL = 1 << 11
METHOD = 1 << 17


@ti.kernel
def sum_of_forty(
    a0: ti.i32, a1: ti.i32, a2: ti.i32, a3: ti.i32, a4: ti.i32, a5: ti.i32, a6: ti.i32,
    a7: ti.i32, a8: ti.i32, a9: ti.i32, b0: ti.i32, b1: ti.i32, b2: ti.i32, b3: ti.i32,
    b4: ti.i32, b5: ti.i32, b6: ti.i32, b7: ti.i32, b8: ti.i32, b9: ti.i32, c0: ti.i32,
    c1: ti.i32, c2: ti.i32, c3: ti.i32, c4: ti.i32, c5: ti.i32, c6: ti.i32, c7: ti.i32,
    c8: ti.i32, c9: ti.i32, d0: ti.i32, d1: ti.i32, d2: ti.i32, d3: ti.i32, d4: ti.i32,
    d5: ti.i32, d6: ti.i32, d7: ti.i32, d8: ti.i32, d9: ti.i32,
) -> ti.i32:  # fmt: skip
    low = a0 + 2 * a1 + 3 * a2 + 4 * a3 + 5 * a4 + 6 * a5 + 7 * a6 + 8 * a7 + 9 * a8 + 10 * a9
    low += 11 * b0 + 12 * b1 + 13 * b2 + 14 * b3 + 15 * b4 + 16 * b5 + 17 * b6 + 18 * b7
    low += 19 * b8 + 20 * b9 + 21 * c0 + 22 * c1 + 23 * c2 + 24 * c3 + 25 * c4 + 26 * c5
    low += 27 * c6 + 28 * c7 + 29 * c8 + 30 * c9 + 31 * d0 + 32 * d1 + 33 * d2 + 34 * d3
    return low + 35 * d4 + 36 * d5 + 37 * d6 + 38 * d7 + 39 * d8 + 40 * d9


def test_many_arguments():
    ti.init()
    rng = np.random.default_rng(3)
    for _ in range(3):
        given = [int(x) for x in rng.integers(-1000, 1000, 40)]
        assert sum_of_forty(*given) == sum((i + 1) * x for i, x in enumerate(given))
    with pytest.raises(ti.TaiRuntimeTypeError, match="does not fit"):
        sum_of_forty(*given[:-1], 1 << 40)


def test_calls_make_no_tuples():
    assert type(sum_of_forty).__flags__ & VECTORCALL
    assert type(sum_of_forty.grad).__flags__ & VECTORCALL
    assert type(sum_of_forty).__flags__ & METHOD


def test_arguments_of_all_kinds_again_and_again():
    ti.init()
    out = ti.field(ti.f64, shape=4)

    @ti.kernel
    def put(at: ti.template(), flag: ti.u1, x: ti.f64, a: ti.types.ndarray(ndim=1), k: ti.u8):
        if flag:
            out[at] = x + a[0] + a[1] + k

    for step in range(4):
        a = np.array([step, 0.5])
        put(step % 2, step != 1, 0.25, a, 255)
    np.testing.assert_array_equal(out.to_numpy(), [2 + 255.75, 3 + 255.75, 0, 0])
    # Names and defaults go another way, and come to the same.
    put(at=2, flag=True, x=1.0, a=np.array([1.0, 1.0]), k=0)
    assert out[2] == 3.0


def test_fields_that_come_and_go_between_calls():
    ti.init()
    x = ti.field(ti.f32, shape=())

    @ti.kernel
    def bump(t: ti.i32):
        x[None] += t

    for _ in range(3):
        bump(1)
    block = ti.FieldsBuilder()
    y = ti.field(ti.f32)
    block.dense(ti.i, 4).place(y)
    tree = block.finalize()

    @ti.kernel
    def fill(value: ti.f32):
        for i in y:
            y[i] = value

    for value in (1.0, 2.0, 3.0):
        bump(1)
        fill(value)
    assert y[3] == 3.0
    tree.destroy()
    bump(1)
    assert x[None] == 7.0
    with pytest.raises(ti.TaiError, match="destroyed"):
        fill(4.0)


def test_a_tape_between_calls():
    ti.init()
    x = ti.field(ti.f32, shape=(), needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def add(t: ti.f32):
        loss[None] += t * x[None]

    x[None] = 2.0
    add(1.0)
    add(1.0)
    with ti.ad.Tape(loss):
        add(3.0)
        add(4.0)
    assert x.grad[None] == 7.0
    before = loss[None]
    add(1.0)
    assert loss[None] == before + 2.0
    assert x.grad[None] == 7.0


@pytest.mark.parametrize("grad", [False, True])
def test_methods(grad):
    ti.init()

    @ti.data_oriented
    class Scene:
        def __init__(self, factor):
            self.factor = factor
            self.x = ti.field(ti.f32, shape=(), needs_grad=True)
            self.y = ti.field(ti.f32, shape=(), needs_grad=True)

        @ti.kernel
        def scale(self, t: ti.f32):
            self.y[None] += t * self.factor * self.x[None]

    scenes = [Scene(2.0), Scene(3.0)]
    for scene in scenes:
        scene.x[None] = 1.0
        scene.y.grad[None] = 1.0
    for _ in range(3):
        for scene in scenes:
            if grad:
                scene.scale.grad(2.0)
            else:
                scene.scale(2.0)
    for scene in scenes:
        found = scene.x.grad[None] if grad else scene.y[None]
        assert found == 3 * 2.0 * scene.factor


def test_methods_by_other_names():
    ti.init()
    y = ti.field(ti.i32, shape=())

    @ti.data_oriented
    class Scene:
        @ti.kernel
        def add(self, t: ti.i32):
            y[None] += t

    class Other(Scene):
        pass

    scene, other = Scene(), Other()
    for _ in range(3):
        scene.add(1)
        bound = scene.add
        bound(10)
        bound(t=100)
        Scene.add(scene, 1000)
        other.add(10000)
    assert y[None] == 3 * 11111
    scene.add = lambda t: 7
    assert scene.add(1) == 7
    with pytest.raises(ti.TaiRuntimeTypeError, match="needs an argument 't'"):
        other.add()
