"""The treatment by conftest.py of a failure on a device, and of a list that is not true."""

import os
import subprocess
import sys
from pathlib import Path

import device_lists

HERE = Path(__file__).parents[1]
LISTED = device_lists.FAILS_ON_A_DEVICE["test_zero_adjoints"]


def run(folder, name, text):
    """Runs a file of tests on the emulated device, with this folder's conftest.py."""
    file = folder / f"{name}.py"
    file.write_text(text)
    command = [sys.executable, "-m", "pytest", "-p", "conftest", "-q", "-rA", "--arch=emulated"]
    command += ["-p", "no:cacheprovider", "--rootdir", folder, file]
    places = [str(HERE), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(places)}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=folder)
    return done.returncode, done.stdout + done.stderr


def test_a_failure_is_one_whatever_it_says(tmp_path):
    text = "def test_it():\n    assert 1 == 2, 'this is not there on the GPU yet'\n"
    status, output = run(tmp_path, "test_anything", text)
    assert status == 1 and "1 failed" in output


def test_what_is_listed_fails_when_it_passes(tmp_path):
    first, *others = LISTED
    text = f"def {first}():\n    pass\n" + "".join(f"def {n}():\n    assert 0\n" for n in others)
    status, output = run(tmp_path, "test_zero_adjoints", text)
    assert status == 1
    assert f"1 failed, {len(others)} xfailed" in output
    assert f"[XPASS(strict)] {LISTED[first]}" in output


def test_what_is_listed_is_there(tmp_path):
    status, output = run(tmp_path, "test_zero_adjoints", "def test_it():\n    pass\n")
    assert status != 0
    assert f"lists what is not there: test_zero_adjoints.{next(iter(LISTED))}" in output
