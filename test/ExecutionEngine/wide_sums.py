"""The PTX of wide-sums.mlir against exact sums."""

import math
import pathlib
import random
import struct
import sys
from fractions import Fraction

import ptx_warp
from fixed_point import CELLS, COUNT, INF, NAN, draw, pack, same, to_single


def expected_of(start, values):
    """The exact sum, and how far the result may be from it."""
    everything = [start, *values]
    if all(map(math.isfinite, everything)):
        return sum(map(Fraction, everything)), sum(abs(Fraction(v)) for v in everything)
    return sum(v for v in everything if not math.isfinite(v)), None


def check(text, name, spread, special, seed):
    numbers = random.Random(seed)
    at = [numbers.randrange(spread) for _ in range(COUNT)]
    v, w = ([draw(numbers, code) for _ in range(COUNT)] for code in "fd")
    a, d = ([draw(numbers, code) for _ in range(CELLS)] for code in "fd")
    # Most large numbers have a partner of the other sign.
    for numbers_of in (v, w):
        for i in range(0, COUNT // 2, 2):
            numbers_of[COUNT - 1 - i] = -numbers_of[i]
            at[COUNT - 1 - i] = at[i]
    for i, value in enumerate([0.0, -0.0, 1e-45, -3e-39, *special]):
        v[5 * i] = to_single(value)
        w[5 * i] = value
    data = pack(at, v, w, a, d)
    is_double = name == "double"
    scratch, parts = len(data), 2 if is_double else 1
    memory = data + bytes(8 * CELLS * parts)
    element = 16 * COUNT + (8 if is_double else 0)
    for part, shape in enumerate([(2, 96), (1, 32)]):
        kernel = ptx_warp.Kernel(text, f"{name}_{part}")
        params = [0, scratch] if part == 0 else [element, scratch]
        memory = ptx_warp.run(kernel, memory, params, *shape, seed)
    unit, kept = (2.0**-53, 2.0**-98) if is_double else (2.0**-24, 2.0**-48)
    for j in range(CELLS):
        mine = [i for i in range(COUNT) if at[i] == j]
        x, _, y = struct.unpack_from("<ffd", memory, 16 * COUNT + 16 * j)
        found, start = (y, d[j]) if is_double else (x, a[j])
        exact, size = expected_of(start, [-w[i] if is_double else v[i] for i in mine])
        if size is None:
            right = same(found, exact)
        else:
            slack = abs(exact) * Fraction(unit) * 2 + size * Fraction(kept) + Fraction(1e-45)
            right = math.isfinite(found) and abs(Fraction(found) - exact) <= slack
        if not right:
            sys.exit(f"{name}, element {j} of {spread}: {found} instead of {float(exact)}")
    if any(memory[scratch:]):
        sys.exit(f"{name}: a sum was not taken")


def main():
    text = pathlib.Path(sys.argv[1]).read_text()
    for name in ("single", "double"):
        for seed, special in enumerate([[], [1e30], [INF], [INF, -INF], [NAN, -INF], [-INF]]):
            for spread in (1, 2, CELLS):
                check(text, name, spread, special, seed)


if __name__ == "__main__":
    main()
