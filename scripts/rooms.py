"""Checks the layering of the C++ sources: which components ("rooms") may include which.

A room is a folder of lib/ and the one of the same name in include/tai; those of the runtime and
the dialects are subfolders. `ARROWS`, `RUNTIME_ARROWS` and `DIALECT_ARROWS` are the allowed
dependencies; `--write` updates the graphs of them in docs/architecture.md.

Headers of include/tai are public, headers of lib private to their folder `lib/Room/Folder`:
decision 0068. Headers and unit tests stand in the folder of their source.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs/architecture.md"
MOST_FILES = 40
MOST_SOURCES = 2

# Room: the rooms whose headers it may include. A room that is listed and not needed is an error,
# too.
ARROWS: dict[str, str] = {
    "ABI": "",
    "Support": "",
    "Interfaces": "",
    "Dialect": "Interfaces",
    "Analysis": "ABI Dialect Interfaces Support",
    "AD": "ABI Analysis Dialect Interfaces Support",
    "Transforms": "ABI Analysis Dialect Interfaces Support",
    "Conversion": "ABI Analysis Dialect Support Transforms",
    "Pipelines": "AD Conversion Dialect Interfaces Support Transforms",
    "DeviceLibrary": "ABI Support",
    "Runtime": "ABI Support",
    "CodeGen": "ABI Runtime Support Transforms",
    "Interpreter": "ABI Dialect Runtime Support",
    "ExecutionEngine": "ABI AD Analysis CodeGen Conversion Dialect Interfaces Interpreter "
    "Pipelines Runtime Support Transforms",
    "CAPI": "ExecutionEngine Runtime Support",
    "Portable": "",
}

# The same for the rooms of the runtime. Rooms that include one another are listed in KNOWN_CIRCLES
# and nowhere else: parts of one class that are still to be separated.
RUNTIME_ARROWS: dict[str, str] = {
    "Cache": "",
    "Math": "",
    "Text": "",
    "Threads": "",
    "Sparse": "Threads",
    "Storage": "Sparse Text",
    "Device": "Text",
    "Profile": "Device",
    "Programs": "Device",
    "Queue": "Device Programs Threads",
    "Mirror": "Device Profile Queue Sparse Storage Text Threads",
    "Host": "Mirror Storage Threads",
    "Launch": "Device Host Math Mirror Sparse Storage Text Threads",
    "Tape": "Host Launch Mirror Sparse Storage Text",
    "Cuda": "Device Text Threads",
    "Emulated": "Device Text Threads",
}
KNOWN_CIRCLES: set[tuple[str, str]] = set()

# The same for dialects: lower ones use upper ones by traits and interfaces alone.
DIALECT_ARROWS: dict[str, str] = {
    "Tai": "",
    "TaiRT": "Tai",
    "Check": "Tai",
    "Mesh": "Tai",
}

# Classes whose methods stand in more sources than MOST_SOURCES, and in how many: to be cut
# into parts. The numbers may fall, not rise.
KNOWN_SLICES: dict[str, int] = {}

# Rooms whose parts (a header with its source) include each other one way only.
PARTS_IN_ORDER = ("lib/Runtime/Tape/", "lib/Runtime/Programs/", "lib/Runtime/Queue/")


@dataclass
class Graph:
    """Includes from room to room, with one example of each."""

    arrows: dict[tuple[str, str], list[str]] = field(default_factory=lambda: defaultdict(list))

    def below(self, room: str) -> list[str]:
        return sorted(b for a, b in self.arrows if a == room)


def sources() -> list[str]:
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    command += ["lib", "include/tai"]
    output = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    return sorted(n for n in set(output.splitlines()) if (ROOT / n).is_file())


def room_of(name: str, *, within: str = "") -> str | None:
    """The room of a file; the room within a larger one if so asked."""
    parts = name.split("/")
    parts = parts[1:] if parts[0] == "lib" else parts[2:]
    if within:
        return parts[1] if len(parts) > 2 and parts[0] == within else None
    return parts[0] if len(parts) > 1 else None


def included(name: str, text: str) -> list[str]:
    """The files of this project that a file includes."""
    found = []
    for path in re.findall(r'^\s*#?\s*include "([^"]+)"', text, re.M):
        if path.startswith("tai/"):
            found.append("include/" + path)
        elif (ROOT / name).parent.joinpath(path).exists():
            target = (ROOT / name).parent.joinpath(path).resolve()
            found.append(str(target.relative_to(ROOT)))
    return found


def read_graph(*, within: str = "") -> Graph:
    graph = Graph()
    for name in sources():
        room = room_of(name, within=within)
        if room is None or not name.endswith((".cpp", ".h", ".td", ".def", ".cu")):
            continue
        for target in included(name, (ROOT / name).read_text()):
            other = room_of(target, within=within)
            if other is not None and other != room:
                graph.arrows[room, other].append(f"{name} includes {target}")
    return graph


def check_arrows(table: dict[str, str], graph: Graph, circles: set[tuple[str, str]]) -> list[str]:
    """Includes that the table does not allow, and entries of the table that nobody uses."""
    problems = []
    for (room, other), examples in sorted(graph.arrows.items()):
        if room not in table:
            problems.append(f"{examples[0]}: the room '{room}' is in no table of scripts/rooms.py")
        elif other not in table[room].split() and (room, other) not in circles:
            problems.append(f"{examples[0]}: '{room}' may not include '{other}'")
    for room, allowed in table.items():
        for other in allowed.split():
            if (room, other) not in graph.arrows:
                problems.append(f"scripts/rooms.py: '{room}' does not need '{other}'")
    for room, other in sorted(circles):
        if (room, other) not in graph.arrows:
            problems.append(f"scripts/rooms.py: '{room}' does not need '{other}' any more")
    if order(table) is None:
        problems.append("scripts/rooms.py: the rooms of the table form a circle")
    return problems


def order(table: dict[str, str]) -> list[str] | None:
    """The rooms, each after those that it includes; None where there is a circle."""
    done: list[str] = []
    while len(done) < len(table):
        ready = [r for r in table if r not in done and set(table[r].split()) <= set(done)]
        if not ready:
            return None
        done += ready
    return done


def slices() -> dict[str, set[str]]:
    """In which sources the methods of each class stand."""
    found: dict[str, set[str]] = defaultdict(set)
    method = re.compile(r"^(?!\s)(?:[\w:<>,&*\s]+?\s[&*]?)?((?:\w+::)*\w+)::~?(\w+)\(", re.M)
    for name in sources():
        if name.endswith(".cpp"):
            for match in method.finditer((ROOT / name).read_text()):
                # Without namespaces. Ops are defined by ODS; their methods stand with their
                # subject.
                classes = [part for part in match.group(1).split("::") if part[0].isupper()]
                if classes and not classes[-1].endswith("Op"):
                    found["::".join(classes)].add(name)
    return found


def check_slices() -> list[str]:
    problems = []
    counts = {name: len(files) for name, files in slices().items()}
    for name, count in sorted(counts.items()):
        if count > max(MOST_SOURCES, KNOWN_SLICES.get(name, 0)):
            problems.append(f"the methods of '{name}' stand in {count} sources: cut it into parts")
    for name, known in KNOWN_SLICES.items():
        now = counts.get(name, 0)
        if now < known:
            problems.append(f"scripts/rooms.py: '{name}' stands in {now} sources now")
    return problems


def check_parts() -> list[str]:
    """The parts of a room that include each other in a circle."""
    problems = []
    for room in PARTS_IN_ORDER:
        needs: dict[str, set[str]] = defaultdict(set)
        for name in sources():
            if name.startswith(room):
                part = Path(name).stem
                needs[part] |= {
                    Path(target).stem
                    for target in included(name, (ROOT / name).read_text())
                    if target.startswith(room)
                } - {part}
        while ready := [part for part in needs if not needs[part] & needs.keys()]:
            for part in ready:
                del needs[part]
        if needs:
            problems.append(f"parts include each other in a circle: {', '.join(sorted(needs))}")
    return problems


def folder_of(name: str) -> tuple[str, str]:
    """The room and the folder of a file in lib or include/tai; "" for the room's own files."""
    parts = Path(name).parent.parts[1 if name.startswith("lib/") else 2 :]
    return (parts[0] if parts else ""), (parts[1] if len(parts) > 1 else "")


def check_private(name: str, text: str) -> list[str]:
    """Private headers that a file includes and may not: see decision 0068."""
    room, folder = folder_of(name)
    problems = []
    for target in included(name, text):
        if not target.startswith("lib/"):
            continue
        other, owner = folder_of(target)
        if not name.startswith("lib/"):
            problems.append(f"{name} is public and includes the private {target}")
        elif room != other or (folder and owner and folder != owner):
            problems.append(
                f"{name} includes {target}, which is private to its folder: move it to include/tai"
            )
    return problems


def check_mirrors(names: list[str]) -> list[str]:
    """Public headers whose source stands in another folder of the room."""
    places: dict[tuple[str, str], set[str]] = defaultdict(set)
    for name in names:
        if name.endswith(".cpp"):
            places[folder_of(name)[0], Path(name).stem].add(str(Path(name).parent)[len("lib/") :])
    problems = []
    for name in names:
        room = folder_of(name)[0]
        if room and name.startswith("include/tai/") and name.endswith(".h"):
            sources_of = places[room, Path(name).stem]
            folder = str(Path(name).parent)[len("include/tai/") :]
            if sources_of and folder not in sources_of:
                problems.append(f"{name}: its source is in lib/{min(sources_of)}")
    return problems


# Folders of test/unit that mirror no room: helpers, and libraries for tests.
HELPERS = ("Utils", "FakeCuda", "FakeNvtx")


def check_unit_tests(names: list[str]) -> list[str]:
    """Unit tests whose folder is none of lib or include/tai, and sources not named XTest.cpp."""
    problems = []
    for name in names:
        folder = str(Path(name).parent)[len("test/unit") :].lstrip("/")
        if folder.split("/")[0] in HELPERS or not name.endswith((".cpp", ".h")):
            continue
        if (
            not any((ROOT / base / folder).is_dir() for base in ("lib", "include/tai"))
            or not folder
        ):
            problems.append(f"{name}: there is no folder lib/{folder}")
        if name.endswith(".cpp") and not name.endswith("Test.cpp"):
            problems.append(f"{name}: its name does not end with Test.cpp")
    return problems


def check_lit_tests(names: list[str]) -> list[str]:
    """Folders of lit tests of a room that mirror none of its folders."""
    folders = {Path(name).parent for name in names if name.endswith((".mlir", ".test"))}
    return [
        f"{folder}: there is no folder lib/{folder.relative_to('test')}"
        for folder in sorted(folders)
        if folder.name != "Inputs"
        and (ROOT / "lib" / folder.relative_to("test").parts[0]).is_dir()
        and not (ROOT / "lib" / folder.relative_to("test")).is_dir()
    ]


def check_headers() -> list[str]:
    problems = []
    for name in sources():
        if name.endswith((".cpp", ".h", ".cu", ".def")):
            problems += check_private(name, (ROOT / name).read_text())
    tests = sorted(str(path.relative_to(ROOT)) for path in (ROOT / "test").glob("*/*/**/*.*"))
    units = [name for name in tests if name.startswith("test/unit/")]
    return problems + check_mirrors(sources()) + check_unit_tests(units) + check_lit_tests(tests)


def check_crowds() -> list[str]:
    counts: dict[str, int] = defaultdict(int)
    for name in sources():
        if name.endswith((".cpp", ".h")):
            counts[str(Path(name).parent)] += 1
    return [
        f"{folder}: {count} files side by side, at most {MOST_FILES}"
        for folder, count in sorted(counts.items())
        if count > MOST_FILES
    ]


def drawing() -> str:
    """The tables of the page, from the lowest rooms up."""
    text = []
    for title, table in (
        ("rooms", ARROWS),
        ("rooms of the runtime", RUNTIME_ARROWS),
        ("dialects", DIALECT_ARROWS),
    ):
        text.append(f"| {title} | may include |\n|---|---|")
        for room in order(table) or table:
            text.append(f"| `{room}` | {', '.join(f'`{r}`' for r in table[room].split())} |")
        text.append("")
    return "\n".join(text)


BEGIN, END = "<!-- rooms: begin (scripts/rooms.py --write) -->", "<!-- rooms: end -->"


def page(text: str) -> str:
    head, rest = text.split(BEGIN)
    return head + BEGIN + "\n" + drawing() + END + rest.split(END)[1]


def check_paths(text: str) -> list[str]:
    """Files that the page names and that are not there."""
    known = sources() + [str(path.relative_to(ROOT)) for path in (ROOT / "python").rglob("*.py")]
    return [
        f"docs/architecture.md: there is no file '{name}'"
        for name in sorted(set(re.findall(r"`([\w/]+\.(?:cpp|h|def|py))`", text)))
        if not any(f"/{path}".endswith(f"/{name}") for path in known) and not (ROOT / name).exists()
    ]


def check() -> list[str]:
    problems = check_arrows(ARROWS, read_graph(), set())
    problems += check_arrows(RUNTIME_ARROWS, read_graph(within="Runtime"), KNOWN_CIRCLES)
    problems += check_arrows(DIALECT_ARROWS, read_graph(within="Dialect"), set())
    problems += check_slices() + check_crowds() + check_parts() + check_headers()
    text = PAGE.read_text()
    problems += check_paths(text)
    if page(text) != text:
        problems.append("docs/architecture.md is not what scripts/rooms.py --write makes of it")
    return problems


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="write the tables of the page")
    parser.add_argument("--show", action="store_true", help="print what the includes do")
    args = parser.parse_args()
    if args.show:
        for within in ("", "Runtime", "Dialect"):
            for (room, other), examples in sorted(read_graph(within=within).arrows.items()):
                print(f"{room} -> {other}: {len(examples)}, {examples[0]}")
        for name, files in sorted(slices().items()):
            if len(files) > MOST_SOURCES:
                print(f"{name}: {len(files)} sources")
        return 0
    if args.write:
        PAGE.write_text(page(PAGE.read_text()))
    problems = check()
    print("\n".join(problems))
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
