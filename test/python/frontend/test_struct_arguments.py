"""Parameters of kernels that are structs."""

import numpy as np
import pytest
import tai as ti

Vec = ti.types.vector(3, ti.f64)
Body = ti.types.struct(pos=Vec, mass=ti.f64, count=ti.i32)


@pytest.fixture(autouse=True)
def doubles(fresh_program):
    ti.init(default_fp=ti.f64, offline_cache=False)


def test_members_of_an_argument():
    @ti.kernel
    def run(a: Body, factor: ti.f64) -> ti.f64:
        b = a
        return (b.pos * factor).sum() * a.mass + a.count

    body = Body(pos=[1, 2, 3], mass=2.0, count=5)
    assert run(body, 3.0) == 41
    body.mass = 1.0
    assert run(body, 3.0) == 23
    assert run({"count": 1, "mass": 0.5, "pos": [1, 1, 1]}, 2.0) == 4
    assert run(factor=1.0, a=body) == 11


def test_structs_in_structs_beside_arrays_and_templates():
    Pair = ti.types.struct(left=Body, right=Body)
    x = ti.field(ti.f64, shape=4)

    @ti.kernel
    def run(pair: Pair, out: ti.types.ndarray(), field: ti.template(), n: ti.i32):
        for i in field:
            field[i] = pair.left.mass * i + pair.right.pos[1]
        for i in out:
            out[i] = pair.right.count + n

    out = np.zeros(3)
    run(Pair(left=Body(mass=2.0), right=Body(pos=[0, 7, 0], count=4)), out, x, 1)
    assert x.to_numpy().tolist() == [7, 9, 11, 13]
    assert out.tolist() == [5, 5, 5]


def test_a_dataclass_with_methods_in_a_method():
    @ti.dataclass
    class Ball:
        centre: Vec
        radius: ti.f64

        @ti.func
        def volume(self):
            return self.radius**3

    @ti.data_oriented
    class World:
        def __init__(self):
            self.balls = Ball.field(shape=2)

        @ti.kernel
        def put(self, i: ti.i32, ball: Ball) -> ti.f64:
            self.balls[i] = ball
            return ball.volume() + self.balls[i].volume()

    world = World()
    assert world.put(1, Ball(centre=[1, 2, 3], radius=2.0)) == 16
    assert world.balls[1].centre.to_list() == [1, 2, 3]


def test_gradients_by_fields_and_forward_mode():
    x = ti.field(ti.f64, shape=3, needs_grad=True, needs_dual=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True, needs_dual=True)
    x.from_numpy(np.array([1.0, 2.0, 3.0]))

    @ti.kernel
    def run(body: Body):
        for i in x:
            loss[None] += body.mass * x[i] ** 2 * body.pos[i]

    body = Body(pos=[1, 2, 3], mass=0.5)
    with ti.ad.Tape(loss):
        run(body)
        body.mass = 100.0  # the tape has the numbers of the launch
    assert x.grad.to_numpy().tolist() == [1, 4, 9]
    with ti.ad.FwdMode(loss=loss, param=x, seed=[1.0, 0.0, 0.0]):
        run(Body(pos=[1, 2, 3], mass=0.5))
    assert loss.dual[None] == 1


def test_what_is_no_such_struct_is_refused():
    @ti.kernel
    def run(a: Body) -> ti.f64:
        return a.mass

    for given in (3.0, {"mass": 1.0}, ti.Struct(pos=[0, 0, 0], mass=1.0, count=1, more=2)):
        with pytest.raises(ti.TaiRuntimeTypeError, match=r"argument 'a' of kernel 'run' expects"):
            run(given)
    with pytest.raises(ti.TaiRuntimeTypeError, match=r"argument 'a\.count' of kernel 'run'"):
        run({"pos": [0, 0, 0], "mass": 1.0, "count": 1.5})
    with pytest.raises(ti.TaiRuntimeTypeError, match="needs an argument 'a'"):
        run()


def test_an_argument_is_not_assigned_to():
    @ti.kernel
    def run(a: Body):
        a.mass = 2.0

    with pytest.raises(ti.TaiTypeError, match="'a.mass' is part of a value") as info:
        run(Body())
    assert "hint: give it a name" in str(info.value)
