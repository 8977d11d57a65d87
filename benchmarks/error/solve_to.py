"""Measures `ti.solve_to`: asked error against true error, time and iterations, on scenes.

    .venv/bin/python benchmarks/error/solve_to.py --size tiny
    .venv/bin/python benchmarks/error/solve_to.py --scenes wave,smoke --size quick --errors 1e-4

The true error is that against an implementation of its own, the adjoints in NumPy and f64 of
`test/python/reference`. A scene is run in a process of its own. Exits with 1 if a true error is
above the one that was asked for, or a choice took more than 20 iterations; a scene that is refused
is shown with the reason.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import numpy as np

HERE = Path(__file__).resolve().parent
ERRORS = [1e-2, 1e-4, 1e-6, 1e-9, 1e-12]
MOST_ITERATIONS = 20


def distances(found: tuple, exact: tuple) -> tuple[float, float]:
    """Relative errors of loss and gradient (L2)."""
    loss = abs(found[0] - exact[0]) / abs(exact[0])
    gradient = np.linalg.norm(found[1] - exact[1]) / np.linalg.norm(exact[1])
    return float(loss), float(gradient)


def measure(scene: str, size: str, errors: list[float], kind: str) -> list[dict]:
    """A row for each error that is asked for."""
    import tai as ti

    import cases

    ti.init(default_fp=getattr(ti, kind))
    program = cases.make(scene, "tai", size)
    exact = cases.problem_of(scene, size).reference()
    unknowns = [field for field, _ in program._unknowns]
    slots = [pick for _, pick in program._unknowns]

    def run() -> None:
        program._prepare()
        program._forward()

    rows = []
    for error in errors:
        row: dict = {"scene": scene, "size": size, "types": kind, "asked": error}
        try:
            found = ti.solve_to(run, loss=program._loss, wrt=unknowns, error=error)
        except ti.TaiError as failure:
            rows.append(row | {"refused": failure.message})
            continue
        parts = [pick(g).ravel() for pick, g in zip(slots, found.gradients, strict=True)]
        gradient = np.concatenate(parts)
        row["true"] = max(distances((found.loss, gradient), exact))
        row |= {"expected": found.error, "iterations": found.iterations, "ms": 1e3 * found.time,
                "reference_ms": 1e3 * found.reference_time, "modes": found.modes}  # fmt: skip
        rows.append(row)
    return rows


def shown(row: dict) -> str:
    head = f"{row['scene']:12} {row['size']:5} {row['types']} {row['asked']:8.0e}"
    if "refused" in row:
        return f"{head}  refused: {row['refused']}"
    modes = row["modes"]
    words = [modes["precision"], modes["sums"], modes["math"], str(len(modes["types"])) + " types"]
    return (
        f"{head} {row['true']:9.1e} {row['true'] / row['asked']:9.1e} {row['expected']:9.1e} "
        f"{row['iterations']:4} {row['ms']:9.3g} {row['reference_ms']:9.3g}  {', '.join(words)}"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", default="mass_spring,wave,smoke,diffmpm")
    parser.add_argument("--size", default="tiny", choices=["tiny", "quick", "full"])
    parser.add_argument("--errors", default=",".join(map(str, ERRORS)))
    parser.add_argument("--types", default="f32", choices=["f32", "f64"])
    parser.add_argument("--json", action="store_true", help="rows of one scene, for this script")
    args = parser.parse_args()
    errors = [float(text) for text in args.errors.split(",")]
    if args.json:
        print(json.dumps(measure(args.scenes, args.size, errors, args.types)))
        return 0
    print(
        "scene        size  types   asked      true true/asked  expected iter        ms    ref ms"
    )
    failed = False
    for scene in args.scenes.split(","):
        command = [sys.executable, __file__, "--json", "--scenes", scene, "--size", args.size,
                   "--errors", args.errors, "--types", args.types]  # fmt: skip
        done = subprocess.run(command, capture_output=True, text=True, cwd=HERE, check=False)
        if done.returncode:
            print(f"{scene}: failed\n{done.stderr}")
            failed = True
            continue
        for row in json.loads(done.stdout.splitlines()[-1]):
            print(shown(row), flush=True)
            if "true" in row:
                failed |= row["true"] > row["asked"] or row["iterations"] > MOST_ITERATIONS
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
