"""The PTX of fixed-point.mlir against a model that adds up integers of any size."""

import math
import pathlib
import random
import struct
import sys
from fractions import Fraction

import ptx_warp

COUNT, CELLS = 150, 8
INF, NAN = math.inf, math.nan


def to_single(value):
    try:
        return struct.unpack("f", struct.pack("f", value))[0]
    except OverflowError:
        return math.copysign(INF, value)


def model(start, values, window, least, finish):
    """An element that starts with `start`, to which values are added; `least` is the exponent of
    subnormal numbers."""
    values = [v for v in values if v != 0]
    if not values:
        return start
    if not all(map(math.isfinite, values)):
        return start + sum(v for v in values if not math.isfinite(v))
    top = max(max(math.frexp(v)[1] for v in values), least)
    unit = Fraction(2) ** (top - window)
    units = 0
    for v in values:
        whole = abs(Fraction(v)) / unit
        rounded = math.floor(whole + Fraction(1, 2))
        units += rounded if v > 0 else -rounded
    return finish(start, units * unit) if units else start


def finish_single(start, total):
    return to_single(start + float(total))


def finish_double(start, total):
    return start + float(total)


def pack(at, v, w, a, d):
    data = b"".join(struct.pack("<ifd", *cell) for cell in zip(at, v, w, strict=True))
    return data + b"".join(struct.pack("<ffd", x, 0.0, y) for x, y in zip(a, d, strict=True))


def draw(numbers, code):
    value = numbers.uniform(-1, 1) * 10.0 ** numbers.randrange(-9, 9)
    return to_single(value) if code == "f" else value


def same(x, y):
    return struct.pack("d", x) == struct.pack("d", y) or (x != x and y != y)


def check(text, name, spread, special, seed):
    numbers = random.Random(seed)
    at = [numbers.randrange(spread) for _ in range(COUNT)]
    v, w = ([draw(numbers, code) for _ in range(COUNT)] for code in "fd")
    a, d = ([draw(numbers, code) for _ in range(CELLS)] for code in "fd")
    # Zeros, subnormal numbers, infinities and NaN.
    for i, value in enumerate([0.0, -0.0, 1e-45, -3e-39, *special]):
        v[5 * i] = to_single(value)
        w[5 * i] = value * 1e-280 if abs(value) < 1 else value
    data = pack(at, v, w, a, d)
    scratch = len(data)
    sums = 8 * CELLS * (2 if name == "double" else 1)
    memory = data + bytes(sums + 4 * CELLS)
    for part, shape in enumerate([(2, 64), (3, 32), (1, 32)]):
        kernel = ptx_warp.Kernel(text, f"{name}_{part}")
        first = 0 if part < 2 else 16 * COUNT + (8 if name == "double" else 0)
        params = [first, scratch + sums, scratch][: 2 if part == 0 else 3]
        memory = ptx_warp.run(kernel, memory, params, *shape, seed)
    for j in range(CELLS):
        mine = [i for i in range(COUNT) if at[i] == j]
        x, _, y = struct.unpack_from("<ffd", memory, 16 * COUNT + 16 * j)
        if name == "single":
            found, expected = x, model(a[j], [v[i] for i in mine], 30, -125, finish_single)
        else:
            found, expected = y, model(d[j], [-w[i] for i in mine], 60, -1021, finish_double)
        if not same(found, expected):
            sys.exit(f"{name}, element {j} of {spread}: {found} instead of {expected}")
    if any(memory[scratch + sums :]):
        sys.exit(f"{name}: a sum was not added")


def main():
    text = pathlib.Path(sys.argv[1]).read_text()
    for name in ("single", "double"):
        for seed, special in enumerate([[], [1e30], [INF], [INF, -INF], [NAN, -INF], [-INF]]):
            for spread in (1, 2, CELLS):
                check(text, name, spread, special, seed)


if __name__ == "__main__":
    main()
