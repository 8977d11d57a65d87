"""Builds the wheels of all CPythons that are found, around one libtai: `make wheel`.

    scripts/make_wheels.py [--bundle dist/tai-portable-...] [--headers FOLDER ...] [--download]

The build backend makes the wheel of the interpreter that runs this script, against the libtai
of the portable bundle. For each other CPython of PYTHONS the extension module alone is compiled,
against that version's headers, and takes the place of the first one's. Headers come from
interpreters on this machine (python3.X, pyenv), from --headers (roots of a file system with
usr/include/python3.X) and, with --download, from Debian's packages of other releases.

dist/ gets the wheels, the source distribution, an SBOM in CycloneDX's format, and SHA256SUMS. The
same commit gives the same bytes: times are those of the commit or SOURCE_DATE_EPOCH, and
the entries of archives are sorted.
"""

from __future__ import annotations

import argparse
import base64
import csv
import hashlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
# The oldest glibc that has all symbols of libtai; scripts/check_wheel.py compares.
PLATFORM = "manylinux_2_35_x86_64"
MOST_BYTES = 60_000_000
# Debian's releases whose packages contain the headers of a CPython.
RELEASES = {"3.11": "bookworm", "3.13": "trixie", "3.14": "sid"}
# Linked into libtai or copied beside it, with Debian's package that says the version.
PARTS = {
    "LLVM and MLIR": ("libmlir-22-dev", "Apache-2.0 WITH LLVM-exception"),
    "SLEEF": ("libsleef3", "BSL-1.0"),
    "zlib": ("zlib1g-dev", "Zlib"),
    "zstd": ("libzstd-dev", "BSD-3-Clause"),
}


def run(*words: object, **options: object) -> str:
    """Runs a command; returns its output, or ends the script with it."""
    done = subprocess.run(
        [str(word) for word in words], text=True, capture_output=True, cwd=ROOT, **options
    )  # type: ignore[call-overload]
    if done.returncode != 0:
        sys.exit(f"wheel: {' '.join(map(str, words))}\n{done.stdout[-4000:]}{done.stderr[-4000:]}")
    return done.stdout


def version() -> str:
    text = (ROOT / "python/tai/_version.py").read_text()
    return re.search(r'^__version__ = "(.*)"', text, re.MULTILINE)[1]  # type: ignore[index]


def commit_time() -> str:
    return os.environ.get("SOURCE_DATE_EPOCH") or run("git", "log", "-1", "--format=%ct").strip()


def headers_in(include: Path, python: str) -> list[Path] | None:
    """The include folders of a CPython below `include`, if they are there."""
    found = include / f"python{python}"
    if not (found / "Python.h").exists():
        return None
    # Debian's pyconfig.h includes <x86_64-linux-gnu/python3.X/pyconfig.h>.
    split = include / "x86_64-linux-gnu" / f"python{python}" / "pyconfig.h"
    if not split.exists():
        return [found]
    # The other headers of that folder, those of a C library, must not be found.
    alone = Path(tempfile.mkdtemp(prefix="tai-headers-"))
    target = alone / "x86_64-linux-gnu" / f"python{python}"
    target.mkdir(parents=True)
    shutil.copy(split, target)
    return [found, alone]


def download(python: str, folder: Path) -> Path | None:
    """Unpacks Debian's package of headers, with lists of its own; nothing is installed."""
    release = RELEASES.get(python)
    keyring = Path("/usr/share/keyrings/debian-archive-keyring.gpg")
    if release is None or not shutil.which("apt-get") or not keyring.exists():
        return None
    state = folder / release
    (state / "lists/partial").mkdir(parents=True)
    (state / "cache/archives/partial").mkdir(parents=True)
    source = f"deb [signed-by={keyring}] http://deb.debian.org/debian {release} main\n"
    (state / "sources.list").write_text(source)
    options = []
    for name, value in {
        "Dir::Etc::sourcelist": state / "sources.list", "Dir::Etc::sourceparts": "-",
        "Dir::State::lists": state / "lists", "Dir::Cache": state / "cache",
    }.items():  # fmt: skip
        options += ["-o", f"{name}={value}"]
    run("apt-get", *options, "update", "-q")
    package = f"libpython{python}-dev"
    words = ["apt-get", *map(str, options), "download", "-q", package]
    subprocess.run(words, cwd=state, check=True, capture_output=True)
    for archive in state.glob("*.deb"):
        run("dpkg", "-x", archive, state / "root")
    return state / "root" / "usr/include"


def find_headers(python: str, roots: list[Path], folder: Path | None) -> list[Path] | None:
    """The include folders of a CPython: of this machine, of `roots`, or downloaded."""
    if python == f"{sys.version_info.major}.{sys.version_info.minor}":
        return [Path(sysconfig.get_path("include"))]
    program = shutil.which(f"python{python}")
    places = [Path(program).resolve().parents[1] / "include"] if program else []
    places += sorted(Path.home().glob(f".pyenv/versions/{python}.*/include"))
    places += [root / "usr/include" for root in roots]
    for place in places:
        if found := headers_in(place, python):
            return found
    if folder and (place := download(python, folder)):
        return headers_in(place, python)
    return None


def compile_module(python: str, headers: list[Path], bundle: Path, folder: Path) -> Path:
    """Compiles the extension module for another CPython; returns its path."""
    suffix = f".cpython-{python.replace('.', '')}-x86_64-linux-gnu.so"
    build = folder / f"build-{python}"
    settings = {
        "CMAKE_BUILD_TYPE": "Release", "CMAKE_CXX_COMPILER": "clang++-22",
        "CMAKE_C_COMPILER": "clang-22", "CMAKE_SHARED_LINKER_FLAGS": "-fuse-ld=lld",
        "CMAKE_MODULE_LINKER_FLAGS": "-fuse-ld=lld", "TAI_PREBUILT": bundle, "SKBUILD": "ON",
        "TAI_PYTHON_HEADERS": ";".join(map(str, headers)), "TAI_PYTHON_SUFFIX": suffix,
        "Python3_EXECUTABLE": sys.executable,
    }  # fmt: skip
    run(
        "cmake",
        "-G",
        "Ninja",
        "-S",
        ROOT,
        "-B",
        build,
        *(f"-D{k}={v}" for k, v in settings.items()),
    )
    run("cmake", "--build", build, "--parallel", os.environ.get("JOBS", "2"))
    run(
        "cmake", "--install", build, "--component", "python", "--prefix", folder / python, "--strip"
    )
    return folder / python / "tai" / f"_core{suffix}"


def pack(files: dict[str, bytes], modes: dict[str, int], tag: str, to: Path, epoch: int) -> Path:
    """Writes a wheel: sorted entries, one time, RECORD last."""
    info = next(name.split("/")[0] for name in files if ".dist-info/" in name)
    record = f"{info}/RECORD"
    files = {name: data for name, data in files.items() if name != record}
    wheel = files[f"{info}/WHEEL"].decode()
    wheel = re.sub(r"(?m)^Tag: .*\n", "", wheel).rstrip("\n") + f"\nTag: {tag}\n"
    files[f"{info}/WHEEL"] = wheel.encode()
    rows = io.StringIO()
    writer = csv.writer(rows, lineterminator="\n")
    for name in sorted(files):
        digest = base64.urlsafe_b64encode(hashlib.sha256(files[name]).digest()).rstrip(b"=")
        writer.writerow([name, f"sha256={digest.decode()}", len(files[name])])
    writer.writerow([record, "", ""])
    path = to / f"{info.removesuffix('.dist-info')}-{tag}.whl"
    moment = time.gmtime(max(epoch, 315532800))[:6]
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name in [*sorted(files), record]:
            entry = zipfile.ZipInfo(name, moment)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system = 3
            entry.external_attr = (modes.get(name, 0o100644)) << 16
            archive.writestr(entry, rows.getvalue().encode() if name == record else files[name])
    return path


def bill_of_materials(epoch: int) -> bytes:
    """The parts of a wheel as CycloneDX 1.5; scripts/check_wheel.py validates the text."""
    components = []
    for name, (package, licence) in PARTS.items():
        asked = ["dpkg-query", "-W", "-f=${Version}", package]
        done = subprocess.run(asked, capture_output=True, text=True, check=False)
        found = done.stdout or "unknown"
        components.append({
            "type": "library", "name": name, "version": found, "bom-ref": f"{package}@{found}",
            "purl": f"pkg:deb/debian/{package}@{found}", "licenses": [{"expression": licence}],
        })  # fmt: skip
    import pybind11

    components.append({
        "type": "library", "name": "pybind11", "version": pybind11.__version__,
        "bom-ref": "pybind11", "purl": f"pkg:pypi/pybind11@{pybind11.__version__}",
        "licenses": [{"license": {"id": "BSD-3-Clause"}}],
    })  # fmt: skip
    components.append({
        "type": "file", "name": "libdevice.10.bc", "bom-ref": "libdevice",
        "licenses": [{"license": {"name": "CUDA Toolkit EULA, attachment A"}}],
    })  # fmt: skip
    stamp = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(epoch))
    main = {
        "type": "library", "name": "tai", "version": version(), "bom-ref": "tai",
        "licenses": [{"expression": "Apache-2.0 WITH LLVM-exception"}],
    }  # fmt: skip
    bom = {
        "bomFormat": "CycloneDX", "specVersion": "1.5", "version": 1,
        "metadata": {"timestamp": stamp, "component": main}, "components": components,
    }  # fmt: skip
    return (json.dumps(bom, indent=2) + "\n").encode()


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--bundle", type=Path, help="a folder; default: the newest of dist/")
    parser.add_argument("--headers", type=Path, nargs="*", default=[], help="roots to search")
    parser.add_argument("--download", action="store_true", help="headers from Debian's packages")
    parser.add_argument("--out", type=Path, default=ROOT / "dist")
    args = parser.parse_args()
    bundle = (args.bundle or ROOT / f"dist/tai-portable-{version()}-linux-x86_64").resolve()
    if not (bundle / "lib/libtai.so").exists():
        sys.exit(f"wheel: {bundle} has no lib/libtai.so: run scripts/portable.sh first")
    os.environ["SOURCE_DATE_EPOCH"] = epoch = commit_time()
    commit = run("git", "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*").strip()
    os.environ["TAI_COMMIT"] = commit
    args.out.mkdir(parents=True, exist_ok=True)
    made, missing = [], []
    with tempfile.TemporaryDirectory(prefix="tai-wheel-") as temporary:
        folder = Path(temporary)
        settings = [f"-Ccmake.define.TAI_PREBUILT={bundle}", "-Cinstall.strip=true"]
        run(sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation",
            *settings, "-w", folder, ROOT)  # fmt: skip
        with zipfile.ZipFile(next(folder.glob("tai-*.whl"))) as archive:
            entries = [entry for entry in archive.infolist() if not entry.is_dir()]
            first = {entry.filename: archive.read(entry) for entry in entries}
            modes = {e.filename: (e.external_attr >> 16) & 0o111 for e in entries}
        modes = {name: 0o100755 if bits else 0o100644 for name, bits in modes.items()}
        info = next(name.split("/")[0] for name in first if ".dist-info/" in name)
        first[f"{info}/sboms/tai.cdx.json"] = bill_of_materials(int(epoch))
        own = next(name for name in first if re.fullmatch(r"tai/_core\..*\.so", name))
        for python in PYTHONS:
            headers = find_headers(python, args.headers, folder if args.download else None)
            if headers is None:
                missing.append(python)
                continue
            files = dict(first)
            short = f"cp{python.replace('.', '')}"
            if short.replace("cp", "cpython-") not in own:
                module = compile_module(python, headers, bundle, folder)
                del files[own]
                files[f"tai/{module.name}"] = module.read_bytes()
                modes[f"tai/{module.name}"] = 0o100755
            tag = f"{short}-{short}-{PLATFORM}"
            made.append(pack(files, modes, tag, args.out, int(epoch)))
            print(f"wheel: {made[-1].name}, {made[-1].stat().st_size / 1e6:.1f} MB", flush=True)
    (ROOT / "COMMIT").write_text(commit + "\n")
    try:
        code = "import sys; from scikit_build_core.build import build_sdist as b; b(sys.argv[1])"
        run(sys.executable, "-c", code, args.out)
    finally:
        (ROOT / "COMMIT").unlink()
    made.append(args.out / f"tai-{version()}.tar.gz")
    bom = args.out / f"tai-{version()}.cdx.json"
    bom.write_bytes(bill_of_materials(int(epoch)))
    made.append(bom)
    sums = [f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}" for path in made]
    (args.out / "SHA256SUMS").write_text("\n".join(sums) + "\n")
    for python in missing:
        print(f"wheel: no headers of CPython {python}: no wheel (--headers, --download)")
    large = [p.name for p in made if p.stat().st_size > MOST_BYTES]
    if large:
        print(f"wheel: error: larger than {MOST_BYTES // 1_000_000} MB: {', '.join(large)}")
    return 1 if large else 0


if __name__ == "__main__":
    sys.exit(main())
