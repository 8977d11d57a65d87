"""Checks the reference: tai's results in f64 against arithmetic of 50 digits.

    .venv/bin/python benchmarks/error/exact.py [--scenes wave,billiards]

Each scene and kernel at its tiny size: the loss, and the derivative along a direction of all
unknowns, by a central difference with an error of about 1e-36. Kernels run as Python functions,
in `decimal_tai.py`. Exits with 1 if an error of f64 exceeds 1e-11. The scenes in three dimensions
take many minutes, and run only if they are named.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import mpmath
import numpy as np

import decimal_tai

HERE = Path(__file__).resolve().parent
BAR = 1e-11
SLOW = {"diffmpm3d", "liquid"}
STEP = mpmath.mpf(10) ** -18


def in_f64(scene: str) -> tuple[float, np.ndarray]:
    """Loss and gradient by tai, in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        kept = Path(folder) / "0.npz"
        command = [sys.executable, str(HERE / "references.py"), "--scene", scene, "--size", "tiny"]
        command += ["--how", "tai", "--count", "1", "--out", folder, "--cache", folder]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if not kept.is_file():
            raise RuntimeError(f"{scene}: {done.stdout}{done.stderr}")
        with np.load(kept) as file:
            return float(file["loss"]), file["gradient"]


def unknowns_of(program) -> list[tuple]:
    """Pairs (field, indices) of the unknowns of the gradient."""
    import tai_scenes

    if hasattr(program, "module"):
        return [(field, field.indices()) for field in program.unknowns]
    pairs = []
    for field, pick in program._unknowns:
        indices = field.indices()
        if pick is tai_scenes.first_slot:
            indices = [index for index in indices if index[0] == 0]
        pairs.append((field, indices))
    return pairs


def in_digits(scene: str, gradient: np.ndarray) -> tuple:
    """The loss, its derivative along a direction, and that of the gradient."""
    import cases

    program = cases.make(scene, "tai", "tiny")
    loss = program.module.loss if hasattr(program, "module") else program._loss
    forward = program.forward if hasattr(program, "module") else program._forward
    prepare = getattr(program, "_prepare", lambda: None)
    unknowns = unknowns_of(program)
    start = [(field, index, field[index]) for field, indices in unknowns for index in indices]

    def value(step) -> mpmath.mpf:
        place = 0
        for field, index, old in start:
            size = max(1, int(np.prod(field.element)))
            way = [int(w) for w in direction[place : place + size]]
            place += size
            moved = np.array(way, object).reshape(field.element) * step if field.element else (
                way[0] * step
            )  # fmt: skip
            field[index] = old + moved
        assert place == len(gradient), (place, len(gradient))
        prepare()
        loss[None] = 0.0
        forward()
        return loss[None]

    # Small whole numbers are exact in each way of counting.
    direction = np.random.default_rng(0).integers(-3, 4, len(gradient))
    slope = (value(STEP) - value(-STEP)) / (2 * STEP)
    along = mpmath.fsum(mpmath.mpf(float(g)) * int(d) for g, d in zip(gradient, direction))
    size = float(np.linalg.norm(gradient) * np.linalg.norm(direction))
    return value(mpmath.mpf(0)), abs(slope - along) / (size or 1)


def main() -> int:
    sys.modules["tai"] = decimal_tai
    import cases

    usual = [name for name in cases.NAMES if name not in SLOW]
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", default=",".join(usual), help="comma-separated")
    given = parser.parse_args()
    wrong = 0
    for scene in given.scenes.split(","):
        loss, gradient = in_f64(scene)
        exact, apart = in_digits(scene, gradient)
        off = abs(exact - loss) / abs(exact) if exact else abs(loss)
        is_wrong = not (off <= BAR and apart <= BAR)
        wrong += is_wrong
        print(
            f"{scene:16} loss {mpmath.nstr(exact, 30)}: f64 is off by {float(off):.1e}, its "
            f"gradient along a direction by {float(apart):.1e}{'  WRONG' if is_wrong else ''}",
            flush=True,
        )
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
