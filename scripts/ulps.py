"""The largest errors of elementary functions, in units in the last place, by mode.

python scripts/ulps.py           prints them
python scripts/ulps.py --fix     writes them to the table of docs/guides/precision.md

Arguments are sampled uniformly over the exponents of the type; the reference is mpmath at 100
digits. A figure is the largest error observed, not a bound.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import mpmath
import numpy as np
import tai as ti

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs/guides/precision.md"
BEGIN, END = "<!-- ulps: begin (scripts/ulps.py --fix) -->\n", "<!-- ulps: end -->\n"
MODES = ("default", "accurate", "strict", "fast")
TYPES = {"f32": (ti.f32, np.float32, 24, 200), "f64": (ti.f64, np.float64, 53, 12)}

# The function, mpmath's, and what arguments make sense: the greatest size, and whether they are
# positive.
FUNCTIONS = {
    "exp": (mpmath.exp, 700, False),
    "log": (mpmath.log, None, True),
    "sin": (mpmath.sin, 1e9, False),
    "cos": (mpmath.cos, 1e9, False),
    "tan": (mpmath.tan, 1e9, False),
    "asin": (mpmath.asin, 1, False),
    "acos": (mpmath.acos, 1, False),
    "tanh": (mpmath.tanh, None, False),
    "expm1": (mpmath.expm1, 700, False),
    "log1p": (mpmath.log1p, None, True),
    "sqrt": (mpmath.sqrt, None, True),
    "rsqrt": (lambda x: 1 / mpmath.sqrt(x), None, True),
    "pow": (mpmath.power, None, True),
    "atan2": (mpmath.atan2, None, False),
}


def arguments(name: str, npt: type, per_exponent: int, rng: np.random.Generator) -> np.ndarray:
    """Numbers of every exponent for which the function is defined."""
    _, most, is_positive = FUNCTIONS[name]
    info = np.finfo(npt)
    low, high = info.minexp, info.maxexp - 1
    if most == 700:
        most = float(np.log(info.max)) - 1
    exponents = np.repeat(np.arange(low, high), per_exponent)
    x = np.ldexp(rng.uniform(1, 2, len(exponents)), exponents).astype(npt)
    if not is_positive:
        x *= rng.choice(np.array([-1, 1], npt), len(x))
    if most is not None:
        x = x[np.abs(x) <= most]
    # Most of them are tiny: as many from where something happens.
    near = rng.uniform(0.01, min(most or 100, 100), len(x)).astype(npt)
    return np.concatenate([x, near if is_positive else near * rng.choice([-1, 1], len(x))]).astype(
        npt
    )


def compute(name: str, mode: str, dt: ti.types.DataType, x: np.ndarray, y: np.ndarray | None):
    """The results of a kernel for the numbers."""
    ti.init(arch=ti.cpu, math=mode, default_fp=dt)
    n = len(x)
    a, b, c = (ti.field(dt, shape=n) for _ in range(3))
    function = {"pow": ti.pow, "atan2": ti.atan2}.get(name) or getattr(ti, name, None)
    function = function or getattr(ti.math, name)

    @ti.kernel
    def unary():
        for i in a:
            c[i] = function(a[i])

    @ti.kernel
    def binary():
        for i in a:
            c[i] = function(a[i], b[i])

    a.from_numpy(x)
    if y is None:
        unary()
    else:
        b.from_numpy(y)
        binary()
    return c.to_numpy()


def worst(name: str, kind: str) -> dict[str, float]:
    """The largest error of a function in each mode."""
    dt, npt, digits, per_exponent = TYPES[kind]
    rng = np.random.default_rng(0)
    x = arguments(name, npt, per_exponent, rng)
    y = None
    if name == "atan2":
        y = rng.permutation(x)
    elif name == "pow":
        # So that the result is of any size, and finite.
        size = np.log(float(np.finfo(npt).max)) - 1
        with np.errstate(divide="ignore"):
            y = (rng.uniform(-1, 1, len(x)) * size / np.log(x.astype(np.float64))).astype(npt)
        keep = np.isfinite(y) & (np.abs(y) < 1e6)
        x, y = x[keep], y[keep]
    pairs = zip(x.tolist(), (y if y is not None else x).tolist(), strict=True)
    function = FUNCTIONS[name][0]
    exact = [function(a) if y is None else function(a, b) for a, b in pairs]
    tiny, most = mpmath.mpf(float(np.finfo(npt).tiny)), mpmath.mpf(float(np.finfo(npt).max))
    found = {}
    for mode in MODES:
        got = compute(name, mode, dt, x, y)
        largest = mpmath.mpf(0)
        for value, right in zip(got.tolist(), exact, strict=True):
            if not tiny <= abs(right) <= most:
                continue
            ulp = mpmath.ldexp(1, int(mpmath.frexp(right)[1]) - digits)
            largest = max(largest, abs(mpmath.mpf(value) - right) / ulp)
        found[mode] = float(largest)
    return found


def table(names: list[str]) -> str:
    heads = [f"{kind} {mode}" for kind in TYPES for mode in MODES]
    lines = ["| function | " + " | ".join(heads) + " |", "|---" * (1 + len(heads)) + "|"]
    for name in names:
        figures: list[str] = []
        for kind in TYPES:
            found = worst(name, kind)
            figures += [f"{found[mode]:.3g}" for mode in MODES]
        lines.append(f"| `{name}` | " + " | ".join(figures) + " |")
        print(lines[-1], flush=True)
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--fix", action="store_true", help=f"write the table to {PAGE.relative_to(ROOT)}"
    )
    parser.add_argument("names", nargs="*", help="functions; all if left out")
    given = parser.parse_args()
    mpmath.mp.dps = 100
    made = table(given.names or list(FUNCTIONS))
    if given.fix:
        head, rest = PAGE.read_text().split(BEGIN)
        PAGE.write_text(head + BEGIN + made + END + rest.split(END)[1])


if __name__ == "__main__":
    main()
