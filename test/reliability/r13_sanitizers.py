"""R13: reports of sanitizers over the tests of the presets asan and tsan.

Builds each preset and runs its tests, as `make test PRESET=asan` does, and counts what they say
at the end. Takes long: most of it is the build, which is kept.

    python test/reliability/r13_sanitizers.py [--presets asan] [--jobs 2]
"""

import argparse
import os
import re
import subprocess
import sys

from bars import ROOT

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--presets", nargs="+", choices=["asan", "tsan"], default=["asan", "tsan"])
parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)


def run(preset, jobs):
    """The numbers of passed and failed tests, and of reports; None where nothing ran."""
    build = ROOT / f"build-{preset}"
    commands = [["ninja", "-C", build, f"-j{jobs}"]]
    if not (build / "build.ninja").exists():
        commands.insert(0, ["cmake", "--preset", preset])
    for command in commands:
        if subprocess.run(command, cwd=ROOT, stdout=sys.stderr).returncode != 0:
            return None
    tests = [sys.executable, ROOT / "scripts/run_tests.py", "--build", build, "--jobs", str(jobs)]
    process = subprocess.Popen(
        [*tests, "--sanitizer", preset], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    reports, passed, failed = None, 0, 0
    for line in process.stdout:
        print(line, end="", file=sys.stderr, flush=True)
        if found := re.match(r"reports: 1 passed, (\d+) failed", line):
            reports = int(found[1])
        elif found := re.match(r"(\d+) passed, (\d+) failed$", line):
            passed, failed = int(found[1]) - 1, int(found[2]) - (reports or 0)
    process.wait()
    return None if reports is None else (passed, failed, reports)


def main():
    args = parser.parse_args()
    words, met = [], True
    for preset in args.presets:
        numbers = run(preset, args.jobs)
        if numbers is None:
            words.append(f"{preset}: did not run")
            met = False
            continue
        passed, failed, reports = numbers
        words.append(f"{preset}: {passed} tests, {failed} failed, {reports} reports")
        met &= failed == reports == 0
    print(f"R13 reports of sanitizers: {'; '.join(words)} (bar 0)")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
