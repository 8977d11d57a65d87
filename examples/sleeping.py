"""Columns of balls, of which only those that move are computed.

One ball flies at the first of many columns of balls. The others stand still, and nothing touches
them: they sleep. Balls that are near one another are an island, found by union-find every few
steps. An island is awake if anything in it moves or is pushed, and the loops of a step, forward and
in reverse, run over the awake balls alone. Fields are updated in place, so the memory of a tape
follows the awake balls, too. With 2,000 columns an iteration takes a tenth of the time.

Descent on the velocity of the flying ball brings the top of the first column to a target.

    python examples/sleeping.py
    python examples/sleeping.py --columns 2000
    python examples/sleeping.py --awake      # all balls, always
    python examples/sleeping.py --check      # the gradient against differences
"""

import time
from pathlib import Path
from typing import Any

import numpy as np
import tai as ti

import studio

parser = studio.plain(__doc__)
add, least = parser.add_argument, studio.at_least
add("--columns", type=least(1), default=200, help="how many (200)")
add("--iterations", type=least(1), default=12, help="steps of descent (12)")
add("--steps", type=least(16), default=640, help="steps in time (640)")
add("--awake", action="store_true", help="compute all balls")
add("--check", action="store_true", help="compare the gradient with differences")
add("--out", type=Path, default=Path("out"), help="folder of the picture")
args = parser.parse_args()

COLUMNS, HEIGHT, STEPS = args.columns, 5, args.steps
N = COLUMNS * HEIGHT + 1
FLYING = N - 1
RADIUS, GAP = 0.5, 3.0
DT, GRAVITY = 2e-3, -9.8
STIFFNESS, DAMPING = 8e3, 12.0
EVERY = 16  # steps between two searches for islands
# Nothing that is farther away comes into contact before the next search.
NEAR = 2 * RADIUS + 0.5
STILL, BALANCED = 1e-3, 1e-2  # slower, and pushed less: at rest
ROUNDS = STEPS // EVERY + 1
CELLS, ROOM = int(COLUMNS * GAP / NEAR) + 16, 16

ti.init(arch=ti.cpu, default_fp=ti.f64)

x, v, push = (ti.Vector.field(2, ti.f64, shape=N, needs_grad=True) for _ in range(3))
start = ti.Vector.field(2, ti.f64, shape=(), needs_grad=True)
loss = ti.field(ti.f64, shape=(), needs_grad=True)

# The lists of each search are kept, because the reverse sweep runs over them again.
awake = ti.field(ti.i32, shape=(ROUNDS, N))
count = ti.field(ti.i32, shape=ROUNDS)
parent = ti.field(ti.i32, shape=N)
restless = ti.field(ti.i32, shape=N)
filled = ti.field(ti.i32, shape=(CELLS, 8))
members = ti.field(ti.i32, shape=(CELLS, 8, ROOM))


@ti.func
def cell_of(p: int):
    """Balls that leave the cells count for the last ones."""
    i = ti.cast(ti.floor(x[p][0] / NEAR), ti.i32) + 8
    j = ti.cast(ti.floor(x[p][1] / NEAR), ti.i32)
    return ti.Vector([ti.min(ti.max(i, 0), CELLS - 1), ti.min(ti.max(j, 0), 7)])


@ti.kernel
def sort():
    for i, j in filled:
        filled[i, j] = 0
    for p in x:
        cell = cell_of(p)
        k = ti.atomic_add(filled[cell[0], cell[1]], 1)
        assert k < ROOM, "too many balls in a cell"
        members[cell[0], cell[1], k] = p


@ti.func
def root_of(p: int):
    q = p
    while parent[q] != q:
        parent[q] = parent[parent[q]]
        q = parent[q]
    return q


@ti.kernel
def find_islands(round: int, everything: int):
    for p in parent:
        parent[p] = p
        restless[p] = everything
    ti.loop_config(serialize=True)
    for p in range(N):
        cell = cell_of(p)
        for di, dj in ti.ndrange((-1, 2), (-1, 2)):
            i, j = cell[0] + di, cell[1] + dj
            if 0 <= i and i < CELLS and 0 <= j and j < 8:
                for k in range(filled[i, j]):
                    q = members[i, j, k]
                    if q < p and (x[p] - x[q]).norm() < NEAR:
                        parent[root_of(p)] = root_of(q)
    ti.loop_config(serialize=True)
    for p in range(N):
        if v[p].norm() > STILL or push[p].norm() > BALANCED:
            restless[root_of(p)] = 1
    count[round] = 0
    ti.loop_config(serialize=True)
    for p in range(N):
        if restless[root_of(p)] != 0:
            awake[round, count[round]] = p
            count[round] += 1


@ti.func
def contact(way: Any, speed: Any, least: float):
    """The push along `way` of something that is nearer than `least`."""
    distance = way.norm()
    result = ti.Vector([0.0, 0.0])
    if distance < least:
        normal = way / distance
        result = (STIFFNESS * (least - distance) - DAMPING * speed.dot(normal)) * normal
    return result


@ti.kernel
def collide(round: int):
    for k in range(count[round]):
        p = awake[round, k]
        total = ti.Vector([0.0, GRAVITY]) - 0.4 * v[p]
        floor = ti.Vector([0.0, x[p][1]])
        total += contact(floor, v[p], RADIUS)
        cell = cell_of(p)
        for di, dj in ti.static(ti.ndrange((-1, 2), (-1, 2))):
            i, j = cell[0] + di, cell[1] + dj
            if 0 <= i and i < CELLS and 0 <= j and j < 8:
                for m in range(filled[i, j]):
                    q = members[i, j, m]
                    if q != p:
                        total += contact(x[p] - x[q], v[p] - v[q], 2 * RADIUS)
        push[p] = total


@ti.kernel
def move(round: int):
    for k in range(count[round]):
        p = awake[round, k]
        v[p] += DT * push[p]
        x[p] += DT * v[p]


@ti.kernel
def throw():
    v[FLYING] = start[None]


@ti.kernel
def measure(at_x: float, at_y: float):
    loss[None] = (x[HEIGHT - 1] - ti.Vector([at_x, at_y])).norm_sqr()


def search(number: int, everything: bool = False) -> None:
    with ti.ad.no_grad():
        sort()
        find_islands(number, int(everything or args.awake))


def settle():
    """The state of rest: columns that their own weight presses a little."""
    places = np.zeros((N, 2))
    for p in range(N - 1):
        places[p] = GAP * (p // HEIGHT + 1), RADIUS + 2 * RADIUS * (p % HEIGHT)
    places[FLYING] = GAP - 3.0, 2.0 * HEIGHT
    x.from_numpy(places)
    v.fill(0.0)
    push.fill(0.0)
    for number in range(6000):
        if number % EVERY == 0:
            search(0, everything=True)
            speeds = v.to_numpy()[:FLYING]
            if number > 100 and np.abs(speeds).max() < STILL / 10:
                break
        collide(0)
        move(0)
        places[FLYING] = GAP - 2.0, HEIGHT - 0.3
        x[FLYING] = places[FLYING]
        v[FLYING] = [0.0, 0.0]
    return x.to_numpy()


def run(rest: Any, frames: list[Any] | None = None) -> int:
    """One throw from the state of rest; the balls that were awake at most."""
    x.from_numpy(rest)
    v.fill(0.0)
    push.fill(0.0)
    with ti.ad.Tape(loss):
        throw()
        for number in range(STEPS):
            if number % EVERY == 0:
                search(number // EVERY)
            collide(number // EVERY)
            move(number // EVERY)
            if frames is not None and number % 20 == 0:
                frames.append(
                    (x.to_numpy(), awake.to_numpy()[number // EVERY], count[number // EVERY])
                )
        measure(GAP + 2.0, 3.0)
    return count.to_numpy()[: STEPS // EVERY].max()


def check(rest: Any) -> None:
    run(rest)
    slope = start.grad[None].to_numpy()
    found = np.zeros(2)
    for c in range(2):
        for sign in (1, -1):
            start[None][c] += sign * 1e-6
            run(rest)
            found[c] += sign * loss[None] / 2e-6
            start[None][c] -= sign * 1e-6
    print(f"check    gradient {slope}, by differences {found}")
    print(f"check    gradient differs by {np.abs(slope - found).max() / np.abs(found).max():.2e}")


def draw(gui: ti.GUI, places: Any, listed: Any, number: int) -> None:
    """Awake balls are blue."""
    scale = 1 / (6 * GAP)
    moving = np.zeros(N, dtype=bool)
    moving[listed[:number]] = True
    for group, color in ((~moving, studio.SOFT), (moving, studio.BLUE)):
        if group.any():
            gui.circles(
                places[group] * scale + [0.05, 0.1], radius=RADIUS * scale * 480, color=color
            )


def main():
    rest = settle()
    start[None] = [6.0, 0.5]
    if args.check:
        check(rest)
    losses: list[float] = []
    most = 0
    began = time.perf_counter()
    for _ in ti.tools.Progress(range(args.iterations), "sleeping"):
        most = run(rest)
        losses.append(loss[None])
        slope = start.grad[None].to_numpy()
        start[None] = start[None].to_numpy() - 0.3 * slope / max(1.0, np.linalg.norm(slope))
    each = (time.perf_counter() - began) / args.iterations
    print(f"awake    {most} of {N} balls at most")
    print(f"time     {1e3 * each:.1f} ms an iteration")
    print(f"loss     {losses[0]:.6f} -> {losses[-1]:.6f}")
    frames: list[Any] = []
    run(rest, frames)
    gui = ti.GUI("sleeping", res=(480, 480), background_color=studio.PAPER)
    pictures: list[Any] = []
    for places, listed, number in frames:
        draw(gui, places, listed, number)
        pictures.append(gui.picture())
        gui.show()
    args.out.mkdir(parents=True, exist_ok=True)
    picture = args.out / "sleeping.gif"
    ti.tools.write_gif(pictures + pictures[-1:] * 10, str(picture), framerate=20)
    print(f"picture  {picture.resolve()}")


if __name__ == "__main__":
    main()
