# seed 58, smooth
# An element that is stored first, and then read at an index from a field.


@ti.kernel
def kernel0():
    z[2] = m[3].determinant()
    n1 = 0
    f2 = z[p[n1]]
    loss[None] += f2 * f2


def run():
    kernel0()
    total()
