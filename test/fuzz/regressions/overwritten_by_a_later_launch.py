# seed 22, smooth
# A launch overwrites elements that the one before reads, at an index from a field.


@ti.kernel
def kernel0(a: ti.f64, t: ti.i32):
    for _ in range(1):
        m[1] += ti.tanh((v[1]).outer_product(v[(t + 1) % N] + v[t]))
        v[p[t]][1] = 0.3 * ti.cos(power(ti.tanh(y[(t + 1) % N]), 3))
    for i1 in x:
        s[None] += ti.tanh(v[i1][1])
        loss[None] += 0.3 * ti.cos((a * x[4]) - a)


def run():
    kernel0(1.15, 3)
    kernel0(0.35, 0)
    total()
