"""The benchmark's scenes in the Taichi API.

The same source runs on tai and, with the name `tai` pointing at them, on taichi and
quadrants (see peers/), so that these three are compared on one program. Kernels are
written as the published differentiable simulators write them: every time slot stored,
one launch per operation and step, `ti.ad.Tape` around the forward pass. Grids and
particles keep every component in an array of its own, the layout of the published timing
programs; on a GPU tai places those of diffmpm whole, as the hand-written program does. The
kernels' annotations must be objects, not strings, for taichi.
"""

import numpy as np
import tai as ti

from harness import Program, clock

# Whether elements of diffmpm are stored whole. A GPU then reads them at once, and adds to a grid
# node at once.
elements_whole = False


def place_components(node, *fields, whole=False) -> None:
    """Places every component of vector and matrix fields below a node of its own.

    With `whole`, every field.
    """
    for field in fields:
        if whole:
            node().place(field)
        elif field.m > 1:
            for a in range(field.n):
                for b in range(field.m):
                    node().place(field.get_scalar_field(a, b))
        else:
            for a in range(field.n):
                node().place(field.get_scalar_field(a))


class TapeProgram(Program):
    """A program whose forward pass is recorded by a tape."""

    def __init__(self, loss, unknowns, forward, prepare=lambda: None):
        """`forward` launches kernels, `prepare` clears the fields that they accumulate into."""
        self._loss = loss
        self._unknowns = unknowns
        self._forward = forward
        self._prepare = prepare
        self._tape = None

    def run(self) -> tuple[float, float]:
        start = clock()
        self._prepare()
        with ti.ad.Tape(self._loss) as tape:
            self._forward()
            ti.sync()
            middle = clock()
        ti.sync()
        end = clock()
        self._tape = tape
        return middle - start, end - middle

    def replay(self):
        start = clock()
        if not self.queue():
            return None
        ti.sync()
        return clock() - start

    def queue(self) -> bool:
        if not hasattr(self._tape, "replay"):
            return False
        self._prepare()
        self._loss[None] = 0.0
        self._tape.replay()
        return True

    def sync(self) -> None:
        ti.sync()

    def loss(self) -> float:
        return float(self._loss[None])

    def gradient(self) -> np.ndarray:
        return np.concatenate([pick(u.grad.to_numpy()).ravel() for u, pick in self._unknowns])

    def inputs(self) -> np.ndarray:
        return np.concatenate([pick(u.to_numpy()).ravel() for u, pick in self._unknowns])

    def assign(self, flat: np.ndarray) -> None:
        assign_fields(self._unknowns, flat)


def assign_fields(unknowns, flat: np.ndarray) -> None:
    """Writes flat values to pairs of a field and its unknown part."""
    for field, pick in unknowns:
        array = field.to_numpy()
        part = pick(array)
        part[...] = flat[: part.size].reshape(part.shape)
        flat = flat[part.size :]
        field.from_numpy(array)


def whole(array: np.ndarray) -> np.ndarray:
    """The gradient of an unknown that has no time slots."""
    return array


def first_slot(array: np.ndarray) -> np.ndarray:
    """The gradient of slot 0 of a stored field."""
    return array[0]


def make_smoke(problem) -> Program:
    n, slots, sweeps = problem.n, problem.slots, problem.sweeps
    dx = 1.0 / n
    v = ti.Vector.field(2, dtype=float)
    star = ti.Vector.field(2, dtype=float)
    density = ti.field(dtype=float)
    divergence = ti.field(dtype=float)
    pressure = ti.field(dtype=float)
    target = ti.field(dtype=float)
    loss = ti.field(dtype=float)

    def grids():
        return ti.root.dense(ti.i, slots).dense(ti.jk, (n, n))

    place_components(grids, v, star)
    grids().place(density)
    grids().place(divergence)
    # Step t writes the sweeps t * sweeps + 1 to (t + 1) * sweeps.
    ti.root.dense(ti.i, slots * sweeps + 1).dense(ti.jk, (n, n)).place(pressure)
    ti.root.dense(ti.ij, (n, n)).place(target)
    ti.root.place(loss)
    ti.root.lazy_grad()

    @ti.func
    def wrapped(a):
        return a % n

    @ti.func
    def sample(field, t, i, j, w):
        """Bilinear value of slot t at (i, j) - w."""
        x = i - w[0]
        y = j - w[1]
        left = ti.floor(x)
        low = ti.floor(y)
        fx = x - left
        fy = y - low
        ax = wrapped(ti.cast(left, ti.i32))
        ay = wrapped(ti.cast(low, ti.i32))
        bx = wrapped(ax + 1)
        by = wrapped(ay + 1)
        nearer = (1.0 - fy) * field[t, ax, ay] + fy * field[t, ax, by]
        farther = (1.0 - fy) * field[t, bx, ay] + fy * field[t, bx, by]
        return (1.0 - fx) * nearer + fx * farther

    @ti.kernel
    def advect_velocity(t: ti.i32):
        for i, j in ti.ndrange(n, n):
            star[t, i, j] = sample(v, t - 1, i, j, v[t - 1, i, j])

    @ti.kernel
    def diverge(t: ti.i32):
        for i, j in ti.ndrange(n, n):
            divergence[t, i, j] = (
                -0.5
                * dx
                * (
                    star[t, wrapped(i + 1), j][0]
                    - star[t, wrapped(i - 1), j][0]
                    + star[t, i, wrapped(j + 1)][1]
                    - star[t, i, wrapped(j - 1)][1]
                )
            )

    @ti.kernel
    def relax(t: ti.i32, k: ti.i32):
        for i, j in ti.ndrange(n, n):
            pressure[k + 1, i, j] = 0.25 * (
                divergence[t, i, j]
                + pressure[k, wrapped(i - 1), j]
                + pressure[k, wrapped(i + 1), j]
                + pressure[k, i, wrapped(j - 1)]
                + pressure[k, i, wrapped(j + 1)]
            )

    @ti.kernel
    def project(t: ti.i32, k: ti.i32):
        for i, j in ti.ndrange(n, n):
            slope = ti.Vector(
                [
                    pressure[k, wrapped(i + 1), j] - pressure[k, wrapped(i - 1), j],
                    pressure[k, i, wrapped(j + 1)] - pressure[k, i, wrapped(j - 1)],
                ]
            )
            v[t, i, j] = star[t, i, j] - 0.5 / dx * slope

    @ti.kernel
    def advect_density(t: ti.i32):
        for i, j in ti.ndrange(n, n):
            density[t, i, j] = sample(density, t - 1, i, j, v[t, i, j])

    @ti.kernel
    def compute_loss():
        for i, j in ti.ndrange(n, n):
            loss[None] += (target[i, j] - density[slots - 1, i, j]) ** 2 / (n * n)

    @ti.kernel
    def load(v0: ti.types.ndarray(), density0: ti.types.ndarray(), target0: ti.types.ndarray()):
        for i, j in ti.ndrange(n, n):
            v[0, i, j] = ti.Vector([v0[i, j, 0], v0[i, j, 1]])
            density[0, i, j] = density0[i, j]
            target[i, j] = target0[i, j]

    load(
        problem.velocity.astype(np.float32),
        problem.density.astype(np.float32),
        problem.target.astype(np.float32),
    )

    def forward():
        for t in range(1, slots):
            advect_velocity(t)
            diverge(t)
            for sweep in range(sweeps):
                relax(t, t * sweeps + sweep)
            # The published index: the last but one sweep of the step before.
            project(t, t * sweeps - 1)
            advect_density(t)
        compute_loss()

    return TapeProgram(loss, [(v, first_slot)], forward)


def make_wave(problem) -> Program:
    n, slots = problem.n, problem.slots
    dx = 1.0 / n
    # c^2 dt^2 of the scene's time step.
    factor = dx * dx / 3.0
    u = ti.field(dtype=float)
    target = ti.field(dtype=float)
    loss = ti.field(dtype=float)
    ti.root.dense(ti.i, slots).dense(ti.jk, (n, n)).place(u)
    ti.root.dense(ti.ij, (n, n)).place(target)
    ti.root.place(loss)
    ti.root.lazy_grad()

    @ti.func
    def laplacian(t, i, j):
        total = -4.0 * u[t, i, j]
        if i > 0:
            total += u[t, i - 1, j]
        if i < n - 1:
            total += u[t, i + 1, j]
        if j > 0:
            total += u[t, i, j - 1]
        if j < n - 1:
            total += u[t, i, j + 1]
        return total / (dx * dx)

    @ti.kernel
    def advance(t: ti.i32):
        for i, j in ti.ndrange(n, n):
            u[t, i, j] = 2.0 * u[t - 1, i, j] + factor * laplacian(t - 1, i, j) - u[t - 2, i, j]

    @ti.kernel
    def compute_loss():
        for i, j in ti.ndrange(n, n):
            loss[None] += dx * dx * (target[i, j] - u[slots - 1, i, j]) ** 2

    @ti.kernel
    def load(height: ti.types.ndarray(), target0: ti.types.ndarray()):
        for i, j in ti.ndrange(n, n):
            u[0, i, j] = height[i, j]
            target[i, j] = target0[i, j]

    load(problem.height.astype(np.float32), problem.target.astype(np.float32))

    def forward():
        for t in range(2, slots):
            advance(t)
        compute_loss()

    return TapeProgram(loss, [(u, first_slot)], forward)


def make_mpm(problem) -> Program:
    material, slots, count = problem.material, problem.slots, len(problem.position)
    n, dt, dx = material.n, material.dt, material.dx
    mu, lam, mass, volume = material.mu, material.lam, material.mass, material.volume
    gravity = material.gravity
    goal_x, goal_y = problem.target
    x = ti.Vector.field(2, dtype=float)
    v = ti.Vector.field(2, dtype=float)
    C = ti.Matrix.field(2, 2, dtype=float)
    F = ti.Matrix.field(2, 2, dtype=float)
    momentum = ti.Vector.field(2, dtype=float)
    grid_mass = ti.field(dtype=float)
    grid_v = ti.Vector.field(2, dtype=float)
    loss = ti.field(dtype=float)
    whole = elements_whole

    def particles():
        return ti.root.dense(ti.i, slots).dense(ti.j, count)

    place_components(particles, x, v, C, F, whole=whole)

    def grids():
        return ti.root.dense(ti.i, slots).dense(ti.jk, (n, n))

    place_components(grids, grid_v, whole=whole)
    if whole:
        # Fills a node up to 16 bytes.
        rest = ti.field(dtype=float)
        grids().place(momentum, grid_mass, rest)
    else:
        rest = None  # taichi reads all that a kernel names
        place_components(grids, momentum)
        grids().place(grid_mass)
    ti.root.place(loss)
    ti.root.lazy_grad()

    @ti.kernel
    def scatter(t: ti.i32):
        for p in range(count):
            base = ti.cast(x[t, p] / dx - 0.5, ti.i32)
            fx = x[t, p] / dx - ti.cast(base, float)
            w = [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1.0) ** 2, 0.5 * (fx - 0.5) ** 2]
            new_F = (ti.Matrix.diag(dim=2, val=1.0) + dt * C[t, p]) @ F[t, p]
            F[t + 1, p] = new_F
            J = new_F.determinant()
            R, _ = ti.polar_decompose(new_F)
            cauchy = 2.0 * mu * (new_F - R) @ new_F.transpose() + ti.Matrix.diag(
                dim=2, val=lam * (J - 1.0) * J
            )
            affine = -(dt * volume * 4.0 / dx**2) * cauchy + mass * C[t, p]
            for i in ti.static(range(3)):
                for j in ti.static(range(3)):
                    offset = ti.Vector([i, j])
                    dpos = (ti.cast(offset, float) - fx) * dx
                    weight = w[i][0] * w[j][1]
                    momentum[t, base + offset] += weight * (mass * v[t, p] + affine @ dpos)
                    grid_mass[t, base + offset] += weight * mass
                    if ti.static(whole):
                        rest[t, base + offset] += 0.0

    @ti.kernel
    def update_grid(t: ti.i32):
        for i, j in ti.ndrange(n, n):
            velocity = momentum[t, i, j] / (grid_mass[t, i, j] + 1e-10)
            velocity[1] -= dt * gravity
            if i < 3 and velocity[0] < 0:
                velocity[0] = 0
            if i > n - 3 and velocity[0] > 0:
                velocity[0] = 0
            if j < 3 and velocity[1] < 0:
                velocity[1] = 0
            if j > n - 3 and velocity[1] > 0:
                velocity[1] = 0
            grid_v[t, i, j] = velocity

    @ti.kernel
    def gather(t: ti.i32):
        for p in range(count):
            base = ti.cast(x[t, p] / dx - 0.5, ti.i32)
            fx = x[t, p] / dx - ti.cast(base, float)
            w = [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1.0) ** 2, 0.5 * (fx - 0.5) ** 2]
            new_v = ti.Vector([0.0, 0.0])
            new_C = ti.Matrix([[0.0, 0.0], [0.0, 0.0]])
            for i in ti.static(range(3)):
                for j in ti.static(range(3)):
                    offset = ti.Vector([i, j])
                    dpos = ti.cast(offset, float) - fx
                    weight = w[i][0] * w[j][1]
                    part = weight * grid_v[t, base + offset]
                    new_v += part
                    new_C += 4.0 / dx * part.outer_product(dpos)
            v[t + 1, p] = new_v
            x[t + 1, p] = x[t, p] + dt * new_v
            C[t + 1, p] = new_C

    @ti.kernel
    def compute_loss():
        for p in range(count):
            distance = x[slots - 1, p] - ti.Vector([goal_x, goal_y])
            loss[None] += 0.5 / count * distance.dot(distance)

    @ti.kernel
    def load(position: ti.types.ndarray(), velocity: ti.types.ndarray()):
        for p in range(count):
            x[0, p] = ti.Vector([position[p, 0], position[p, 1]])
            v[0, p] = ti.Vector([velocity[p, 0], velocity[p, 1]])
            F[0, p] = ti.Matrix([[1.0, 0.0], [0.0, 1.0]])

    load(problem.position.astype(np.float32), problem.velocity.astype(np.float32))

    def prepare():
        momentum.fill(0.0)
        grid_mass.fill(0.0)
        if whole:
            rest.fill(0.0)

    def forward():
        for t in range(slots - 1):
            scatter(t)
            update_grid(t)
            gather(t)
        compute_loss()

    return TapeProgram(loss, [(v, first_slot)], forward, prepare)


def make_mass_spring(problem) -> Program:
    body, walk = problem.body, problem.walk
    slots, dt, gravity, ground = walk.slots, walk.dt, walk.gravity, walk.ground
    goal = walk.goal
    points, springs = len(body.points), len(body.springs)
    waves, hidden_count = 10, len(problem.weights["b1"])
    inputs = body.inputs
    damp = float(np.exp(-walk.damping * dt))
    x = ti.Vector.field(2, dtype=float)
    v = ti.Vector.field(2, dtype=float)
    increment = ti.Vector.field(2, dtype=float)
    centre = ti.Vector.field(2, dtype=float)
    hidden = ti.field(dtype=float)
    output = ti.field(dtype=float)
    w1 = ti.field(dtype=float)
    b1 = ti.field(dtype=float)
    w2 = ti.field(dtype=float)
    b2 = ti.field(dtype=float)
    first = ti.field(dtype=ti.i32)
    second = ti.field(dtype=ti.i32)
    rest = ti.field(dtype=float)
    stiffness = ti.field(dtype=float)
    amount = ti.field(dtype=float)
    loss = ti.field(dtype=float)
    ti.root.dense(ti.i, slots).dense(ti.j, points).place(x, v, increment)
    ti.root.dense(ti.i, springs).place(first, second, rest, stiffness, amount)
    if elements_whole:
        # Neighbours in a warp have neighbours in memory.
        ti.root.dense(ti.j, inputs).dense(ti.i, hidden_count).place(w1)
        ti.root.dense(ti.j, hidden_count).dense(ti.i, springs).place(w2)
    else:
        ti.root.dense(ti.ij, (hidden_count, inputs)).place(w1)
        ti.root.dense(ti.ij, (springs, hidden_count)).place(w2)
    ti.root.dense(ti.i, hidden_count).place(b1)
    ti.root.dense(ti.i, springs).place(b2)
    ti.root.dense(ti.ij, (slots, hidden_count)).place(hidden)
    ti.root.dense(ti.ij, (slots, springs)).place(output)
    ti.root.dense(ti.i, slots).place(centre)
    ti.root.place(loss)
    ti.root.lazy_grad()

    @ti.kernel
    def find_centre(t: ti.i32):
        for i in range(points):
            centre[t] += x[t, i] / points

    @ti.kernel
    def layer_1(t: ti.i32):
        for i in range(hidden_count):
            total = b1[i]
            for j in ti.static(range(waves)):
                total += w1[i, j] * ti.sin(10.0 * t * dt + 2.0 * np.pi / waves * j)
            for j in ti.static(range(points)):
                offset = x[t, j] - centre[t]
                total += w1[i, waves + 4 * j] * offset[0] * 0.05
                total += w1[i, waves + 4 * j + 1] * offset[1] * 0.05
                total += w1[i, waves + 4 * j + 2] * v[t, j][0] * 0.05
                total += w1[i, waves + 4 * j + 3] * v[t, j][1] * 0.05
            total += w1[i, waves + 4 * points] * (goal[0] - centre[t][0])
            total += w1[i, waves + 4 * points + 1] * (goal[1] - centre[t][1])
            hidden[t, i] = ti.tanh(total)

    @ti.kernel
    def layer_2(t: ti.i32):
        for i in range(springs):
            total = b2[i]
            for j in ti.static(range(hidden_count)):
                total += w2[i, j] * hidden[t, j]
            output[t, i] = ti.tanh(total)

    @ti.kernel
    def apply_springs(t: ti.i32):
        for i in range(springs):
            a = first[i]
            b = second[i]
            d = x[t, a] - x[t, b]
            length = d.norm() + 1e-4
            wanted = rest[i] * (1.0 + amount[i] * output[t, i])
            impulse = dt * (length - wanted) * stiffness[i] / length * d
            increment[t + 1, a] += -impulse
            increment[t + 1, b] += impulse

    @ti.kernel
    def advance(t: ti.i32):
        for i in range(points):
            old_x = x[t - 1, i]
            free = damp * v[t - 1, i] + dt * gravity * ti.Vector([0.0, 1.0]) + increment[t, i]
            new_v = free
            toi = 0.0
            if old_x[1] + dt * free[1] < ground and free[1] < -1e-4:
                toi = -(old_x[1] - ground) / free[1]
                new_v = ti.Vector([0.0, 0.0])
            v[t, i] = new_v
            x[t, i] = old_x + toi * free + (dt - toi) * new_v

    @ti.kernel
    def compute_loss():
        loss[None] += -x[slots - 1, 0][0]

    @ti.kernel
    def load(points0: ti.types.ndarray()):
        for i in range(points):
            x[0, i] = ti.Vector([points0[i, 0], points0[i, 1]])

    load(body.points.astype(np.float32))
    first.from_numpy(body.springs[:, 0].astype(np.int32))
    second.from_numpy(body.springs[:, 1].astype(np.int32))
    rest.from_numpy(body.rest.astype(np.float32))
    stiffness.from_numpy(body.stiffness.astype(np.float32))
    amount.from_numpy(body.actuation.astype(np.float32))
    for name, field in (("w1", w1), ("b1", b1), ("w2", w2), ("b2", b2)):
        field.from_numpy(problem.weights[name].astype(np.float32))

    def prepare():
        increment.fill(0.0)
        centre.fill(0.0)

    def forward():
        for t in range(1, slots):
            find_centre(t - 1)
            layer_1(t - 1)
            layer_2(t - 1)
            apply_springs(t - 1)
            advance(t)
        compute_loss()

    unknowns = [(w1, whole), (b1, whole), (w2, whole), (b2, whole)]
    return TapeProgram(loss, unknowns, forward, prepare)


def make_first_kernel(problem) -> Program:
    x = ti.field(dtype=float, shape=len(problem.x), needs_grad=True)
    loss = ti.field(dtype=float, shape=(), needs_grad=True)

    @ti.kernel
    def compute_loss():
        for i in x:
            loss[None] += x[i] ** 2

    x.from_numpy(problem.x.astype(np.float32))
    return TapeProgram(loss, [(x, whole)], compute_loss)


def make_launch():
    """A launch of a compiled kernel with one argument, and what waits for it."""
    value = ti.field(dtype=float, shape=())

    @ti.kernel
    def bump(t: ti.i32):
        value[None] += t

    return lambda: bump(1), ti.sync


# "diffmpm_large" is the same program on another problem.
SCENES = {
    "smoke": make_smoke,
    "wave": make_wave,
    "diffmpm": make_mpm,
    "diffmpm_large": make_mpm,
    "mass_spring": make_mass_spring,
    "first_kernel": make_first_kernel,
}
