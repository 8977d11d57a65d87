"""Verifies precision reports: estimated rounding errors against measured ones.

    .venv/bin/python benchmarks/error/advice.py                  # all scenes, small
    .venv/bin/python benchmarks/error/advice.py --scenes wave,smoke --size tiny

For each scene, the difference of the loss in f32 and in f64 is compared with the estimates of the
reports of both. Exits with 1 if that of f32 is wrong by more than a factor of ten; errors below one
unit in the last place of the loss count as one. Scenes in which rounding decides which voxel is
read have discontinuous losses, which derivatives cannot predict: they are shown and not judged.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import modes

HERE = Path(__file__).resolve().parent
FACTOR = 10.0
JUMPS = {"volume_renderer"}


def report(scene: str, size: str, mode: str) -> None:
    """Prints loss and estimate of one mode as a line of JSON."""
    import measure

    with tempfile.TemporaryDirectory() as cache:
        measure.start("tai", modes.find("tai", mode), "cpu", 1, Path(cache))
        import tai as ti

        import cases

        program = cases.make(scene, "tai", size)
        is_example = hasattr(program, "module")
        loss = program.module.loss if is_example else program._loss
        forward = program.forward if is_example else program._forward
        if not is_example:
            program._prepare()
        with ti.ad.Tape(loss, precision=True) as tape:
            forward()
        found = tape.precision_report()
        lines = sum(line.error for line in found.lines)
        print(json.dumps({"loss": found.loss, "lines": lines, "expected": found.expected}))


def of(scene: str, size: str, mode: str) -> dict:
    command = [sys.executable, __file__, "--measure", scene, "--size", size, "--mode", mode]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{scene} in {mode}: {done.stderr.strip().splitlines()[-1]}")
    return json.loads(done.stdout.splitlines()[-1])


def judge(exact: dict, rounded: dict) -> tuple[float, float]:
    """The measured error, and the estimate of the program in f32 as a multiple of it."""
    digit = 2.0**-24 * abs(exact["loss"])
    measured = max(abs(rounded["loss"] - exact["loss"]), digit)
    return measured, max(rounded["expected"], digit) / measured


def main() -> int:
    import cases

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", default=",".join(cases.SCENES), help="comma-separated")
    parser.add_argument("--size", choices=cases.SIZES, default="quick")
    parser.add_argument("--mode", default="f32", help=argparse.SUPPRESS)
    parser.add_argument("--measure", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.measure:
        report(given.measure, given.size, given.mode)
        return 0
    print("| scene | loss | f32 - f64 | its sign by lines, f32 | expected, f32 | expected, f64 |")
    print("|---|---|---|---|---|---|")
    wrong = []
    for scene in given.scenes.split(","):
        exact, rounded = (of(scene, given.size, mode) for mode in ("f64 deterministic", "f32"))
        _, ratio = judge(exact, rounded)
        apart = rounded["loss"] - exact["loss"]
        print(
            f"| {scene} | {exact['loss']:.6g} | {apart:+.1e} | {rounded['lines']:+.1e} | "
            f"{rounded['expected']:.1e} | {exact['expected']:.1e} |",
            flush=True,
        )
        if scene not in JUMPS and not 1 / FACTOR <= ratio <= FACTOR:
            wrong.append(f"{scene}: expected {ratio:.2g} times what was measured")
    print("\n".join(wrong), file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
