"""Checks that `tai-opt --mlir-pass-statistics` tells of each pass of tai that it changes something.

Each pass is run by the commands of its tests, until one has a number. Passes that only check the
code have the number of ops that they saw.
"""

import re
import subprocess
import sys
from pathlib import Path

CHECKS = {
    "tai-check-access-rules",
    "tai-check-lowerable",
    "tai-verify-inlinable",
    "tai-verify-llvm",
}


SKIPPED = re.compile(r"verify-diagnostics|split-input-file|^-o$|%|/dev/null|[<>\\\\]|^2>&1$")
# The pipelines that run passes for which no test has a command of its own.
PIPELINES = {"--tai-to-llvm": "to-llvm.mlir", "--tai-to-nvvm": "to-nvvm.mlir"}


def find_commands(source: Path) -> list[tuple[Path, list[str]]]:
    """The files and flags of all lit tests that run `tai-opt`."""
    commands = []
    for path in sorted((source / "test").rglob("*.mlir")):
        text = path.read_text().replace("\\\n// RUN:", "")
        for line in re.findall(r"RUN: (?:not )?tai-opt %s ([^|\n]*)", text):
            flags = [flag for flag in line.split() if not SKIPPED.search(flag)]
            commands.append((path, [flag.replace('"', "").replace("'", "") for flag in flags]))
    for flag, name in PIPELINES.items():
        commands.append((source / "test/Pipelines" / name, [flag]))
    return commands


def main() -> None:
    tai_opt, source = sys.argv[1], Path(sys.argv[2])
    names = {
        name
        for path in (source / "include").rglob("*.td")
        for name in re.findall(r'^def \w+ *: *Pass<\s*"([^"]+)"', path.read_text(), re.M)
    }
    names.remove("tai-test-failure")  # It changes nothing, and fails.
    commands = find_commands(source)
    without = []
    for name in sorted(names):
        mentions = [c for c in commands if re.search(rf"[-(,]{name}(?![\w-])", " ".join(c[1]))]
        found = ""
        for path, flags in mentions[:6] + commands[-len(PIPELINES) :]:
            run = subprocess.run(
                [tai_opt, path, *flags, "--split-input-file", "--mlir-pass-statistics"]
                + ["-o", "/dev/null"],
                capture_output=True,
                text=True,
                check=False,
            )
            pattern = rf"^  {name}: \d+ runs?, (\d+) changed, [1-9]\d* ops(; .*)?$"
            row = re.search(pattern, run.stderr, re.M)
            if row and (name in CHECKS or (int(row[1]) and row[2])):
                found = row[0]
                break
        if not found:
            without.append(f"{name} ({len(mentions)} tests)")
        print(found[:160] or f"  {name}: nothing")
    print(f"{len(names) - len(without)} of {len(names)} passes have statistics")
    if without:
        sys.exit("without: " + ", ".join(without))


if __name__ == "__main__":
    main()
