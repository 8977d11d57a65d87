# seed 924, smooth, 33 elements
# Elements of vectors and matrices are stored and read again in one iteration.


@ti.kernel
def kernel0():
    for i1 in x:
        m[i1] = ti.tanh(m[i1])
        if y[i1] > x[i1] and x[i1] < 0.4:
            f2 = ti.cos(u[p[i1], 0])
            for _ in range(2):
                loss[None] += ti.tanh(ti.exp(ti.tanh(f2)))
                f2 -= u[i1, 0] + v[q[i1]][1] + pick(y[i1], u[i1, 2])
            y[i1] = ti.sin(x[p[i1]])
        m[i1] = m[i1].inverse()


def run():
    kernel0()
    total()
