"""The command line of the experiments, and the saved state of interrupted runs."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import json
import os
import platform
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from tai._impl.base.files import replacing_name, write_text

from . import __doc__ as text
from . import page
from .experiments import EXPERIMENTS, Experiment
from .lab import Failed, Lab, LeftOut, Result

PLACES = (Path(__file__).resolve().parents[1], Path.cwd() / "examples")


def fail(message: str) -> NoReturn:
    """Prints one line as the error, and ends the program."""
    print(f"paper: {' '.join(str(message).split())}", file=sys.stderr)
    sys.exit(2)


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        fail(f"{message} (--help lists all options)")


def _options() -> argparse.Namespace:
    parser = _Parser(
        prog="python -m tai paper", description=text,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    add = parser.add_argument
    levels = parser.add_mutually_exclusive_group()
    words = {
        "once": "single iterations on small sizes, to see that all runs",
        "quick": "the default: ten minutes at most on two cores",
        "full": "all iterations of the paper: hours",
    }
    for level, what in words.items():
        levels.add_argument(
            f"--{level}", dest="level", action="store_const", const=level, help=what
        )
    parser.set_defaults(level="quick")
    names = [experiment.name for experiment in EXPERIMENTS]
    add("--only", nargs="+", metavar="NAME", choices=names, help="some experiments")
    add("--list", action="store_true", help="their names, and what each shows")
    add("--arch", choices=["cpu", "cuda"], default="cpu", help="what computes (cpu)")
    add("--resume", action="store_true", help="keep what is done in --out, and go on")
    add("--out", type=Path, default=Path("out/paper"), help="folder of runs and page (out/paper)")
    add("--examples", type=Path, help="the folder of the programs (examples, of the checkout)")
    add("--page", type=Path, help="also writes paper.md or paper-cuda.md here, with pictures")
    return parser.parse_args()


def _examples(given: Path | None) -> Path:
    """The folder of the example programs: by default, the one that holds this package."""
    for place in (given,) if given else PLACES:
        if (place / "mass_spring_simple.py").is_file() and (place / "studio").is_dir():
            return place.resolve()
    where = given or PLACES[0]
    fail(f"{where} has no examples: name the folder 'examples' of a checkout by --examples")


def _writable(folder: Path, option: str) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        fail(f"{option} {folder}: cannot write there ({error.strerror})")
    return folder.resolve()


@functools.cache
def _gpu() -> str:
    """The name of the first GPU that processes see, as its driver says it."""
    number = os.environ.get("CUDA_VISIBLE_DEVICES", "0").split(",")[0]
    command = ["nvidia-smi", "-i", number, "--query-gpu=name", "--format=csv,noheader"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=20)
    except (OSError, subprocess.TimeoutExpired):
        return "GPU unknown"
    return done.stdout.strip() if done.returncode == 0 else "GPU unknown"


def _cores() -> int:
    return len(os.sched_getaffinity(0))


def _machine(arch: str) -> str:
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        model = names[0].split(":", 1)[1].strip() if names else model
    host = f"{model}, {_cores()} cores"
    return f"{host}, {_gpu()}" if arch == "cuda" else host


class _Store:
    """Stores the results of the experiments, in a file for each."""

    def __init__(self, folder: Path, settings: dict[str, str]):
        self.folder, self.settings = folder / "results", settings
        self.runs = folder / "runs"
        self.folder.mkdir(exist_ok=True)

    def clear(self, names: Sequence[str], resume: bool) -> None:
        """Deletes the runs that cannot go on: those made with other settings, and, unless
        resuming, all of the given experiments, with their results."""
        made = self.runs / "settings.json"
        content = json.dumps(self.settings)
        if made.is_file() and made.read_text() != content:
            shutil.rmtree(self.runs, ignore_errors=True)
        for name in () if resume else names:
            shutil.rmtree(self.runs / name, ignore_errors=True)
            (self.folder / f"{name}.json").unlink(missing_ok=True)
        self.runs.mkdir(exist_ok=True)
        write_text(made, content)

    def save(self, result: Result) -> None:
        content = {"settings": self.settings, "result": dataclasses.asdict(result)}
        write_text(self.folder / f"{result.name}.json", json.dumps(content))

    def load(self, name: str) -> Result | None:
        """Loads the result of an earlier run, if it was made with the same settings."""
        try:
            content = json.loads((self.folder / f"{name}.json").read_text())
            if content["settings"] == self.settings:
                return Result(**content["result"])
        except (OSError, ValueError, KeyError, TypeError):
            pass
        return None


def _perform(lab: Lab, experiment: Experiment) -> Result:
    """Runs an experiment; an error in it becomes its result."""
    result = lab.begin(experiment.name)
    begin = time.monotonic()
    try:
        experiment.run(lab)
    except LeftOut as error:
        result.status, result.reason = "left out", str(error)
    except Failed as error:
        result.status, result.reason = "failed", str(error)
    except OSError as error:
        if error.filename and not os.access(lab.out, os.W_OK):
            raise
        result.status, result.reason = "failed", f"{type(error).__name__}: {error}"
    except Exception as error:  # an experiment must not take the others with it
        result.status, result.reason = "failed", f"{type(error).__name__}: {error}"
    result.seconds = time.monotonic() - begin
    result.load = os.getloadavg()[0]
    result.machine, result.cores = _machine(lab.arch), _cores()
    return result


def _copy_page(lab: Lab, text: str, rows: list[page.Row], docs: Path) -> None:
    """Copies the report page. The page for a GPU is beside that for the CPU, with its own
    pictures.
    """
    suffix = "" if lab.arch == "cpu" else f"-{lab.arch}"
    folder = docs / "pictures"
    folder.mkdir(exist_ok=True)
    gone = set(folder.glob(f"paper{suffix}_*.png"))
    for _, _, _, result in rows:
        for kind, *content in result.blocks:
            if kind == "picture":
                name = content[0].replace("/paper_", f"/paper{suffix}_", 1)
                text = text.replace(f"]({content[0]})", f"]({name})")
                with replacing_name(docs / name) as part:
                    shutil.copyfile(lab.out / content[0], part)
                gone.discard(docs / name)
    write_text(docs / f"paper{suffix}.md", text)
    for old in gone:
        old.unlink()


def _write_page(lab: Lab, rows: list[page.Row], copy: Path | None) -> Path:
    load = max((row[3].load for row in rows), default=0)
    shared = [row[3].cores for row in rows if row[3].load > 2 * row[3].cores]
    seconds = sum(row[3].seconds for row in rows)
    machines = dict.fromkeys(row[3].machine or "not named" for row in rows)
    times = (
        f"The experiments took {seconds / 60:.1f} minutes together, at a load of up to {load:.0f}."
    )
    if shared:
        times += (
            f" **{shared[0]} cores were shared with other work: "
            "times are several times too large.**"
        )
    head = [
        "Results of the programs of [examples](../start/examples.md) for the figures and tables of "
        "*DiffTaichi: Differentiable Programming for Physical Simulation* (ICLR 2020). Made by "
        f"`python -m tai paper --{lab.level}`; every number that is not said to be the paper's "
        "comes from that run.",
        f"Machine: {'; '.join(machines)}; arch {lab.arch}. {times}",
    ]
    path = lab.out / "paper.md"
    write_text(path, page.markdown(head, rows))
    write_text(lab.out / "paper.html", page.hypertext(head, rows, lab.out))
    if copy:
        _copy_page(lab, path.read_text(), rows, copy)
    return path


def _stop(*_: object) -> NoReturn:
    raise KeyboardInterrupt


def main() -> int:
    """Runs the experiments that the command line asks for; 1 if one of them failed."""
    args = _options()
    if args.list:
        for experiment in EXPERIMENTS:
            print(f"{experiment.name:16} {experiment.title} ({experiment.shows})")
        return 0
    examples = _examples(args.examples)
    out = _writable(args.out, "--out")
    copy = _writable(args.page, "--page") if args.page else None
    store = _Store(out, {"level": args.level, "arch": args.arch})
    lab = Lab(examples, out, args.level, args.arch, args.resume)
    chosen = [e for e in EXPERIMENTS if not args.only or e.name in args.only]
    store.clear([experiment.name for experiment in chosen], args.resume)
    signal.signal(signal.SIGTERM, _stop)
    rows: list[page.Row] = []
    for number, experiment in enumerate(chosen, 1):
        result = store.load(experiment.name) if args.resume else None
        if result is None or result.status != "ok":
            print(f"{experiment.name} ({number} of {len(chosen)})", file=sys.stderr, flush=True)
            try:
                result = _perform(lab, experiment)
                store.save(result)
            except KeyboardInterrupt:
                done = f"{len(rows)} of {len(chosen)} experiments are kept in {out}"
                print(f"paper: stopped in {experiment.name}; {done}; --resume goes on",
                      file=sys.stderr)  # fmt: skip
                return 130
            except OSError as error:
                fail(f"cannot write {error.filename}: {error.strerror}")
        rows.append((experiment.name, experiment.shows, experiment.title, result))
        print(f"{experiment.name:16} {page.verdict(result)} ({result.seconds:.1f} s)", flush=True)
    path = _write_page(lab, rows, copy)
    failed = sum(result.status == "failed" for *_, result in rows)
    print(f"page     {path}")
    print(f"{len(rows) - failed} experiments as expected or left out, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
