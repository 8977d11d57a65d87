"""A wave in a medium at rest, and the blocks of memory that follow it.

The medium is excitable, as heart muscle is (Barkley's model): a spark makes a ring that runs
outward, and behind it the medium comes to rest. Only cells that are not at rest are stored and
computed: blocks of 64×64 cells hold blocks of 8×8 cells. A block becomes active when the wave
reaches its neighbour, and inactive when it is at rest again; memory at rest holds zeros.

The picture shows the wave with the blocks of both levels drawn around it.

    python examples/active_blocks.py
    python examples/active_blocks.py --n 2048 --steps 6000
    python examples/active_blocks.py --dense      # all cells, always: the same wave
"""

import time
from pathlib import Path
from typing import Any

import numpy as np
import tai as ti

import studio

parser = studio.plain(__doc__)
add, least = parser.add_argument, studio.at_least
add("--n", type=least(2), default=512, help="cells along a side, a multiple of 64 (512)")
add("--steps", type=least(2), default=1800, help="steps in time (1800)")
add("--dense", action="store_true", help="store and compute all cells")
add("--out", type=Path, default=Path("out"), help="folder of the picture")
args = parser.parse_args()

N, FINE, COARSE = args.n, 8, 64
if N % COARSE:
    parser.error(f"--n: {N} is no multiple of {COARSE}")
DX, DT = 0.5, 0.01
A, B, EPSILON = 0.75, 0.02, 0.02
REST = 1e-3  # values nearer to zero are at rest

ti.init(arch=ti.cpu)

# Excitation and recovery, now and then; the steps go to and fro between them.
now, then = (ti.Struct.field({"u": ti.f32, "v": ti.f32}) for _ in range(2))
kind = "dense" if args.dense else "pointer"
coarse = getattr(ti.root, kind)(ti.ij, N // COARSE)
fine = getattr(coarse, kind)(ti.ij, COARSE // FINE)
fine.dense(ti.ij, FINE).place(now, then)


@ti.kernel
def spark():
    for i, j in ti.ndrange((N // 3, N // 3 + 12), (N // 2 - 6, N // 2 + 6)):
        now[i, j].u = 1.0
    for i, j in ti.ndrange((3 * N // 4, 3 * N // 4 + 12), (N // 3, N // 3 + 12)):
        now[i, j].u = 1.0


@ti.func
def at(field: ti.template, i: int, j: int):
    """Walls reflect; a cell of an inactive block is zero, and stays inactive."""
    return field.u[ti.min(ti.max(i, 0), N - 1), ti.min(ti.max(j, 0), N - 1)]


@ti.kernel
def step(old: ti.template, new: ti.template):
    for i, j in old:
        u, v = old[i, j].u, old[i, j].v
        around = at(old, i - 1, j) + at(old, i + 1, j) + at(old, i, j - 1) + at(old, i, j + 1)
        growth = u * (1 - u) * (u - (v + B) / A) / EPSILON
        new[i, j].u = u + DT * (growth + (around - 4 * u) / DX**2)
        new[i, j].v = v + DT * (u - v)


@ti.kernel
def wake():
    """Activates the neighbours of blocks at whose edge something stirs.

    The loop goes over the blocks that were active when it began, so that one call reaches
    neighbours and no further.
    """
    for bi, bj in fine:
        for side in ti.static(range(4)):
            stirs = False
            for k in range(FINE):
                i, j = FINE * bi + k, FINE * bj + k
                if ti.static(side < 2):
                    j = FINE * bj + (FINE - 1) * side
                else:
                    i = FINE * bi + (FINE - 1) * (side - 2)
                if ti.abs(now[i, j].u) > REST:
                    stirs = True
            ni = bi + ti.static((0, 0, -1, 1)[side])
            nj = bj + ti.static((-1, 1, 0, 0)[side])
            if stirs and 0 <= ni < N // FINE and 0 <= nj < N // FINE:
                if not ti.is_active(fine, [ni, nj]):
                    ti.activate(fine, [ni, nj])


@ti.kernel
def rest():
    """Deactivates blocks that are at rest, and blocks of blocks that hold none."""
    for bi, bj in fine:
        greatest = 0.0
        for i, j in ti.ndrange((FINE * bi, FINE * (bi + 1)), (FINE * bj, FINE * (bj + 1))):
            greatest = ti.max(greatest, ti.abs(now[i, j].u), ti.abs(now[i, j].v))
        if greatest < REST:
            ti.deactivate(fine, [bi, bj])
    for ci, cj in coarse:
        any_active = False
        span = COARSE // FINE
        for i, j in ti.ndrange((span * ci, span * (ci + 1)), (span * cj, span * (cj + 1))):
            if ti.is_active(fine, [i, j]):
                any_active = True
        if not any_active:
            ti.deactivate(coarse, [ci, cj])


def blocks_of(level: ti.SNode) -> Any:
    """The active blocks of a level."""
    if args.dense:
        return np.stack(np.meshgrid(*map(np.arange, level.shape), indexing="ij"), -1).reshape(-1, 2)
    return level.active_cells()


def draw():
    """The wave, white where it rises and blue where it recovers, and the blocks around it."""
    state = now.to_numpy()
    u, v = np.clip(state["u"], 0, 1)[..., None], np.clip(state["v"] / 0.6, 0, 1)[..., None]
    picture = np.array([16, 18, 24]) + v * np.array([20, 70, 150])
    picture = picture * (1 - u) + u * np.array([255, 244, 214])
    for level, size, colour in ((fine, FINE, (58, 66, 84)), (coarse, COARSE, (196, 120, 48))):
        for i, j in (size * blocks_of(level)).tolist():
            for line in (picture[i, j : j + size], picture[i : i + size, j]):
                line[:] = colour
            if size == COARSE:
                for line in (
                    picture[i + size - 1, j : j + size],
                    picture[i : i + size, j + size - 1],
                ):
                    line[:] = colour
    return picture.astype(np.uint8)


def main():
    spark()
    frames: list[Any] = []
    most, visited = 0, 0
    took = 0.0
    for number in ti.tools.Progress(range(args.steps // 2), "active_blocks"):
        if number % max(1, args.steps // 80) == 0:
            frames.append(draw())
        begin = time.perf_counter()
        if not args.dense:
            if number % 4 == 0:
                wake()
            if number % 40 == 39:
                rest()
        step(now, then)
        step(then, now)
        took += time.perf_counter() - begin
        active = len(blocks_of(fine)) if args.dense else fine.num_active
        most, visited = max(most, active), visited + 2 * active
    total = (N // FINE) ** 2
    print(f"blocks   at most {most} of {total}, {visited / args.steps:.0f} in a step")
    print(f"time     {1e3 * took / args.steps:.3f} ms per step")
    state = now.to_numpy()
    print(f"wave     {state['u'].sum():.4f} excited, {state['v'].sum():.4f} recovering")
    frames.append(draw())
    args.out.mkdir(parents=True, exist_ok=True)
    ti.tools.imwrite(frames[len(frames) // 2], str(args.out / "active_blocks.png"))
    picture = args.out / "active_blocks.gif"
    frames = [ti.tools.cook_image_to_bytes(frame) for frame in frames]
    ti.tools.write_gif(frames + frames[-1:] * 10, str(picture), framerate=12)
    print(f"picture  {picture.resolve()}")
    ti.profiler.print_skips()


if __name__ == "__main__":
    main()
