# seed 172, smooth
# One component is stored and read again; the other one keeps its value.


@ti.kernel
def kernel0(a: ti.f64, t: ti.i32):
    for i1 in range(N):
        v[i1][0] = 0.3 * a
        loss[None] += v[i1][0] * v[i1][1]


def run():
    kernel0(0.85, 3)
    total()
