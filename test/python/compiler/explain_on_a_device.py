"""Explanations of loops on a device, for test_explain.py."""

import tai as ti

ti.init(offline_cache=False)
x = ti.field(ti.f32, shape=(64, 2), needs_grad=True)


@ti.kernel
def serial():
    for _ in range(1):
        for i in range(1, 64):
            x[i, 0] = x[i - 1, 0] * 0.5 + x[i, 0]


@ti.kernel
def short():
    for i in range(64):
        value = x[i, 0]
        for _ in range(60):
            value = ti.sin(value)
        x[i, 1] = value


print(serial.explain())
print("---")
print(short.explain())
