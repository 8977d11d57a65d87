"""Runs the examples in the descriptions of ops, types and passes through tai-opt.

Each ```mlir block of include/tai/**/*.td must parse. An example may use values that it does not
define: they get the types that the parser expects. Blocks without such values are verified, too.
With `--list` the blocks are counted by file.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BLOCK = re.compile(r"```mlir\n(.*?)```", re.S)
# Separates the input of a pass from its output: two examples.
BECOMES = re.compile(r"^\s*// becomes\b.*\n", re.M)
OWNER = re.compile(r"^def (\w+)", re.M)
MISMATCH = re.compile(
    r"use of value '(%[\w#]+)' expects different type than prior uses: '([^\n]+)' vs '"
)


@dataclass
class Example:
    file: Path
    line: int
    owner: str
    text: str

    @property
    def place(self) -> str:
        return f"{self.file.relative_to(ROOT)}:{self.line}: {self.owner}"


def examples() -> list[Example]:
    found = []
    for file in sorted((ROOT / "include/tai").rglob("*.td")):
        source = file.read_text()
        for block in BLOCK.finditer(source):
            owners = OWNER.findall(source[: block.start()])
            line = source.count("\n", 0, block.start()) + 2
            for part in BECOMES.split(block[1]):
                found.append(Example(file, line, owners[-1] if owners else "?", part))
                line += part.count("\n") + 1
    return found


def defined(text: str) -> set[str]:
    """Values that the text defines: results, arguments of regions and of functions."""
    names = set()
    for line in text.splitlines():
        if results := re.match(r"\s*((?:%\w+(?::\d+)?\s*,?\s*)+)=", line):
            names.update(re.findall(r"%\w+", results[1]))
        for header in re.findall(r"(?:parallel_for|parallel) \(([^)]*)\)", line):
            names.update(re.findall(r"%\w+", header))
        for header in re.findall(r"(?:@\w+|\^\w+)\(([^)]*:[^)]*)\)", line):
            names.update(re.findall(r"(%\w+)\s*:", header))
        names.update(re.findall(r"for (?:unsigned )?(%\w+) =", line))
        for header in re.findall(r"iter_args\(([^)]*)\)", line):
            names.update(re.findall(r"(%\w+) =", header))
    return names


def wrap(text: str, given: dict[str, str]) -> str:
    """The text with its free values defined, in a kernel if it is not a module of its own."""
    values = "".join(f'%{n[1:]} = "given.value"() : () -> {t}\n' for n, t in given.items())
    if text.lstrip().startswith("!"):
        return f"!example = {text.strip()}\n"
    top = r"^\s*(tai\.(kernel|tree|field)|func\.func|gpu\.module|llvm\.func|![\w]+ =|#\w+ =)"
    if re.search(top, text, re.M):
        # A module: the free values are defined at the beginning of each body.
        return re.sub(r"(tai\.kernel @\w+\([^{]*\)[^{\n]*\{\n)", rf"\1{values}", text)
    return f"tai.kernel @example() {{\n{values}{text}\ntai.return\n}}\n"


def parse(opt: str, source: str, verify: bool) -> str:
    """The first error, or nothing."""
    command = [opt, "-", "-o", "/dev/null", "--allow-unregistered-dialect"]
    if not verify:
        command.append("--mlir-very-unsafe-disable-verifier-on-parsing")
        command.append("--verify-each=false")
    run = subprocess.run(command, input=source, capture_output=True, text=True)
    return "" if run.returncode == 0 else run.stderr or f"exit status {run.returncode}"


def check(opt: str, example: Example) -> str:
    """The fault of an example, or nothing."""
    text = example.text
    used = set(re.findall(r"%\w+", re.sub(r"//.*", "", text)))
    given = dict.fromkeys(sorted(used - defined(text)), "index")
    error = ""
    for _ in range(4 * len(given) + 1):
        error = parse(opt, wrap(text, given), verify=False)
        mismatch = MISMATCH.search(error)
        if not mismatch or mismatch[1] not in given:
            break
        given[mismatch[1]] = mismatch[2]
    if (
        error
        or given
        or "@" in re.sub(r"tai\.kernel @\w+|tai\.field @\w+|tai\.tree @\w+", "", text)
    ):
        return error
    return parse(opt, wrap(text, given), verify=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--opt", default=str(ROOT / "build/bin/tai-opt"), help="the tool")
    parser.add_argument("--list", action="store_true", help="print the examples of each file")
    args = parser.parse_args()
    found = examples()
    if args.list:
        for example in found:
            print(example.place)
    failed = 0
    for example in found:
        if error := check(args.opt, example):
            failed += 1
            print(f"{example.place}: the example does not parse\n{error.strip()}\n")
    print(f"{len(found) - failed} of {len(found)} examples parse")
    return 1 if failed or not found else 0


if __name__ == "__main__":
    sys.exit(main())
