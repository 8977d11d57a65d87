"""Run time against error: each scene and kernel in each mode of tai and of its peers.

    make bench-error                       # full sizes: an hour or two on a quiet machine
    make bench-error ARGS=--quick          # small ones: ten minutes
    make bench-error ARGS=--resume         # continue an interrupted run
    make bench-error ARGS="--scenes smoke,exp --systems tai,jax"
    make bench-error ARGS=--page           # only the page and its plots, from existing results

Each measurement is a process of its own. Its row is written at once; a failed row contains the
reason and does not affect others. Writes benchmarks/results/error-<machine>.csv and
docs/reports/accuracy.md, then judges the gates: the exit status is 1 if one of them fails.
"""

from __future__ import annotations

import argparse
import functools
import json
import os
import platform
import re
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import cases
import gates
import modes
import page
import rows
from setup_peers import peers_python

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
RESULTS = ROOT / "benchmarks" / "results"
# Widths of the columns that name the measurement.
WIDTHS = (16, 5, 10, 18, 4, 3)
# Steps of descent after which a loss is compared.
STEPS = {"tiny": 2, "quick": 5, "full": 10}


def processor() -> str:
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return platform.machine()


def cores() -> int:
    return len(os.sched_getaffinity(0))


def machine_name(arch: str) -> str:
    """As in the names of the other results."""
    if arch == "cuda":
        done = subprocess.run(
            ["nvidia-smi", "--query-gpu=name", "--format=csv,noheader"],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        found = re.search(r"[A-Z]+\d+\w*", done.stdout)
        return found[0].lower() if found else "cuda"
    family = re.search(r"xeon|epyc|ryzen|core|neoverse", processor().lower())
    return f"{family[0] if family else platform.machine()}-{cores()}-cores"


def revision() -> str:
    if known := os.environ.get("TAI_COMMIT"):
        return known
    command = ["git", "-C", str(ROOT), "describe", "--always", "--dirty", "--exclude=*"]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()


class Runner:
    """Runs measurements, and keeps their rows."""

    def __init__(self, given: argparse.Namespace):
        self.given = given
        self.out: Path = given.out
        self.rows: dict[tuple, dict] = {}
        self.lock = threading.Lock()
        if given.resume and self.out.is_file():
            self.rows = {rows.key_of(row): row for row in rows.read(self.out)}
        self.common = {"machine": given.machine, "git": revision()}
        given.work.mkdir(parents=True, exist_ok=True)
        self.log = given.work / "log.txt"

    def command(self, scene: str, system: str, mode: str, arch: str, threads: str) -> list[str]:
        python = Path(sys.executable) if system == modes.OURS else peers_python(self.given.peers)
        cache = self.given.work / "cache" / system / re.sub(r"\W+", "_", mode)
        cache.mkdir(parents=True, exist_ok=True)
        found = [str(python), str(HERE / "measure.py"), "--scene", scene, "--system", system]
        found += ["--mode", mode, "--size", self.given.size, "--arch", arch]
        return [*found, "--threads", "0" if threads == "all" else "1", "--cache", str(cache)]

    def process(self, command: list[str]) -> dict:
        """The output of a measurement; a failure has its reason."""
        environment = dict(os.environ, PYTHONPATH=str(ROOT / "python"))
        with self.log.open("a") as log:
            log.write(f"$ {' '.join(command)}\n")
            log.flush()
            try:
                done = subprocess.run(
                    command, stdout=subprocess.PIPE, stderr=log, text=True, cwd=ROOT,
                    timeout=self.given.timeout, env=environment, check=False,
                )  # fmt: skip
            except subprocess.TimeoutExpired:
                return {"status": "failed", "reason": f"longer than {self.given.timeout} s"}
            except OSError as error:
                return {"status": "missing", "reason": f"no environment of peers: {error.strerror}"}
        if done.returncode == -signal.SIGINT:
            raise KeyboardInterrupt  # Ctrl-C reaches both: that is no failure of the scene
        lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
        if not lines:
            log = os.path.relpath(self.log, ROOT)  # results are for other machines too
            return {"status": "failed", "reason": f"exit status {done.returncode}, see {log}"}
        return json.loads(lines[-1])

    def reference(self, scene: str) -> Path | None:
        """Loss and gradient in f64, made once for each size; None if that failed."""
        if scene in cases.micro.NAMES:
            return self.given.work / "none.npz"
        path = self.given.work / f"reference-{scene}-{self.given.size}.npz"
        if path.is_file() and self.given.resume:
            return path
        path.unlink(missing_ok=True)
        command = self.command(scene, modes.OURS, modes.REFERENCE, "cpu", "1")
        said = self.process([*command, "--keep", str(path)])
        if said["status"] != "ok":
            print(f"{scene}: no reference: {said['reason']}", file=sys.stderr)
        return path if path.is_file() else None

    def measure(self, key: tuple[str, ...], reference: Path | None) -> None:
        scene, _, system, name, arch, threads = key
        print(" ".join(f"{word:{n}}" for word, n in zip(key, WIDTHS, strict=True)), flush=True)
        if reference is None:
            said = {"status": "failed", "reason": "there is no reference"}
        else:
            command = self.command(scene, system, name, arch, threads)
            command += ["--reference", str(reference), "--runs", str(self.given.runs)]
            command += ["--budget", str(self.given.budget)]
            # Descents of tai compare its modes; and the sizes of steps are those of its scenes.
            if scene in cases.EXAMPLES and system in cases.TAICHI:
                command += ["--steps", str(STEPS[self.given.size])]
            count = 20 if system == modes.OURS or self.given.size == "full" else 5
            if modes.find(system, name).is_deterministic:
                count = 100
            command += ["--distinct", str(count)]
            said = self.process(command)
        row = dict(zip(rows.KEY, key, strict=True)) | self.common | said
        with self.lock:
            old = self.rows.get(key)
            if old and old["status"] == "ok" and row["status"] == "ok":
                row = better(old, row)
            self.rows[key] = row
            rows.write(self.out, list(self.rows.values()))

    def all(self) -> None:
        given = self.given
        kept = {key for key, row in self.rows.items() if row["status"] in ("ok", "missing")}
        for turn in range(given.rounds):
            for scene in given.scenes:
                wanted = [
                    (scene, given.size, system, mode.name, arch, threads)
                    for arch in given.arch
                    for threads in (given.threads if arch == "cpu" else ["all"])
                    for system in given.systems
                    for mode in modes.MODES[system]
                    if not given.modes or mode.name in given.modes
                ]
                wanted = [key for key in wanted if key not in kept]
                if not wanted:
                    continue
                if turn:
                    wanted = [key for key in wanted if self.rows[key]["status"] == "ok"]
                reference = self.reference(scene)
                measure = functools.partial(self.measure, reference=reference)
                with ThreadPoolExecutor(given.jobs) as pool:
                    try:
                        list(pool.map(measure, wanted))
                    except BaseException:
                        pool.shutdown(cancel_futures=True)
                        raise


def better(old: dict, new: dict) -> dict:
    """Merges two rounds: the times of the quicker, and the worse of all else."""
    times = min(old, new, key=lambda row: float(row["ms"]))
    row = new | {name: times[name] for name in ("ms", "p10", "p90", "n")}
    row["least"] = min(float(old["least"]), float(new["least"]))
    for name in ("distinct", "nan_count", "peak_mb"):
        row[name] = max(float(old[name]), float(new[name]))
    return row


def parse(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--quick", action="store_true", help="small sizes, one thread")
    add("--size", choices=cases.SIZES, help="of the scenes (full; with --quick: quick)")
    add("--scenes", default=",".join(cases.NAMES), help="comma-separated")
    add("--systems", default=",".join(modes.MODES), help="comma-separated")
    add("--modes", default="", help="separated by semicolons; all, if left out")
    add("--arch", default="cpu", help="cpu, cuda or both: cpu,cuda")
    add("--threads", default="", help="1, all or both; both if left out, with --quick 1")
    add("--runs", type=int, default=20, help="timed runs of a measurement (20)")
    add("--rounds", type=int, default=0, help="times all are measured (3; with --quick 1)")
    add("--budget", type=float, default=0, help="seconds of timed runs (10; with --quick 0.5)")
    add("--timeout", type=int, default=600, help="seconds of a measurement (600)")
    add("--jobs", type=int, default=0, help="measurements at a time (1; with --quick the cores)")
    add("--resume", action="store_true", help="keep the rows that are there already")
    add("--page", action="store_true", help="measure nothing: write the page, judge the gates")
    add("--machine", default="", help="its name in the file of results")
    add("--out", type=Path, help="the file of results")
    add("--work", type=Path, default=ROOT / "build" / "bench-error", help="caches and logs")
    add("--peers", type=Path, default=ROOT / "build" / "peers-venv", help="environment of peers")
    given = parser.parse_args(arguments)
    given.size = given.size or ("quick" if given.quick else "full")
    is_full = given.size == "full"
    given.rounds = given.rounds or (3 if is_full else 1)
    given.jobs = given.jobs or (1 if is_full else cores())
    given.budget = given.budget or (10.0 if is_full else 0.5)
    given.scenes = _listed(parser, given.scenes, cases.NAMES, "scene")
    given.systems = _listed(parser, given.systems, list(modes.MODES), "system")
    given.arch = _listed(parser, given.arch, ["cpu", "cuda"], "arch")
    usual = "1,all" if is_full and cores() > 1 else "1"
    given.threads = _listed(parser, given.threads or usual, ["1", "all"], "number of threads")
    given.modes = [name for name in given.modes.split(";") if name]
    known = {mode.name for found in modes.MODES.values() for mode in found}
    for name in given.modes:
        if name not in known:
            parser.error(f"unknown mode '{name}', known are {'; '.join(sorted(known))}")
    given.name = given.machine or machine_name(given.arch[-1])
    given.machine = f"{processor()}, {cores()} cores"
    if given.arch != ["cpu"]:
        given.machine += f", {given.name.upper()}"
    suffix = "" if is_full else f"-{given.size}"
    given.out = given.out or RESULTS / f"error-{given.name}{suffix}.csv"
    return given


def _listed(parser: argparse.ArgumentParser, text: str, known: list[str], what: str) -> list[str]:
    found = [name for name in text.split(",") if name]
    for name in found:
        if name not in known:
            parser.error(f"unknown {what} '{name}', known are {', '.join(known)}")
    return found


def main(arguments: list[str] | None = None) -> int:
    given = parse(arguments)
    begin = time.monotonic()
    if not given.page:
        runner = Runner(given)
        try:
            runner.all()
        except KeyboardInterrupt:
            count = len(runner.rows)
            print(f"\nstopped; {count} rows are in {given.out}; --resume goes on", file=sys.stderr)
            return 130
        print(f"{given.out}: {len(runner.rows)} rows in {time.monotonic() - begin:.0f} s")
    kept = RESULTS in given.out.parents
    text = page.write(
        sorted(RESULTS.glob("error-*.csv")) if kept else [given.out], kept, given.work
    )
    print(text)
    return gates.main([str(given.out)])


if __name__ == "__main__":
    sys.exit(main())
