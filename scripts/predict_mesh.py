"""Predicts how a program on a mesh scales, from the time of one process and the figures of a link.

    python scripts/predict_mesh.py --rows 16384 --row-bytes 131072 --row-seconds 2e-5 \\
        --latency 5e-6 --bandwidth 25e9 --halo 1 --steps 100 --reductions 1

The schedule is that of `tai-shard`: each step exchanges halos with two neighbours and then computes
the rows of the rank; a reduction waits for all ranks. Each rank has a clock of its own, and a rank
waits for those that it hears from. The result is a prediction, and no measurement: it knows no
shared links, no caches, and no other work on the hosts.
"""

from __future__ import annotations

import argparse
import math
from typing import NamedTuple


class Program(NamedTuple):
    """A program of equal steps over sharded rows, in seconds and bytes."""

    rows: int
    row_seconds: float
    row_bytes: float
    halo: int = 1  # rows that each side of a rank fetches in a step
    exchanges: int = 1  # in each step
    steps: int = 100
    reductions: int = 0  # over all ranks, after the steps
    jitter: float = 0.0  # the part of its computing that every second rank takes longer


# Programs of benchmarks/gpu/mesh_gpus.py, forward and backward, with the rows and bytes of a step:
# each exchange has an adjoint of the same size. The bytes of a row are averages over exchanges.
SCENES = {
    # A step of a wave of 16384² points reads one row.
    "wave": {"rows": 16384, "row_bytes": 4 * 16384, "exchanges": 2, "reductions": 1},
    # Smoke of 8192² cells reads 4 rows of 12 bytes, and 12 times one row of 4 or 8 bytes.
    "smoke": {"rows": 8192, "row_bytes": 8192 * 100 / 13, "exchanges": 26, "reductions": 1},
    # 16 Mi particles on 1440 columns exchange 3 rows of 12 and of 8 bytes.
    "mpm": {"rows": 1440, "row_bytes": 1440 * 10, "halo": 3, "exchanges": 4, "reductions": 1},
}


class Link(NamedTuple):
    """A link between two ranks: seconds to the first byte, and bytes in a second."""

    latency: float
    bandwidth: float

    def seconds(self, size: float) -> float:
        """The time of a message."""
        return self.latency + size / self.bandwidth


def predict(program: Program, link: Link, ranks: int) -> float:
    """The seconds that the last of the ranks takes."""
    rows = program.rows / ranks
    clocks = [0.0] * ranks
    busy = [rows * program.row_seconds * (1 + program.jitter * (rank % 2)) for rank in range(ranks)]
    # The halo of a rank with few rows comes from several ranks, one after the other.
    hops = math.ceil(program.halo / rows)
    message = hops * link.seconds(min(program.halo, rows) * program.row_bytes)
    for _ in range(program.steps):
        for _ in range(program.exchanges if ranks > 1 else 0):
            clocks = [
                max(clocks[max(r - 1, 0)], clocks[r], clocks[min(r + 1, ranks - 1)]) + message
                for r in range(ranks)
            ]
        clocks = [clock + work for clock, work in zip(clocks, busy, strict=True)]
    # A sum goes up and down a tree.
    tree = 2 * math.ceil(math.log2(ranks)) * link.seconds(8) if ranks > 1 else 0.0
    return max(clocks) + program.reductions * tree


def table(program: Program, link: Link, most: int) -> list[tuple[int, float, float, float]]:
    """Ranks, seconds, and the efficiencies of strong and of weak scaling, for powers of two."""
    one = predict(program, link, 1)
    found = []
    for ranks in (2**k for k in range(int(math.log2(most)) + 1)):
        if ranks > program.rows:
            break
        strong = predict(program, link, ranks)
        weak = predict(program._replace(rows=program.rows * ranks), link, ranks)
        found.append((ranks, strong, one / (ranks * strong), one / weak))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--scene", choices=SCENES, help="a scene, in place of rows, bytes and exchanges")
    add("--rows", type=int, help="rows along the sharded axis")
    add("--row-seconds", type=float, required=True, help="of one process, for a row in a step")
    add("--row-bytes", type=float, help="bytes of a row that a halo carries")
    add("--latency", type=float, required=True, help="seconds until a message arrives")
    add("--bandwidth", type=float, required=True, help="bytes in a second")
    add("--halo", type=int, default=1, help="rows that a step reads on each side (1)")
    add("--exchanges", type=int, default=1, help="exchanges in a step (1)")
    add("--steps", type=int, default=100, help="steps (100)")
    add("--reductions", type=int, default=0, help="sums over all ranks, after the steps (0)")
    add("--jitter", type=float, default=0.0, help="the part by which every second rank is slower")
    add("--ranks", type=int, default=1024, help="the largest number of ranks (1024)")
    given = vars(parser.parse_args())
    given.update(SCENES.get(given.pop("scene"), {}))
    if given["rows"] is None or given["row_bytes"] is None:
        parser.error("a scene, or rows and bytes, are needed")
    link = Link(given.pop("latency"), given.pop("bandwidth"))
    most = given.pop("ranks")
    print("a prediction, not a measurement")
    print(f"{'ranks':>6} {'seconds':>10} {'strong':>7} {'weak':>7}")
    for ranks, seconds, strong, weak in table(Program(**given), link, most):
        print(f"{ranks:6} {seconds:10.4g} {strong:7.1%} {weak:7.1%}")


if __name__ == "__main__":
    main()
