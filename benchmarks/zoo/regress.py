"""Compare two builds of tai on the programs of the zoo and on the forms that users write.

    .venv/bin/python benchmarks/zoo/regress.py BASE [--only cloth form:rope] [--threads 1,2]

BASE is a built checkout of another commit, to which this checkout is compared. Both run the sources
of this checkout, each measurement in a process of its own and in turns, so that a machine that
gets slower slows both. A zoo program counts an iteration, which records, runs backward and clears,
and a form its kernel and its adjoint (benchmarks/micro/forms.py). The result is the least of all
runs: processor time on one thread, the clock on more. Prints the worst rows first. Exits with 1 if
a ratio is above --bar in all rounds, a program that fails included.
"""

from __future__ import annotations

import argparse
import csv
import importlib
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
NOT_PROGRAMS = {"first_iterations", "regress"}
PROGRAMS = sorted({path.stem for path in HERE.glob("*.py")} - NOT_PROGRAMS)
FORM = "form:"
WARM_UPS = 4


def load_forms():
    sys.path.insert(0, str(HERE.parent / "micro"))
    return importlib.import_module("forms")


def measure(row: str, threads: int, seconds: float, cache: str) -> None:
    """Prints the least milliseconds of each part of a row as one line of JSON."""
    import tai as ti

    if row.startswith(FORM):
        forward, adjoint, _, _ = load_forms().measure(row.removeprefix(FORM), threads)
        print(json.dumps({"forward": forward / 1e3, "adjoint": adjoint / 1e3}))
        return
    ti.init(
        arch=ti.cpu,
        cpu_max_num_threads=threads,
        offline_cache_file_path=cache,
        log_level=ti.ERROR,
    )
    iterate = importlib.import_module(row).make()[0]
    clock = time.thread_time if threads == 1 else time.perf_counter
    for _ in range(WARM_UPS):
        iterate()
    times = []
    end = time.perf_counter() + seconds
    while time.perf_counter() < end or len(times) < 5:
        begin = clock()
        iterate()
        times.append(clock() - begin)
    print(json.dumps({"iteration": 1e3 * min(times)}))


def run_side(tree: Path, row: str, threads: int, options, cache: Path) -> dict[str, float] | None:
    """The milliseconds of one process; none if it fails."""
    command = [sys.executable, __file__, "--measure", row, "--threads", str(threads)]
    done = subprocess.run(
        [*command, "--seconds", str(options.seconds), "--cache", str(cache)],
        capture_output=True,
        text=True,
        env=dict(os.environ, PYTHONPATH=str(tree / "python")),
        cwd=HERE,
        check=False,
    )
    if done.returncode:
        print(f"{row} on {tree} failed:\n{done.stderr[-1000:]}", file=sys.stderr)
        return None
    return json.loads(done.stdout.splitlines()[-1])


def revision(tree: Path) -> str:
    command = ["git", "-C", str(tree), "describe", "--always", "--dirty", "--exclude=*"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.stdout.strip() or tree.name


def compare(
    base: list[dict | None], new: list[dict | None]
) -> list[tuple[str, float, float, float]]:
    """For each part of a row: the least of both sides, and the least ratio of a round."""
    if None in base:
        return []
    if None in new:
        return [("failed", 0.0, float("inf"), float("inf"))]
    return [
        (
            part,
            min(round_[part] for round_ in base),
            min(round_[part] for round_ in new),
            min(after[part] / before[part] for before, after in zip(base, new, strict=True)),
        )
        for part in base[0]
    ]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("base", type=Path, nargs="?", help="a built checkout to compare with")
    parser.add_argument("--only", nargs="*", help="programs, and form:NAME for a form")
    parser.add_argument("--threads", default="1,2", help="numbers of threads")
    parser.add_argument("--rounds", type=int, default=3, help="processes per side and row")
    parser.add_argument("--seconds", type=float, default=1.0, help="of a program in a process")
    parser.add_argument("--bar", type=float, default=1.05, help="highest ratio that passes")
    parser.add_argument("--out", type=Path, help="a CSV file to write")
    parser.add_argument("--measure", metavar="ROW", help=argparse.SUPPRESS)
    parser.add_argument("--cache", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        measure(options.measure, int(options.threads), options.seconds, options.cache)
        return 0
    if not options.base:
        parser.error("name a built checkout to compare with")
    sides = {"base": options.base.resolve(), "new": ROOT}
    names = {side: revision(tree) for side, tree in sides.items()}
    print(f"# base {names['base']}, new {names['new']}: least milliseconds", flush=True)
    wanted = options.only or PROGRAMS + [FORM + name for name in load_forms().ROWS]
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for row in wanted:
            for threads in map(int, options.threads.split(",")):
                found: dict[str, list[dict | None]] = {side: [] for side in sides}
                for turn in range(options.rounds):
                    for side in sorted(sides, reverse=turn % 2 == 1):
                        cache = Path(folder) / side / row.replace(":", "-")
                        found[side].append(run_side(sides[side], row, threads, options, cache))
                rows += [(row, threads, *part) for part in compare(found["base"], found["new"])]
                print(".", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    rows.sort(key=lambda entry: -entry[-1])
    for row, threads, part, base, new, ratio in rows:
        print(f"{row:24} {threads:2} {part:10} {base:10.4f} {new:10.4f} {ratio:7.3f}")
    if options.out:
        with options.out.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(["row", "threads", "part", names["base"], names["new"], "ratio"])
            writer.writerows(rows)
    return 1 if any(entry[-1] > options.bar for entry in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
