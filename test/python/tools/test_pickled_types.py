"""Types and values that are pickled, copied, or sent to another process."""

import copy
import multiprocessing
import os
import pickle
import subprocess
import sys

import numpy as np
import pytest
import tai as ti


@ti.dataclass
class Ball:
    mass: ti.f32
    place: ti.math.vec2

    @ti.func
    def weight(self):
        return 10 * self.mass

    def doubled(self):
        return 2 * self.mass


@ti.kernel
def weigh(x: ti.f32) -> ti.f32:
    return 10 * x


def _pickled(thing):
    return pickle.loads(pickle.dumps(thing))


WAYS = pytest.mark.parametrize("way", [_pickled, copy.copy, copy.deepcopy])


@WAYS
@pytest.mark.parametrize("name", "u1 i8 i16 i32 i64 u8 u16 u32 u64 f16 bf16 f32 f64".split())
def test_number_types_stay_themselves(way, name):
    assert way(getattr(ti, name)) is getattr(ti, name)
    assert way([getattr(ti, name)])[0] is getattr(ti, name)


@WAYS
def test_types_of_elements_are_equal(way):
    ti.init(arch=ti.cpu)
    for kind in (ti.math.vec3, ti.types.matrix(2, 3, ti.f64), ti.types.vector(4, float)):
        made = way(kind)
        assert made == kind and hash(made) == hash(kind)
        assert made != ti.types.vector(7, ti.i8)
    vec3 = way(ti.math.vec3)
    x = vec3.field(shape=2)
    x[1] = vec3(1, 2, 3)

    @ti.kernel
    def run(v: vec3) -> vec3:
        return v + x[1]

    assert list(run(vec3(1, 1, 1))) == [2, 3, 4]


@WAYS
@pytest.mark.parametrize("dtype", [None, ti.f32, ti.math.vec2])
def test_types_of_arrays_work(way, dtype):
    ti.init(arch=ti.cpu)
    kind = way(ti.types.ndarray(dtype=dtype, ndim=1))

    @ti.kernel
    def run(x: kind):
        for i in x:
            x[i] = x[i] + 1

    array = np.zeros((3, 2) if dtype is ti.math.vec2 else 3, dtype=np.float32)
    run(array)
    assert (array == 1).all()


@WAYS
def test_structs(way):
    ti.init(arch=ti.cpu)
    assert way(Ball) is Ball and way(weigh) is weigh
    ball = way(Ball(3.0, [1, 2]))
    assert ball.mass == 3 and list(ball.place) == [1, 2] and ball.doubled() == 6

    @ti.kernel
    def run(b: Ball) -> ti.f32:
        return b.weight()

    assert run(ball) == 30
    plain = way(ti.types.struct(a=ti.i32, b=ti.math.vec2))
    assert list(plain.members) == ["a", "b"] and plain(a=4).a == 4
    assert way(ti.Struct(a=1, b=2)).to_dict() == {"a": 1, "b": 2}
    field = Ball.field(shape=2)
    field[1] = Ball(5.0)
    field[1].place[1] = 7
    assert way(field[1]).mass == 5 and list(way(field[1]).place) == [0, 7]
    assert list(way(field.place[1])) == [0, 7]


def _in_child(kind, struct, number):
    ti.init(arch=ti.cpu)
    x = ti.field(kind, shape=2)
    x.fill(number)
    return kind, struct, x.to_numpy().sum(), weigh(1)


def test_pool_of_spawned_processes():
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        waiting = pool.apply_async(_in_child, (ti.f32, Ball, 2))
        kind, struct, total, weight = waiting.get(timeout=120)
    assert kind is ti.f32 and struct is Ball and total == 4 and weight == 10


PROGRAM = '''
import importlib, importlib.util, pkgutil, tai as ti
left_out = ("__main__", "_core")
if not importlib.util.find_spec("torch"):
    left_out += ("tai.torch", "torch_operators", "torch_ranks", "torch_watch", "exchanged_cuda")
if not importlib.util.find_spec("jax"):
    left_out += ("tai.jax", "jax_operators")
for module in pkgutil.walk_packages(ti.__path__, "tai."):
    if not module.name.endswith(left_out):
        importlib.import_module(module.name)
ti.init(arch=ti.cpu)
@ti.func
def twice(x):
    "Doubles it."
    assert x > 0
    return 2 * x
@ti.kernel
def run(x: ti.f32) -> ti.f32:
    """Says so."""
    assert x > 1, "large"
    return twice(x)
print(run(3.0))
'''


@pytest.mark.parametrize("switch", ["-O", "-OO"])
def test_optimised_python(tmp_path, switch):
    path = tmp_path / "program.py"
    path.write_text(PROGRAM)
    env = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [sys.executable, switch, str(path)], capture_output=True, text=True, timeout=120, env=env
    )
    assert done.stdout == "6.0\n", done.stderr


# Struct types that derive from others


@ti.dataclass
class Body:
    mass: ti.f32
    speed: ti.f32

    @ti.func
    def energy(self):
        return 0.5 * self.mass * self.speed**2

    @ti.func
    def push(self, by):
        self.speed += by

    def shown(self):
        return f"{self.mass} {self.speed}"


class Charged:
    charge: ti.f32

    @ti.func
    def force(self):
        return 2 * self.charge


@ti.dataclass
class Ion(Body, Charged):
    level: ti.i32

    @ti.func
    def energy(self):
        return Body.energy(self) + self.level

    @ti.func
    def push(self, by):
        if by > 0:
            Body.push(self, 2 * by)


def test_struct_that_derives_from_another():
    ti.init(arch=ti.cpu)
    assert list(Ion.members) == ["charge", "mass", "speed", "level"]
    x = Ion.field(shape=3, needs_grad=True)
    e = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def run():
        for i in x:
            ion = x[i]
            ion.push(1.0)
            ion.push(-5.0)
            e[None] += ion.energy() + ion.force()

    x[1] = Ion(charge=3.0, mass=4.0, speed=1.0, level=7)
    with ti.ad.Tape(e):
        run()
    assert e[None] == 0.5 * 4 * 9 + 7 + 6
    assert x.grad[1].mass == 4.5 and x.grad[1].speed == 12 and x.grad[1].charge == 2
    assert Ion(mass=1.0, speed=2.0).shown() == "1.0 2.0"


def test_derived_class_without_the_decorator():
    ti.init(arch=ti.cpu)

    class Plain(Body):
        other: ti.f32

    with pytest.raises(ti.TaiTypeError) as caught:
        Plain(1.0)
    assert "decorate it with @ti.dataclass" in str(caught.value)
