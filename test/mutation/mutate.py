"""A mutation run: small changes of the code, each of which a test has to notice.

    mutate.py python --count 300 --seed 1        # of python/tai, after make coverage
    mutate.py prepare; ninja -C build-mutants/build; mutate.py reach
    mutate.py cpp --count 300 --seed 1           # of lib/AD and lib/Analysis
    mutate.py table                              # the results, into docs/reliability.md

Python: a copy of the package is changed, one mutant at a time, and the tests that run the line
are run; `make coverage` says which these are. C++: `prepare` writes a copy of the tree whose
sources hold all mutants, which an environment variable switches on; `reach` runs each test once,
to see which mutants it reaches. It needs libclang (pip install libclang==18.1.1).

The sample is drawn by the seed from all mutants of a part. A mutant that no test runs counts as
alive. survivors.csv says of survivors that the tests cannot notice why not: these are the same
program, or are slower alone.
"""

from __future__ import annotations

import argparse
import csv
import datetime
import json
import os
import random
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
FOLDER = Path(__file__).resolve().parent
sys.path.insert(0, str(ROOT / "test/reliability"))

TABLE = ROOT / "benchmarks/results/mutants.csv"
COLUMNS = ["part", "mutants", "sample", "killed", "explained", "survived", "not_run", "seed",
           "date", "machine", "commit"]  # fmt: skip
SURVIVORS = FOLDER / "survivors.csv"
COPY = ROOT / "build-mutants"
# The programs of the paper are experiments, which their pages check.
LEFT_OUT = ("paper/",)
ROOMS = ("AD", "Analysis")


def read_rows(path: Path) -> dict[str, dict[str, Any]]:
    if not path.exists():
        return {}
    return {row["name"]: row for row in map(json.loads, path.read_text().splitlines())}


def note(path: Path, row: dict[str, Any]) -> None:
    with path.open("a") as file:
        file.write(json.dumps(row) + "\n")
    print(f"{row['outcome']}: {row['name']}", flush=True)


def run_python(args: argparse.Namespace) -> None:
    import python_mutants

    root = args.root.resolve()
    found = [one for one in python_mutants.mutants(root / "python/tai")
             if not one.file.startswith(LEFT_OUT)]  # fmt: skip
    sample = random.Random(args.seed).sample(found, min(args.count, len(found)))
    known = read_rows(args.out)
    log = args.log.read_text() if args.log else ""
    data = args.data or root / "build/coverage/data"
    tests = python_mutants.Tests(data, root, python_mutants.read_seconds(log))
    package = (args.work or root / "build/mutants/python").resolve() / "tai"
    shutil.rmtree(package, ignore_errors=True)
    shutil.copytree(root / "python/tai", package, ignore=shutil.ignore_patterns("__pycache__"))
    # The module finds the library from its own place.
    link = package.parent.parent / "build"
    if not link.exists():
        link.symlink_to(root / "build", target_is_directory=True)
    for mutant in sample[args.part :: args.parts]:
        if mutant.name not in known:
            row = python_mutants.judge(mutant, tests, package, root / "build", args.budget)
            note(args.out, row | {"part": "python/tai", "all": len(found), "seed": args.seed})


def prepare(args: argparse.Namespace) -> None:
    import cpp_mutants
    import cpp_tests

    shutil.rmtree(args.copy, ignore_errors=True)
    args.copy.mkdir(parents=True)
    archive = subprocess.run(
        ["git", "-C", ROOT, "archive", "HEAD"], stdout=subprocess.PIPE, check=True
    )
    subprocess.run(["tar", "x", "-C", args.copy], input=archive.stdout, check=True)
    if (ROOT / ".venv").exists():
        (args.copy / ".venv").symlink_to(ROOT / ".venv", target_is_directory=True)
    found = cpp_mutants.mutate_sources(ROOT, ROOT / "build", args.copy, list(ROOMS))
    cpp_tests.Build(args.copy).patch_lit()
    subprocess.run(["cmake", "--preset", "release"], cwd=args.copy, check=True)
    print(f"{len(found)} mutants; now: ninja -C {args.copy / 'build'}")


def reach(args: argparse.Namespace) -> None:
    import cpp_tests

    build = cpp_tests.Build(args.copy)
    for kind in args.kinds:
        for old in args.copy.glob(f"reach-{kind}*.jsonl"):
            old.unlink()
        notes = args.copy / f"reach-{kind}.jsonl"
        if kind == "pytest":
            build.reach_pytest(args.files, notes, args.jobs)
        else:
            build.reach(kind, notes, args.jobs)


def run_cpp(args: argparse.Namespace) -> None:
    import cpp_mutants
    import cpp_tests

    build = cpp_tests.Build(args.copy)
    reached = cpp_tests.Reached(sorted(args.copy.glob("reach-*.jsonl")))
    known = read_rows(args.out)
    every = cpp_mutants.read_mutants(args.copy)
    for room in ROOMS:
        found = [one for one in every if one.file.startswith(f"lib/{room}/")]
        sample = random.Random(args.seed).sample(found, min(args.count, len(found)))
        unknown = [mutant for mutant in sample if mutant.name not in known]
        common = {"part": f"lib/{room}", "all": len(found), "seed": args.seed}

        def judge(mutant: cpp_mutants.Mutant, common: dict[str, Any] = common) -> dict[str, Any]:
            row = cpp_tests.judge(build, reached, mutant.number, args.budget)
            return row | common | {"name": mutant.name, "number": mutant.number}

        with ThreadPoolExecutor(args.jobs) as pool:
            for done in as_completed(pool.submit(judge, mutant) for mutant in unknown):
                note(args.out, done.result())


def explanations() -> dict[str, str]:
    """The reasons for survivors that no test can notice. Lines move: files and texts stay."""
    if not SURVIVORS.exists():
        return {}
    with SURVIVORS.open(newline="") as file:
        return {row["mutant"]: row["reason"] for row in csv.DictReader(file)}


def without_line(name: str) -> str:
    file, _, rest = name.partition(":")
    return f"{file}:{rest.partition(':')[2]}"


def make_table(args: argparse.Namespace) -> None:
    import soak

    known = explanations()
    rows: dict[str, dict[str, Any]] = {}
    if TABLE.exists():
        with TABLE.open(newline="") as file:
            rows = {row["part"]: row for row in csv.DictReader(file)}
    results = [row for path in args.results for row in read_rows(path).values()]
    for part in sorted({row["part"] for row in results}):
        ours = [row for row in results if row["part"] == part]
        count = dict.fromkeys(("killed", "explained", "survived", "not_run"), 0)
        for row in ours:
            outcome = {"timeout": "killed", "not run by any test": "not_run"}.get(
                row["outcome"], row["outcome"])  # fmt: skip
            if outcome != "killed" and without_line(row["name"]) in known:
                outcome = "explained"
            count[outcome] += 1
        rows[part] = {
            "part": part, "mutants": ours[0]["all"], "sample": len(ours), **count,
            "seed": ours[0]["seed"], "date": datetime.date.today().isoformat(),
            "machine": soak.machine("cpu"), "commit": args.commit or soak.commit(),
        }  # fmt: skip
        print(part, count)
    with TABLE.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(sorted(rows.values(), key=lambda row: row["part"]))
    soak.PAGE.write_text(soak.make_page())


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(required=True)

    def command(name: str, function: Any, **defaults: Any) -> argparse.ArgumentParser:
        sub = commands.add_parser(name)
        sub.set_defaults(function=function, **defaults)
        return sub

    def sampled(sub: argparse.ArgumentParser, out: str) -> None:
        sub.add_argument("--count", type=int, default=300, help="mutants of each part")
        sub.add_argument("--seed", type=int, default=1)
        sub.add_argument("--budget", type=float, default=20, help="seconds of tests for a mutant")
        sub.add_argument("--out", type=Path, default=ROOT / "build" / out, help="results so far")

    python = command("python", run_python)
    sampled(python, "mutants-python.jsonl")
    python.add_argument("--root", type=Path, default=ROOT, help="the tree that was counted")
    python.add_argument("--data", type=Path, help="the contexts of coverage.py, combined")
    python.add_argument("--log", type=Path, help="output of pytest --durations=0")
    python.add_argument("--work", type=Path, help="folder for the copy of the package")
    python.add_argument("--part", type=int, default=0, help="every Nth mutant, from this one on")
    python.add_argument("--parts", type=int, default=1)
    cpp = command("cpp", run_cpp)
    sampled(cpp, "mutants-cpp.jsonl")
    for sub in (command("prepare", prepare), command("reach", reach), cpp):
        sub.add_argument("--copy", type=Path, default=COPY, help="the tree with all mutants")
        sub.add_argument("--jobs", type=int, default=1, help="tests at a time")
    options = commands.choices["reach"]
    options.add_argument("--kinds", nargs="+", default=["lit", "gtest", "pytest"])
    options.add_argument("--files", nargs="+", default=["test/python/ad", "test/python/tapes"])
    table = command("table", make_table)
    table.add_argument("results", nargs="+", type=Path)
    table.add_argument("--commit", default="", help="of what was run")
    args = parser.parse_args()
    args.function(args)
    return 0


if __name__ == "__main__":
    os.environ.setdefault("TAI_VERIFY_EACH", "1")
    sys.exit(main())
