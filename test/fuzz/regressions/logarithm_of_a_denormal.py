# seed 3050, kinked
# The derivative of the logarithm is beyond the range, and comes back into it: with a small seed the
# gradient is right.


@ti.kernel
def kernel1():
    for i2 in x:
        for j3 in ti.static(range(2)):
            y[i2] *= ti.tanh(z[p[j3]])
    for _ in x:
        loss[None] += ti.log(y[1]) * ti.tan(1.0)


def run():
    kernel1()
    total()
