"""The peer warp: kernels, every time slot stored, reverse by wp.Tape.

On a GPU, *replay* is a run captured in a CUDA graph.
"""

# Annotations of warp kernels are objects, so they must not be turned into strings.

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

import harness


class WarpProgram(harness.Program):
    """A program whose launches a tape records; `clear` are arrays that launches add to."""

    def __init__(self, wp, loss, unknowns, forward, clear=()):
        self.wp = wp
        self.loss_array = loss
        self.unknowns = unknowns
        self.forward = forward
        self.clear = clear
        self.tape = None
        self.graph = None

    def run(self) -> tuple[float, float]:
        start = harness.clock()
        self.loss_array.zero_()
        for array in self.clear:
            array.zero_()
        tape = self.wp.Tape()
        with tape:
            self.forward()
        self.sync()
        middle = harness.clock()
        # Only a tape that ran backward knows which adjoints to clear. Clearing belongs to
        # the reverse pass, as it does in ti.ad.Tape.
        if self.tape is not None:
            self.tape.zero()
        tape.backward(self.loss_array)
        self.sync()
        end = harness.clock()
        self.tape = tape
        return middle - start, end - middle

    def inputs(self) -> np.ndarray:
        return np.concatenate([pick(array.numpy()).ravel() for array, pick in self.unknowns])

    def assign(self, flat: np.ndarray) -> None:
        for array, pick in self.unknowns:
            numbers = array.numpy().copy()
            part = pick(numbers)
            part[...] = flat[: part.size].reshape(part.shape)
            flat = flat[part.size :]
            array.assign(numbers)

    def replay(self) -> float | None:
        start = harness.clock()
        if not self.queue():
            return None
        self.sync()
        return harness.clock() - start

    def queue(self) -> bool:
        if not self.wp.get_device().is_cuda:
            return False
        if self.graph is None:
            with self.wp.ScopedCapture() as capture:
                self.loss_array.zero_()
                for array in self.clear:
                    array.zero_()
                with self.wp.Tape() as tape:
                    self.forward()
                self.tape.zero()
                tape.backward(self.loss_array)
            self.graph = capture.graph
        self.wp.capture_launch(self.graph)
        return True

    def sync(self) -> None:
        self.wp.synchronize()

    def loss(self) -> float:
        return float(self.loss_array.numpy()[0])

    def gradient(self) -> np.ndarray:
        return np.concatenate([pick(u.grad.numpy()).ravel() for u, pick in self.unknowns])


def whole(array: np.ndarray) -> np.ndarray:
    return array


def first_slot(array: np.ndarray) -> np.ndarray:
    return array[0]


def make_smoke(problem) -> harness.Program:
    import warp as wp

    n, slots, sweeps = problem.n, problem.slots, problem.sweeps
    N = wp.constant(n)
    DX = wp.constant(1.0 / n)
    LAST = wp.constant(slots - 1)

    @wp.func
    def wrapped(a: int):
        # The remainder of a negative number is negative here.
        return ((a % N) + N) % N

    @wp.func
    def sample(field: wp.array3d(dtype=float), t: int, i: int, j: int, w0: float, w1: float):
        x = float(i) - w0
        y = float(j) - w1
        left = wp.floor(x)
        low = wp.floor(y)
        fx = x - left
        fy = y - low
        ax = wrapped(int(left))
        ay = wrapped(int(low))
        bx = wrapped(ax + 1)
        by = wrapped(ay + 1)
        nearer = (1.0 - fy) * field[t, ax, ay] + fy * field[t, ax, by]
        farther = (1.0 - fy) * field[t, bx, ay] + fy * field[t, bx, by]
        return (1.0 - fx) * nearer + fx * farther

    @wp.kernel
    def advect_velocity(
        v0: wp.array3d(dtype=float),
        v1: wp.array3d(dtype=float),
        star0: wp.array3d(dtype=float),
        star1: wp.array3d(dtype=float),
        t: int,
    ):
        i, j = wp.tid()
        w0 = v0[t - 1, i, j]
        w1 = v1[t - 1, i, j]
        star0[t, i, j] = sample(v0, t - 1, i, j, w0, w1)
        star1[t, i, j] = sample(v1, t - 1, i, j, w0, w1)

    @wp.kernel
    def diverge(
        star0: wp.array3d(dtype=float),
        star1: wp.array3d(dtype=float),
        divergence: wp.array3d(dtype=float),
        t: int,
    ):
        i, j = wp.tid()
        divergence[t, i, j] = (
            -0.5
            * DX
            * (
                star0[t, wrapped(i + 1), j]
                - star0[t, wrapped(i - 1), j]
                + star1[t, i, wrapped(j + 1)]
                - star1[t, i, wrapped(j - 1)]
            )
        )

    @wp.kernel
    def relax(
        divergence: wp.array3d(dtype=float), pressure: wp.array3d(dtype=float), t: int, k: int
    ):
        i, j = wp.tid()
        pressure[k + 1, i, j] = 0.25 * (
            divergence[t, i, j]
            + pressure[k, wrapped(i - 1), j]
            + pressure[k, wrapped(i + 1), j]
            + pressure[k, i, wrapped(j - 1)]
            + pressure[k, i, wrapped(j + 1)]
        )

    @wp.kernel
    def project(
        star0: wp.array3d(dtype=float),
        star1: wp.array3d(dtype=float),
        pressure: wp.array3d(dtype=float),
        v0: wp.array3d(dtype=float),
        v1: wp.array3d(dtype=float),
        t: int,
        k: int,
    ):
        i, j = wp.tid()
        down = pressure[k, wrapped(i + 1), j] - pressure[k, wrapped(i - 1), j]
        right = pressure[k, i, wrapped(j + 1)] - pressure[k, i, wrapped(j - 1)]
        v0[t, i, j] = star0[t, i, j] - 0.5 / DX * down
        v1[t, i, j] = star1[t, i, j] - 0.5 / DX * right

    @wp.kernel
    def advect_density(
        density: wp.array3d(dtype=float),
        v0: wp.array3d(dtype=float),
        v1: wp.array3d(dtype=float),
        t: int,
    ):
        i, j = wp.tid()
        density[t, i, j] = sample(density, t - 1, i, j, v0[t, i, j], v1[t, i, j])

    @wp.kernel
    def compute_loss(
        density: wp.array3d(dtype=float),
        target: wp.array2d(dtype=float),
        loss: wp.array(dtype=float),
    ):
        i, j = wp.tid()
        difference = target[i, j] - density[LAST, i, j]
        wp.atomic_add(loss, 0, difference * difference / float(N * N))

    def grids(count=slots):
        return wp.zeros((count, n, n), dtype=float, requires_grad=True)

    def grids_from(first):
        stored = np.zeros((slots, n, n), np.float32)
        stored[0] = first
        return wp.array(stored, dtype=float, requires_grad=True)

    v0, v1 = grids_from(problem.velocity[..., 0]), grids_from(problem.velocity[..., 1])
    star0, star1, divergence = grids(), grids(), grids()
    density, pressure = grids_from(problem.density), grids(slots * sweeps + 1)
    target = wp.array(problem.target.astype(np.float32), dtype=float)
    loss = wp.zeros(1, dtype=float, requires_grad=True)

    def forward():
        size = (n, n)
        for t in range(1, slots):
            wp.launch(advect_velocity, size, [v0, v1, star0, star1, t])
            wp.launch(diverge, size, [star0, star1, divergence, t])
            for sweep in range(sweeps):
                wp.launch(relax, size, [divergence, pressure, t, t * sweeps + sweep])
            wp.launch(project, size, [star0, star1, pressure, v0, v1, t, t * sweeps - 1])
            wp.launch(advect_density, size, [density, v0, v1, t])
        wp.launch(compute_loss, size, [density, target, loss])

    class Smoke(WarpProgram):
        def gradient(self) -> np.ndarray:
            # The two components are arrays of their own here.
            parts = [v.grad.numpy()[0] for v in (v0, v1)]
            return np.stack(parts, axis=-1).ravel()

    return Smoke(wp, loss, [], forward)


def make_wave(problem) -> harness.Program:
    import warp as wp

    n, slots = problem.n, problem.slots
    N = wp.constant(n)
    LAST = wp.constant(slots - 1)

    @wp.func
    def outside_zero(u: wp.array3d(dtype=float), t: int, i: int, j: int):
        value = 0.0
        if i >= 0 and i < N and j >= 0 and j < N:
            value = u[t, i, j]
        return value

    @wp.kernel
    def advance(u: wp.array3d(dtype=float), t: int):
        i, j = wp.tid()
        around = (
            outside_zero(u, t - 1, i - 1, j)
            + outside_zero(u, t - 1, i + 1, j)
            + outside_zero(u, t - 1, i, j - 1)
            + outside_zero(u, t - 1, i, j + 1)
        )
        now = u[t - 1, i, j]
        u[t, i, j] = 2.0 * now + (around - 4.0 * now) / 3.0 - u[t - 2, i, j]

    @wp.kernel
    def compute_loss(
        u: wp.array3d(dtype=float), target: wp.array2d(dtype=float), loss: wp.array(dtype=float)
    ):
        i, j = wp.tid()
        difference = target[i, j] - u[LAST, i, j]
        wp.atomic_add(loss, 0, difference * difference / float(N * N))

    stored = np.zeros((slots, n, n), np.float32)
    stored[0] = problem.height
    u = wp.array(stored, dtype=float, requires_grad=True)
    target = wp.array(problem.target.astype(np.float32), dtype=float)
    loss = wp.zeros(1, dtype=float, requires_grad=True)

    def forward():
        for t in range(2, slots):
            wp.launch(advance, (n, n), [u, t])
        wp.launch(compute_loss, (n, n), [u, target, loss])

    return WarpProgram(wp, loss, [(u, first_slot)], forward)


def make_mpm(problem) -> harness.Program:
    import warp as wp

    material, slots, count = problem.material, problem.slots, len(problem.position)
    n = material.n
    N = wp.constant(n)
    COUNT = wp.constant(count)
    LAST = wp.constant(slots - 1)
    DX = wp.constant(material.dx)
    DT = wp.constant(material.dt)
    MU = wp.constant(material.mu)
    LAM = wp.constant(material.lam)
    MASS = wp.constant(material.mass)
    GRAVITY = wp.constant(material.gravity)
    STIFF = wp.constant(-material.dt * material.volume * 4.0 / material.dx**2)
    GOAL = wp.constant(wp.vec2(*problem.target))

    @wp.func
    def spline(fx: float, k: int):
        value = 0.5 * (1.5 - fx) * (1.5 - fx)
        if k == 1:
            value = 0.75 - (fx - 1.0) * (fx - 1.0)
        if k == 2:
            value = 0.5 * (fx - 0.5) * (fx - 0.5)
        return value

    @wp.kernel
    def scatter(
        x: wp.array2d(dtype=wp.vec2),
        v: wp.array2d(dtype=wp.vec2),
        C: wp.array2d(dtype=wp.mat22),
        F: wp.array2d(dtype=wp.mat22),
        momentum: wp.array3d(dtype=wp.vec2),
        mass: wp.array3d(dtype=float),
        t: int,
    ):
        p = wp.tid()
        scaled = x[t, p] / DX
        bi = int(scaled[0] - 0.5)
        bj = int(scaled[1] - 0.5)
        fi = scaled[0] - float(bi)
        fj = scaled[1] - float(bj)
        identity = wp.mat22(1.0, 0.0, 0.0, 1.0)
        new_F = (identity + DT * C[t, p]) * F[t, p]
        F[t + 1, p] = new_F
        even = new_F[0, 0] + new_F[1, 1]
        odd = new_F[1, 0] - new_F[0, 1]
        scale = 1.0 / wp.sqrt(even * even + odd * odd)
        cosine = even * scale
        sine = odd * scale
        rotation = wp.mat22(cosine, -sine, sine, cosine)
        J = wp.determinant(new_F)
        cauchy = 2.0 * MU * (new_F - rotation) * wp.transpose(new_F)
        cauchy = cauchy + LAM * (J - 1.0) * J * identity
        affine = STIFF * cauchy + MASS * C[t, p]
        for i in range(3):
            for j in range(3):
                d = wp.vec2((float(i) - fi) * DX, (float(j) - fj) * DX)
                weight = spline(fi, i) * spline(fj, j)
                wp.atomic_add(momentum, t, bi + i, bj + j, weight * (MASS * v[t, p] + affine * d))
                wp.atomic_add(mass, t, bi + i, bj + j, weight * MASS)

    @wp.kernel
    def update_grid(
        momentum: wp.array3d(dtype=wp.vec2),
        mass: wp.array3d(dtype=float),
        grid: wp.array3d(dtype=wp.vec2),
        t: int,
    ):
        i, j = wp.tid()
        velocity = momentum[t, i, j] / (mass[t, i, j] + 1.0e-10)
        g0 = velocity[0]
        g1 = velocity[1] - DT * GRAVITY
        if i < 3 and g0 < 0.0:
            g0 = 0.0
        if i > N - 3 and g0 > 0.0:
            g0 = 0.0
        if j < 3 and g1 < 0.0:
            g1 = 0.0
        if j > N - 3 and g1 > 0.0:
            g1 = 0.0
        grid[t, i, j] = wp.vec2(g0, g1)

    @wp.kernel
    def gather(
        x: wp.array2d(dtype=wp.vec2),
        v: wp.array2d(dtype=wp.vec2),
        C: wp.array2d(dtype=wp.mat22),
        grid: wp.array3d(dtype=wp.vec2),
        t: int,
    ):
        p = wp.tid()
        scaled = x[t, p] / DX
        bi = int(scaled[0] - 0.5)
        bj = int(scaled[1] - 0.5)
        fi = scaled[0] - float(bi)
        fj = scaled[1] - float(bj)
        new_v = wp.vec2(0.0, 0.0)
        new_C = wp.mat22(0.0, 0.0, 0.0, 0.0)
        for i in range(3):
            for j in range(3):
                d = wp.vec2(float(i) - fi, float(j) - fj)
                part = spline(fi, i) * spline(fj, j) * grid[t, bi + i, bj + j]
                new_v = new_v + part
                new_C = new_C + 4.0 / DX * wp.outer(part, d)
        v[t + 1, p] = new_v
        x[t + 1, p] = x[t, p] + DT * new_v
        C[t + 1, p] = new_C

    @wp.kernel
    def compute_loss(x: wp.array2d(dtype=wp.vec2), loss: wp.array(dtype=float)):
        p = wp.tid()
        distance = x[LAST, p] - GOAL
        wp.atomic_add(loss, 0, 0.5 / float(COUNT) * wp.dot(distance, distance))

    def slots_of(first, dtype):
        stored = np.zeros((slots, *first.shape), np.float32)
        stored[0] = first
        return wp.array(stored, dtype=dtype, requires_grad=True)

    identity = np.tile(np.eye(2), (count, 1, 1))
    x, v = slots_of(problem.position, wp.vec2), slots_of(problem.velocity, wp.vec2)
    C, F = slots_of(0.0 * identity, wp.mat22), slots_of(identity, wp.mat22)
    momentum = wp.zeros((slots, n, n), dtype=wp.vec2, requires_grad=True)
    mass = wp.zeros((slots, n, n), dtype=float, requires_grad=True)
    grid = wp.zeros((slots, n, n), dtype=wp.vec2, requires_grad=True)
    loss = wp.zeros(1, dtype=float, requires_grad=True)

    def forward():
        for t in range(slots - 1):
            wp.launch(scatter, count, [x, v, C, F, momentum, mass, t])
            wp.launch(update_grid, (n, n), [momentum, mass, grid, t])
            wp.launch(gather, count, [x, v, C, grid, t])
        wp.launch(compute_loss, count, [x, loss])

    return WarpProgram(wp, loss, [(v, first_slot)], forward, (momentum, mass))


def make_mass_spring(problem) -> harness.Program:
    import warp as wp

    # The reverse of a kernel does not run a loop that is not unrolled, so what follows such
    # a loop (here tanh of its sum) would be differentiated at the wrong point.
    wp.set_module_options({"max_unroll": 64})

    body, walk = problem.body, problem.walk
    points, springs, hidden_count = len(body.points), len(body.springs), 32
    slots = walk.slots
    POINTS = wp.constant(points)
    HIDDEN = wp.constant(hidden_count)
    DT = wp.constant(walk.dt)
    GROUND = wp.constant(walk.ground)
    GRAVITY = wp.constant(walk.gravity)
    DAMP = wp.constant(float(np.exp(-walk.damping * walk.dt)))
    GOAL = wp.constant(wp.vec2(*walk.goal))
    TURN = wp.constant(float(2.0 * np.pi / 10.0))
    LAST = wp.constant(slots - 1)

    @wp.kernel
    def find_centre(x: wp.array2d(dtype=wp.vec2), centre: wp.array(dtype=wp.vec2), t: int):
        i = wp.tid()
        wp.atomic_add(centre, t, x[t, i] / float(POINTS))

    @wp.kernel
    def layer_1(
        x: wp.array2d(dtype=wp.vec2),
        v: wp.array2d(dtype=wp.vec2),
        centre: wp.array(dtype=wp.vec2),
        w1: wp.array2d(dtype=float),
        b1: wp.array(dtype=float),
        hidden: wp.array2d(dtype=float),
        t: int,
    ):
        i = wp.tid()
        total = b1[i]
        for j in range(10):
            total += w1[i, j] * wp.sin(10.0 * float(t) * DT + TURN * float(j))
        for j in range(POINTS):
            offset = x[t, j] - centre[t]
            speed = v[t, j]
            total += w1[i, 10 + 4 * j] * offset[0] * 0.05
            total += w1[i, 11 + 4 * j] * offset[1] * 0.05
            total += w1[i, 12 + 4 * j] * speed[0] * 0.05
            total += w1[i, 13 + 4 * j] * speed[1] * 0.05
        away = GOAL - centre[t]
        total += w1[i, 10 + 4 * POINTS] * away[0]
        total += w1[i, 11 + 4 * POINTS] * away[1]
        hidden[t, i] = wp.tanh(total)

    @wp.kernel
    def layer_2(
        hidden: wp.array2d(dtype=float),
        w2: wp.array2d(dtype=float),
        b2: wp.array(dtype=float),
        output: wp.array2d(dtype=float),
        t: int,
    ):
        i = wp.tid()
        total = b2[i]
        for j in range(HIDDEN):
            total += w2[i, j] * hidden[t, j]
        output[t, i] = wp.tanh(total)

    @wp.kernel
    def apply_springs(
        x: wp.array2d(dtype=wp.vec2),
        output: wp.array2d(dtype=float),
        first: wp.array(dtype=int),
        second: wp.array(dtype=int),
        rest: wp.array(dtype=float),
        stiffness: wp.array(dtype=float),
        amount: wp.array(dtype=float),
        increment: wp.array2d(dtype=wp.vec2),
        t: int,
    ):
        i = wp.tid()
        a = first[i]
        b = second[i]
        d = x[t, a] - x[t, b]
        length = wp.length(d) + 1.0e-4
        wanted = rest[i] * (1.0 + amount[i] * output[t, i])
        impulse = DT * (length - wanted) * stiffness[i] / length * d
        wp.atomic_add(increment, t + 1, a, -impulse)
        wp.atomic_add(increment, t + 1, b, impulse)

    @wp.kernel
    def advance(
        x: wp.array2d(dtype=wp.vec2),
        v: wp.array2d(dtype=wp.vec2),
        increment: wp.array2d(dtype=wp.vec2),
        t: int,
    ):
        i = wp.tid()
        old = x[t - 1, i]
        free = DAMP * v[t - 1, i] + wp.vec2(0.0, DT * GRAVITY) + increment[t, i]
        if old[1] + DT * free[1] < GROUND and free[1] < -1.0e-4:
            toi = -(old[1] - GROUND) / free[1]
            v[t, i] = wp.vec2(0.0, 0.0)
            x[t, i] = old + toi * free
        else:
            v[t, i] = free
            x[t, i] = old + DT * free

    @wp.kernel
    def compute_loss(x: wp.array2d(dtype=wp.vec2), loss: wp.array(dtype=float)):
        head = x[LAST, 0]
        wp.atomic_add(loss, 0, -head[0])

    stored = np.zeros((slots, points, 2), np.float32)
    stored[0] = body.points
    x = wp.array(stored, dtype=wp.vec2, requires_grad=True)
    v = wp.zeros((slots, points), dtype=wp.vec2, requires_grad=True)
    increment = wp.zeros((slots, points), dtype=wp.vec2, requires_grad=True)
    centre = wp.zeros(slots, dtype=wp.vec2, requires_grad=True)
    hidden = wp.zeros((slots, hidden_count), dtype=float, requires_grad=True)
    output = wp.zeros((slots, springs), dtype=float, requires_grad=True)
    loss = wp.zeros(1, dtype=float, requires_grad=True)
    first = wp.array(body.springs[:, 0].astype(np.int32), dtype=int)
    second = wp.array(body.springs[:, 1].astype(np.int32), dtype=int)
    rest, stiffness, amount = (
        wp.array(a.astype(np.float32), dtype=float)
        for a in (body.rest, body.stiffness, body.actuation)
    )
    weights = [
        wp.array(problem.weights[name].astype(np.float32), dtype=float, requires_grad=True)
        for name in ("w1", "b1", "w2", "b2")
    ]
    w1, b1, w2, b2 = weights

    def forward():
        pull = [first, second, rest, stiffness, amount, increment]
        for t in range(1, slots):
            wp.launch(find_centre, points, [x, centre, t - 1])
            wp.launch(layer_1, hidden_count, [x, v, centre, w1, b1, hidden, t - 1])
            wp.launch(layer_2, springs, [hidden, w2, b2, output, t - 1])
            wp.launch(apply_springs, springs, [x, output, *pull, t - 1])
            wp.launch(advance, points, [x, v, increment, t])
        wp.launch(compute_loss, 1, [x, loss])

    unknowns = [(w, whole) for w in weights]
    return WarpProgram(wp, loss, unknowns, forward, (increment, centre))


def make_first_kernel(problem) -> harness.Program:
    import warp as wp

    @wp.kernel
    def compute_loss(x: wp.array(dtype=float), loss: wp.array(dtype=float)):
        i = wp.tid()
        wp.atomic_add(loss, 0, x[i] * x[i])

    x = wp.array(problem.x.astype(np.float32), dtype=float, requires_grad=True)
    loss = wp.zeros(1, dtype=float, requires_grad=True)

    def forward():
        wp.launch(compute_loss, len(problem.x), [x, loss])

    return WarpProgram(wp, loss, [(x, whole)], forward)


def make_launch():
    import warp as wp

    @wp.kernel
    def bump(value: wp.array(dtype=float), t: int):
        value[0] = value[0] + float(t)

    value = wp.zeros(1, dtype=float)
    return lambda: wp.launch(bump, 1, [value, 1]), wp.synchronize


def load(cache: Path, arch: str):
    import warp as wp

    wp.config.kernel_cache_dir = str(cache)
    wp.config.quiet = True
    wp.init()
    wp.set_device(arch)
    scenes = {
        "smoke": make_smoke,
        "wave": make_wave,
        "diffmpm": make_mpm,
        "mass_spring": make_mass_spring,
        "first_kernel": make_first_kernel,
    }
    return wp.config.version, scenes, make_launch


if __name__ == "__main__":
    sys.exit(harness.main("warp", load))
