"""Points that push their neighbours away, until they lie evenly.

Random points have gaps and clusters. Here each pair closer than a radius has an energy, and
descent on its gradient spreads the points over a square without edges ("blue noise").

Neighbours are found by cells of the size of the radius. Each cell has a list of its points, on a
`dynamic` level: `append` puts a point into the list, and the list has a length. Lists hold at most
32 points; one more would be an error, with the line that appended it.

    python examples/neighbours.py
    python examples/neighbours.py --points 20000 --iterations 100
"""

from pathlib import Path
from typing import Any

import numpy as np
import tai as ti

import studio

parser = studio.plain(__doc__)
add, least = parser.add_argument, studio.at_least
add("--points", type=least(24), default=2000, help="how many (2000)")
add("--iterations", type=least(1), default=80, help="steps of descent (80)")
add("--rate", type=least(0, float), default=0.08, help="learning rate, in radii (0.08)")
text = "of the points at the start (0)"
add("--seed", type=least(0, most=studio.LARGEST_SEED), default=0, help=text)
add("--check", action="store_true", help="compare with all pairs in NumPy")
add("--out", type=Path, default=Path("out"), help="folder of the picture")
args = parser.parse_args()

N = args.points
# At the end, points are about 1.07 / √N apart.
CELLS = int(np.sqrt(N) / 1.6)
RADIUS = 1 / CELLS
CAPACITY = 32

ti.init(arch=ti.cpu)

x = ti.Vector.field(2, ti.f64, shape=N, needs_grad=True)
energy = ti.field(ti.f64, shape=(), needs_grad=True)
neighbours = ti.field(ti.i32, shape=N)
members = ti.field(ti.i32)
lists = ti.root.dense(ti.ij, CELLS).dynamic(ti.k, CAPACITY)
lists.place(members)


@ti.func
def cell_of(point: Any):
    return ti.cast(ti.floor(point / RADIUS), ti.i32) % CELLS


@ti.kernel
def sort():
    """Puts each point into the list of its cell; points on many threads may share one."""
    for p in x:
        cell = cell_of(x[p])
        members[cell[0], cell[1]].append(p)


@ti.func
def way(p: int, q: int):
    """From q to p, the shortest way around the square."""
    between = x[p] - x[q]
    return between - ti.round(between)


@ti.kernel
def measure():
    """(1 - distance / RADIUS)² of all pairs that are closer than RADIUS."""
    for p in x:
        cell = cell_of(x[p])
        for di, dj in ti.static(ti.ndrange((-1, 2), (-1, 2))):
            i, j = (cell[0] + di) % CELLS, (cell[1] + dj) % CELLS
            for k in range(members[i, j].length()):
                q = members[i, j, k]
                if q != p:
                    distance = way(p, q).norm()
                    if distance < RADIUS:
                        energy[None] += 0.5 * (1 - distance / RADIUS) ** 2


@ti.kernel
def count():
    for p in x:
        cell = cell_of(x[p])
        near = 0
        for di, dj in ti.static(ti.ndrange((-1, 2), (-1, 2))):
            i, j = (cell[0] + di) % CELLS, (cell[1] + dj) % CELLS
            for k in range(members[i, j].length()):
                q = members[i, j, k]
                if q != p and way(p, q).norm() < RADIUS:
                    near += 1
        neighbours[p] = near


@ti.kernel
def descend(rate: ti.f64):
    for p in x:
        moved = x[p] - rate * x.grad[p]
        x[p] = moved - ti.floor(moved)


def gradient():
    """The energy, and its gradient in x.grad."""
    lists.deactivate_all()
    sort()
    with ti.ad.Tape(energy):
        measure()
    return energy[None]


def check():
    """Energy, gradient and numbers of neighbours against all pairs."""
    value = gradient()
    count()
    points = x.to_numpy()
    between = points[:, None] - points[None]
    between -= np.round(between)
    distance = np.linalg.norm(between, axis=-1)
    near = (distance < RADIUS) & ~np.eye(N, dtype=bool)
    safe = np.where(near, distance, 1.0)
    total = 0.5 * ((1 - safe / RADIUS) ** 2 * near).sum()
    pull = -2 * (1 - safe / RADIUS) / (RADIUS * safe) * near
    slope = (pull[..., None] * between).sum(1)
    error = np.abs(x.grad.to_numpy() - slope).max() / np.abs(slope).max()
    print(f"check    {near.sum() // 2} pairs, {neighbours.to_numpy().sum() // 2} in the lists")
    print(f"check    energy {value:.9f}, of all pairs {total:.9f}")
    print(f"check    gradient differs by {error:.2e}")


def gap():
    """The least distance between two points, in 1 / √N."""
    points = x.to_numpy()
    between = points[:, None] - points[None]
    distance = np.linalg.norm(between - np.round(between), axis=-1)
    return (distance + 9 * np.eye(N)).min() * np.sqrt(N)


def main():
    x.from_numpy(np.random.default_rng(args.seed).random((N, 2)))
    if args.check:
        check()
    gui = ti.GUI("neighbours", res=(480, 480), background_color=studio.PAPER)
    energies: list[float] = []
    frames: list[Any] = []
    before = gap()
    for number in ti.tools.Progress(range(args.iterations), "neighbours"):
        if number % max(1, args.iterations // 30) == 0:
            gui.circles(x.to_numpy(), radius=2.2, color=studio.BLUE)
            frames.append(gui.picture())
            gui.show()
        energies.append(gradient())
        descend(args.rate * RADIUS**2)
    count()
    lengths = lists.num_active / CELLS**2
    print(f"lists    {CELLS}² cells of {lengths:.2f} points, of {CAPACITY} at most")
    print(f"gap      {before:.3f} -> {gap():.3f} (1 / √N)")
    print(f"loss     {energies[0]:.6f} -> {energies[-1]:.6f}")
    args.out.mkdir(parents=True, exist_ok=True)
    picture = args.out / "neighbours.gif"
    ti.tools.write_gif(frames + frames[-1:] * 10, str(picture), framerate=12)
    print(f"picture  {picture.resolve()}")
    ti.profiler.print_skips()


if __name__ == "__main__":
    main()
