"""The frame of the scripts of this folder: their options, and the last line of each."""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import sys
import time
from pathlib import Path
from typing import NoReturn

ROOT = Path(__file__).resolve().parent.parent.parent

# The share of the processors that other programs may take where times by the clock are judged.
BUSY = 0.1


class Bar:
    """One bar: its name, the counted cases, and their numbers in a long and a short run.

    `target` and `miss` are for the page of all bars: the invariant, and the meaning of one miss.
    `archs` are the devices on which the script can run, if there is a choice, the first by default.
    `adds` says that runs with other seeds are other cases, whose numbers add up; `apart` that the
    bar takes too long for a soak of all and has no short form.
    """

    def __init__(
        self, name: str, what: str, full: int, short: int, *, target: str, miss: str,
        archs: tuple[str, ...] = (), adds: bool = False, apart: bool = False,
    ):  # fmt: skip
        self.name, self.what = name, what
        self.full, self.short = full, short
        self.facts = {"bar": name, "what": what, "target": target, "miss": miss,
                      "archs": archs, "full": full, "adds": adds, "apart": apart}  # fmt: skip
        self.begun = time.monotonic()
        self.busy = busy_seconds()
        self.seconds = math.inf
        self.parser = argparse.ArgumentParser(
            description=f"{name}: {what}", formatter_class=argparse.ArgumentDefaultsHelpFormatter
        )
        add = self.parser.add_argument
        add("--short", action="store_true", help=f"{short} cases, at most 15 seconds")
        add("--count", type=int, default=full, help="number of cases")
        add("--seconds", type=float, default=math.inf, help="begin no case after that long")
        add("--seed", type=int, default=0, help="where the random choices begin")
        add("--build", type=Path, default=build_folder(), help="the build to test")
        add("--facts", action="store_true", help="print what the page of all bars says of it")
        if archs:
            add("--arch", choices=archs, default=archs[0], help="where kernels run")

    def parse(self) -> argparse.Namespace:
        """Reads the command line. A script may add options to `parser` before."""
        args = self.parser.parse_args()
        if args.facts:
            print(json.dumps(self.facts))
            sys.exit(0)
        if args.short:
            args.count = min(args.count, self.short)
        self.seconds = args.seconds
        if getattr(args, "arch", "both") != "both":
            choose_arch(args.arch)
        return args

    def left(self) -> float:
        """How many seconds are left of --seconds."""
        return self.seconds - (time.monotonic() - self.begun)

    def others(self) -> float:
        """The share of the processors that other programs took since this one began.

        Where they took much, times by the clock say little about this program.
        """
        seconds = time.monotonic() - self.begun
        taken = busy_seconds() - self.busy - own_seconds()
        return max(0.0, taken) / (seconds * (os.cpu_count() or 1))

    def report(self, cases: str, seen: str, *, met: bool, bar: object = 0) -> NoReturn:
        """Prints the line with the numbers and ends the script, with 1 below the bar."""
        print(f"{self.name} {self.what}: {cases}; {seen} (bar {bar})", flush=True)
        sys.exit(0 if met else 1)


def choose_arch(name: str) -> None:
    """Where the next `ti.init` runs kernels: on the cpu, on the emulated GPU or on one (cuda)."""
    os.environ["TI_ARCH"] = "cuda" if name == "emulated" else name
    if name == "emulated":
        os.environ["TAI_CUDA_EMULATION"] = "1"
    elif name == "cpu":
        os.environ["TAI_CUDA_EMULATION"] = ""


def build_folder() -> Path:
    """The build of this checkout, or that of TAI_BUILD_DIR."""
    return Path(os.environ.get("TAI_BUILD_DIR", ROOT / "build")).resolve()


def package_folder() -> Path:
    """The folder that holds the package: of this checkout, or of the wheel in TAI_BUILD_DIR."""
    build = build_folder()
    return build.parent if (build / "__init__.py").exists() else ROOT / "python"


def own_seconds() -> float:
    """Seconds that processors have worked for this process and its children that have ended."""
    return sum(os.times()[:4])


def busy_seconds() -> float:
    """Seconds that all processors have worked since the machine was started."""
    with open("/proc/stat") as file:
        user, nice, system = map(int, file.readline().split()[1:4])
    return (user + nice + system) / os.sysconf("SC_CLK_TCK")


def seconds_of(process: int) -> float:
    """Seconds that processors have worked for a process that has not been waited for."""
    with open(f"/proc/{process}/stat") as file:
        fields = file.read().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def is_idle(process: int) -> bool:
    """Whether no thread of a process computes, or waits for a processor: it waits for something."""
    for _ in range(10):
        for stat in Path(f"/proc/{process}/task").glob("*/stat"):
            with contextlib.suppress(OSError):  # the thread has ended
                if stat.read_text().rpartition(")")[2].split()[0] not in "SDTZX":
                    return False
        time.sleep(0.1)
    return True


def resident() -> int:
    """Bytes of this process that are in memory."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096
