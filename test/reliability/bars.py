"""What the scripts of this folder share: their options, and the line that each ends with."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import NoReturn

ROOT = Path(__file__).resolve().parent.parent.parent


class Bar:
    """One bar: its name, what is counted, and how many cases a long and a short run take."""

    def __init__(self, name: str, what: str, full: int, short: int):
        self.name, self.what = name, what
        self.full, self.short = full, short
        self.parser = argparse.ArgumentParser(
            description=f"{name}: {what}", formatter_class=argparse.ArgumentDefaultsHelpFormatter
        )
        add = self.parser.add_argument
        add("--short", action="store_true", help=f"{short} cases, at most 15 seconds")
        add("--count", type=int, default=full, help="number of cases")
        add("--seed", type=int, default=0, help="where the random choices begin")
        add("--build", type=Path, default=build_folder(), help="the build to test")

    def parse(self) -> argparse.Namespace:
        """Reads the command line. A script may add options to `parser` before."""
        args = self.parser.parse_args()
        if args.short:
            args.count = min(args.count, self.short)
        return args

    def report(self, numbers: str, *, met: bool, bar: object = 0) -> NoReturn:
        """Prints the line with the numbers and ends the script, with 1 below the bar."""
        print(f"{self.name} {self.what}: {numbers} (bar {bar})", flush=True)
        sys.exit(0 if met else 1)


def build_folder() -> Path:
    """The build of this checkout, or that of TAI_BUILD_DIR."""
    return Path(os.environ.get("TAI_BUILD_DIR", ROOT / "build")).resolve()
