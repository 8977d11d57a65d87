"""Sparse layouts against dense ones and against Taichi, on this machine, in one run.

    .venv/bin/python benchmarks/sparse/run.py [--rounds 2]

Each measurement has a process of its own, and the rounds go through all of them in turn; the
least time of all rounds counts, because it is affected least by other load. Writes sparse.csv
into build/bench and prints a table. Taichi is timed if benchmarks/setup_peers.py installed it.
"""

from __future__ import annotations

import argparse
import csv
import json
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(HERE.parent))

from setup_peers import peers_python  # noqa: E402

SHARES = [0.001, 0.01, 0.03, 0.1, 0.3, 1.0]
LAYOUTS = ["bitmasked", "pointer", "pointer2", "pointer-aos", "pointer-apart"]
TIMEOUT = 300


def measure(python: str, system: str, program: str, layout: str, size: float) -> dict | None:
    command = [python, str(HERE / "measure.py"), system, program, layout, str(size)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT, cwd=ROOT)
    except subprocess.TimeoutExpired:
        return None
    lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
    if done.returncode != 0 or not lines:
        print(f"failed: {' '.join(command[2:])}\n{done.stderr[-500:]}", file=sys.stderr)
        return None
    return json.loads(lines[-1])


def jobs(with_taichi: bool) -> list[tuple]:
    shares = [0.01, 0.1, 1.0]
    result = [("tai", "stencil", "dense", 1.0), ("tai", "adjoint", "dense", 1.0)]
    for layout in LAYOUTS:
        more = SHARES if layout in ("pointer", "bitmasked") else shares
        result += [("tai", "stencil", layout, share) for share in more]
    result += [("tai", "adjoint", "pointer", share) for share in SHARES]
    result += [("tai", "bodies", "pointer", bodies) for bodies in (1, 10)]
    result += [("tai", "band", "pointer", 512)]
    if with_taichi:
        result += [("taichi", "stencil", "dense", 1.0)]
        for layout in ("bitmasked", "pointer"):
            result += [("taichi", "stencil", layout, share) for share in shares]
    return result


def straightness(points: list[tuple[int, float]]) -> tuple[float, float]:
    """Nanoseconds a cell of the line through the origin, and the largest excess over it.

    The excess, in microseconds, is the cost of a launch without active cells.
    """
    slope = sum(c * ms for c, ms in points) / sum(c * c for c, _ in points)
    return 1e6 * slope, 1e3 * max(ms - slope * cells for cells, ms in points)


def report(best: dict[tuple, dict]) -> None:
    def ms(*key) -> float:
        return best[key]["ms"] if key in best else float("nan")

    dense = ms("tai", "stencil", "dense", 1.0)
    print(f"five-point stencil, 2048², blocks of 8×8; dense takes {dense:.3f} ms")
    print(f"{'layout':15}{'active':>8}{'ms':>10}{'of dense':>10}{'taichi':>10}{'ratio':>8}")
    for key in sorted(k for k in best if k[:2] == ("tai", "stencil") and k[2] != "dense"):
        time, other = ms(*key), ms("taichi", *key[1:])
        print(
            f"{key[2]:15}{key[3]:8.1%}{time:10.4f}{time / dense:10.4f}{other:10.3f}"
            f"{other / time:8.1f}"
        )
    for program, layout in (
        ("stencil", "bitmasked"),
        ("stencil", "pointer"),
        ("adjoint", "pointer"),
    ):
        points = [
            (best[k]["cells"], best[k]["ms"]) for k in best if k[:3] == ("tai", program, layout)
        ]
        if len(points) > 2:
            slope, excess = straightness(points)
            print(
                f"{program} on {layout}: {slope:.3f} ns a cell, at most {excess:.1f} us more "
                "than that line through the origin"
            )
    one, ten = ms("tai", "bodies", "pointer", 1), ms("tai", "bodies", "pointer", 10)
    print(f"reverse of a loss on one body of ten: {one / ten:.3f} of that on all ({ten:.3f} ms)")
    band = best.get(("tai", "band", "pointer", 512))
    if band:
        print(
            f"narrow band in 512³: {band['cells']} cells in active blocks, {band['bytes'] >> 20} "
            f"MiB resident, {band['bytes'] / band['cells']:.1f} bytes a cell, "
            f"{band['ms']:.2f} ms a loop"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--peers-venv", type=Path, default=ROOT / "build" / "peers-venv")
    options = parser.parse_args()
    peers = peers_python(options.peers_venv)
    with_taichi = peers.exists()
    best: dict[tuple, dict] = {}
    for _ in range(options.rounds):
        for job in jobs(with_taichi):
            record = measure(str(peers) if job[0] == "taichi" else sys.executable, *job)
            if record and (job not in best or record["ms"] < best[job]["ms"]):
                best[job] = record
    out = ROOT / "build" / "bench"
    out.mkdir(parents=True, exist_ok=True)
    with (out / "sparse.csv").open("w", newline="") as file:
        writer = csv.DictWriter(
            file, ["system", "program", "layout", "size", "cells", "bytes", "ms"], restval=""
        )
        writer.writeheader()
        writer.writerows(best.values())
    report(best)
    if any(job[0] == "tai" and job not in best for job in jobs(False)):
        sys.exit("some program of tai failed")


if __name__ == "__main__":
    main()
