"""Time tai on a GPU against hand-written CUDA and its peers, in one run; write one report.

    benchmarks/gpu/run.py [--only smoke,diffmpm] [--quick] [--minutes 6] [--name h200]

Compiles the hand-written programs (benchmarks/floor/cuda) if there is nvcc, runs each program in
a process of its own, and writes gpu-<name>.csv and gpu-<name>.md into --out after each of them:
programs that fail or time out are reported with the reason, and the run continues.
`--arch cpu --small` tests the benchmark on a machine without a GPU.
"""

from __future__ import annotations

import argparse
import csv
import datetime
import json
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

HERE = Path(__file__).resolve().parent
BENCHMARKS = HERE.parent
ROOT = BENCHMARKS.parent
sys.path.insert(0, str(BENCHMARKS))
sys.path.insert(0, str(HERE))

import gpu_report as report  # noqa: E402

GROUPS = [
    *("diffmpm", "smoke", "mass_spring", "launch", "chain", "bandwidth", "sparse"),
    *("diffmpm_large", "wave", "first_kernel"),
]
# The program of each floor, and its variants that belong to a group.
FLOORS = {
    "diffmpm": (
        "mpm",
        [
            *("graph", "graph-scalar", "graph-overlapped"),
            *("fused-graph", "fused-overlapped", "persistent"),
        ],
    ),
    "diffmpm_large": ("mpm", ["graph-large", "shared-large", "fused-large"]),
    "smoke": ("smoke", []),
    "mass_spring": ("robot", []),
    "bandwidth": ("bandwidth", []),
    "sparse": ("sparse", []),
}
SCENES = ["diffmpm", "smoke", "mass_spring", "diffmpm_large", "wave", "first_kernel"]
PEER_SCENES = {
    "jax": ["smoke", "diffmpm", "mass_spring", "wave"],
    "torch": ["smoke", "diffmpm", "wave"],
    "warp": ["smoke", "diffmpm", "mass_spring", "wave"],
    "quadrants": ["smoke", "diffmpm", "mass_spring"],
    "taichi": ["smoke", "diffmpm", "mass_spring"],
}
# How far losses and gradients may be off the f64 ones. Smoke's gradient has kinks at cell borders,
# the robot's contacts amplify rounding over 2048 steps.
LOSS = {"": 1e-3}
GRADIENT = {"": 1e-4, "smoke": 1e-3, "mass_spring": 5e-2}
FIELDS = [
    *("peer", "version", "scene", "variant", "phase", "ms", "p10", "p90", "n", "gb_per_s"),
    *("loss", "gradient_norm", "gradient_probe", "loss_rel_err", "grad_rel_err", "reason"),
]


@dataclass
class Job:
    """A process that prints records."""

    peer: str
    group: str
    command: list[str]
    timeout: float
    environment: dict[str, str] = field(default_factory=dict)


def name_of(device: str) -> str:
    """A device's name as part of a file's."""
    return re.sub(r"[^a-z0-9]+", "-", device.lower().replace("nvidia ", "")).strip("-")


def first_line(command: list[str]) -> str:
    """The first line that a program prints, or nothing."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.splitlines()[0].strip() if done.returncode == 0 and done.stdout else ""


def machine(arch: str) -> dict[str, str]:
    """Device, driver and tools, for the head of the report."""
    query = ["nvidia-smi", "--query-gpu=name,driver_version,memory.total", "--format=csv,noheader"]
    gpu = first_line(query).split(", ")
    emulated = os.environ.get("TAI_CUDA_EMULATION") == "1" and arch == "cuda"
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        names = re.findall(r"^model name\s*:\s*(.*)$", cpuinfo.read_text(), re.MULTILINE)
        model = names[0] if names else model
    found = {"device": gpu[0] if gpu[0] else "no GPU"}
    if arch == "cpu" or emulated:
        found["device"] = f"dry run without a GPU ({'emulated device' if emulated else 'CPU'})"
    if len(gpu) == 3:
        found |= {"driver": gpu[1], "memory": gpu[2]}
    if shutil.which("nvcc"):
        version = subprocess.run(["nvcc", "--version"], capture_output=True, text=True).stdout
        release = re.search(r"release [\d.]+, V([\d.]+)", version)
        found["nvcc"] = release.group(1) if release else "unknown"
    found["host"] = f"{model}, {len(os.sched_getaffinity(0))} cores"
    found["python"] = platform.python_version()
    found["date"] = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")
    commit = first_line(["git", "-C", str(ROOT), "rev-parse", "--short", "HEAD"])
    if commit or os.environ.get("TAI_COMMIT"):
        found["commit"] = os.environ.get("TAI_COMMIT") or commit
    return found


def judged(record: dict) -> dict:
    """The record, made a failure where its loss or gradient is wrong: no bar may count it."""
    for key, limits in (("loss_rel_err", LOSS), ("grad_rel_err", GRADIENT)):
        error, limit = record.get(key), limits.get(record["scene"], limits[""])
        if error is not None and not error <= limit:
            name = key.split("_")[0].replace("grad", "gradient")
            return {**record, "reason": f"{record['phase']}: the {name} is off by {error:.1e}"}
    return record


class Run:
    """All records of a run, written out after each job."""

    def __init__(self, options: argparse.Namespace):
        self.options = options
        self.out = options.out.resolve()
        self.work = (options.work or options.out).resolve()
        for folder in (self.out, self.work):
            folder.mkdir(parents=True, exist_ok=True)
        self.deadline = time.monotonic() + 60.0 * options.minutes
        self.machine = machine(options.arch)
        self.records: list[dict] = []
        self.log = (self.out / "gpu.log").open("w")

    def on_gpu(self) -> bool:
        """Whether this measures a GPU at all."""
        return self.machine["device"] != "no GPU" and "dry run" not in self.machine["device"]

    def trouble(self, job: Job, phase: str, reason: str) -> dict:
        return {"peer": job.peer, "scene": job.group, "phase": phase, "reason": reason}

    def do(self, job: Job) -> None:
        """Runs a job and keeps its output."""
        left = self.deadline - time.monotonic()
        if left < 5.0:
            self.add([self.trouble(job, "not run", "the time was up")])
            return
        print(f"{job.group}, {job.peer} …", end=" ", file=sys.stderr, flush=True)
        begin = time.monotonic()
        records = self._records(job, min(job.timeout, left))
        print(f"{time.monotonic() - begin:.1f} s", file=sys.stderr, flush=True)
        self.add(records)

    def _records(self, job: Job, timeout: float) -> list[dict]:
        self.log.write(f"$ {' '.join(job.command)}\n")
        self.log.flush()
        process = subprocess.Popen(
            job.command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT,
            env=os.environ | job.environment, start_new_session=True,
        )  # fmt: skip
        late = False
        try:
            output, errors = process.communicate(timeout=timeout)
        except subprocess.TimeoutExpired:
            # Ends its children as well, a compiler for example.
            os.killpg(process.pid, signal.SIGKILL)
            output, errors = process.communicate()
            late = True
        self.log.write(output + errors)
        self.log.flush()
        found = []
        for line in output.splitlines():
            if line.startswith("{"):
                try:
                    found.append(json.loads(line))
                except json.JSONDecodeError:
                    continue
        if late:
            found.append(self.trouble(job, "failed", f"longer than {timeout:.0f} s"))
        elif process.returncode != 0 and not any(r.get("reason") for r in found):
            last = [line for line in errors.splitlines() if line.strip()][-1:] or ["no message"]
            reason = f"exit status {process.returncode}: {last[0].strip()[:300]}"
            found.append(self.trouble(job, "failed", reason))
        elif not found:
            found.append(self.trouble(job, "failed", "it printed nothing"))
        return found

    def add(self, records: list[dict]) -> None:
        self.records += [judged(record) for record in records]
        self.write()

    def write(self) -> None:
        base = self.out / f"gpu-{self.options.name}"
        with base.with_suffix(".csv").open("w", newline="") as stream:
            writer = csv.DictWriter(stream, FIELDS, extrasaction="ignore", lineterminator="\n")
            writer.writeheader()
            writer.writerows(self.records)
        judge = self.on_gpu()
        note = (
            "Milliseconds are medians. Scenes run forward and backward; those of tai are replays "
            "of its tape, queued ten at a time. Floors are hand-written CUDA (benchmarks/floor/"
            "cuda), timed by events. Bytes count each array once."
        )
        if not judge:
            note += " **This is no measurement of a GPU**: the bars are not judged."
        if self.options.quick or self.options.small:
            note += " Sizes are reduced."
        text = report.markdown(self.records, self.options.only, self.machine, judge, note)
        base.with_suffix(".md").write_text(text)


def build_floors(run: Run) -> Path | None:
    """Compiles the floors; without nvcc or on failure the report says so."""
    folder = run.work / "floors"
    job = Job("floor", "all", [str(BENCHMARKS / "floor/cuda/build.sh"), str(folder)], 120)
    if not shutil.which("nvcc"):
        run.add([run.trouble(job, "missing", "there is no nvcc")])
        return None
    architecture = first_line(["nvidia-smi", "--query-gpu=compute_cap", "--format=csv,noheader"])
    if architecture:
        job.command.append("sm_" + architecture.replace(".", ""))
    done = subprocess.run(job.command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        run.log.write(done.stdout + done.stderr)
        run.add([run.trouble(job, "failed", "the floors do not compile, see gpu.log")])
        return None
    return folder


def floor_jobs(run: Run, folder: Path) -> list[Job]:
    jobs = []
    for group in run.options.only:
        if group not in FLOORS:
            continue
        program, variants = FLOORS[group]
        command = [str(folder / program), f"--runs={run.options.floor_runs}", *variants]
        if run.options.quick:
            command.append("--quick")
        jobs.append(Job("floor", group, command, 60))
    return jobs


def own_jobs(run: Run) -> list[Job]:
    """tai's scenes, with an empty cache and then with a full one, and its other programs."""
    options, jobs = run.options, []
    caches = run.work / "cache"
    shutil.rmtree(caches, ignore_errors=True)
    sizes = ["--small"] if options.small else []
    for group in options.only:
        if group in SCENES:
            runs, budget = (options.runs, options.budget)
            command = [sys.executable, str(BENCHMARKS / "peers/peer_tai.py"), "--scene", group]
            command += ["--arch", options.arch, "--cache", str(caches / group), *sizes]
            # The driver caches compiled code, too: empty at first, and full later.
            driver = {"CUDA_CACHE_PATH": str(caches / f"{group}-driver")}
            first = [*command, "--runs", str(runs), "--budget", str(budget)]
            jobs.append(Job("tai", group, first, 120, driver))
            if group != "diffmpm_large":
                again = [*command, "--runs", "3", "--budget", "0.1"]
                jobs.append(Job("tai", group, again, 60, driver))
        else:
            command = [sys.executable, str(HERE / "measure.py"), group, "--arch", options.arch]
            quick = ["--quick"] if options.quick else []
            jobs.append(Job("tai", group, [*command, *sizes, *quick], 120))
    return jobs


def peer_jobs(run: Run) -> list[Job]:
    options, jobs = run.options, []
    for peer in options.peers:
        for scene in PEER_SCENES[peer]:
            if scene not in options.only or (options.quick and scene == "wave"):
                continue
            command = [options.peers_python, str(BENCHMARKS / f"peers/peer_{peer}.py")]
            command += ["--scene", scene, "--arch", options.arch, "--runs", "10"]
            command += ["--budget", "3", "--cache", str(run.work / "cache" / peer / scene)]
            if options.small:
                command.append("--small")
            # jax would take three quarters of the memory for itself.
            environment = {"XLA_PYTHON_CLIENT_PREALLOCATE": "false"}
            jobs.append(Job(peer, scene, command, 90, environment))
    return jobs


def present(python: str, peers: list[str]) -> list[str]:
    """The peers that the interpreter can import."""
    modules = {"warp": "warp"}
    found = []
    for peer in peers:
        name = modules.get(peer, peer)
        code = f"import importlib.util as u, sys; sys.exit(u.find_spec('{name}') is None)"
        if subprocess.run([python, "-c", code], check=False).returncode == 0:
            found.append(peer)
    return found


def listed(text: str, known: list[str], what: str) -> list[str]:
    names = [name for name in text.split(",") if name]
    for name in names:
        if name not in known:
            raise SystemExit(f"unknown {what} {name!r}, known are {', '.join(known)}")
    return names


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default=",".join(GROUPS), help="groups, comma-separated")
    parser.add_argument("--peers", default=",".join(PEER_SCENES), help="comma-separated, or ''")
    parser.add_argument("--arch", default="cuda", choices=["cuda", "cpu"])
    parser.add_argument("--quick", action="store_true", help="fewer runs, smaller arrays")
    parser.add_argument("--small", action="store_true", help="tiny scenes, to try it out")
    parser.add_argument("--no-floors", action="store_true", help="do not run the floors")
    parser.add_argument("--no-own", action="store_true", help="do not run tai")
    parser.add_argument("--minutes", type=float, default=6.0, help="for all of it")
    parser.add_argument("--name", default=None, help="of the machine, in the files' names")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "bench" / "gpu")
    parser.add_argument("--work", type=Path, help="folder of what it builds; default: --out")
    parser.add_argument("--peers-python", default=sys.executable)
    options = parser.parse_args()
    options.only = listed(options.only, GROUPS, "group")
    options.peers = listed(options.peers, list(PEER_SCENES), "peer")
    options.runs, options.floor_runs = (10, 20) if options.quick else (20, 50)
    options.budget = 1.5 if options.quick else 4.0
    if options.name is None:
        options.name = name_of(machine(options.arch)["device"])
    return options


def main() -> int:
    options = parse_arguments()
    run = Run(options)
    run.write()
    jobs = []
    if not options.no_floors:
        folder = build_floors(run)
        if folder and run.on_gpu():
            jobs += floor_jobs(run, folder)
    if not options.no_own:
        jobs += own_jobs(run)
    options.peers = present(options.peers_python, options.peers)
    jobs += peer_jobs(run)
    for job in jobs:
        run.do(job)
    groups = options.only
    device = run.machine["device"]
    print("\n".join(report.figures(run.records, groups, device, run.on_gpu())))
    failed = [r for r in run.records if r["peer"] in ("tai", "floor") and r.get("reason")]
    wrong = report.disagreements(run.records)
    for record in failed:
        print(f"{record['scene']}, {record['peer']}: {record['phase']}: {record['reason']}")
    print("\n".join(wrong))
    print(f"the report is {run.out / f'gpu-{options.name}.md'}")
    return 1 if failed or wrong else 0


if __name__ == "__main__":
    sys.exit(main())
