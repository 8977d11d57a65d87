"""Reduces a module on which passes fail to a smaller one on which they fail in the same way.

The passes are those of a reproducer, or those of --passes. The reduced module is printed with
the command that shows the failure.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def read_pipeline(text: str) -> str | None:
    """The pipeline of a reproducer, as MLIR and the library write it."""
    match = re.search(r'pipeline: "((?:[^"\\]|\\.)*)"', text)
    return match and match[1].encode().decode("unicode_escape")


def run(command: list[str], path: Path) -> subprocess.CompletedProcess:
    return subprocess.run([*command, path], capture_output=True, text=True, errors="replace")


def find_message(result: subprocess.CompletedProcess) -> str:
    """The mark that tells this failure from others: the first error, without its place."""
    match = re.search(r"error: (.*)", result.stderr)
    return match[1] if match else ""


def write_test(path: Path, command: list[str], message: str, crashes: bool) -> None:
    """The script that tai-reduce asks: it ends with 1 where the failure is still there."""
    call = shlex.join(command) + ' "$1" -o /dev/null >/dev/null 2>"$0.err"'
    status = "[ $status -gt 1 ]" if crashes else "[ $status -eq 1 ]"
    if message:
        same = f'grep -qF -- {shlex.quote(message)} "$0.err"'
    else:
        same = "true" if crashes else '! grep -q "error:" "$0.err"'
    path.write_text(f"#!/bin/sh\n{call}\nstatus=$?\n{status} && {same} && exit 1\nexit 0\n")
    path.chmod(0o755)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path, help="a reproducer, or any .mlir file with --passes")
    parser.add_argument("--passes", help="options of tai-opt, in the place of the reproducer's")
    parser.add_argument("--message", help="a part of the output that must stay")
    parser.add_argument("--build", type=Path, default=ROOT / "build")
    args = parser.parse_args()
    pipeline = read_pipeline(args.file.read_text())
    if args.passes is None and pipeline is None:
        parser.error(f"{args.file} names no passes; give them with --passes")
    passes = shlex.split(args.passes) if args.passes else [f"--pass-pipeline={pipeline}"]
    os.environ.setdefault("LLVM_DISABLE_SYMBOLIZATION", "1")
    command = [str(args.build.resolve() / "bin/tai-opt"), "--mlir-disable-threading", *passes]
    first = run(command, args.file)
    if first.returncode == 0:
        parser.error("the passes do not fail on it; is it a failure of what follows them?")
    crashes = first.returncode < 0
    message = args.message or ("" if crashes else find_message(first))
    with tempfile.TemporaryDirectory() as folder:
        test = Path(folder) / "test.sh"
        write_test(test, command, message, crashes)
        reduced = args.file
        for number, options in enumerate(
            [
                f"--reduction-tree=traversal-mode=0 test={test}",
                f"--opt-reduction-pass=opt-pass=canonicalize test={test}",
                f"--tai-reduction=test={test}",
            ]
        ):
            made = Path(folder) / f"{number}.mlir"
            tool = [str(args.build / "bin/tai-reduce"), options, "-o", str(made)]
            if run(tool, reduced).returncode == 0 and run(["sh", str(test)], made).returncode:
                reduced = made
        print(f"// {shlex.join(['tai-opt', *passes])}\n{reduced.read_text()}", end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
