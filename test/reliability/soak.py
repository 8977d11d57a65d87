"""Runs all bars, and writes docs/reliability.md.

    make soak                            # all, in 90 minutes on 2 cores at most
    make soak ARGS="--only R5 R8"        # these rows of the page alone
    make soak ARGS="--only R4 --count 5000 --seconds 7200"
    python test/reliability/soak.py --arch cuda     # on a GPU: those that can run there
    python test/reliability/soak.py --page          # the page, from the kept results

    python test/reliability/soak.py --lines run.log --seed 5000 --commit 1a2b3c4
                                         # the output of a script that was run by itself

Results are kept in benchmarks/results, one file for CPUs and one for GPUs: the page is made of
both. A row stays the same until its bar runs again.

Cases of several runs add up where each run has other ones (`adds` of a bar), as long as none
missed and the scripts mean the same: a run begins behind the last seed of those before. After a
miss the count begins anew, at the seeds of the run that missed.
"""

from __future__ import annotations

import argparse
import ast
import csv
import datetime
import hashlib
import json
import math
import os
import platform
import re
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path[:0] = [str(Path(__file__).resolve().parent), str(ROOT / "scripts")]

import page_tables  # noqa: E402
from bars import package_folder  # noqa: E402

import measured_commits  # noqa: E402

FOLDER = Path(__file__).resolve().parent
RESULTS = {name: ROOT / f"benchmarks/results/reliability-{name}.csv" for name in ("cpu", "gpu")}
PAGE = ROOT / "docs/reliability.md"
# `total` is the number of cases of all runs that are added up, `next` the seed behind them, and
# `version` what their cases are made by.
COLUMNS = ["bar", "met", "seen", "cases", "limit", "date", "machine", "commit", "runs", "total",
           "next", "version"]  # fmt: skip
# How many seconds each may take in a soak of all, 85 minutes together: what all its cases take by
# the processor time of one, on two cores that do nothing else, but for R17, whose target is an
# hour, and R20, whose runs are hours. A bar that is stopped says how many cases it ran. One that is
# not here runs where it is named.
SECONDS = {
    "R1": 350, "R2": 240, "R3": 1250, "R4": 1000, "R5": 30, "R6": 240, "R7": 120, "R8": 240,
    "R9": 30, "R10": 180, "R11": 90, "R12": 120, "R15": 60, "R16": 120, "R17": 240, "R18": 60,
    "R19": 240, "R20": 450,
}  # fmt: skip
# Options that make use of two cores, where a script takes them.
OPTIONS = {"R3": ["--jobs", "2"], "R4": ["--jobs", "2"]}
LINE = re.compile(r"^(R\d+) (.+?): (.+?); (.+) \(bar (.+)\)$", re.MULTILINE)

HEAD = """\
# Reliability

This page counts failures that must not happen. Each bar is a script of
[test/reliability](../test/reliability), which ends with a line of numbers and a status other than
zero below its bar. `make soak` runs them all and writes this page; `make soak ARGS="--only R5"`
writes one row of it. A row holds the results for the day, machine and commit that it names, and the
number of cases: a number below the target is marked. If each run has cases of its own, the cases of
several runs add up until one misses: such a row names all their commits, and beside the count the
result of the last run. If a bar can run on a GPU, its results there have a column of their own; an
emulated device is not a GPU. Short forms run with `make test`.

The last column counts the commits between a row's oldest commit and this page. A row is old if they
are more than {old}; `make lint` counts anew, lists the old rows, and fails if a row's commit is not
in the history.
"""


def number(name: str) -> int:
    return int(re.match(r"r?(\d+)", name.lower())[1])


def scripts() -> dict[str, Path]:
    """The script of each bar."""
    found = {f"R{number(path.name)}": path for path in FOLDER.glob("r[0-9]*_*.py")
             if "Bar(" in path.read_text()}  # fmt: skip
    return dict(sorted(found.items(), key=lambda item: number(item[0])))


def environment() -> dict[str, str]:
    paths = [str(package_folder()), os.environ.get("PYTHONPATH", "")]
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))}


def facts(script: Path) -> dict:
    """The facts of a script about its bar."""
    command = [sys.executable, script, "--facts"]
    run = subprocess.run(command, env=environment(), capture_output=True, text=True, check=True)
    return json.loads(run.stdout.splitlines()[-1])


def machine(arch: str) -> str:
    if arch == "cuda":
        command = ["nvidia-smi", "--query-gpu=name", "--format=csv,noheader"]
        if os.environ.get("TAI_CUDA_EMULATION") == "1":
            return "emulated GPU"
        names = subprocess.run(command, capture_output=True, text=True).stdout.splitlines()
        return names[0] if names else "GPU"
    text = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    model = re.search(r"model name\s*: (.+)", text)
    name = re.sub(r"\((R|TM)\)|CPU|@.*", "", model[1] if model else platform.machine())
    return f"{' '.join(name.split())}, {os.cpu_count()} cores"


def commit() -> str:
    if known := os.environ.get("TAI_COMMIT"):
        return known
    command = ["git", "-C", ROOT, "log", "-1", "--format=%h"]
    try:
        return subprocess.run(command, capture_output=True, text=True).stdout.strip() or "unknown"
    except OSError:  # there is no git
        return "unknown"


def version(script: Path) -> str:
    """A number that changes with the cases of a bar: with its code and that of its helpers.

    Comments and descriptions do not count, nor does bars.py, which knows of no cases.
    """
    folders = [FOLDER, ROOT / "test/fuzz"]
    seen: set[Path] = set()
    waiting = [script]
    digest = hashlib.sha256()
    while waiting:
        path = waiting.pop()
        if path in seen:
            continue
        seen.add(path)
        tree = ast.parse(path.read_text())
        for node in ast.walk(tree):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) else []
            found = [f / f"{name}.py" for name in names if name != "bars" for f in folders]
            waiting += sorted(other for other in found if other.exists())
            body = getattr(node, "body", None)
            if isinstance(body, list) and body and is_text(body[0]):
                del body[0]
        digest.update(ast.dump(tree).encode())
    return digest.hexdigest()[:12]


def is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def number_of(cases: str) -> int:
    return int(re.match(r"\d+", cases)[0])


def add_up(row: dict[str, str], before: dict[str, str] | None, seed: int, adds: bool) -> None:
    """Makes one row of a run, which began at a seed, and of those before it, if they go together.

    A miss ends the count: the next run begins where this one did, and sees it again.
    """
    if not adds or not row["cases"]:
        return
    if row["met"] == "no":
        row |= {"runs": "1", "total": "0", "next": str(seed)}
        return
    count = number_of(row["cases"])
    row |= {"runs": "1", "total": str(count), "next": str(seed + count)}
    same = before and before["met"] == "yes" and before["version"] == row["version"]
    if not same or not before["total"] or not count:
        return
    commits = before["commit"].split(" ")
    commits += [one for one in row["commit"].split(" ") if one not in commits]
    row |= {
        "runs": str(int(before["runs"]) + 1),
        "total": str(int(before["total"]) + count),
        "next": str(max(seed + count, int(before["next"]))),
        "commit": " ".join(commits),
    }


def read_line(
    text: str, name: str, script: Path, returned: int, args: argparse.Namespace
) -> dict[str, str]:
    """The row for the output of a script."""
    found = [line for line in LINE.findall(text) if line[0] == name]
    row = dict.fromkeys(COLUMNS, "")
    row |= {"bar": name, "met": "yes" if returned == 0 else "no", "version": version(script)}
    # Other options make other cases.
    row["version"] += f" {args.options}" if args.options else ""
    where = args.machine or machine(args.arch)
    row |= {"date": datetime.date.today().isoformat(), "machine": where}
    row |= {"commit": args.commit or commit()}
    if found:
        row |= {"cases": found[-1][2], "seen": found[-1][3], "limit": found[-1][4]}
    else:
        row["seen"] = f"the script ended with {returned} and no line"
    return row


def run_bar(
    name: str, script: Path, seconds: float, seed: int, args: argparse.Namespace
) -> dict[str, str]:
    """Runs a bar for so many seconds; its row."""
    command = [sys.executable, script, "--seed", str(seed), *OPTIONS.get(name, [])]
    if math.isfinite(seconds):
        command += ["--seconds", f"{seconds:.0f}"]
    if args.count:
        command += ["--count", str(args.count)]
    if args.arch == "cuda":
        command += ["--arch", "cuda"]
    command += args.options.split()
    print("$", *command, flush=True)
    run = subprocess.run(command, env=environment(), stdout=subprocess.PIPE, text=True)
    print(run.stdout, end="", flush=True)
    return read_line(run.stdout, name, script, run.returncode, args)


def keep(row: dict[str, str], device: str, seed: int, script: Path) -> None:
    rows = read_rows(device)
    add_up(row, rows.get(row["bar"]), seed, facts(script)["adds"])
    write_rows(device, rows | {row["bar"]: row})


def first_seed(name: str, script: Path, args: argparse.Namespace) -> int:
    """Where a run begins: where it is told to, or behind those that it is added to."""
    row = read_rows("gpu" if args.arch == "cuda" else "cpu").get(name)
    if args.seed is not None or not row or not row["next"]:
        return args.seed or 0
    same = row["version"].split(" ")[0] == version(script)
    return int(row["next"]) if same else 0


def read_rows(device: str) -> dict[str, dict[str, str]]:
    if not RESULTS[device].exists():
        return {}
    with RESULTS[device].open(newline="") as file:
        rows = csv.DictReader(file, restval="")
        return {row["bar"]: {name: row.get(name, "") for name in COLUMNS} for row in rows}


def write_rows(device: str, rows: dict[str, dict[str, str]]) -> None:
    with RESULTS[device].open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(sorted(rows.values(), key=lambda row: number(row["bar"])))


def show(row: dict[str, str] | None, full: int) -> str:
    """A cell of the page. `full` is the number of cases of the target."""
    if row is None:
        return "not run"
    sign = "met" if row["met"] == "yes" else "**missed**"
    if row["met"] == "yes" and int(row["total"] or number_of(row["cases"])) < full:
        sign = "no miss in fewer cases"
    limit = f" (bar {row['limit']})" if row["limit"] else ""
    return f"{sign}: {row['seen']}{limit}"


def show_cases(row: dict[str, str]) -> str:
    """How many cases there were, in all runs that add up."""
    if int(row["runs"] or 1) < 2:
        return row["cases"]
    what = re.match(r"\d+ ([^,(]*)", row["cases"])[1].strip()
    return f"{row['total']} {what}, in {row['runs']} runs"


def show_age(commits: list[str]) -> str:
    """How many commits came since; git does not know it everywhere."""
    count = measured_commits.age_of(commits, ROOT)
    if count is None:
        return "not known"
    return f"**old: {count}**" if count > measured_commits.OLD else str(count)


def without_ages(page: str) -> str:
    """A page without the numbers that each commit changes."""
    one = r"(?:not known|\d+|\*\*old: \d+\*\*)"
    return re.sub(rf"\| {one}(?:; {one})* \|$", "|", page, flags=re.MULTILINE)


def make_row(name: str, said: dict, here: dict[str, str] | None, there: dict | None) -> str:
    """A row of the table, from the facts of a bar and its results here and on a GPU."""
    archs, full = said["archs"], said["full"]
    on_cpu = show(here, full) if here or set(archs) != {"cuda"} else ""
    on_gpu = show(there, full) if "cuda" in archs else ""
    if there:
        on_gpu += f"; {show_cases(there)}"
    known = [row for row in (here, there) if row]
    runs = "; ".join(f"{row['date']}, {row['machine']}, {row['commit']}" for row in known)
    age = "; ".join(show_age(row["commit"].split()) for row in known)
    cases = show_cases(here) if here else ""
    what = f"{name} {said['what']}"
    return f"| {what} | {said['target']} | {on_cpu} | {cases} | {on_gpu} | {runs} | {age} |"


def make_page() -> str:
    """The page, from the scripts and the kept results of their runs."""
    cpu, gpu = read_rows("cpu"), read_rows("gpu")
    head = HEAD.format(old=measured_commits.OLD)
    columns = ["bar", "target", "seen", "cases", "seen on a GPU", "date, machine, commit",
               "commits since"]  # fmt: skip
    lines = [head, f"| {' | '.join(columns)} |", "|---" * len(columns) + "|"]
    misses = []
    for name, script in scripts().items():
        said = facts(script)
        lines.append(make_row(name, said, cpu.get(name), gpu.get(name)))
        misses.append(f"| {name} | {said['miss']} |")
    lines += ["", "The meaning of one miss:", "", "| bar | a miss |", "|---|---|", *misses]
    lines += page_tables.interrupts(RESULTS["cpu"].with_name("interrupts.csv"), show_age)
    lines += page_tables.coverage(RESULTS["cpu"].with_name("coverage.csv"), show_age)
    lines += page_tables.mutants(RESULTS["cpu"].with_name("mutants.csv"), show_age)
    return "\n".join([*lines, ""])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", metavar="R", help="bars to run; all without it")
    parser.add_argument("--count", type=int, help="number of cases of each")
    parser.add_argument("--seconds", type=float, help="of each, in place of its share")
    parser.add_argument("--all-seconds", type=float, help="of all together, each with its share")
    parser.add_argument(
        "--seed", type=int, help="where the random choices begin; behind those before without it"
    )
    parser.add_argument("--arch", choices=["cpu", "cuda"], default="cpu")
    parser.add_argument("--options", default="", help="more options for the scripts")
    parser.add_argument("--page", action="store_true", help="run none")
    parser.add_argument("--lines", type=Path, help="run none: take what a script has printed")
    parser.add_argument("--status", type=int, default=0, help="with which that script ended")
    parser.add_argument("--commit", help="of what was run, in place of that of this checkout")
    parser.add_argument("--machine", help="on which that script ran, in place of this one")
    args = parser.parse_args()
    known = scripts()
    unknown = set(args.only or ()) - set(known)
    if unknown:
        parser.error(f"no script is {', '.join(sorted(unknown))}; there are {', '.join(known)}")
    device = "gpu" if args.arch == "cuda" else "cpu"
    chosen = [name for name in known if name in (args.only or SECONDS)]
    if args.lines:
        text = args.lines.read_text()
        names = [name for name, *_ in LINE.findall(text)]
        if len(names) != 1 or names[0] not in known:
            parser.error(f"{args.lines} holds {len(names)} lines of bars")
        row = read_line(text, names[0], known[names[0]], args.status, args)
        keep(row, device, args.seed or 0, known[names[0]])
    if args.page or args.lines:
        chosen = []
    if args.arch == "cuda":
        chosen = [name for name in chosen if "cuda" in facts(known[name])["archs"]]
    missed = []
    begun = time.monotonic()
    for position, name in enumerate(chosen):
        seconds = args.seconds or SECONDS.get(name, math.inf)
        if args.all_seconds and name in SECONDS:
            left = args.all_seconds - (time.monotonic() - begun)
            seconds = left * SECONDS[name] / sum(SECONDS.get(n, 0) for n in chosen[position:])
        seed = first_seed(name, known[name], args)
        row = run_bar(name, known[name], seconds, seed, args)
        missed += [name] * (row["met"] == "no")
        keep(row, device, seed, known[name])
    PAGE.write_text(make_page())
    if not args.page:
        minutes = (time.monotonic() - begun) / 60
        print(f"{minutes:.0f} minutes, missed: {', '.join(missed) or 'none'}; see {PAGE}")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
