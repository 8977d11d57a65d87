# Type checkers know these types; test_typing.py runs them on this file.
from typing import Any, assert_type

import numpy as np
import tai as ti

ti.init(arch=ti.cpu)
x = ti.field(ti.f32, shape=8, needs_grad=True)
v = ti.Vector.field(2, ti.f32, shape=8)
m = ti.Matrix.field(2, 2, ti.f32, shape=8)
loss = ti.field(ti.f32, shape=(), needs_grad=True)
array = ti.ndarray(ti.f32, 4, needs_grad=True)


@ti.kernel
def energy(a: ti.f32, n: ti.i32) -> ti.f32:
    total = 0.0
    for i in x:
        total += twice(a) * x[i] ** n
    return total


@ti.kernel
def scale(y: ti.template, z: ti.types.ndarray, by: ti.f64):
    for i in y:
        y[i] *= by * z[i]


@ti.func
def twice(a: ti.f32) -> ti.f32:
    return 2 * a


@ti.func
def mixed(y: ti.template, i: int, way: Any) -> Any:
    return y[i] + way @ way * 2 - way.dot(way)


@ti.data_oriented
class Scene:
    def __init__(self, n: int):
        self.x = ti.Vector.field(2, float, shape=n)

    @ti.func
    def at(self, i: int, way: Any):
        return self.x[i] + way

    @ti.kernel
    def run(self, n: int):
        for i in self.x:
            self.x[i] = self.at(i, [1.0, 2.0]) + mixed(x, i, ti.Vector([1.0, 2.0]))
        for index in ti.grouped(ti.ndrange(n, n)):
            for k in ti.static(range(2)):
                self.x[index.x][k] += 0.5 * index[k]


with ti.ad.Tape(loss) as tape:
    result = energy(1.0, 2)
scale(x, np.ones(8, np.float32), 2.0)
assert_type(x, ti.ScalarField)
assert_type(x.grad, ti.Field)
assert_type(v, ti.MatrixField)
assert_type(v.grad, ti.MatrixField)
assert_type(array.grad, ti.Ndarray)
assert_type(result, float)
assert_type(tape, ti.ad.Tape)
print(tape.stats().peak_bytes, x.grad.to_numpy().sum(), energy.grad, m.shape)
gui = ti.GUI("a", res=256)
gui.circles(v.to_numpy(), radius=2)
for event in gui.get_events(ti.GUI.PRESS):
    print(event.key)
w = ti.Vector([1.0, 2.0])
print(w.norm(), ti.linalg.cg, ti.math.vec3, ti.checkpoint.save, ti.sin(1.0))
Scene(4).run(2)
