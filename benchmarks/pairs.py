"""Time the scenes on two builds of tai, interleaved, to measure the effect of a change.

    .venv/bin/python benchmarks/pairs.py BASE [--scenes smoke,wave] [--rounds 5] [--out FILE.csv]

BASE is a checkout of another version with its own build. Both sides run this checkout's
`tai_scenes.py` on one worker, each measurement in a process of its own and in turns, so
that a machine that gets slower slows both. The result is the least processor time, over all
runs, of the thread that runs the scene: other programs on the machine only make runs longer.
Prints milliseconds and the ratio to BASE; exits with 1 if a ratio is above --bar.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
SCENES = ["mass_spring", "wave", "smoke", "diffmpm"]
PHASES = ["forward", "backward", "replay"]


def measure(scene: str, runs: int, cache: str) -> None:
    """Prints the least milliseconds of each phase as one line of JSON."""
    import harness

    harness.clock = time.thread_time
    import tai as ti

    ti.init(
        arch=ti.cpu,
        default_fp=ti.f32,
        cpu_max_num_threads=1,
        offline_cache=True,
        offline_cache_file_path=cache,
    )
    import tai_scenes
    from problems import PROBLEMS

    problem = PROBLEMS[scene](False)
    program = tai_scenes.SCENES[scene](problem)
    for _ in range(harness.WARM_UPS):
        program.run()
    times = [program.run() for _ in range(runs)]
    program.replay()
    replays = [program.replay() for _ in range(runs)]
    least = [min(t[0] for t in times), min(t[1] for t in times), min(replays)]
    print(json.dumps([1e3 * seconds / problem.units for seconds in least]))


def run_side(tree: Path, scene: str, runs: int, cache: Path) -> list[float]:
    command = [sys.executable, __file__, "--measure", scene, "--runs", str(runs)]
    environment = dict(os.environ, PYTHONPATH=str(tree / "python"))
    done = subprocess.run(
        [*command, "--cache", str(cache)],
        capture_output=True,
        text=True,
        env=environment,
        cwd=HERE,
        check=False,
    )
    if done.returncode:
        raise SystemExit(f"{scene} on {tree} failed:\n{done.stderr[-2000:]}")
    return json.loads(done.stdout.splitlines()[-1])


def revision(tree: Path) -> str:
    command = ["git", "-C", str(tree), "describe", "--always", "--dirty", "--exclude=*"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.stdout.strip() or tree.name


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("base", type=Path, nargs="?", help="a built checkout to compare with")
    parser.add_argument("--scenes", default=",".join(SCENES), help="comma-separated")
    parser.add_argument("--rounds", type=int, default=5, help="processes per side and scene")
    parser.add_argument("--runs", type=int, default=30, help="timed runs per process")
    parser.add_argument("--bar", type=float, default=1.03, help="highest ratio that passes")
    parser.add_argument("--out", type=Path, help="a CSV file to write")
    parser.add_argument("--measure", metavar="SCENE", help=argparse.SUPPRESS)
    parser.add_argument("--cache", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        measure(options.measure, options.runs, options.cache)
        return 0
    if not options.base:
        parser.error("name a built checkout to compare with")
    sides = {"base": options.base.resolve(), "new": ROOT}
    names = {side: revision(tree) for side, tree in sides.items()}
    print(f"# base {names['base']}, new {names['new']}: least milliseconds of processor time")
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for scene in options.scenes.split(","):
            found: dict[str, list[list[float]]] = {side: [] for side in sides}
            for turn in range(options.rounds):
                for side in sorted(sides, reverse=turn % 2 == 1):
                    cache = Path(folder) / side / scene
                    found[side].append(run_side(sides[side], scene, options.runs, cache))
            for phase, name in enumerate(PHASES):
                base, new = (min(times[phase] for times in found[side]) for side in ("base", "new"))
                ratio = new / base
                print(f"{scene:12} {name:9} {base:9.4f} {new:9.4f} {ratio:6.3f}", flush=True)
                rows.append([scene, name, f"{base:.5g}", f"{new:.5g}", f"{ratio:.3f}"])
    if options.out:
        with options.out.open("w", newline="") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(["scene", "phase", names["base"], names["new"], "ratio"])
            writer.writerows(rows)
    return 1 if any(float(row[-1]) > options.bar for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
