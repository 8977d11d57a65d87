"""A picture of soft balls, by marching along a ray for each pixel.

The unknowns are the centres and radii of the balls. The loss is the mean squared difference of
the picture from grey.
"""

import numpy as np
import tai as ti


def make(n=128, marches=24, balls=5):
    """Returns a function that runs one iteration, the loss, and the unknowns."""
    ball = ti.Vector.field(4, ti.f32, shape=balls, needs_grad=True)
    picture = ti.field(ti.f32, shape=(n, n), needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.func
    def distance(at):
        near = 0.0
        for b in ti.static(range(balls)):
            d = at - ti.Vector([ball[b][0], ball[b][1], ball[b][2]])
            near += ti.exp(-8.0 * (ti.sqrt(d.dot(d) + 1e-6) - ball[b][3]))
        return -ti.log(near + 1e-6) / 8.0

    @ti.kernel
    def render():
        for i, j in picture:
            way = ti.Vector([i / n - 0.5, j / n - 0.5, 1.0]).normalized()
            depth = 0.0
            for _ in range(marches):
                depth += 0.7 * distance(depth * way + ti.Vector([0.0, 0.0, -2.0]))
            picture[i, j] = ti.exp(-0.3 * depth)

    @ti.kernel
    def measure():
        for i, j in picture:
            d = picture[i, j] - 0.5
            loss[None] += d * d / (n * n)

    start = np.random.default_rng(1).random((balls, 4)) * 0.8 - 0.4
    start[:, 3] = 0.25
    ball.from_numpy(start.astype(np.float32))

    def iterate():
        loss[None] = 0.0
        with ti.ad.Tape(loss):
            render()
            measure()

    return iterate, loss, ball
