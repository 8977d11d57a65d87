# seed 791, kinked
# A product overflows together with its tangent; tanh of it is flat.


@ti.kernel
def kernel0(a: ti.f64):
    for i1 in x:
        ti.atomic_add(m[q[i1]], ti.tanh((a * v[i1]).outer_product(y[4] * v[i1])))


def run():
    kernel0(0.25)
    total()
