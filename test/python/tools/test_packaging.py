"""Metadata of the wheels, and the scripts that make and check them."""

import os
import re
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
import tai as ti
from tai._impl.base import native

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "scripts"))

import check_wheel  # noqa: E402
import make_wheels as wheel  # noqa: E402
import test_wheel  # noqa: E402

BIN = Path(os.environ.get("TAI_BUILD_DIR", ROOT / "build")) / "bin"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_one_list_of_pythons():
    prefix = "Programming Language :: Python :: 3."
    named = [c.removeprefix(prefix) for c in PROJECT["project"]["classifiers"] if prefix in c]
    assert [f"3.{minor}" for minor in named] == list(wheel.PYTHONS)
    first, last = wheel.PYTHONS[0], wheel.PYTHONS[-1]
    assert f"CPython {first} to {last} " in native.WHEELS
    assert PROJECT["project"]["requires-python"] == f">={first}"
    glibc = re.search(r"manylinux_(\d+)_(\d+)", wheel.PLATFORM)
    assert f"glibc {glibc[1]}.{glibc[2]} " in native.WHEELS
    page = (ROOT / "docs/start/install.md").read_text()
    assert f"{first} to {last}" in page and f"glibc {glibc[1]}.{glibc[2]}" in page


def test_version_is_found_by_the_backend():
    rule = PROJECT["tool"]["scikit-build"]["metadata"]["version"]
    found = re.search(rule["regex"], (ROOT / rule["input"]).read_text(), re.MULTILINE)
    assert found["value"] == ti.__version__ == wheel.version()


# The bundle of test_gpu.py has no such file.
@pytest.mark.skipif(not (ROOT / "CITATION.cff").exists(), reason="CITATION.cff is not here")
def test_the_citation_names_this_version():
    assert f"\nversion: {ti.__version__}\n" in (ROOT / "CITATION.cff").read_text()


def test_module_compiles_without_llvm():
    # Wheels compile it against a bundle, which has no headers of LLVM.
    assert "${PROJECT_SOURCE_DIR}/include" in (ROOT / "cmake/Prebuilt.cmake").read_text()
    left, seen = [*(ROOT / "python/src").glob("*.[ch]*")], set()
    while left:
        source = left.pop()
        for name in re.findall(r'^#include "((?:tai|mlir|llvm)/[^"]+)"', source.read_text(), re.M):
            assert name.startswith("tai/"), f"{source} includes {name}"
            if name not in seen:
                seen.add(name)
                left.append(ROOT / "include" / name)
    assert "tai/Support/XXHash.h" in seen


def test_commands_exist_as_tools():
    for name, target in PROJECT["project"]["scripts"].items():
        assert target == "tai.binaries:run"
        assert (BIN / name).exists(), name


def make(folder: Path, names: dict[str, bytes], python: str = "311") -> Path:
    info = "tai-1.0.dist-info"
    files = {f"{info}/WHEEL": b"Wheel-Version: 1.0\nTag: cp310-cp310-linux_x86_64\n", **names}
    tag = f"cp{python}-cp{python}-{wheel.PLATFORM}"
    return wheel.pack(files, {"tai/bin/tai-opt": 0o100755}, tag, folder, 1_700_000_000)


COMPLETE = {
    name: name.encode()
    for name in [
        "tai/__init__.py", "tai/build.json", "tai/lib/libtai.so.1.0", "tai/bin/tai-opt",
        "tai/licenses/LICENSE.llvm", "tai/licenses/LICENSE.pybind11",
        "tai-1.0.dist-info/licenses/LICENSE", "tai-1.0.dist-info/sboms/tai.cdx.json",
        "tai/_core.cpython-311-x86_64-linux-gnu.so", "tai-1.0.dist-info/METADATA",
    ]
}  # fmt: skip


def test_packing_is_reproducible_and_in_order(tmp_path: Path):
    (tmp_path / "again").mkdir()
    first = make(tmp_path, COMPLETE)
    again = make(tmp_path / "again", dict(reversed(COMPLETE.items())))
    assert first.read_bytes() == again.read_bytes()
    assert check_wheel.complaints(first) == []
    with zipfile.ZipFile(first) as archive:
        assert archive.getinfo("tai/bin/tai-opt").external_attr >> 16 == 0o100755
        text = archive.read("tai-1.0.dist-info/WHEEL").decode()
    assert re.findall("^Tag: (.*)$", text, re.MULTILINE) == [f"cp311-cp311-{wheel.PLATFORM}"]


@pytest.mark.parametrize(
    ("lacks", "adds", "message"),
    [
        ("tai/build.json", None, "it lacks"),
        ("tai/licenses/LICENSE.llvm", None, "it lacks"),
        ("tai/_core.cpython-311-x86_64-linux-gnu.so", None, "it has 0 extension modules"),
        (None, "tai/_core.cpython-312-x86_64-linux-gnu.so", "it has 2 extension modules"),
        (None, "tai/__pycache__/a.pyc", "it contains tai/__pycache__/a.pyc"),
    ],
)
def test_what_is_wrong_with_a_wheel(tmp_path: Path, lacks, adds, message):
    names = {name: data for name, data in COMPLETE.items() if name != lacks}
    if adds:
        names[adds] = b""
    assert any(message in line for line in check_wheel.complaints(make(tmp_path, names)))


def test_packages_that_tests_of_a_wheel_use():
    names = test_wheel.packages(test_wheel.REQUIREMENTS.read_text())
    assert {"numpy", "scipy", "pytest", "pytest-xdist", "nbclient"} <= set(names)
    assert not {"pybind11", "scikit-build-core", "mypy", "ruff"} & set(names)


def test_the_wheel_of_this_python_is_tested():
    names = [f"dist/tai-1.0-cp{n}-cp{n}-{wheel.PLATFORM}.whl" for n in ("311", "313")]
    assert test_wheel.choose(names, (3, 13)) == names[1]
    with pytest.raises(SystemExit, match=r"no wheel for CPython 3.12: there are cp311, cp313$"):
        test_wheel.choose(names, (3, 12))
    with pytest.raises(SystemExit, match="there are none"):
        test_wheel.choose([], (3, 12))


def test_headers_of_debian_are_separated(tmp_path: Path):
    include = tmp_path / "usr/include"
    (include / "python3.14").mkdir(parents=True)
    assert wheel.headers_in(include, "3.14") is None
    (include / "python3.14/Python.h").touch()
    assert wheel.headers_in(include, "3.14") == [include / "python3.14"]
    split = include / "x86_64-linux-gnu/python3.14"
    split.mkdir(parents=True)
    (split / "pyconfig.h").touch()
    (split.parent / "stdio.h").touch()
    found = wheel.headers_in(include, "3.14")
    assert (found[1] / "x86_64-linux-gnu/python3.14/pyconfig.h").exists()
    assert not list(found[1].rglob("stdio.h"))
