# seed 2930, kinked
# The derivative of a root at zero is infinite, and meets a factor of zero in another kernel.


@ti.kernel
def kernel0():
    for _ in range(1):
        x[2] = ti.sqrt(ti.select((1.35 > u[3, 0]), v[4][0], s[None]))


@ti.kernel
def kernel1():
    for i5 in range(N):
        y[i5] += ti.cos(0.0 * x[i5])
    for i5 in range(N):
        x[i5] = 0.0


def run():
    kernel0()
    kernel1()
    total()
