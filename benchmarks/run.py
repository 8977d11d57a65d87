"""Time tai and its peers on the same scenes, on this machine, in one run.

    .venv/bin/python benchmarks/run.py [--install-peers] [--scenes smoke,wave] [--peers jax]

Each measurement runs in a process of its own; the rounds go through all peers of a scene
in turn, so that a machine that gets slower slows all of them. The first round starts with
empty caches (cold compilation), the following ones find them filled (warm).

Writes results.csv and results.png into build/bench and prints a table of times and of
ratios to tai. Each gradient is compared with an f64 adjoint. The exit status is 0 only if
every program of tai ran and its gradients are right.
"""

from __future__ import annotations

import argparse
import csv
import json
import shutil
import subprocess
import sys
from pathlib import Path

import report
from harness import machine
from problems import PROBLEMS
from setup_peers import create, peers_python

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
OURS = "tai"
# Our own compiler in other modes.
MODES = ["tai_deterministic"]
PEERS = ["taichi", "quadrants", "jax", "torch", "warp"]
FLOOR_SCENES = ["smoke", "wave", "diffmpm"]
FIELDS = [
    *("round", "peer", "version", "scene", "phase", "ms", "p10", "p90", "n"),
    *("loss", "loss_rel_err", "grad_rel_err", "reason"),
]

# A forward pass whose loss is off by more than this is not the same scene.
LOSS_TOLERANCE = 1e-3
# Our gradients against f64. The robot's contacts amplify rounding over 2048 steps.
GRADIENT_TOLERANCE = {
    "smoke": 1e-3,
    "wave": 1e-4,
    "diffmpm": 1e-4,
    "mass_spring": 5e-2,
    "first_kernel": 1e-6,
}


def problem_record(peer: str, scene: str, phase: str, reason: str) -> dict:
    return {"peer": peer, "version": "", "scene": scene, "phase": phase, "reason": reason}


def run_command(command: list[str], peer: str, scene: str, log: Path, timeout: int) -> list[dict]:
    """Records that a measuring process printed; a failed record if it printed none."""
    with log.open("a") as errors:
        errors.write(f"$ {' '.join(command)}\n")
        errors.flush()
        try:
            done = subprocess.run(
                command,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                cwd=ROOT,
                timeout=timeout,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return [problem_record(peer, scene, "failed", f"longer than {timeout} s")]
    records = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    settled = any(r["phase"] in ("forward", "launch", "missing", "failed") for r in records)
    if not settled:
        reason = f"exit status {done.returncode}, see {log}"
        records.append(problem_record(peer, scene, "failed", reason))
    return records


class Peers:
    """Runs the peer scripts, each with the interpreter that has the peer."""

    def __init__(self, out: Path, options: argparse.Namespace):
        self.out = out
        self.options = options
        self.python = peers_python(options.peers_venv)
        self.floor = out / "floor" / "floor"

    def build_floor(self) -> None:
        """Builds the hand-written floor; without a compiler it is reported as missing."""
        compiler = shutil.which("clang++-22") or shutil.which("clang++") or shutil.which("c++")
        if not compiler or not shutil.which("cmake"):
            return
        folder = self.floor.parent
        configure = ["cmake", "-S", str(HERE / "floor"), "-B", str(folder)]
        configure.append(f"-DCMAKE_CXX_COMPILER={compiler}")
        for command in (configure, ["cmake", "--build", str(folder)]):
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                print(f"the floor does not build:\n{done.stdout}{done.stderr}", file=sys.stderr)
                return

    def run(self, peer: str, scene: str) -> list[dict]:
        if peer == "floor":
            return self._run_floor(scene)
        python = Path(sys.executable) if peer in (OURS, *MODES) else self.python
        if not python.exists():
            reason = "no environment of peers: run benchmarks/setup_peers.py"
            return [problem_record(peer, scene, "missing", reason)]
        cache = self.out / "cache" / peer / scene
        command = [str(python), str(HERE / "peers" / f"peer_{peer}.py"), "--scene", scene]
        command += ["--runs", str(self.options.runs), "--cache", str(cache)]
        if self.options.small:
            command.append("--small")
        return run_command(command, peer, scene, self._log(peer), self.options.timeout)

    def _log(self, peer: str) -> Path:
        return self.out / f"{peer}.log"

    def _run_floor(self, scene: str) -> list[dict]:
        if self.options.small or scene not in FLOOR_SCENES:
            return []
        if not self.floor.exists():
            return [problem_record("floor", scene, "missing", "no C++ compiler or oneTBB")]
        command = [str(self.floor), f"--runs={self.options.runs}", scene]
        records = run_command(command, "floor", scene, self._log("floor"), self.options.timeout)
        for record in records:
            if "loss" in record:
                expected, _ = PROBLEMS[scene](False).reference()
                record["loss_rel_err"] = abs(record["loss"] - expected) / abs(expected)
        return records


def judged(record: dict) -> dict:
    """The record, turned into a failure where it times something that is not the scene."""
    error = record.get("loss_rel_err")
    if error is not None and not error < LOSS_TOLERANCE:
        reason = f"{record['phase']}: loss is off by {error:.1e}"
        return {**record, "phase": "failed", "reason": reason}
    return record


def complaints(records: list[dict], scenes: list[str]) -> list[str]:
    """The faults of our own side, in words."""
    found = []
    for scene in scenes:
        own = [r for r in records if r["peer"] == OURS and r["scene"] == scene]
        found += [f"{scene}: {r['reason']}" for r in own if r["phase"] in ("missing", "failed")]
        for r in own:
            limit = GRADIENT_TOLERANCE.get(scene)
            error = r.get("grad_rel_err")
            if limit is not None and error is not None and not error <= limit:
                found.append(f"{scene}, {r['phase']}: gradient is off by {error:.1e}")
    return list(dict.fromkeys(found))


def write_csv(path: Path, records: list[dict]) -> None:
    with path.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, FIELDS, extrasaction="ignore", lineterminator="\n")
        writer.writeheader()
        writer.writerows(records)


def listed(text: str, known: list[str], what: str) -> list[str]:
    names = [name for name in text.split(",") if name]
    unknown = [name for name in names if name not in known]
    if unknown:
        raise SystemExit(f"unknown {what} {unknown[0]!r}, known are {', '.join(known)}")
    return names


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    scenes = [*PROBLEMS, "launch"]
    everyone = [OURS, *MODES, "floor", *PEERS]
    parser.add_argument("--scenes", default=",".join(scenes), help="comma-separated")
    parser.add_argument("--peers", default=",".join(everyone), help="comma-separated")
    parser.add_argument("--rounds", type=int, default=2, help="processes per measurement")
    parser.add_argument("--runs", type=int, default=20, help="timed runs per process")
    parser.add_argument("--small", action="store_true", help="tiny scenes, to try it out")
    parser.add_argument("--timeout", type=int, default=600, help="seconds per process")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "bench")
    parser.add_argument("--peers-venv", type=Path, default=ROOT / "build" / "peers-venv")
    parser.add_argument("--install-peers", action="store_true", help="install the peers first")
    options = parser.parse_args()
    options.scenes = listed(options.scenes, scenes, "scene")
    options.peers = listed(options.peers, everyone, "peer")
    if options.rounds < 1 or options.runs < 1:
        parser.error("--rounds and --runs must be at least 1")
    return options


def main() -> int:
    options = parse_arguments()
    out = options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    if options.install_peers:
        create(options.peers_venv, ["numpy", *[p for p in options.peers if p in PEERS]])
    for log in out.glob("*.log"):
        log.unlink()
    shutil.rmtree(out / "cache", ignore_errors=True)
    peers = Peers(out, options)
    if "floor" in options.peers and not options.small:
        peers.build_floor()

    records = []
    for turn in range(options.rounds):
        for scene in options.scenes:
            for peer in options.peers:
                print(f"\rround {turn + 1}: {scene}, {peer:12}", end="", file=sys.stderr)
                for record in peers.run(peer, scene):
                    records.append(judged({"round": turn, **record}))
                write_csv(out / "results.csv", records)
    print("\r" + " " * 40 + "\r", end="", file=sys.stderr)

    print(f"# {machine()}; median milliseconds (in brackets: times the time of {OURS})\n")
    print(report.table(records, options.scenes, options.peers, OURS))
    print(f"\n{out / 'results.csv'}")
    picture = report.plot(records, options.scenes, options.peers, machine(), out / "results.png")
    print(picture or "no picture: matplotlib is not installed")
    wrong = complaints(records, options.scenes) if OURS in options.peers else []
    for line in wrong:
        print(f"{OURS}: {line}", file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
