"""Time the first hundred iterations of training programs, each in a fresh process.

    first_iterations.py [--arch cuda] [--only cloth smoke] [--systems tai taichi] [--out FILE]

Prints one row per program, cache state and variant: seconds from the start of the process to the
end of the 1st, 10th and 100th iteration, the median of an iteration and the longest one after the
third (ms).
"""

from __future__ import annotations

import argparse
import csv
import importlib
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
PLAIN = [
    "adi",
    "cloth",
    "fem_cg",
    "lbm",
    "nbody",
    "neural_field",
    "ray_marcher",
    "shallow_water",
    "sph",
]
SCENES = ["smoke", "wave", "mpm", "mass_spring"]
FIELDS = [
    "program",
    "system",
    "variant",
    "cache",
    "first_s",
    "tenth_s",
    "hundredth_s",
    "median_ms",
    "longest_ms",
    "whole_s",
]


def load_system(name: str, arch: str, options: dict):
    """Imports the system, under the name `tai` as well, and initialises it."""
    module = importlib.import_module(name)
    sys.modules["tai"] = module
    module.init(arch=getattr(module, arch), **options)
    return module


def make(program: str):
    if program in PLAIN:
        return importlib.import_module(program).make()[0]
    sys.path.insert(0, str(HERE.parent))
    import problems
    import tai_scenes

    problem = {"smoke": "smoke", "wave": "wave", "mpm": "mpm", "mass_spring": "robot"}[program]
    scene = getattr(tai_scenes, f"make_{program}")(getattr(problems, f"{problem}_problem")())
    return scene.run


def child(arguments) -> None:
    """One process: prints the start and the end of each iteration by the wall clock."""
    options = {} if arguments.variant == "default" else {arguments.variant: False}
    ti = load_system(arguments.system, arguments.arch, options)
    iterate = make(arguments.program)
    for _ in range(arguments.count):
        iterate()
        ti.sync()
        print(f"{time.time():.6f}", flush=True)
    if arguments.explain:
        print(
            "explain:", ti.profiler.explain() if hasattr(ti.profiler, "explain") else "", flush=True
        )


def measure(program: str, system: str, variant: str, cache: Path, arguments) -> dict | None:
    command = [
        sys.executable,
        __file__,
        "--child",
        "--program",
        program,
        "--system",
        system,
        "--variant",
        variant,
        "--arch",
        arguments.arch,
        "--count",
        str(arguments.count),
    ]
    environment = dict(
        os.environ, TAI_CACHE_DIR=str(cache / "tai"), CUDA_CACHE_PATH=str(cache / "cuda")
    )
    start = time.time()
    try:
        ran = subprocess.run(
            command,
            env=environment,
            cwd=HERE,
            capture_output=True,
            text=True,
            timeout=arguments.limit,
        )
    except subprocess.TimeoutExpired:
        print(f"{program} {system} {variant}: no end in {arguments.limit} s", flush=True)
        return None
    whole = time.time() - start
    ends = [float(line) - start for line in ran.stdout.split() if line[:1].isdigit()]
    if len(ends) < arguments.count:
        print(f"{program} {system} {variant}: {ran.stderr.strip()[-300:]}", flush=True)
        return None
    spans = [1e3 * (b - a) for a, b in zip(ends, ends[1:])]
    return {
        "first_s": ends[0],
        "tenth_s": ends[min(9, len(ends) - 1)],
        "hundredth_s": ends[-1],
        "median_ms": statistics.median(spans[len(spans) // 2 :]),
        "longest_ms": max(spans[2:]),
        "whole_s": whole,
    }


def main() -> None:
    ask = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    ask.add_argument("--arch", default="cuda")
    ask.add_argument("--only", nargs="*", default=PLAIN + SCENES)
    ask.add_argument("--systems", nargs="*", default=["tai"])
    ask.add_argument("--variants", nargs="*", default=["default", "fuse_launches"])
    ask.add_argument("--count", type=int, default=100)
    ask.add_argument("--limit", type=float, default=120)
    ask.add_argument("--out")
    ask.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    ask.add_argument("--explain", action="store_true", help=argparse.SUPPRESS)
    for name in ("--program", "--system", "--variant"):
        ask.add_argument(name, help=argparse.SUPPRESS)
    arguments = ask.parse_args()
    if arguments.child:
        child(arguments)
        return
    rows = []
    for program in arguments.only:
        for system in arguments.systems:
            for variant in arguments.variants if system == "tai" else ["default"]:
                with tempfile.TemporaryDirectory() as folder:
                    for cache in ("cold", "warm"):
                        found = measure(program, system, variant, Path(folder), arguments)
                        if not found:
                            break
                        row = {
                            "program": program,
                            "system": system,
                            "variant": variant,
                            "cache": cache,
                        }
                        row |= {name: f"{value:.4g}" for name, value in found.items()}
                        rows.append(row)
                        print(" ".join(row[name] for name in FIELDS), flush=True)
    if arguments.out:
        with open(arguments.out, "w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, FIELDS)
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()
