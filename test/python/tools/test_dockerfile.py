"""The Dockerfile and the devcontainer, read without docker: their images and commands are ours."""

import fnmatch
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "scripts"))

import make_wheels as wheel  # noqa: E402

# The bundle of test_gpu.py has neither.
pytestmark = pytest.mark.skipif(not (ROOT / "Dockerfile").exists(), reason="no Dockerfile here")
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


def test_images_are_the_debian_of_the_readme():
    [supported] = set(re.findall(r"On Debian (\d+)", (ROOT / "README.md").read_text()))
    images = [stage.image for stage in stages()]
    assert [image.removesuffix("-slim") for image in images] == [f"debian:{supported}"] * 2
    container = json.loads((ROOT / ".devcontainer/devcontainer.json").read_text())
    assert container["image"].endswith(f":{DEBIAN[supported]}")


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


def test_the_last_command_is_one_of_the_package():
    [words] = [json.loads(words) for name, words in stages()[-1].steps if name == "CMD"]
    done = subprocess.run([sys.executable, *words[1:]], capture_output=True, text=True)
    assert words[0] == "python" and done.returncode == 0, done.stderr


def test_commands_are_right_for_the_shell():
    for command in (command for stage in stages() for command in stage.runs()):
        done = subprocess.run(["sh", "-n", "-c", command], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr


def test_builds_of_the_checkout_stay_outside():
    """A build folder of another place would stop CMake; the history names the commit."""
    ignored = (ROOT / ".dockerignore").read_text().split()
    for name in ("build", "build-portable", "dist", ".venv"):
        assert any(fnmatch.fnmatch(name, pattern.strip("/")) for pattern in ignored), name
    assert not any(fnmatch.fnmatch(".git", pattern.strip("/")) for pattern in ignored)
