"""The files and commands of docs/guides/ir.md, with their output."""

import difflib
import os
import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PAGE = ROOT / "docs/guides/ir.md"
BUILD = Path(os.environ.get("TAI_BUILD_DIR", ROOT / "build"))
LLVM = Path(os.environ.get("TAI_LLVM_BIN", "/usr/lib/llvm-22/bin"))
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.M | re.S)
pytestmark = pytest.mark.skipif(
    not (BUILD / "lib/TaiPlugin.so").exists(), reason="this machine has no tools of tai"
)
# The first line of a file names it: "// stencil.mlir: …", "/* … */" or "# …".
NAME = re.compile(r"^(?://|/\*|#) ([\w.]+): ")


def blocks() -> list[tuple[str, str]]:
    return BLOCK.findall(PAGE.read_text())


def files() -> dict[str, str]:
    found = {}
    for kind, text in blocks():
        if kind not in ("sh", "text", "diff"):
            name = NAME.match(text)
            assert name, f"a block of {kind} names no file: {text[:60]}"
            assert name[1] not in found, f"two blocks are {name[1]}"
            found[name[1]] = text
    return found


def commands() -> list[tuple[str, str]]:
    """Each block of commands, with the text that the page says it prints."""
    found = []
    for kind, text in blocks():
        if kind == "sh":
            found.append((text, ""))
        elif kind == "text":
            found[-1] = (found[-1][0], text)
    return found


def run(command: str, folder: Path) -> subprocess.CompletedProcess:
    environment = {
        **os.environ,
        "PATH": os.pathsep.join([str(BUILD / "bin"), str(LLVM), os.environ["PATH"]]),
        "TAI": str(BUILD),
        "PKG_CONFIG_PATH": str(BUILD / "lib/pkgconfig"),
        "TAI_CACHE_DIR": str(folder / "cache"),
    }
    return subprocess.run(
        ["bash", "-euo", "pipefail", "-c", command], cwd=folder, env=environment, text=True,
        capture_output=True, timeout=300,
    )  # fmt: skip


def test_commands_print_what_the_page_says(tmp_path):
    for name, text in files().items():
        (tmp_path / name).write_text(text)
    # In the order of the page: a command may use the files that an earlier one has made.
    for command, expected in commands():
        done = run(command, tmp_path)
        # A command may end with an error, which the page then shows.
        printed = done.stdout + done.stderr
        assert done.returncode == 0 or "error:" in expected, f"{command}{printed}"
        difference = "\n".join(difflib.ndiff(expected.splitlines(), printed.splitlines()))
        assert expected.strip() == printed.strip(), f"{command}{difference}"


def test_every_file_is_used():
    text = "\n".join(command for command, _ in commands())
    for name in files():
        assert name in text or name == "CMakeLists.txt", f"no command uses {name}"
