"""Runs the Python tests of this checkout against an installed wheel, as its users have it.

    scripts/test_wheel.py [dist/tai-*.whl] [--folder FOLDER] [-- words for pytest, e.g. --quick]

Makes a virtual environment, installs the wheel and the packages that tests use, at the versions of
scripts/requirements.txt, and runs `pytest test/python` there. Nothing of the checkout's own package
is imported, and neither a compiler nor LLVM is needed: only Python with `venv`, and libstdc++.
Tests whose parts are missing (torch, a display) are skipped with their reason.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
REQUIREMENTS = ROOT / "scripts/requirements.txt"
# Parts of requirements.txt; the others build the package and check its style.
SECTIONS = ("Run time", "Tests", "Notebooks, in the tests")


def packages(text: str) -> list[str]:
    """The packages that tests use, without their versions."""
    parts = re.split(r"^# (.*)\n", text, flags=re.MULTILINE)
    found = dict(zip(parts[1::2], parts[2::2]))
    return [line.split("==")[0] for name in SECTIONS for line in found[name].split()]


def choose(names: list[str], version: tuple[int, int]) -> str:
    """The wheel of this Python, or the end with a line that says which there are."""
    tag = f"-cp{version[0]}{version[1]}-"
    fitting = [name for name in names if tag in name]
    if not fitting:
        there = ", ".join(re.findall(r"-(cp\d+)-", " ".join(names))) or "none"
        sys.exit(f"test_wheel: no wheel for CPython {version[0]}.{version[1]}: there are {there}")
    return fitting[-1]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("wheels", nargs="*", type=Path, help="default: those in dist/")
    parser.add_argument("--folder", type=Path, help="of the environment; default: a temporary one")
    at = sys.argv.index("--") if "--" in sys.argv else len(sys.argv)
    args = parser.parse_args(sys.argv[1:at])
    wheels = args.wheels or sorted((ROOT / "dist").glob("tai-*.whl"))
    wheel = Path(choose([str(path) for path in wheels], sys.version_info[:2])).resolve()
    with tempfile.TemporaryDirectory(prefix="tai-wheel-") as temporary:
        folder = args.folder or Path(temporary)
        python = folder / "bin/python"
        variables = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME")}

        def run(*words: object, must: bool = True) -> subprocess.CompletedProcess:
            command = [str(word) for word in words]
            return subprocess.run(command, cwd=ROOT, env=variables, check=must)

        run(sys.executable, "-m", "venv", folder)
        pip = [python, "-m", "pip", "install", "-q", "--disable-pip-version-check"]
        run(*pip, wheel)
        run(*pip, "-c", REQUIREMENTS, *packages(REQUIREMENTS.read_text()))
        code = "import tai, pathlib; print(pathlib.Path(tai.__file__).parent)"
        words = [str(python), "-c", code]
        asked = subprocess.run(words, cwd=folder, env=variables, capture_output=True, text=True)
        if asked.returncode != 0:
            sys.exit(f"test_wheel: the package cannot be imported:\n{asked.stderr}")
        # Tests look for tools in bin/ below the build folder.
        variables["TAI_BUILD_DIR"] = asked.stdout.strip()
        print(f"test_wheel: {wheel.name} in {asked.stdout.strip()}", flush=True)
        words = sys.argv[at + 1 :] or ["-q", "-rs", "--tb=short"]
        tests = [] if any(word.startswith("test/") for word in words) else ["test/python"]
        return run(python, "-m", "pytest", *tests, *words, must=False).returncode


if __name__ == "__main__":
    sys.exit(main())
