"""Checks wheels of `make wheel`: names, size, licences, checksums, and auditwheel's opinion.

    scripts/check_wheel.py [dist/tai-*.whl ...] [--install]

auditwheel must find the platform of the name, or an older one. With --install, the wheel of this
interpreter is installed into a new virtual environment, where `python -m tai doctor` runs.
The SBOM must be valid CycloneDX 1.5.
Needs auditwheel and cyclonedx-python-lib[json-validation] from PyPI. `make wheel` makes the wheels.
"""

from __future__ import annotations

import argparse
import base64
import csv
import hashlib
import io
import re
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
MOST_BYTES = 60_000_000
MUST_HAVE = [
    r"tai/__init__\.py", r"tai/build\.json", r"tai/lib/libtai\.so\.\d+\.\d+", r"tai/bin/tai-opt",
    r"tai/licenses/LICENSE\.llvm", r"tai/licenses/LICENSE\.pybind11",
    r"tai-[^/]*\.dist-info/licenses/LICENSE", r"tai-[^/]*\.dist-info/sboms/tai\.cdx\.json",
]  # fmt: skip
MUST_NOT_HAVE = r"__pycache__|\.pyc$|\.cpp$|\.h$|(^|/)\.git"


def complaints(path: Path) -> list[str]:
    """The faults of a wheel that its contents show."""
    found = []
    name = re.fullmatch(r"tai-[^-]+-cp(3\d+)-cp\1-(manylinux_\d+_\d+)_x86_64\.whl", path.name)
    if not name:
        return [f"{path.name} is no name of a wheel of tai"]
    if path.stat().st_size > MOST_BYTES:
        found.append(f"{path.stat().st_size / 1e6:.1f} MB, at most {MOST_BYTES // 1_000_000}")
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
        if names[:-1] != sorted(names[:-1]) or not names[-1].endswith(".dist-info/RECORD"):
            found.append("its entries are not sorted, with RECORD last")
        if len({entry.date_time for entry in archive.infolist()}) != 1:
            found.append("its entries have different times")
        module = rf"tai/_core\.cpython-{name[1]}-x86_64-linux-gnu\.so"
        for pattern in [*MUST_HAVE, module]:
            if not any(re.fullmatch(pattern, entry) for entry in names):
                found.append(f"it lacks {pattern}")
        found += [f"it contains {entry}" for entry in names if re.search(MUST_NOT_HAVE, entry)]
        modules = [entry for entry in names if entry.startswith("tai/_core")]
        if len(modules) != 1:
            found.append(f"it has {len(modules)} extension modules: {', '.join(modules)}")
        rows = list(csv.reader(io.StringIO(archive.read(names[-1]).decode())))
        if {row[0] for row in rows} != set(names):
            found.append("RECORD lists other files than the archive has")
        for entry, digest, _ in rows:
            if not digest or entry not in names:
                continue
            sum_of = hashlib.sha256(archive.read(entry)).digest()
            expected = base64.urlsafe_b64encode(sum_of).rstrip(b"=").decode()
            if digest != f"sha256={expected}":
                found.append(f"{entry} differs from RECORD")
    return found


def audit(path: Path) -> str:
    """auditwheel's complaint, or nothing."""
    words = [sys.executable, "-m", "auditwheel", "show", str(path)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    text = " ".join(done.stdout.split())
    tag = re.search(r'following platform tag: "(\w+)"', text)
    if done.returncode != 0 or not tag:
        return f"auditwheel: {text or done.stderr[-500:]}"
    found, named = re.findall(r"manylinux_2_(\d+)", f"{tag[1]} {path.name}") or (0, 0)
    return "" if int(found) <= int(named) else f"auditwheel finds {tag[1]}"


def validate(path: Path) -> str:
    """CycloneDX's complaint about the SBOM, or nothing."""
    from cyclonedx.schema import SchemaVersion
    from cyclonedx.validation.json import JsonStrictValidator

    with zipfile.ZipFile(path) as archive:
        name = next(n for n in archive.namelist() if n.endswith("/sboms/tai.cdx.json"))
        text = archive.read(name).decode()
    error = JsonStrictValidator(SchemaVersion.V1_5).validate_str(text)
    return f"{name}: {error}" if error else ""


def install(path: Path) -> str:
    """Installs a wheel into a new environment, and asks the doctor; returns its complaint."""
    with tempfile.TemporaryDirectory() as folder:
        python = Path(folder) / "bin/python"
        for words in (
            [sys.executable, "-m", "venv", folder],
            [python, "-m", "pip", "install", "-q", path.resolve()],
            [python, "-m", "tai", "doctor"],
        ):
            done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=folder)
            if done.returncode != 0:
                return done.stdout + done.stderr
    return ""


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("wheels", nargs="*", type=Path)
    parser.add_argument("--install", action="store_true")
    args = parser.parse_args()
    wheels = args.wheels or sorted((ROOT / "dist").glob("tai-*.whl"))
    own = f"-cp{sys.version_info.major}{sys.version_info.minor}-"
    failed = 0 if wheels else 1
    for path in wheels:
        wrong = [*complaints(path), *filter(None, [audit(path), validate(path)])]
        if args.install and own in path.name:
            wrong += filter(None, [install(path)])
        failed += bool(wrong)
        print(f"{'FAIL' if wrong else 'ok'} {path.name}, {path.stat().st_size / 1e6:.1f} MB")
        for line in wrong:
            print(f"  {line}")
    print(f"check_wheel: {len(wheels) - failed} passed, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
