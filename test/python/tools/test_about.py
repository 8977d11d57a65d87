"""`ti.info`, `python -m tai`, and the errors of an installation that does not fit."""

import json
import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest
import tai as ti
from tai import about, doctor
from tai._impl.base import native

PACKAGE = Path(ti.__file__).parent


def tai(*words: object, **variables: str) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-m", "tai", *map(str, words)],
        capture_output=True, text=True, env=os.environ | variables,
    )  # fmt: skip


def test_one_version():
    assert native.version() == ti.__version__


def test_info_names_versions_and_machine():
    ti.init(offline_cache=False)
    found = ti.info()
    assert found.version == ti.__version__
    assert found.llvm.startswith("22.")
    assert Path(found.libtai).name.startswith("libtai.so.") and Path(found.libtai).exists()
    assert found.python.endswith(".".join(map(str, sys.version_info[:3])))
    assert found.cache == ""
    assert found.arch == "cpu" or "TI_ARCH" in os.environ or found.arch == "cuda"
    assert "numpy" in found.packages
    lines = str(found).splitlines()
    assert lines[0].split() == ["version", ti.__version__]
    assert "none" in next(line for line in lines if line.startswith("cache"))


def test_commit_of_a_built_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "build.json").write_text('{"commit": "0123456789ab"}')
    monkeypatch.setattr(about, "_PACKAGE", tmp_path)
    about.commit.cache_clear()
    assert about.commit() == "0123456789ab"
    monkeypatch.setattr(about, "_PACKAGE", tmp_path / "lib" / "tai")
    about.commit.cache_clear()
    assert about.commit() == "unknown"
    monkeypatch.undo()
    about.commit.cache_clear()


@pytest.mark.parametrize(
    ("options", "variables", "expected"),
    [
        ({"offline_cache_file_path": "/a/b"}, {}, "/a/b"),
        ({}, {"TAI_CACHE_DIR": "/c"}, "/c"),
        ({}, {"TAI_CACHE_DIR": None, "XDG_CACHE_HOME": "/d"}, "/d/tai"),
        ({}, {"TAI_CACHE_DIR": None, "XDG_CACHE_HOME": None, "HOME": "/e"}, "/e/.cache/tai"),
    ],
)
def test_cache_folder(options, variables, expected, monkeypatch: pytest.MonkeyPatch):
    ti.reset()
    if options:
        ti.init(**options)
    for name, value in variables.items():
        if value is None:
            monkeypatch.delenv(name, raising=False)
        else:
            monkeypatch.setenv(name, value)
    assert about.cache_folder() == expected


def test_command_line():
    done = tai("info", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["version"] == ti.__version__
    done = tai("--version")
    assert done.stdout.startswith(f"tai {ti.__version__} (commit ") and "LLVM 22." in done.stdout
    done = tai()
    assert done.returncode == 2 and "doctor" in done.stdout
    done = tai("no-such-command")
    assert done.returncode == 2 and "invalid choice" in done.stderr
    # Options behind the command belong to it.
    done = tai("paper", "--list")
    assert done.returncode == 0 and "diffmpm" in done.stdout
    assert "usage: python -m tai.view" in tai("view", "--help").stdout


def test_doctor(tmp_path: Path):
    done = tai("doctor", TAI_CACHE_DIR=str(tmp_path / "cache"))
    assert done.returncode == 0, done.stdout + done.stderr
    grades = {line.split()[1]: line.split()[0] for line in done.stdout.splitlines()[:-1]}
    assert grades["compiler"] == grades["versions"] == grades["cache"] == "ok"
    assert done.stdout.endswith("all is well\n")


def test_doctor_finds_what_is_wrong(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o777)
    monkeypatch.setenv("TAI_CACHE_DIR", str(shared))
    monkeypatch.setattr(doctor, "__version__", "0.0.1")
    monkeypatch.setattr(doctor, "_gradient", lambda arch: "the gradient is off")
    found = doctor.examine()
    assert found["versions"].grade == found["compiler"].grade == "FAIL"
    assert found["cache"].grade == "note" and "chmod go-w" in found["cache"].remedy
    assert doctor.main() == 1


def copy_without_module(folder: Path) -> Path:
    ignored = shutil.ignore_patterns("_core*", "__pycache__")
    shutil.copytree(PACKAGE, folder / "tai", ignore=ignored)
    return folder / "tai"


def last_error(folder: Path, program: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=folder,
        env=os.environ | {"PYTHONPATH": str(folder)},
    )  # fmt: skip
    assert done.returncode == 1
    return done.stderr.splitlines()[-1]


def test_another_python_is_one_line(tmp_path: Path):
    package = copy_without_module(tmp_path)
    message = last_error(tmp_path, "import tai")
    assert message.startswith("ImportError: tai has no extension module for CPython 3.")
    assert "`make build`" in message and native.WHEELS in message
    (package / "_core.cpython-310-x86_64-linux-gnu.so").touch()
    message = last_error(tmp_path, "import tai")
    assert "this installation has _core.cpython-310-x86_64-linux-gnu.so" in message


def test_an_older_python_is_refused_first(tmp_path: Path):
    """Neither its syntax nor a missing NumPy is the first complaint."""
    package = copy_without_module(tmp_path)
    for path in package.rglob("*.py"):
        if path.name not in ("__init__.py", "native.py", "types.py"):
            path.write_text("match = = 1\n")
    (tmp_path / "numpy.py").write_text("raise ImportError('no numpy')\n")
    message = last_error(tmp_path, "import tai")
    assert message.startswith("ImportError: tai has no extension module for CPython 3.")


def test_library_that_cannot_be_loaded_is_one_line(tmp_path: Path):
    package = copy_without_module(tmp_path)
    (package / f"_core{sysconfig.get_config_var('EXT_SUFFIX')}").write_text("no library")
    message = last_error(tmp_path, "import tai as ti; ti.init()")
    assert message.startswith("ImportError: the compiled part of tai cannot be loaded: ")
    assert native.WHEELS in message
