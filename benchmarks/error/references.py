"""Reference results of a scene: loss and gradient at its inputs, and at inputs an ulp away.

    .venv/bin/python benchmarks/error/references.py --scene wave --size quick --out /tmp/wave

Kernels are computed in NumPy, with 80-bit floats and sums that are rounded once. Scenes run in f64
with shadows of 80 bits (docs/guides/shadow.md); four of them are compared with adjoints that are
written by hand in NumPy, in 80 bits, too, and share nothing with tai. Writes a file for each input
and `about.json`: the error of the reference, and how that was found.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import numpy as np

import modes

INPUTS = 16
# f64, whose shadows are 80-bit floats.
SHADOWS = modes.Mode("shadows", 64, {"default_fp": "f64", "deterministic": True, "shadow": True})
# An f80 has 11 bits more than an f64, and rounding errors that are so much smaller.
MORE_BITS = 2.0**-11
ROUNDED = 2.0**-53


def perturbed(base: np.ndarray, number: int) -> np.ndarray:
    """Inputs whose numbers are each an ulp of f32 off, up or down; those of number 0 are not."""
    if number == 0:
        return base
    signs = np.random.default_rng(number).choice(np.array([-1.0, 1.0]), base.shape)
    ulps = np.spacing(np.abs(base).astype(np.float32)).astype(np.float64)
    return base + np.where(base == 0, 0.0, signs * ulps)


def relative(found: np.ndarray, expected: np.ndarray) -> float:
    """Relative distance (L2); infinite where something is not finite."""
    if found.shape != expected.shape or not np.all(np.isfinite(found)):
        return float("inf")
    size = np.linalg.norm(expected)
    return float(np.linalg.norm(found - expected) / (size or 1))


def distance(found: tuple, expected: tuple) -> float:
    """The error of loss or gradient, whichever is greater."""
    pairs = zip(found, expected, strict=True)
    return max(relative(np.atleast_1d(a), np.atleast_1d(b)) for a, b in pairs)


class Reference:
    """The files that `make` has written."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.base = np.load(folder / "inputs.npy")
        self.numbers = sorted(int(path.stem) for path in folder.glob("[0-9]*.npz"))

    def load(self, number: int) -> dict:
        with np.load(self.folder / f"{number}.npz") as file:
            return dict(file)

    def about(self) -> dict:
        return json.loads((self.folder / "about.json").read_text())

    def condition(self) -> float:
        """The greatest change of loss or gradient, in parts of that of the inputs (L2)."""
        first = self.load(0)
        found = 0.0
        for number in self.numbers[1:]:
            moved = relative(perturbed(self.base, number), self.base)
            there = self.load(number)
            pairs = [(there[key], first[key]) for key in ("loss", "gradient")]
            found = max(found, *(relative(np.atleast_1d(a), np.atleast_1d(b)) / moved
                                 for a, b in pairs))  # fmt: skip
        return found


def of_kernel(name: str, size: str, numbers: list[int], out: Path) -> dict:
    """A kernel, in NumPy."""
    import micro

    data = micro.data_of(name, size)
    base = next(iter(data.inputs.values())).ravel()
    np.save(out / "inputs.npy", base)
    about = {}
    for number in numbers:
        there = data.at(perturbed(base, number))
        exact = there.exact()
        save(out, number, exact)
        if number == 0:
            micro.real = np.float64
            less = there.exact()
            micro.real = np.longdouble
            apart = distance(*((e["loss"], e["gradient"]) for e in (less, exact)))
            how = f"NumPy in 80 bits, {apart:.1e} from NumPy in f64"
            about = {"error": max(apart * MORE_BITS, ROUNDED), "how": how}
    return about


def of_scene(name: str, size: str, numbers: list[int], out: Path, how: str, cache: Path) -> dict:
    """A scene, by shadows; or plainly in f64, to compare builds of which one has no shadows."""
    import measure

    mode = SHADOWS if how == "shadows" else modes.find(modes.OURS, modes.REFERENCE)
    measure.start(modes.OURS, mode, "cpu", 1, cache)
    import tai as ti

    import cases

    program = cases.make(name, modes.OURS, size)
    base = np.asarray(program.inputs(), np.float64)
    np.save(out / "inputs.npy", base)
    about = {"error": None, "how": "tai in f64, deterministic"}
    for number in numbers:
        program.assign(perturbed(base, number))
        program.run()
        plain = program.loss(), np.asarray(program.gradient(), np.float64)
        found = plain
        if how == "shadows":
            loss, unknowns = measure.fields_of(program)
            parts = [pick(ti.tools.shadow_values(u.grad)).ravel() for u, pick in unknowns]
            found = ti.tools.shadow_values(loss)[()], np.concatenate(parts)
        save(out, number, {"loss": found[0], "gradient": found[1]})
        if number == 0 and how == "shadows":
            apart = distance(plain, found)
            own = max(apart * MORE_BITS, ROUNDED)
            about = {"error": own, "how": f"shadows of 80 bits, {apart:.1e} from f64"}
            if name in cases.SHARED:
                other = cases.wide(cases.problem_of(name, size)).reference()
                between = distance(found, other)
                how = f"shadows of 80 bits, {between:.1e} from NumPy in 80 bits"
                about = {"error": max(between, ROUNDED), "how": how}
    return about


def save(out: Path, number: int, found: dict) -> None:
    arrays = {key: np.asarray(value, np.float64) for key, value in found.items()}
    np.savez(out / f"{number}.npz", **arrays)


def main() -> int:
    import cases

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", required=True, choices=cases.NAMES)
    parser.add_argument("--size", default="quick", choices=cases.SIZES)
    parser.add_argument("--out", type=Path, required=True, help="a folder")
    parser.add_argument("--first", type=int, default=0, help="of the inputs; 0: as they are")
    parser.add_argument("--count", type=int, default=INPUTS + 1, help="of inputs")
    # Without shadows, to compare builds; with tai in f64 for kernels, too, to check that.
    parser.add_argument("--how", default="shadows", choices=["shadows", "f64", "tai"])
    parser.add_argument("--cache", type=Path, default=Path("/tmp"))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    numbers = list(range(given.first, given.first + given.count))
    if given.scene in cases.micro.NAMES and given.how != "tai":
        about = of_kernel(given.scene, given.size, numbers, given.out)
    else:
        about = of_scene(given.scene, given.size, numbers, given.out, given.how, given.cache)
    if given.first == 0:
        (given.out / "about.json").write_text(json.dumps(about) + "\n")
        print(json.dumps(about))
    return 0


if __name__ == "__main__":
    sys.exit(main())
