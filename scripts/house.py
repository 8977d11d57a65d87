"""Counts that say how far each subject of the compiler is decided in one place, with a bar each.

    house.py          print the counts, their bars and their goals
    house.py --list   print the places that are counted as well

A count may not rise above its bar. When it falls, lint asks for the bar in `BARS` to be lowered,
which `lint.py --fix` does, so that the count cannot rise again. scripts/rooms.py and
scripts/rooms_python.py hold the rules of the rooms that have no bar.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

# A struct with more booleans has states that nobody has thought of: 2 ** 4 and more.
MOST_BOOLEANS = 3


@cache
def sources() -> dict[str, str]:
    """Texts of the C++ and TableGen sources and of the lit tests, by name."""
    patterns = ["lib", "include/tai", "test/*.mlir", "test/*.test"]
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "--", *patterns]
    output = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    return {
        name: (ROOT / name).read_text()
        for name in sorted(set(output.splitlines()))
        if name.endswith((".cpp", ".h", ".td", ".mlir", ".test")) and (ROOT / name).is_file()
    }


def below(*folders: str, ends: tuple[str, ...] = (".cpp", ".h")) -> Iterator[tuple[str, str]]:
    for name, text in sources().items():
        if name.startswith(folders) and name.endswith(ends):
            yield name, text


def without_comments(text: str) -> str:
    return re.sub(r"//.*", "", text)


def index_arithmetic() -> list[str]:
    """Sources outside of Analysis/Index that take a product of indices apart.

    The interpreter and the rules of derivatives have a row for each op of `arith`.
    """
    match = re.compile(r"\b(?:\w*(?:cast|isa|getDefiningOp)\w*|Case)<[^>]*arith::MulIOp")
    exempt = ("lib/Interpreter/", "lib/AD/Rules/", "lib/Analysis/Index/")
    return [
        name
        for name, text in below("lib/")
        if match.search(without_comments(text)) and not name.startswith(exempt)
    ]


MODES = "deterministic isDeterministic compensated isCompensated oneOrder hasOneOrder keepsTerms"


def modes_of_sums() -> list[str]:
    """Sources outside of the rooms of reductions that ask how a sum is to be computed.

    The dialect defines the modes, the C API passes them on, the interpreter computes with them.
    """
    match = re.compile(rf"\b(?:{'|'.join(MODES.split())})\b")
    exempt = ("lib/Interpreter/", "lib/CAPI/", "lib/Dialect/")
    return [
        name
        for name, text in below("lib/")
        if match.search(without_comments(text))
        and not name.startswith(exempt)
        and "/Reductions/" not in name
    ]


def bodies(text: str) -> Iterator[tuple[str, str]]:
    """The classes and structs of a source with their bodies, nested ones as well.

    A body is given without the functions and the classes that stand in it.
    """
    text = without_comments(text)
    for head in re.finditer(r"\b(?:struct|class)\s+(?:alignas\(\d+\)\s+)?(\w+)[^;{}()]*\{", text):
        depth, at, own = 1, head.end(), []
        while depth and at < len(text):
            char = text[at]
            if depth == 1 and char not in "{}":
                own.append(char)
            depth += {"{": 1, "}": -1}.get(char, 0)
            if depth == 1 and char == "}":
                own.append(";")
            at += 1
        yield head[1], "".join(own)


BOOLEAN = re.compile(
    r"(?:^|(?<=[;:]))\s*(?:mutable\s+|const\s+)*(?:bool|std::atomic<bool>)\s+([\w,\s=:]+?)(?=;)"
)


def booleans(body: str) -> int:
    """Data members of type bool, which `std::atomic<bool>` and bit fields are as well."""
    return sum(found.count(",") + 1 for found in BOOLEAN.findall(body))


def flag_structs() -> list[str]:
    """Structs and classes with more than three booleans."""
    return [
        f"{name}: {title}: {count} booleans"
        for name, text in below("lib/", "include/")
        for title, body in bodies(text)
        if (count := booleans(body)) > MOST_BOOLEANS
    ]


def runtime_getters() -> list[str]:
    """Getters of the runtime that begin with `get`, as those of MLIR's classes do."""
    match = re.compile(r"\bget[A-Z]\w*\(\)\s*(?:const)?\s*[{;]")
    return [
        f"{name}: {found[0].rstrip('{; ')}"
        for name, text in below("include/tai/Runtime/", "lib/Runtime/")
        if name.endswith(".h")
        for found in match.finditer(without_comments(text))
    ]


def run_lines(text: str) -> str:
    return "\n".join(line for line in text.splitlines() if "RUN:" in line)


def source_folders() -> dict[str, str]:
    """The folder below lib/ of each pass, by the name of its class."""
    found = {}
    for name, text in below("lib/", ends=(".cpp",)):
        for title in re.findall(r"impl::(\w+)Base<", text):
            found.setdefault(title, str(Path(name).parent.relative_to("lib")))
    return found


def passes_without_test() -> list[str]:
    """Passes that no lit test runs in the folder of test/ that mirrors their room of lib/.

    A room with folders of its own in test/ has its tests there.
    """
    folders = source_folders()
    tests = [(name, run_lines(text)) for name, text in below("test/", ends=(".mlir", ".test"))]
    found = []
    for name, text in below("include/tai/", ends=(".td",)):
        for title, argument in re.findall(r'def (\w+) : Pass<"([a-z0-9-]+)"', text):
            room = Path("test", folders.get(title, name.split("/")[2]))
            if not any(test.startswith(f"{room}/") for test, _ in tests):
                room = room.parent
            runs = re.compile(rf"(?<![\w]){re.escape(argument)}(?![\w-])")
            if not any(test.startswith(f"{room}/") and runs.search(run) for test, run in tests):
                found.append(f"{name}: no test in {room} runs {argument}")
    return found


@dataclass(frozen=True)
class Rule:
    """A count with the bar that it may not exceed, and the goal of the bar."""

    what: str
    find: Callable[[], list[str]]
    bar: int
    goal: int


BARS = [
    Rule("sources that take index arithmetic apart", index_arithmetic, bar=2, goal=3),
    Rule("sources that ask for a mode of sums", modes_of_sums, bar=5, goal=6),
    Rule("structs with more than three booleans", flag_structs, bar=0, goal=0),
    Rule("getters of the runtime that begin with get", runtime_getters, bar=0, goal=0),
    Rule("passes without a test in the folder of their room", passes_without_test, bar=0, goal=0),
]


def lower_bars() -> None:
    """Writes the counts that are below their bars into this file."""
    text = Path(__file__).read_text()
    for rule in BARS:
        if (count := len(rule.find())) < rule.bar:
            old = f"{rule.find.__name__}, bar={rule.bar}"
            text = text.replace(old, f"{rule.find.__name__}, bar={count}")
    Path(__file__).write_text(text)


def check(rules: list[Rule] = BARS) -> list[str]:
    """Counts above their bars, with the places, and bars that can be lowered."""
    problems = []
    for rule in rules:
        found = rule.find()
        if len(found) > rule.bar:
            problems.append(f"{len(found)} {rule.what}, at most {rule.bar}:")
            problems += [f"  {place}" for place in found]
        elif len(found) < rule.bar:
            problems.append(
                f"scripts/house.py: {len(found)} {rule.what}, and a bar of {rule.bar}: "
                "lint.py --fix lowers it"
            )
    return problems


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--list", action="store_true", help="print the places that are counted")
    asked = parser.parse_args()
    for rule in BARS:
        found = rule.find()
        print(f"{len(found):3} {rule.what} (bar {rule.bar}, goal {rule.goal})")
        if asked.list:
            print("".join(f"      {place}\n" for place in found), end="")
    problems = check()
    print("\n".join(problems))
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
