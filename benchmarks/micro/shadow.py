"""The cost of shadow execution: the benchmark's scenes with `shadow=True` and with `strict=True`.

    python benchmarks/micro/shadow.py [--scene wave] [--rounds 3] [--plain strict]

Processes of both kinds in turns, one thread, f32. Prints the least processor time of a run,
forward, backward and both, and how many times as long it takes with shadows. `--save FILE` writes
the reports, to compare those of two builds.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import harness

SCENES = [name for name in harness.PROBLEMS if name != "first_kernel"]
PHASES = ("forward", "backward")
KINDS = {"shadow": {"shadow": True}, "strict": {"strict": True}, "default": {}}


def measure(scene: str, kind: str, runs: int, small: bool) -> dict:
    """Least times of a scene in this process, and the report of its last run."""
    harness.clock = time.process_time
    import tai as ti

    ti.init(
        arch=ti.cpu, default_fp=ti.f32, cpu_max_num_threads=1, offline_cache=False, **KINDS[kind]
    )
    import tai_scenes

    program = tai_scenes.SCENES[scene](harness.PROBLEMS[scene](small))
    program.run()
    best = [float("inf")] * 2
    for _ in range(runs):
        if kind == "shadow":
            ti.tools.clear_shadow_report()
        best = [min(pair) for pair in zip(best, program.run(), strict=True)]
    rows = []
    if kind == "shadow":
        for row in ti.tools.shadow_report():
            counts = (row.lost, row.cancellations, row.flips, row.non_finite)
            place = (row.kernel, row.lineno, row.column, row.operation)
            rows.append([*place, *counts, row.digits_lost, row.error, row.error_in])
    return {"times": best, "report": sorted(rows)}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", choices=SCENES, action="append")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--runs", type=int, default=3, help="timed in a process")
    parser.add_argument("--plain", choices=("strict", "default"), default="strict")
    parser.add_argument("--small", action="store_true")
    parser.add_argument("--save", type=Path)
    parser.add_argument("--child", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    scenes = chosen.scene or SCENES
    if chosen.child:
        print(json.dumps(measure(scenes[0], chosen.child, chosen.runs, chosen.small)))
        return 0

    saved = {}
    for scene in scenes:
        best = {kind: [float("inf")] * 2 for kind in ("shadow", chosen.plain)}
        for _ in range(chosen.rounds):
            for kind, before in best.items():
                command = [sys.executable, __file__, "--scene", scene, "--child", kind]
                command += ["--runs", str(chosen.runs)] + ["--small"] * chosen.small
                done = subprocess.run(command, capture_output=True, text=True)
                if done.returncode:
                    print(done.stderr, file=sys.stderr)
                    return 1
                found = json.loads(done.stdout.splitlines()[-1])
                best[kind] = [min(pair) for pair in zip(before, found["times"], strict=True)]
                if kind == "shadow":
                    saved[scene] = found["report"]
        shadow, plain = ([*times, sum(times)] for times in (best["shadow"], best[chosen.plain]))
        for phase, slow, fast in zip([*PHASES, "both"], shadow, plain, strict=True):
            times = f"{fast * 1e3:8.2f} {slow * 1e3:8.2f} ms"
            print(f"{scene:12} {phase:9} {times} {slow / fast:6.1f}", flush=True)
    if chosen.save:
        rows = [json.dumps({"scene": scene, "row": row}) for scene in saved for row in saved[scene]]
        chosen.save.write_text("\n".join(rows) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
