# seed 7, smooth
# Each mode adds up s in an order of its own, and the sine turns thousands of times with s.


@ti.kernel
def kernel0():
    for i in x:
        if i % 2 == 1:
            s[None] += ti.tanh(z[i] * x[q[i]])
            s[None] -= 3.0
        else:
            loss[None] += ti.tanh(x[q[i]])
        s[None] -= ti.tanh(z[(i + 1) % N] * x[2])
    for _ in x:
        for j in range(3):
            u[3, 2] -= ti.sin((s[None] * v[p[j]]).norm_sqr())


def run():
    kernel0()
    total()
