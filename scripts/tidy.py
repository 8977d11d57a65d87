"""Runs clang-tidy with LLVM's profile (.clang-tidy) over sources of the compiler and runtime.

    python scripts/tidy.py                    # files that differ from main, and uncommitted ones
    python scripts/tidy.py --all --jobs 2     # the whole tree: about 40 minutes of one core
    python scripts/tidy.py lib/AD/Conventions.cpp

Sources are those of the build folder's compile_commands.json, so code of other platforms is not
checked; a header is checked in a source that includes it. Each finding is printed once, however
many sources include the header that it is in. Exits with 1 if there are findings.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
TIDY = "clang-tidy-22"
INCLUDE = re.compile(r'^\s*#\s*include\s+"([^"]+)"', re.M)
FINDING = re.compile(r"^(\S+?):(\d+):(\d+): (?:warning|error): (.*)$", re.M)


def git(*command: str) -> list[str]:
    result = subprocess.run(["git", *command], cwd=ROOT, capture_output=True, text=True)
    return result.stdout.split("\n") if result.returncode == 0 else []


def changed(committed: bool = True) -> set[str]:
    """Sources and headers that differ from main (else from the last commit), tracked or not yet."""
    names = git("diff", "--name-only", "main...HEAD") if committed else []
    names += git("diff", "--name-only", "HEAD")
    names += git("ls-files", "--others", "--exclude-standard")
    return {name for name in names if name.endswith((".cpp", ".h")) and (ROOT / name).exists()}


def includes(name: str) -> set[str]:
    """The files of the checkout that a file includes."""
    found = set()
    for other in INCLUDE.findall((ROOT / name).read_text()):
        for folder in ((ROOT / name).parent, ROOT / "include"):
            path = (folder / other).resolve()
            if path.is_relative_to(ROOT) and path.is_file():
                found.add(str(path.relative_to(ROOT)))
    return found


def includer(header: str, known: set[str]) -> str | None:
    """A source that includes the header, by way of few others; its own source if there is one."""
    headers = {name for name in git("ls-files", "*.h") if (ROOT / name).is_file()}
    included = {name: includes(name) for name in known | headers}
    stem = Path(header).stem
    wanted, seen = {header}, {header}
    while wanted:
        wanted = {name for name, others in included.items() if others & wanted} - seen
        sources = sorted(wanted & known, key=lambda name: (Path(name).stem != stem, name))
        if sources:
            return sources[0]
        seen |= wanted
    return None


def to_look_at(names: set[str], known: set[str]) -> set[str]:
    """The sources among the names, and one for each header."""
    sources = names & known
    for name in sorted(names - known):
        source = includer(name, known) if name.endswith(".h") else None
        if source:
            sources.add(source)
        else:
            print(f"{name} is not compiled")
    return sources


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


def findings(sources: set[str], build: Path, jobs: int) -> Iterator[str]:
    """`file:line:column: text`, each once."""
    seen: set[tuple[str, int, int, str]] = set()
    with concurrent.futures.ThreadPoolExecutor(jobs) as pool:
        for found in pool.map(lambda source: look_at(build, source), sorted(sources)):
            yield from (
                f"{place}:{line}:{column}: {text}"
                for place, line, column, text in sorted(found - seen)
            )
            seen |= found


def why_not(build: Path) -> str:
    """The reason why clang-tidy cannot run; empty if it can."""
    if not shutil.which(TIDY):
        return f"{TIDY} is not installed: apt-get install clang-tidy-22"
    if not (build / "compile_commands.json").exists():
        return f"{build} has no compile_commands.json: configure it first (make build)"
    return ""


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "files", nargs="*", help="sources, headers; without any, those that differ from main"
    )
    parser.add_argument("--all", action="store_true", help="every source that is compiled")
    parser.add_argument("--build", type=Path, default=ROOT / "build", help="build folder (build)")
    parser.add_argument("--jobs", type=int, default=2, help="sources at once (2)")
    args = parser.parse_args()
    build = args.build.resolve()
    if lacks := why_not(build):
        print(lacks)
        return 2
    known = compiled(build)
    sources = known if args.all else to_look_at(set(args.files) or changed(), known)
    count = 0
    for line in findings(sources, build, args.jobs):
        print(line, flush=True)
        count += 1
    print(f"clang-tidy: {count} findings in {len(sources)} sources")
    return 1 if count else 0


if __name__ == "__main__":
    sys.exit(main())
