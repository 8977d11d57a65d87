"""Runs tests of this folder with their fields below sparse levels.

    python layouts.py FOLDER OUTPUT --layouts pointer,bitmasked,hash TOOL…

The RUN lines of each file in FOLDER are run on a copy in which the dense levels at the roots of
the trees stand below levels of another kind, and where `@main` makes all cells active before it
does anything else. The checks of the RUN lines are the same. A tool is a path; RUN lines name it by
its last part.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

AXES = "ijklmnopqrst"


@dataclass
class Level:
    """A level in the text of a tree: [begin, end) of it, and its text before the children."""

    kind: str
    extents: dict[str, int]
    begin: int
    head: int
    end: int = 0
    levels: list[Level] = field(default_factory=list)
    places: list[str] = field(default_factory=list)


HEAD = re.compile(r"(\w+)<\[([^]]*)\](?:, chunk \d+)?,\s*")


def parse_levels(text: str, at: int, into: Level) -> int:
    """Reads children up to the closing bracket; returns where that stands."""
    while text[at] != ">":
        if text[at] == "{":
            end = text.index("}", at)
            into.places += re.findall(r'"?([\w.]+)"?\s*:', text[at:end])
            at = end + 1
        elif head := HEAD.match(text, at):
            pairs = [part.split(":") for part in head[2].split(",")]
            extents = {axis.strip(): int(extent) for axis, extent in pairs}
            level = Level(head[1], extents, at, head.end())
            level.end = parse_levels(text, head.end(), level) + 1
            into.levels.append(level)
            at = level.end
        else:
            at += 1
    return at


def find_place(level: Level, name: str) -> dict[str, int] | None:
    """The extents along the axes down to a place."""
    if name in level.places:
        return dict(level.extents)
    for inner in level.levels:
        found = find_place(inner, name)
        if found is not None:
            for axis, extent in level.extents.items():
                found[axis] = found.get(axis, 1) * extent
            return found
    return None


def convert(text: str, layout: str) -> tuple[str, int]:
    """The text with other levels, and how many levels were changed."""
    fields = re.findall(r'tai\.field @(\w+) = @(\w+)\["([^"]+)"\]([^\n]*)', text)
    adjoints = set(re.findall(r"(?:adjoint|dual) @(\w+)", text))
    changes, kernels = [], []
    for tree in re.finditer(r"tai\.tree @(\w+)\s*:\s*!tai\.root<", text):
        root = Level("root", {}, tree.start(), tree.end())
        parse_levels(text, tree.end(), root)
        for level in root.levels:
            primal = None
            for name, of, place, clauses in fields:
                shape = find_place(level, place) if of == tree[1] else None
                if shape is not None and name not in adjoints:
                    assert "offset" not in clauses and "order" not in clauses
                    primal = (name, [shape[a] for a in sorted(shape, key=AXES.index)])
                    break
            # A gradient elsewhere than its field stays dense.
            if primal is None or level.kind != "dense":
                continue
            changes.append((level, layout))
            kernels.append(primal)
    for level, kind in sorted(changes, key=lambda change: -change[0].begin):
        body = text[level.head : level.end]
        axes = level.extents.items()
        if kind == "bitmasked":
            new = f"bitmasked<[{', '.join(f'{a}: {n}' for a, n in axes)}], {body}"
        else:
            blocks = {a: next(b for b in (4, 3, 2, 1) if n % b == 0) for a, n in axes}
            outer = ", ".join(f"{a}: {n // blocks[a]}" for a, n in axes)
            inner = ", ".join(f"{a}: {b}" for a, b in blocks.items())
            new = f"{kind}<[{outer}], dense<[{inner}], {body}>"
        text = text[: level.begin] + new + text[level.end :]
    launches = ""
    for number, (name, shape) in enumerate(kernels):
        axes = AXES[: len(shape)]
        zeros = ", ".join(["%zero"] * len(shape))
        ends = ", ".join(f"%n{a}" for a in axes)
        indices = ", ".join(f"%{a}" for a in axes)
        text += f"\ntai.kernel @make_active_{number}() {{\n  %zero = arith.constant 0 : index\n"
        for axis, extent in zip(axes, shape, strict=True):
            text += f"  %n{axis} = arith.constant {extent} : index\n"
        text += f"  tai.parallel_for ({indices}) = ({zeros}) to ({ends}) {{\n"
        text += f"    tai.activate @{name}[{indices}] level 1\n  }}\n  tai.return\n}}\n"
        launches += f" tai.launch @make_active_{number}() : () -> ()"
    # On the same line, so that lines keep their numbers.
    text = re.sub(r"(func\.func @main\(\) \{)", rf"\1{launches}", text)
    return text, len(kernels)


def run_lines(file: Path, tools: dict[str, str]) -> list[str]:
    """The commands of a file, with the tools by their paths."""
    commands, rest = [], ""
    for line in re.findall(r"RUN:\s*(.*)", file.read_text()):
        if line.endswith("\\"):
            rest += line[:-1]
            continue
        command = (rest + line).replace("%s", str(file)).replace("%t", f"{file}.tmp")
        rest = ""
        for name, path in tools.items():
            command = re.sub(rf"(?<![\w/.-]){re.escape(name)}(?![\w/.-])", path, command)
        commands.append(command)
    return commands


def run(file: Path, tools: dict[str, str]) -> str:
    """Runs the commands of a file; returns the output of the first failing one."""
    for command in run_lines(file, tools):
        done = subprocess.run(
            ["bash", "-o", "pipefail", "-c", command], capture_output=True, text=True
        )
        if done.returncode != 0:
            return f"{command}\n{done.stdout}{done.stderr}"
    return ""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--layouts", default="pointer,bitmasked,hash")
    parser.add_argument("--only", help="names of files, with commas between them")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--log", type=Path, help="file of results, as JUnit writes them")
    parser.add_argument("tools", nargs="+", help="paths of tai-run, tai-opt, FileCheck, not")
    args = parser.parse_args()
    tools = {os.path.basename(path): path for path in args.tools}
    names = (
        args.only.split(",") if args.only else sorted(f.name for f in args.folder.glob("*.mlir"))
    )
    files = []
    for layout in args.layouts.split(","):
        (args.output / layout).mkdir(parents=True, exist_ok=True)
        for name in names:
            text, changed = convert((args.folder / name).read_text(), layout)
            # A gradient is checked by differences on dense trees alone.
            if changed and not re.search(r"check[._]gradient", text):
                files.append(args.output / layout / name)
                files[-1].write_text(text)
    with ThreadPoolExecutor(args.jobs) as pool:
        problems = list(pool.map(lambda file: run(file, tools), files))
    for file, problem in zip(files, problems, strict=True):
        if problem:
            print(f"FAIL {file.parent.name}/{file.name}\n{problem}")
    if args.log:
        suite = ElementTree.Element("testsuite")
        for file, problem in zip(files, problems, strict=True):
            case = ElementTree.SubElement(
                suite, "testcase", classname=file.parent.name, name=file.name
            )
            if problem:
                ElementTree.SubElement(case, "failure").text = problem
        ElementTree.ElementTree(suite).write(args.log)
    failed = sum(bool(problem) for problem in problems)
    print(f"{len(files) - failed} files agree, {failed} fail")
    return 1 if failed or not files else 0


if __name__ == "__main__":
    sys.exit(main())
