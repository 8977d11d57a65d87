# Type checkers know these types; test_typing.py runs them on this file.
from typing import assert_type

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
