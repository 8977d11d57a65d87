# seed 295, smooth
# Read by one kernel, accumulated at single elements by the next one.


@ti.kernel
def kernel0():
    for i1 in x:
        f2 = ti.sin(ti.math.mix(z[q[i1]], y[i1], 0.3) - v[q[i1]].norm_sqr())
        f3 = ti.tanh(v[p[i1]].max())
        for j4 in range(1, k[i1]):
            loss[None] += ti.tanh(ti.atan2(s[None], 1.2 + ti.cos(f2)) + f2 * v[(j4 + 1) % N][1])
            n5 = 0
            while n5 < 2 and f3 < v[p[j4]][1]:
                n5 += 1
                f2 *= ti.tanh(f2 * f3 * ti.math.fract(s[None]))
                m[n5 % N] += ti.tanh(ti.Vector([y[i1], f2]).outer_product(v[4]))


@ti.kernel
def kernel1(a: ti.f64, t: ti.i32):
    for i8 in range(N):
        ti.atomic_add(z[4], 0.3 * ti.cos(ti.tanh(a + a)))
        ti.atomic_add(s[None], 0.3 * ti.cos(ti.tanh(a * a) ** 3))
        z[3] += 0.3 * ti.cos(m[(i8 + 1) % N].transpose()[1, 0])


def run():
    kernel0()
    kernel1(1.35, 3)
    total()
