"""Run time against error: each scene and kernel in each mode of tai and of its peers.

    make bench-error                                # full sizes: an hour or two on a quiet machine
    make bench-error ARGS="--quick --minutes 10"    # small ones, within a time
    make bench-error ARGS="--arch cuda,cpu --threads 1 --minutes 8 --out DIR"
    make bench-error ARGS="--scenes smoke,exp --systems tai,jax"

One session on one machine, one place after the other. All modes of a scene are alive together,
each in a process of its own: first errors, over 16 inputs that are an ulp apart; then ten rounds in
which they are timed in turns, while all other processes of the session are stopped. With --minutes,
rounds and inputs become fewer where time is short, and a row says how many there were. Writes
benchmarks/results/error-<machine>.csv and the page, docs/reports/accuracy.md, which is refused for
a tree with changes or rows of several commits. A session of a part (--quick, --scenes, --systems,
--modes or --out) replaces neither: its page is build/bench-error/page/accuracy.md. Then judges the
gates: the exit status is 1 if one of them fails.
"""

from __future__ import annotations

import argparse
import datetime
import os
import platform
import re
import secrets
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import cases
import gates
import modes
import page
import references
import rows
from mode_workers import Crowd, Worker, environment_of, interpreter
from setup_peers import peers_python

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
RESULTS = ROOT / "benchmarks" / "results"
# Scenes in the order in which their references are there.
ORDER = [
    "wave", "billiards", "rigid_body", "electric", "mass_spring", "smoke", "exp", "sin", "pow",
    "sum", "sum_ill", "scatter", "stencil", "one_cell", "volume_renderer", "diffmpm", "polar",
    "diffmpm3d", "liquid",
]  # fmt: skip
# Scenes whose references take a minute for each input have fewer, one for each process.
SLOW, SLOW_INPUTS = {"diffmpm3d", "liquid"}, 4
LEAST_ROUNDS = 3
# Runs that each row takes at least, and how many times its share of the time they may last.
LEAST_RUNS, MOST_SHARES = 15, 2.5
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
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError:  # there is no git
        return "unknown"
    return done.stdout.strip() or "unknown"


class References:
    """Computes references, each once for a commit."""

    def __init__(self, given: argparse.Namespace, commit: str, log: Path, crowd: Crowd):
        self.given, self.log, self.crowd = given, log, crowd
        self.folder = given.work / f"references-{commit}"
        # Slow references begin at once, and hold no other one up.
        self.pool = ThreadPoolExecutor(max(1, given.jobs // 4))
        self.slow = ThreadPoolExecutor(max(1, given.jobs // 4))
        self.lock = threading.Lock()
        self.futures: dict[str, list[Future]] = {}
        self.processes: list[subprocess.Popen] = []

    def start(self, scene: str) -> list[Future]:
        """Begins, unless somebody has."""
        with self.lock:
            if scene not in self.futures:
                pool = self.slow if scene in SLOW else self.pool
                self.futures[scene] = [
                    pool.submit(self._make, scene, first, count)
                    for first, count in self._parts(scene)
                ]
            return self.futures[scene]

    def _parts(self, scene: str) -> list[tuple[int, int]]:
        total = self.given.inputs + 1
        if scene in SLOW and self.given.size == "full":
            return [(first, 1) for first in range(min(total, SLOW_INPUTS + 1))]
        return [(0, total)]

    def of(self, scene: str, deadline: float) -> references.Reference | None:
        """The reference of a scene; None if there is none, or not in time."""
        _, late = wait(self.start(scene), max(deadline - time.monotonic(), 1.0))
        if late:
            return None
        path = self._path(scene)
        return references.Reference(path) if (path / "about.json").is_file() else None

    def _path(self, scene: str) -> Path:
        return self.folder / f"{scene}-{self.given.size}"

    def _make(self, scene: str, first: int, count: int) -> None:
        path = self._path(scene)
        names = [f"{number}.npz" for number in range(first, first + count)]
        names += ["about.json"] if first == 0 else []
        if "dirty" not in self.folder.name and all((path / name).is_file() for name in names):
            return
        cache = self.given.work / "cache" / "references"
        cache.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, str(HERE / "references.py"), "--scene", scene, "--out", path]
        command += ["--size", self.given.size, "--cache", cache, "--first", first]
        command = ["nice", "-n", "5", *command, "--count", count]
        with self.log.open("a") as log:
            log.write(f"$ {' '.join(map(str, command))}\n")
            log.flush()
            process = self.crowd.start(
                list(map(str, command)), stdout=log, stderr=log, env=environment_of(ROOT)
            )
        self.processes.append(process)
        process.wait()

    def close(self) -> None:
        for pool in (self.pool, self.slow):
            pool.shutdown(wait=False, cancel_futures=True)
        for process in self.processes:
            process.kill()


class Group:
    """All modes of a scene at a place, each in a process."""

    def __init__(self, session: Session, scene: str, arch: str, threads: str, jobs: int):
        self.session, self.given, self.jobs = session, session.given, jobs
        self.scene, self.arch, self.threads = scene, arch, threads
        self.workers: dict[tuple[str, str], Worker] = {}
        self.rows: dict[tuple[str, str], dict] = {}

    def names(self) -> list[tuple[str, str]]:
        return [
            (system, mode.name)
            for system in self.given.systems
            for mode in modes.MODES[system]
            if not self.given.modes or mode.name in self.given.modes
        ]

    def prepare(self) -> Group:
        """Starts all processes, each of which compiles and runs its program once."""
        self._all(self._start)
        return self

    def _all(self, do, jobs: int = 0) -> None:
        with ThreadPoolExecutor(jobs or self.jobs) as pool:
            list(pool.map(do, self.names()))

    def _start(self, name: tuple[str, str]) -> None:
        system, mode = name
        cache = self.given.work / "cache" / system / re.sub(r"\W+", "_", mode)
        cache.mkdir(parents=True, exist_ok=True)
        arguments = ["--scene", self.scene, "--system", system, "--mode", mode]
        arguments += ["--size", self.given.size, "--arch", self.arch, "--cache", str(cache)]
        arguments += ["--threads", "0" if self.threads == "all" else "1"]
        python = interpreter(system, modes.OURS, peers_python(self.given.peers))
        with self.session.log.open("a") as log:
            crowd = self.session.crowd
            worker = self.workers[name] = Worker(arguments, python, ROOT, log, crowd)
        self.rows[name] = worker.answer(self.given.timeout) or {}

    def measure(self, deadline: float, before_times: Callable[[], object]) -> None:
        """Errors, then times in turns; the rows go to the session."""
        reference = self.session.references.of(self.scene, deadline)
        begin = time.monotonic()
        share = max(deadline - begin, 1.0)
        if reference is None:
            for worker in self.workers.values():
                worker.failure = worker.failure or {
                    "status": "failed", "reason": "there is no reference, or not in time"
                }  # fmt: skip
        else:
            self._drop_slow(share)
            known = {"condition": reference.condition(),
                     "reference_error": reference.about()["error"]}  # fmt: skip
            # On a GPU, programs choose the forms of their launches by times of their first runs.
            jobs = max(1, self.jobs // 3) if self.arch == "cuda" else self.jobs
            seconds = 0.25 * share * min(1.0, jobs / len(self.names()))
            self._all(lambda name: self._errors(name, reference, seconds), jobs)
            for row in self.rows.values():
                row.update(known)
            before_times()
            with self.session.crowd.stopped():
                if self.arch == "cuda":
                    for worker in self.workers.values():
                        worker.ask_alone("warm", self.given.timeout, seconds=0.3)
                self._rounds(deadline)
        self._all(self._end)
        for name in self.names():
            row = self.rows[name] | (self.workers[name].failure or {"status": "ok"})
            self.session.add(self._key(name), row)

    def _drop_slow(self, share: float) -> None:
        """With a bound of the time, one program may not take that of the other scenes."""
        for name, worker in self.workers.items():
            seconds = self.rows[name].get("seconds", 0.0)
            if LEAST_RUNS * seconds > MOST_SHARES * share and not worker.failure:
                worker.failure = {
                    "status": "missing",
                    "reason": f"a run takes {seconds:.1f} s, for which there was no time",
                }

    def _errors(self, name: tuple[str, str], reference: references.Reference, share: float) -> None:
        worker = self.workers[name]
        count = 100 if modes.find(*name).is_deterministic else 20
        folder = str(reference.folder)
        seconds = min(share, 0.1 * self.given.timeout)
        # Slow programs take longer than that: some inputs are always measured.
        said = worker.ask(
            "errors", self.given.timeout, reference=folder, seconds=seconds, distinct=count
        )
        self.rows[name].update(said or {})
        worker.ask("warm", self.given.timeout, seconds=min(2.0, seconds))

    def _rounds(self, deadline: float) -> None:
        taken: dict[tuple[str, str], list[dict]] = {name: [] for name in self.names()}
        for number in range(self.given.rounds):
            if time.monotonic() > deadline and number >= LEAST_ROUNDS:
                break
            # Every other round in the opposite order: none is always behind the same one.
            for name in self.names()[:: 1 if number % 2 == 0 else -1]:
                said = self.workers[name].ask_alone(
                    "time", self.given.timeout, seconds=1e-3 * self.given.slice
                )
                if said:
                    taken[name].append(said)
        for name, found in taken.items():
            if found:
                times = [said["ms"] for said in found]
                q1, _, q3 = quartiles(times)
                self.rows[name].update(
                    {"ms": statistics.median(times), "q1": q1, "q3": q3, "rounds": len(times),
                     "least": min(said["least"] for said in found)}
                )  # fmt: skip

    def _end(self, name: tuple[str, str]) -> None:
        worker, system = self.workers[name], name[0]
        # Descents of tai compare its modes; and the sizes of steps are those of its scenes.
        steps = STEPS[self.given.size] if system in cases.TAICHI else 0
        if self.scene in cases.EXAMPLES and self.rows[name].get("ms", 0) > 300:
            steps = 0
        said = worker.ask("end", self.given.timeout, steps=steps)
        self.rows[name].update(said or {})
        worker.close()

    def _key(self, name: tuple[str, str]) -> tuple[str, ...]:
        return self.scene, self.given.size, *name, self.arch, self.threads

    def skip(self, reason: str) -> None:
        """Rows that say why there are no figures."""
        for name in self.names():
            if worker := self.workers.get(name):
                worker.close()
            self.session.add(self._key(name), {"status": "missing", "reason": reason})


def quartiles(times: list[float]) -> tuple[float, float, float]:
    """The first quartile, the median and the third one."""
    if len(times) < 2:
        return times[0], times[0], times[0]
    low, middle, high = statistics.quantiles(times, n=4, method="inclusive")
    return low, middle, high


class Session:
    """Measures, and keeps the rows."""

    def __init__(self, given: argparse.Namespace):
        self.given = given
        self.rows: list[dict] = []
        self.lock = threading.Lock()
        commit = revision()
        begin = datetime.datetime.now(datetime.UTC)
        self.name = f"{begin:%Y-%m-%d %H:%M} {secrets.token_hex(3)}"
        self.common = {"git": commit, "session": self.name}
        given.work.mkdir(parents=True, exist_ok=True)
        self.log = given.work / "log.txt"
        self.crowd = Crowd()
        self.references = References(given, commit, self.log, self.crowd)
        self.end = time.monotonic() + (60 * given.minutes if given.minutes else 1e9)

    def add(self, key: tuple[str, ...], row: dict) -> None:
        machine = self.given.machines[key[4]]
        made = dict(zip(rows.KEY, key, strict=True)) | self.common | {"machine": machine} | row
        with self.lock:
            self.rows.append(made)
            rows.write(self.given.out, self.rows)

    def all(self) -> None:
        """One place after the other: two beside each other would take each other's cores."""
        given = self.given
        places = [
            (arch, threads)
            for arch in given.arch
            for threads in (given.threads if arch == "cpu" else ["all"])
        ]
        if given.jobs >= 8:
            for scene in given.scenes:
                self.references.start(scene)
        try:
            for number, place in enumerate(places):
                share = (self.end - time.monotonic()) / (len(places) - number)
                self.lane(*place, time.monotonic() + share)
        finally:
            self.references.close()

    def lane(self, arch: str, threads: str, end: float) -> None:
        """All scenes at a place. While errors of one are measured, the next one is compiled.

        A stopped process may have left work on a GPU. So the programs of the next scene have run
        before times are taken there: each process waits for the card before it answers.
        """
        jobs = self.given.jobs
        if arch == "cuda" and jobs >= 8:
            jobs = max(jobs, sum(len(modes.MODES[system]) for system in self.given.systems))
        groups = [Group(self, scene, arch, threads, jobs) for scene in self.given.scenes]
        with ThreadPoolExecutor(1) as ahead:
            is_large = self.given.jobs >= 8
            coming = ahead.submit(groups[0].prepare) if is_large else None
            for number, group in enumerate(groups):
                left = end - time.monotonic()
                if left < 5:
                    if coming:
                        coming.result()
                        coming = None
                    group.skip("no time was left")
                    continue
                if coming:
                    coming.result()
                    is_last = number + 1 == len(groups)
                    coming = None if is_last else ahead.submit(groups[number + 1].prepare)
                else:
                    group.prepare()
                share = (end - time.monotonic()) / (len(groups) - number)
                begin = time.monotonic()
                wait_for = [coming] if coming and arch == "cuda" else []
                group.measure(begin + share, lambda found=wait_for: wait(found))
                took = time.monotonic() - begin
                print(f"{arch:4} {threads:3} {group.scene:16} {took:6.1f} s", flush=True)


def parse(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--quick", action="store_true", help="small sizes, one thread")
    add("--size", choices=cases.SIZES, help="of the scenes (full; with --quick: quick)")
    add("--scenes", default=",".join(ORDER), help="comma-separated")
    add("--systems", default=",".join(modes.MODES), help="comma-separated")
    add("--modes", default="", help="separated by semicolons; all, if left out")
    add("--arch", default="cpu", help="cpu, cuda or both: cuda,cpu")
    add("--threads", default="", help="1, all or both; both if left out, with --quick 1")
    add("--minutes", type=float, default=0, help="for all together; no bound, if left out")
    add("--inputs", type=int, default=references.INPUTS, help="an ulp apart (16)")
    add("--rounds", type=int, default=10, help="in which all modes of a scene take turns (10)")
    add("--slice", type=float, default=0, help="ms of runs in a round (100; with --quick 20)")
    add("--timeout", type=int, default=600, help="seconds until a process must answer (600)")
    add("--jobs", type=int, default=cores(), help="processes at work at a time (the cores)")
    add("--machine", default="", help="its name in the file of results")
    add("--out", type=Path, help="the file of results, or a folder for it")
    add("--no-page", action="store_true", help="only the results")
    add("--work", type=Path, default=ROOT / "build" / "bench-error", help="caches and logs")
    add("--peers", type=Path, default=ROOT / "build" / "peers-venv", help="environment of peers")
    given = parser.parse_args(arguments)
    given.size = given.size or ("quick" if given.quick else "full")
    is_full = given.size == "full"
    given.slice = given.slice or (100 if is_full and not given.minutes else 20)
    if given.minutes:
        given.timeout = min(given.timeout, max(10, int(15 * given.minutes)))
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
    given.name = given.machine or machine_name(given.arch[0])
    plain = f"{processor()}, {cores()} cores"
    given.machines = {"cpu": plain, "cuda": f"{plain}, {given.name.upper()}"}
    suffix = "" if is_full else f"-{given.size}"
    is_whole = is_full and not given.modes and given.out is None
    is_part = not is_whole or {*ORDER} - {*given.scenes} or {*modes.MODES} - {*given.systems}
    given.page = given.work.resolve() / "page" if is_part else None
    given.out = given.out or RESULTS
    if given.out.suffix != ".csv":
        given.out = given.out / f"error-{given.name}{suffix}.csv"
    given.out, given.work = given.out.resolve(), given.work.resolve()
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
    session = Session(given)
    try:
        session.all()
    except KeyboardInterrupt:
        print(f"\nstopped; {len(session.rows)} rows are in {given.out}", file=sys.stderr)
        return 130
    print(f"{given.out}: {len(session.rows)} rows in {time.monotonic() - begin:.0f} s")
    if not given.no_page:
        print(page.make([given.out], given.page))
    return gates.main([str(given.out)])


if __name__ == "__main__":
    sys.exit(main())
