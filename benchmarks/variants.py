"""The cost of an option of `ti.init` in a scene: processes with and without it, interleaved.

    .venv/bin/python benchmarks/variants.py --scene diffmpm --option ad_guards=False

prints, for forward and backward, the least and the median time without and with the option,
and the number of instructions of a run if the operating system lets `perf` count them. The
least time of many short runs is affected least by other load.
"""

from __future__ import annotations

import argparse
import ast
import json
import re
import shutil
import statistics
import subprocess
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import harness

SCENES = [name for name in harness.PROBLEMS if name != "first_kernel"]


def measure(scene: str, options: dict, seconds: float, runs: int) -> dict[str, list[float]]:
    """Times of a scene in this process."""
    import tai as ti

    ti.init(arch=ti.cpu, default_fp=ti.f32, cpu_max_num_threads=1, offline_cache=False, **options)
    import tai_scenes

    program = tai_scenes.SCENES[scene](harness.PROBLEMS[scene](False))
    for _ in range(harness.WARM_UPS):
        program.run()
    forward, backward, start = [], [], time.perf_counter()
    while len(forward) < runs if runs else time.perf_counter() - start < seconds:
        times = program.run()
        forward.append(times[0])
        backward.append(times[1])
    return {"forward": forward, "backward": backward}


def instructions(command: list[str]) -> float | None:
    """Instructions per run: the difference of a long and a short process, or None."""
    if shutil.which("perf") is None:
        return None
    counts = []
    for runs in (5, 25):
        done = subprocess.run(
            ["perf", "stat", "-x,", "-e", "instructions:u", *command, "--runs", str(runs)],
            capture_output=True, text=True,
        )  # fmt: skip
        found = re.search(r"^(\d+),.*instructions", done.stderr, re.M)
        if found is None:
            return None
        counts.append(int(found[1]))
    return (counts[1] - counts[0]) / 20


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", default="diffmpm", choices=SCENES)
    parser.add_argument("--option", default="ad_guards=False", help="name=value")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=5.0, help="of timed runs in a process")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    parser.add_argument("--runs", type=int, default=0, help=argparse.SUPPRESS)
    chosen = parser.parse_args()

    if chosen.child is not None:
        times = measure(chosen.scene, json.loads(chosen.child), chosen.seconds, chosen.runs)
        print(json.dumps(times))
        return 0
    name, _, value = chosen.option.partition("=")
    variants = {"default": {}, chosen.option: {name: ast.literal_eval(value)}}
    times: dict[str, dict[str, list[float]]] = {}
    counts = {}
    for round_ in range(chosen.rounds):
        for label, options in variants.items():
            command = [sys.executable, __file__, "--scene", chosen.scene]
            command += ["--seconds", str(chosen.seconds), "--child", json.dumps(options)]
            done = subprocess.run(command, capture_output=True, text=True, check=True)
            found = json.loads(done.stdout.splitlines()[-1])
            for phase, values in found.items():
                times.setdefault(label, {}).setdefault(phase, []).extend(values)
            if round_ == 0:
                counts[label] = instructions(command)
    print(f"{chosen.scene}, one thread, milliseconds a run")
    for phase in ("forward", "backward"):
        least, middle = (
            {v: f(times[v][phase]) * 1e3 for v in variants} for f in (min, statistics.median)
        )
        for label in variants:
            ratios = [t[label] / t["default"] for t in (least, middle)]
            print(
                f"{phase:9} {label:20} least {least[label]:9.4f} ({ratios[0]:.4f})"
                f"  median {middle[label]:9.4f} ({ratios[1]:.4f})"
            )
    for label, count in counts.items():
        if count and counts["default"]:
            print(f"instructions {label:17} {count:.4g} ({count / counts['default']:.4f})")
    return 0


if __name__ == "__main__":
    sys.exit(main())
