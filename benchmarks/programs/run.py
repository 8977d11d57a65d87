"""Times an iteration of every simulator in examples/ on tai, and unchanged on its peers.

    .venv/bin/python benchmarks/programs/run.py                       # wall time, all threads
    .venv/bin/python benchmarks/programs/run.py --processor           # one thread, processor time
    .venv/bin/python benchmarks/programs/run.py --only wave billiards --peers taichi
    .venv/bin/python benchmarks/programs/run.py --arch cuda           # on a GPU
    .venv/bin/python benchmarks/programs/run.py --fill                # peers only compile
    .venv/bin/python benchmarks/programs/run.py --minutes 12 --rounds 1 --keep

taichi and quadrants run the very same file (`measure.py`). Warp and JAX have their own programs for
some scenes of the benchmark (`../peers`); of those the scene with the same settings is taken.
Each measurement has a process of its own, and the rounds go through all peers of a program in
turn. A peer whose first losses differ is shown as wrong, one that rejects the program or times out
with the reason, and none of these counts as best. Writes programs.csv and programs.md
into build/bench.

Some peers compile for minutes. `--fill` only compiles, into the cache that the measuring run then
uses, so the machine may be busy. `--minutes` bounds the whole run; each process gets a share of
the remaining time.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(HERE.parent))

from harness import machine  # noqa: E402
from setup_peers import peers_python  # noqa: E402

SAME_FILE = ["taichi", "quadrants"]
SCENES = ["warp", "jax"]
BAR = 2.0
# Entries of the table, by the first word of a reason; other entries are the peer's own words.
WORDS = {
    "ended": "ended by a signal", "longer": "longer", "missing": "missing", "not": "not run",
    "wall": "wall", "wrong": "wrong",
}  # fmt: skip
FIELDS = [
    *("program", "peer", "round", "ms", "iterations", "first_s", "first_loss", "second_loss"),
    *("note", "reason"),
]
# A process gets this many times its even share of the remaining --minutes: most take less.
SHARE = 4.0


class Program(NamedTuple):
    """How an example is run: its options, or statements and an expression of it."""

    name: str
    options: str = ""
    before: str = ""
    call: str = ""
    scene: str = ""  # of ../problems.py, with the same settings
    units: int = 1  # the scene's times are of one in so many
    note: str = ""  # the difference of the scene
    tolerance: float = 2e-3  # of the first two losses

    @property
    def title(self) -> str:
        return f"{self.name} {self.options}".strip()

    def words(self) -> list[str]:
        found = self.options.split()
        return [*found, "--before", self.before, "--call", self.call] if self.call else found


PROGRAMS = [
    Program("mass_spring_simple"),
    Program("mass_spring", "--robot 1"),
    Program("mass_spring", "--robot 3 --steps 2048", scene="mass_spring", tolerance=2e-2),
    Program("rigid_body", "--robot 1", tolerance=2e-2),
    Program("rigid_body", "--robot 2", tolerance=2e-2),
    Program("rigid_body_toi", before="set_up()", call="bounce('toi')"),
    Program("rigid_body_discontinuity", before="set_up()", call="throw(1.0)"),
    Program("billiards"),
    Program("electric"),
    Program("gradient_explosion", before="push[None] = 1.0", call="gradient(args.steps, miss)"),
    Program("wave", scene="wave"),
    Program("smoke"),
    Program("smoke", "--setting stripes-peace", scene="smoke"),
    Program("diffmpm", "--steps 256"),
    Program("diffmpm3d", "--steps 16 --start sines"),
    Program("liquid", "--steps 16 --start sines"),
    Program("volume_renderer", "--res 128 --views 3"),
    Program(
        "checkpointing",
        "--scheme stored --steps 51",
        scene="diffmpm",
        units=50,
        note="128² cells in the place of 120²",
    ),  # fmt: skip
    Program("checkpointing", "--scheme grid --steps 51"),
    Program("svd_gradient"),
]


class Clock:
    """How long each process may take."""

    def __init__(self, args: argparse.Namespace, processes: int):
        self.timeout, self.processes = args.timeout, processes
        self.end = time.monotonic() + 60 * args.minutes if args.minutes else None

    def limit(self, peer: str) -> float:
        """Seconds for the next process; 0 where the time is over. tai always has its turn."""
        self.processes -= 1
        if self.end is None or peer == "tai":
            return self.timeout
        left = self.end - time.monotonic()
        share = SHARE * left / (self.processes + 1)
        # Less is no measurement: nothing even starts.
        return 0.0 if left < 3 else min(self.timeout, left, max(share, 10.0))


def answers(text: str | bytes | None) -> list[dict]:
    """The lines of JSON in the output of a process."""
    text = text.decode(errors="replace") if isinstance(text, bytes) else text or ""
    found = []
    for line in text.splitlines():
        try:
            found.append(json.loads(line))
        except ValueError:
            continue  # cut off, or not ours
    return [line for line in found if isinstance(line, dict)]


def call(command: list, limit: float, **more) -> tuple[list[dict], str]:
    """The answers of a process, and the reason why they are not complete."""
    words = list(map(str, command))
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=limit, **more)
    except subprocess.TimeoutExpired as error:
        return answers(error.stdout), f"longer than {limit:.0f} s"
    if done.returncode < 0:
        return answers(done.stdout), f"ended by signal {-done.returncode}"
    if not done.returncode:
        return answers(done.stdout), ""
    said = done.stderr.strip().splitlines() or [f"no word, exit status {done.returncode}"]
    lines = [line for line in said if "Error" in line] or said
    return answers(done.stdout), " ".join(lines[-1].split())[:200]


def steady(times: list[float]) -> list[float]:
    """The second half: the first iterations compile, and on a GPU try how they run best."""
    return times[len(times) // 2 :]


def package_folder() -> Path:
    """The folder that holds the package: of this checkout, or of the wheel in TAI_BUILD_DIR."""
    build = Path(os.environ.get("TAI_BUILD_DIR", "build")).resolve()
    return build.parent if (build / "__init__.py").exists() else ROOT / "python"


def measured(program: Program, peer: str, args: argparse.Namespace, folder: Path) -> dict:
    """One run of the same file; times in milliseconds, or the reason why there are none."""
    python = sys.executable if peer == "tai" else str(peers_python(args.peers_venv))
    path = ROOT / "examples" / f"{program.name}.py"
    cache = args.cache / "programs" / peer
    command = [python, HERE / "measure.py", peer, cache, folder, path, *program.words()]
    count = 1 if args.fill else args.iterations
    command += ["--count" if program.call else "--iterations", count]
    command += ["--seconds", args.seconds, "--arch", args.arch]
    command += ["--processor", "--threads", 1] if args.processor else []
    if not Path(python).exists():
        return {"reason": "missing: run benchmarks/setup_peers.py"}
    environment = os.environ | ({"PYTHONPATH": str(package_folder())} if peer == "tai" else {})
    found, reason = call(command, args.limit, env=environment)
    whole = [line for line in found if line.get("whole")]
    times = [value for line in whole or found for value in line["ms"]]
    losses = [value for line in whole or found for value in line["losses"]]
    if reason.startswith("longer") and len(times) == 1:
        reason += f", of which the first iteration took {times[0] / 1e3:.0f} s"
    if reason and not (reason.startswith("longer") and len(times) > 1):
        return {"reason": reason}
    if not times:
        return {"reason": "no times"}
    row = {
        "ms": statistics.median(steady(times)), "iterations": len(times),
        "first_s": times[0] / 1e3, "first_loss": losses[0], "second_loss": losses[:2][-1],
    }  # fmt: skip
    return row | ({"note": f"{len(times)} iterations in {args.limit:.0f} s"} if reason else {})


def scene(program: Program, peer: str, args: argparse.Namespace) -> dict:
    """A program of the peer's own, forward and backward."""
    if args.processor:
        return {"reason": "wall time only"}
    python = peers_python(args.peers_venv)
    if not python.exists():
        return {"reason": "missing: run benchmarks/setup_peers.py"}
    command = [python, HERE.parent / "peers" / f"peer_{peer}.py", "--scene", program.scene]
    command += ["--arch", args.arch]
    command += ["--runs", 1 if args.fill else 5, "--cache", args.cache / peer / program.scene]
    found, reason = call(command, args.limit)
    times = {record["phase"]: record for record in found if "phase" in record}
    if "forward" in times and "backward" in times:
        total = times["forward"]["ms"] + times["backward"]["ms"]
        row = {"ms": total * program.units, "iterations": times["forward"]["n"]}
        return row | ({"note": program.note} if program.note else {})
    said = [record["reason"] for record in found if "reason" in record]
    return {"reason": reason if reason.startswith(("longer", "ended")) else (said or [reason])[-1]}


def judged(row: dict, ours: dict, program: Program) -> dict:
    """Marks a peer that computes something else."""
    for key in ("first_loss", "second_loss"):
        if key in row and key in ours:
            off = abs(row[key] - ours[key]) / max(abs(ours[key]), 1e-12)
            if not off < program.tolerance:
                words = f"wrong: the {key.replace('_', ' ')} is {row[key]:.6g}"
                return {**row, "reason": f"{words}, tai's {ours[key]:.6g}"}
    return row


def best_of(rows: list[dict]) -> dict:
    """The fastest round; a reason, if all have one."""
    good = [row for row in rows if not row.get("reason")]
    return min(good, key=lambda row: row["ms"]) if good else rows[0]


def cell(found: dict, ours: dict) -> str:
    """The time of a peer, with the ratio to tai, or one word for the reason."""
    if found.get("reason"):
        word = found["reason"].split(":")[0].split(" ")[0]
        known = ("missing", "longer", "wrong", "ended", "wall", "not")
        return (
            {"ended": "ended by a signal", "not": "not run"}.get(word, word)
            if (word in known)
            else "refused"
        )
    if "ms" not in found:
        return ""
    mark = " *" if found.get("note") else ""
    ratio = f" ({found['ms'] / ours['ms']:.2f})" if "ms" in ours else ""
    return f"{found['ms']:.4g}{ratio}{mark}"


def table(rows: list[dict], programs: list[Program], peers: list[str]) -> str:
    """Milliseconds, with the ratio to tai in brackets, and whether the bar is kept."""
    lines = [f"| program | tai | {' | '.join(peers)} | best peer |"]
    lines.append("|---" * (len(peers) + 3) + "|")
    notes = []
    for program in programs:
        own = [row for row in rows if row["program"] == program.title]
        by_peer = {peer: [r for r in own if r["peer"] == peer] for peer in ["tai", *peers]}
        if not by_peer["tai"]:
            continue
        ours = best_of(by_peer["tai"])
        cells, ratios = [], []
        for peer in peers:
            found = best_of(by_peer[peer]) if by_peer[peer] else {}
            cells.append(cell(found, ours))
            why = found.get("reason") or found.get("note")
            if why:
                notes.append(f"- {program.title}, {peer}: {why}")
            if "ms" in found and "ms" in ours and not found.get("reason"):
                ratios.append(found["ms"] / ours["ms"])
        end = f"{min(ratios):.2f}{'' if min(ratios) >= BAR else ' **below 2**'}" if ratios else "-"
        first = f"{ours['ms']:.4g}" if "ms" in ours else ours["reason"]
        lines.append(f"| {program.title} | {first} | {' | '.join(cells)} | {end} |")
    return "\n".join([*lines, "", *notes])


def gpu() -> str:
    """The name of the GPU."""
    command = ["nvidia-smi", "--query-gpu=name", "--format=csv,noheader"]
    try:
        done = subprocess.run(command, capture_output=True, text=True)
    except OSError:
        return "a GPU"
    return (done.stdout.splitlines() or ["a GPU"])[0]


def versions(peers: list[str], python: Path) -> str:
    """The peers with their versions."""
    packages = {"warp": "warp-lang"}
    text = "import importlib.metadata as m, sys; print(*map(m.version, sys.argv[1:]))"
    names = [packages.get(peer, peer) for peer in peers]
    try:
        done = subprocess.run([python, "-c", text, *names], capture_output=True, text=True)
    except OSError:
        return ", ".join(peers)
    found = done.stdout.split()
    if len(found) != len(peers):
        return ", ".join(peers)
    return ", ".join(f"{peer} {version}" for peer, version in zip(peers, found, strict=True))


def page(rows: list[dict], programs: list[Program], args: argparse.Namespace, load: float) -> str:
    """The table with the results, and their machine."""
    kind = "processor time of one thread" if args.processor else "wall time, all threads"
    if args.arch == "cuda":
        kind = f"wall time on {gpu()}"
    peers = versions(args.peers, peers_python(args.peers_venv))
    lines = [
        "# The examples on tai and on its peers", "",
        f"Milliseconds of an iteration ({kind}): a median, the least of {args.rounds} rounds; in "
        "brackets, times tai's. The last column is the ratio of the best peer. Made by "
        "`benchmarks/programs/run.py`.", "",
        f"Machine: {machine()}, at a load of {load:.1f} when it began. Peers: {peers}.",
    ]  # fmt: skip
    if load > 0.5 * (os.cpu_count() or 1):
        lines += ["", "**The machine was busy: times are too large.**"]
    return "\n".join([*lines, "", table(rows, programs, args.peers)]).rstrip() + "\n"


def write(rows: list[dict], path: Path) -> None:
    """All rows, after each of them: an interrupted run keeps its results."""
    with path.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, FIELDS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--only", nargs="+", choices=sorted({p.name for p in PROGRAMS}), help="some programs")
    add("--peers", nargs="+", choices=[*SAME_FILE, *SCENES], default=[*SAME_FILE, *SCENES])
    add("--arch", choices=["cpu", "cuda"], default="cpu", help="what computes (cpu)")
    add("--rounds", type=int, default=2, help="processes per measurement (2)")
    add("--iterations", type=int, default=6, help="the second half counts (6)")
    add(
        "--seconds",
        type=float,
        default=15,
        help="no iteration begins after these but a second (15)",
    )
    add("--processor", action="store_true", help="one thread, processor time: for busy machines")
    add("--timeout", type=float, default=600, help="seconds per process (600)")
    add("--minutes", type=float, default=0, help="for all together (as long as it takes)")
    add("--fill", action="store_true", help="let the peers compile into the cache, and end")
    add("--keep", action="store_true", help="write the results into benchmarks/results, too")
    add("--out", type=Path, default=ROOT / "build" / "bench")
    add("--cache", type=Path, help="folder of compiled code (cache in --out)")
    add("--peers-venv", type=Path, default=ROOT / "build" / "peers-venv")
    args = parser.parse_args()
    if args.processor and args.arch == "cuda":
        parser.error("--processor is of the CPU: on a GPU its time says nothing")
    args.cache = args.cache or args.out / "cache"
    args.out.mkdir(parents=True, exist_ok=True)
    load = os.getloadavg()[0]
    programs = [p for p in PROGRAMS if not args.only or p.name in args.only]
    turns = [
        (turn, program, peer)
        for turn in range(1 if args.fill else args.rounds)
        for program in programs
        for peer in ([] if args.fill else ["tai"]) + args.peers
        if peer not in SCENES or program.scene
    ]
    clock = Clock(args, len(turns))
    rows: list[dict] = []
    ours: dict = {}
    for turn, program, peer in turns:
        args.limit = clock.limit(peer)
        before = [r for r in rows if (r["program"], r["peer"]) == (program.title, peer)]
        if before and before[-1].get("reason"):
            continue  # it would be so again
        print(f"round {turn + 1}: {program.title}, {peer}", file=sys.stderr, flush=True)
        with tempfile.TemporaryDirectory() as folder:
            if not args.limit:
                row = {"reason": f"not run: the {args.minutes:g} minutes were over"}
            elif peer in SCENES:
                row = scene(program, peer, args)
            else:
                row = measured(program, peer, args, Path(folder))
        ours = row if peer == "tai" else ours
        row = row if args.fill else judged(row, ours, program)
        if args.fill:
            print(f"  {row.get('reason') or 'ready'}", file=sys.stderr, flush=True)
            continue
        rows.append({"program": program.title, "peer": peer, "round": turn, **row})
        write(rows, args.out / "programs.csv")
    if args.fill:
        return 0
    text = page(rows, programs, args, load)
    folders = [args.out, *([ROOT / "benchmarks" / "results"] if args.keep else [])]
    for folder in folders:
        write(rows, folder / "programs.csv")
        (folder / "programs.md").write_text(text)
    print(text)
    return 1 if any(row["peer"] == "tai" and row.get("reason") for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
