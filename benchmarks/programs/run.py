"""Times an iteration of every simulator in examples/ on tai, and as it stands on its peers.

    .venv/bin/python benchmarks/programs/run.py                       # wall time, all threads
    .venv/bin/python benchmarks/programs/run.py --processor           # one thread, processor time
    .venv/bin/python benchmarks/programs/run.py --only wave billiards --peers taichi

taichi and quadrants run the very same file (`measure.py`). Warp and JAX have their own programs for
some scenes of the benchmark (`../peers`); of those the scene with the same settings is taken.
Each measurement has a process of its own, and the rounds go through all peers of a program in
turn. A peer whose first losses are others is shown as wrong, one that refuses the program with its
reason, and neither counts as best. Writes programs.csv and programs.md into build/bench.
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
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(HERE.parent))

from setup_peers import peers_python  # noqa: E402

SAME_FILE = ["taichi", "quadrants"]
SCENES = ["warp", "jax"]
BAR = 2.0
FIELDS = ["program", "peer", "round", "ms", "compile_s", "first_loss", "second_loss", "reason"]


class Program(NamedTuple):
    """How an example is run: its options, or statements and an expression of it."""

    name: str
    options: str = ""
    before: str = ""
    call: str = ""
    scene: str = ""  # of ../problems.py, with the same settings
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
    Program("diffmpm3d", "--steps 32 --start sines"),
    Program("liquid", "--steps 32 --start sines"),
    Program("volume_renderer", "--res 128 --views 3"),
    Program("checkpointing", "--scheme stored --steps 128"),
    Program("checkpointing", "--scheme grid --steps 128"),
    Program("svd_gradient"),
]


def measured(program: Program, peer: str, args: argparse.Namespace, folder: Path) -> dict:
    """One run of the same file; times in milliseconds, or the reason why there are none."""
    python = sys.executable if peer == "tai" else str(peers_python(args.peers_venv))
    path = ROOT / "examples" / f"{program.name}.py"
    cache = args.out / "cache" / "programs" / peer
    command = [python, HERE / "measure.py", peer, cache, folder, path, *program.words()]
    command += ["--count" if program.call else "--iterations", args.iterations]
    command += ["--processor", "--threads", 1] if args.processor else []
    if not Path(python).exists():
        return {"reason": "missing: run benchmarks/setup_peers.py"}
    environment = os.environ | ({"PYTHONPATH": str(ROOT / "python")} if peer == "tai" else {})
    try:
        done = subprocess.run(
            list(map(str, command)), capture_output=True, text=True, timeout=args.timeout,
            env=environment,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return {"reason": f"longer than {args.timeout} s"}
    if done.returncode < 0:
        return {"reason": f"ended by signal {-done.returncode}"}
    if done.returncode:
        said = done.stderr.strip().splitlines() or ["no reason"]
        lines = [line for line in said if "Error" in line] or said
        return {"reason": " ".join(lines[-1].split())[:160]}
    found = json.loads(done.stdout.splitlines()[-1])
    usual = statistics.median(found["ms"][1:] or found["ms"])
    losses = [*found["losses"], found["losses"][-1]]
    compiled = max(found["ms"][0] - usual, 0.0) / 1e3
    return {"ms": usual, "compile_s": compiled, "first_loss": losses[0], "second_loss": losses[1]}


def scene(program: Program, peer: str, args: argparse.Namespace) -> dict:
    """A program of the peer's own, forward and backward."""
    if args.processor:
        return {"reason": "wall time only"}
    python = peers_python(args.peers_venv)
    if not python.exists():
        return {"reason": "missing: run benchmarks/setup_peers.py"}
    command = [python, HERE.parent / "peers" / f"peer_{peer}.py", "--scene", program.scene]
    command += ["--runs", 5, "--cache", args.out / "cache" / peer / program.scene]
    try:
        done = subprocess.run(
            list(map(str, command)), capture_output=True, text=True, timeout=args.timeout
        )
    except subprocess.TimeoutExpired:
        return {"reason": f"longer than {args.timeout} s"}
    records = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    times = {record["phase"]: record for record in records}
    if "forward" not in times or "backward" not in times:
        last = records[-1].get("reason", "no times") if records else "no times"
        return {"reason": str(last)}
    return {"ms": times["forward"]["ms"] + times["backward"]["ms"]}


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
            found = best_of(by_peer[peer]) if by_peer[peer] else {"reason": ""}
            if found.get("reason"):
                notes.append(f"- {program.title}, {peer}: {found['reason']}")
                word = found["reason"].split(":")[0].split(" ")[0]
                known = ("missing", "longer", "wrong", "ended", "wall")
                cells.append(word if word in known else "refused")
            elif "ms" in found and "ms" in ours:
                ratios.append(found["ms"] / ours["ms"])
                cells.append(f"{found['ms']:.4g} ({ratios[-1]:.2f})")
            else:
                cells.append("")
        end = f"{min(ratios):.2f}{'' if min(ratios) >= BAR else ' **below 2**'}" if ratios else "-"
        first = f"{ours['ms']:.4g}" if "ms" in ours else ours["reason"]
        lines.append(f"| {program.title} | {first} | {' | '.join(cells)} | {end} |")
    return "\n".join([*lines, "", *notes])


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--only", nargs="+", choices=sorted({p.name for p in PROGRAMS}), help="some programs")
    add("--peers", nargs="+", choices=[*SAME_FILE, *SCENES], default=[*SAME_FILE, *SCENES])
    add("--rounds", type=int, default=2, help="processes per measurement (2)")
    add("--iterations", type=int, default=6, help="the first one compiles (6)")
    add("--processor", action="store_true", help="one thread, processor time: for busy machines")
    add("--timeout", type=int, default=600, help="seconds per process (600)")
    add("--out", type=Path, default=ROOT / "build" / "bench")
    add("--peers-venv", type=Path, default=ROOT / "build" / "peers-venv")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    programs = [p for p in PROGRAMS if not args.only or p.name in args.only]
    rows: list[dict] = []
    path = args.out / "programs.csv"
    failed = False
    for turn in range(args.rounds):
        for program in programs:
            ours: dict = {}
            for peer in ["tai", *args.peers]:
                if peer in SCENES and not program.scene:
                    continue
                before = [r for r in rows if (r["program"], r["peer"]) == (program.title, peer)]
                if before and before[-1].get("reason", "").startswith(("longer", "wrong")):
                    continue  # it would be so again
                print(f"round {turn + 1}: {program.title}, {peer}", file=sys.stderr, flush=True)
                with tempfile.TemporaryDirectory() as folder:
                    if peer in SCENES:
                        row = scene(program, peer, args)
                    else:
                        row = judged(measured(program, peer, args, Path(folder)), ours, program)
                ours = row if peer == "tai" else ours
                failed |= peer == "tai" and bool(row.get("reason"))
                rows.append({"program": program.title, "peer": peer, "round": turn, **row})
                with path.open("w", newline="") as stream:
                    writer = csv.DictWriter(stream, FIELDS, lineterminator="\n")
                    writer.writeheader()
                    writer.writerows(rows)
    kind = "processor time of one thread" if args.processor else "wall time, all threads"
    text = f"Milliseconds of an iteration ({kind}); in brackets, times tai's.\n\n"
    text += table(rows, programs, args.peers) + "\n"
    (args.out / "programs.md").write_text(text)
    print(text)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
