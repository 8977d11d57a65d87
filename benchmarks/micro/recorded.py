"""A tape that is recorded anew in each iteration against one that is replayed:
milliseconds for an iteration of recording (or replay), gradient and a step of an optimiser.

    recorded.py [--arch cuda] [--scenes chain,mass_spring,smoke] [--iterations 20] [--small]

`chain` is a chain of small kernels, the others are scenes of tai_scenes.py with a gradient step on
their parameters. The first column is the median with the loss read in each iteration, before the
step; for the second the host waits only at the end. Both are measured after the runtime's trials
of program ways have ended. The loss in the last column shows that all compute the same.
"""

import argparse
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
# How it is run, whether launches are fused, and the environment.
WAYS = {
    "replayed": ("replay", True, {}),
    "replayed, not fused": ("replay", False, {}),
    "recorded": ("record", True, {}),
    "recorded, never collected": ("record", True, {"TAI_COLLECT_RECORDINGS": "0"}),
    "recorded, always collected": ("record", True, {"TAI_COLLECT_RECORDINGS": "1"}),
    "recorded, not fused": ("record", False, {}),
}
SCENES = ["chain", "mass_spring", "smoke", "diffmpm", "diffmpm_large"]


def make_chain(ti, small: bool):
    """The loss, the work before the tape, the recorded work, and a step."""
    n, steps = 4096, 50 if small else 500
    x = ti.field(ti.f32, shape=(steps + 1, n), needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def advance(t: ti.i32):
        for i in range(n):
            x[t + 1, i] = 0.9 * x[t, i] + 0.05 * (x[t, (i + 1) % n] + x[t, (i + n - 1) % n])

    @ti.kernel
    def total():
        for i in range(n):
            loss[None] += x[steps, i] ** 2

    @ti.kernel
    def step(rate: ti.f32):
        for i in range(n):
            x[0, i] -= rate * x.grad[0, i]

    def forward():
        for t in range(steps):
            advance(t)
        total()

    x.fill(1.0)
    return loss, lambda: None, forward, step


def make_scene(ti, name: str, small: bool):
    """The same of a scene."""
    sys.path.insert(0, str(HERE.parent))
    import problems
    import tai_scenes

    tai_scenes.elements_whole = True
    make = {**problems.PROBLEMS, **problems.LARGE_PROBLEMS}[name]
    program = tai_scenes.SCENES[name](make(small))
    unknown = program._unknowns[0][0]
    if name == "mass_spring":

        @ti.kernel
        def step(rate: ti.f32):
            for i in ti.grouped(unknown):
                unknown[i] -= rate * unknown.grad[i]

    elif name == "smoke":

        @ti.kernel
        def step(rate: ti.f32):
            for i, j in ti.ndrange(unknown.shape[1], unknown.shape[2]):
                unknown[0, i, j] -= rate * unknown.grad[0, i, j]

    else:

        @ti.kernel
        def step(rate: ti.f32):
            for i in range(unknown.shape[1]):
                unknown[0, i] -= rate * unknown.grad[0, i]

    return program._loss, program._prepare, program._forward, step


def measure(options) -> None:
    """Prints the line of one scene and one way."""
    import tai as ti

    how, fuses, _ = WAYS[options.way]
    ti.init(arch=getattr(ti, options.arch), fuse_launches=fuses)
    make = make_chain if options.scene == "chain" else make_scene
    names = () if options.scene == "chain" else (options.scene,)
    loss, prepare, forward, step = make(ti, *names, options.small)
    tape = None

    def iterate(reads: bool) -> None:
        nonlocal tape
        prepare()
        if how == "record" or tape is None:
            with ti.ad.Tape(loss) as tape:
                forward()
        else:
            loss[None] = 0.0
            tape.replay()
        if reads:
            loss[None]
        step(1e-9)

    for _ in range(options.warmup):
        iterate(True)
    ti.sync()
    times = []
    for _ in range(options.iterations):
        start = time.perf_counter()
        iterate(True)
        times.append(time.perf_counter() - start)
    for _ in range(options.warmup // 4):
        iterate(False)
    ti.sync()
    start = time.perf_counter()
    for _ in range(options.iterations):
        iterate(False)
    ti.sync()
    queued = (time.perf_counter() - start) / options.iterations
    print(
        f"{options.scene:14} {options.way:28} {1e3 * statistics.median(times):9.3f} "
        f"{1e3 * queued:9.3f}  loss {float(loss[None]):.8g}",
        flush=True,
    )
    if options.explain:
        told = tape.explain().splitlines()
        print("\n".join(line for line in told if not line.split(":")[0].isdigit()), flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n", maxsplit=1)[0])
    parser.add_argument("--arch", default="cuda")
    parser.add_argument("--scenes", default="chain,mass_spring,smoke")
    parser.add_argument("--ways", default="", help="separated by semicolons; all where empty")
    parser.add_argument("--iterations", type=int, default=20)
    parser.add_argument("--warmup", type=int, default=40)
    parser.add_argument("--small", action="store_true", help="fewer steps, for a dry run")
    parser.add_argument("--explain", action="store_true", help="what became of the sequences")
    parser.add_argument("--package", default=str(HERE.parent.parent / "python"))
    parser.add_argument("--scene", help=argparse.SUPPRESS)
    parser.add_argument("--way", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.scene:
        sys.path.insert(0, options.package)
        measure(options)
        return 0
    scenes = options.scenes.split(",")
    ways = options.ways.split(";") if options.ways else list(WAYS)
    for chosen, known in ((scenes, SCENES), (ways, WAYS)):
        for name in chosen:
            if name not in known:
                parser.error(f"there is no '{name}', but {', '.join(known)}")
    print(f"{'scene':14} {'way':28} {'ms, read':>9} {'ms':>9}", flush=True)
    failed = 0
    for scene in scenes:
        for way in ways:
            command = [sys.executable, __file__, *sys.argv[1:], "--scene", scene, "--way", way]
            result = subprocess.run(command, env={**os.environ, **WAYS[way][2]}, check=False)
            if result.returncode:
                print(f"{scene:14} {way:28} failed", flush=True)
                failed = 1
    return failed


if __name__ == "__main__":
    sys.exit(main())
