"""Runs clang-tidy with LLVM's profile (.clang-tidy) over sources of the compiler and runtime.

    python scripts/tidy.py                    # files that differ from main, and uncommitted ones
    python scripts/tidy.py --all --jobs 2     # the whole tree: about 40 minutes of one core
    python scripts/tidy.py lib/AD/Conventions.cpp

Sources are those of the build folder's compile_commands.json, so code of other platforms is not
checked. A finding in a header is printed once, however many sources include it. Exits with 1 if
there are findings.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
TIDY = "clang-tidy-22"
FINDING = re.compile(r"^(\S+?):(\d+):(\d+): (?:warning|error): (.*)$", re.M)


def git(*command: str) -> list[str]:
    result = subprocess.run(["git", *command], cwd=ROOT, capture_output=True, text=True)
    return result.stdout.split("\n") if result.returncode == 0 else []


def changed() -> set[str]:
    """Sources that differ from main, whether committed or not."""
    names = git("diff", "--name-only", "main...HEAD") + git("diff", "--name-only", "HEAD")
    return {name for name in names if name.endswith(".cpp")}


def compiled(build: Path) -> set[str]:
    """Sources of the checkout that the build folder compiles."""
    database = json.loads((build / "compile_commands.json").read_text())
    files = {(Path(entry["directory"]) / entry["file"]).resolve() for entry in database}
    return {
        str(file.relative_to(ROOT))
        for file in files
        if file.is_relative_to(ROOT) and not file.is_relative_to(build) and file.suffix == ".cpp"
    }


def look_at(build: Path, source: str) -> set[tuple[str, int, int, str]]:
    """The findings in a source and in the headers of the checkout that it includes."""
    result = subprocess.run(
        [TIDY, "-p", str(build), "--quiet", source], cwd=ROOT, capture_output=True, text=True
    )
    found = set()
    for place, line, column, text in FINDING.findall(result.stdout):
        path = Path(place)
        path = (path if path.is_absolute() else build / path).resolve()
        if path.is_relative_to(ROOT) and not path.is_relative_to(build):
            found.add((str(path.relative_to(ROOT)), int(line), int(column), text))
    return found


def report(sources: set[str], build: Path, jobs: int) -> int:
    """Prints what is found in the sources; the number of findings."""
    seen: set[tuple[str, int, int, str]] = set()
    with concurrent.futures.ThreadPoolExecutor(jobs) as pool:
        for found in pool.map(lambda source: look_at(build, source), sorted(sources)):
            for place, line, column, text in sorted(found - seen):
                print(f"{place}:{line}:{column}: {text}", flush=True)
            seen |= found
    return len(seen)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("files", nargs="*", help="sources; those that differ from main by default")
    parser.add_argument("--all", action="store_true", help="every source that is compiled")
    parser.add_argument("--build", type=Path, default=ROOT / "build", help="build folder (build)")
    parser.add_argument("--jobs", type=int, default=2, help="sources at once (2)")
    args = parser.parse_args()
    if not shutil.which(TIDY):
        print(f"{TIDY} is not installed: apt-get install clang-tidy-22")
        return 2
    build = args.build.resolve()
    if not (build / "compile_commands.json").exists():
        print(f"{build} has no compile_commands.json: configure it first (make build)")
        return 2
    known = compiled(build)
    wanted = known if args.all else set(args.files) or changed()
    for name in sorted(set(args.files) - known):
        print(f"{name} is not compiled in {build.name}")
    count = report(wanted & known, build, args.jobs)
    print(f"clang-tidy: {count} findings in {len(wanted & known)} sources")
    return 1 if count else 0


if __name__ == "__main__":
    sys.exit(main())
