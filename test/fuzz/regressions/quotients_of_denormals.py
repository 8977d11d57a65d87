# seed 1637, kinked
# A quotient of a denormal number, and by it again: with a small seed the gradient is right.


@ti.kernel
def kernel0():
    for i1 in range(N):
        f3 = v[i1][1]
        v[i1] = ti.tanh(ti.Vector([(1.0 * f3), (x[(i1 + 1) % N] / f3)]))


def run():
    kernel0()
    kernel0()
    total()
