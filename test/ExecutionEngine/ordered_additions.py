"""The PTX of ordered-additions.mlir against a model of the order of its additions."""

import pathlib
import random
import re
import struct
import sys

import ptx_warp

COUNT, CELLS, LANES = 70, 8, 32


def round_to(value, code):
    return struct.unpack(code, struct.pack(code, value))[0]


def add_in_order(values, code):
    """Neighbours first, then their sums, and so on."""
    values = list(values)
    distance = 1
    while distance < len(values):
        values = [
            round_to(v + values[i + distance], code) if i + distance < len(values) else v
            for i, v in enumerate(values)
        ]
        distance *= 2
    return values[0]


def add_together(field, pairs, code):
    """The lanes of a warp add at the same place: (index, value), or None."""
    for index in {p[0] for p in pairs if p}:
        total = add_in_order([p[1] for p in pairs if p and p[0] == index], code)
        field[index] = round_to(field[index] + total, code)


def model(at, v, w, a, b, d):
    for first in range(0, COUNT, LANES):
        lanes = range(first, min(first + LANES, COUNT))
        add_together(a, [(at[i], v[i]) for i in lanes], "f")
        add_together(b, [(at[i], -v[i]) for i in lanes], "f")
        add_together(d, [(at[i], w[i]) if v[i] > 0 else None for i in lanes], "d")
        add_together(a, [(7 - at[i], v[i]) if v[i] <= 0 else None for i in lanes], "f")
        for k in range(3):
            add_together(b, [(k, v[i]) for i in lanes], "f")
    for i in range(COUNT):
        at[i] = 100000000
        v[i] = round_to(2 * v[i], "f") if v[i] > 0 else v[i]


def model_of_turns(at, v, w, a, b, d):
    """One iteration after another."""
    for i in range(COUNT):
        a[at[i]] = round_to(a[at[i]] + v[i], "f")
        b[at[i]] = round_to(b[at[i]] - v[i], "f")
        if v[i] > 0:
            d[at[i]] += w[i]


def check_that_errors_show(text, name, data):
    """Without barriers, lanes touch what others have not finished with."""
    kernel = ptx_warp.Kernel(re.sub(r"\tbar\.warp\.sync.*", "", text), name)
    try:
        ptx_warp.run(kernel, data, [0, 16 * COUNT], 1, 32, 0)
    except SystemExit as error:
        if "two lanes" in str(error):
            return
    sys.exit("nobody misses the barriers")


def main():
    text = pathlib.Path(sys.argv[1]).read_text()
    compare(text, "scatter_0", model)
    compare(text, "turns_0", model_of_turns)


def compare(text, name, model):
    kernel = ptx_warp.Kernel(text, name)
    values = random.Random(1)
    for spread in (1, CELLS):
        at = [values.randrange(spread) for _ in range(COUNT)]
        v = [round_to(values.uniform(-1, 1), "f") for _ in range(COUNT)]
        w = [values.uniform(-1, 1) for _ in range(COUNT)]
        a, b, d = ([round_to(values.random(), "f") for _ in range(CELLS)] for _ in range(3))

        def pack(at=at, v=v, w=w, a=a, b=b, d=d):
            data = b"".join(struct.pack("<ifd", *cell) for cell in zip(at, v, w, strict=True))
            return data + b"".join(struct.pack("<ffd", *cell) for cell in zip(a, b, d, strict=True))

        before = pack()
        check_that_errors_show(text, name, before)
        model(at, v, w, a, b, d)
        for seed, (blocks, threads) in enumerate([(1, 32), (3, 64)]):
            after = ptx_warp.run(kernel, before, [0, 16 * COUNT], blocks, threads, seed)
            if after != pack():
                sys.exit(
                    f"{name}: {blocks} blocks of {threads} threads give other bits than the model"
                )


main()
