"""Metadata of wheels, the scripts that make and check them, and the files for containers."""

import fnmatch
import json
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path
from typing import NamedTuple

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


# The Dockerfile and the devcontainer, read without docker: their images and commands are ours.
# The bundle of test_gpu.py has neither.
of_docker = pytest.mark.skipif(not (ROOT / "Dockerfile").exists(), reason="no Dockerfile here")
DEBIAN = {"12": "bookworm", "13": "trixie"}


class Stage(NamedTuple):
    """One stage of a build: its base, its name, and its instructions with their words."""

    image: str
    name: str
    steps: list[tuple[str, str]]

    def runs(self) -> list[str]:
        return [words for instruction, words in self.steps if instruction == "RUN"]

    def packages(self) -> set[str]:
        found = re.findall(r"apt-get install ((?:(?!&&).)*)", " ".join(self.runs()))
        return {word for words in found for word in words.split() if not word.startswith("-")}


def read(text: str) -> list[Stage]:
    """The stages of a Dockerfile."""
    stages: list[Stage] = []
    text = re.sub(r"^#.*\n", "", text, flags=re.MULTILINE)
    for line in re.sub(r"\\\n", " ", text).splitlines():
        instruction, _, words = line.strip().partition(" ")
        if instruction == "FROM":
            image, _, name = words.partition(" AS ")
            stages.append(Stage(image, name, []))
        elif instruction:
            stages[-1].steps.append((instruction, words.strip()))
    return stages


def stages() -> list[Stage]:
    return read((ROOT / "Dockerfile").read_text())


def targets() -> set[str]:
    """The commands that `make help` lists."""
    return set(re.findall(r"^([a-z-]+):.*## ", (ROOT / "Makefile").read_text(), re.MULTILINE))


def test_stages_are_read():
    made = read("# about\nFROM a AS b\nRUN one \\\n && two\n\nFROM c\nCOPY --from=b x y\n")
    assert made == [
        Stage("a", "b", [("RUN", "one   && two")]),
        Stage("c", "", [("COPY", "--from=b x y")]),
    ]
    [stage] = read("FROM a\nRUN apt-get update && apt-get install -y b \\\n c && rm d\n")
    assert stage.packages() == {"b", "c"}


@of_docker
def test_images_are_the_debian_of_the_readme():
    [supported] = set(re.findall(r"On Debian (\d+)", (ROOT / "README.md").read_text()))
    images = [stage.image for stage in stages()]
    assert [image.removesuffix("-slim") for image in images] == [f"debian:{supported}"] * 2
    container = json.loads((ROOT / ".devcontainer/devcontainer.json").read_text())
    assert container["image"].endswith(f":{DEBIAN[supported]}")


@of_docker
def test_the_first_stage_runs_commands_of_the_readme():
    build, _ = stages()
    # Its packages are those that the README asks for; `scripts/setup.sh` installs the others.
    [asked] = re.findall(
        r"^On Debian \d+ with (\w+) and (\w+),", (ROOT / "README.md").read_text(), re.M
    )
    assert {*asked} <= build.packages()
    assert not {name for name in build.packages() if re.search("llvm|mlir|clang|cmake", name)}
    install, *commands = build.runs()
    assert install.startswith("apt-get update")
    makes = [re.fullmatch(r"make ([a-z-]+)", command) for command in commands]
    assert makes and all(command and command[1] in targets() for command in makes)
    assert ("COPY", ". .") in build.steps
    container = json.loads((ROOT / ".devcontainer/devcontainer.json").read_text())
    assert container["postCreateCommand"].split()[0] == "make"
    assert container["postCreateCommand"].split()[1] in targets()


@of_docker
def test_the_second_stage_installs_the_wheel_of_its_python():
    build, last = stages()
    release = DEBIAN[build.image.partition(":")[2]]
    [python] = [python for python, name in wheel.RELEASES.items() if name == release]
    [copied] = [words for instruction, words in last.steps if instruction == "COPY"]
    source = re.fullmatch(r"--from=(\S+) /src/(\S+) /tmp/", copied)
    assert source and source[1] == build.name and ("WORKDIR", "/src") in build.steps
    tags = [f"cp{number.replace('.', '')}" for number in wheel.PYTHONS]
    made = [f"dist/tai-{wheel.version()}-{tag}-{tag}-{wheel.PLATFORM}.whl" for tag in tags]
    matched = fnmatch.filter(made, source[2])
    assert matched == [name for name in made if f"-cp{python.replace('.', '')}-" in name]
    # Neither a compiler nor LLVM.
    assert {"python3", "python3-venv"} <= last.packages()
    assert not {name for name in last.packages() if re.search("llvm|clang|gcc|dev$", name)}


@of_docker
def test_the_last_command_is_one_of_the_package():
    [words] = [json.loads(words) for name, words in stages()[-1].steps if name == "CMD"]
    done = subprocess.run([sys.executable, *words[1:]], capture_output=True, text=True)
    assert words[0] == "python" and done.returncode == 0, done.stderr


@of_docker
def test_commands_are_right_for_the_shell():
    for command in (command for stage in stages() for command in stage.runs()):
        done = subprocess.run(["sh", "-n", "-c", command], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr


@of_docker
def test_builds_of_the_checkout_stay_outside():
    """A build folder of another place would stop CMake; the history names the commit."""
    ignored = (ROOT / ".dockerignore").read_text().split()
    for name in ("build", "build-portable", "dist", ".venv"):
        assert any(fnmatch.fnmatch(name, pattern.strip("/")) for pattern in ignored), name
    assert not any(fnmatch.fnmatch(".git", pattern.strip("/")) for pattern in ignored)
