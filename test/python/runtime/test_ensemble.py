"""The example for several GPUs, with processes on CPUs: how they split changes no number."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import needed

ROOT = Path(__file__).resolve().parents[3]
EXAMPLE = ROOT / "examples" / "ensemble.py"


def find_python() -> str | None:
    """This interpreter, or that of the benchmark's peers, where it has torch and can load tai."""
    for python in (sys.executable, ROOT / "build/peers-venv/bin/python"):
        try:
            done = subprocess.run(
                [python, "-c", "import tai, torch.distributed"], env=environment()
            )
        except OSError:
            continue
        if done.returncode == 0:
            return str(python)
    return None


def environment() -> dict[str, str]:
    path = [*os.environ.get("PYTHONPATH", "").split(os.pathsep), str(needed.PACKAGE)]
    more = {"PYTHONPATH": os.pathsep.join(filter(None, path)), "OMP_NUM_THREADS": "1"}
    kept = {k: v for k, v in os.environ.items() if k not in ("TI_ARCH", "TAI_CUDA_EMULATION")}
    return kept | more


@pytest.fixture(scope="module")
def python():
    found = find_python()
    if not found:
        pytest.skip("no interpreter that has both tai and torch")
    return found


def train(python: str, processes: int, scenes: int) -> tuple[list[tuple[float, float]], str]:
    """(loss, norm of the weights) as they are printed, and the last line."""
    options = [str(EXAMPLE), "--scenes", str(scenes), "--steps", "40", "--iterations", "25"]
    launcher = []
    if processes > 1:
        launcher = ["-m", "torch.distributed.run", "--standalone"]
        launcher += ["--nproc-per-node", str(processes)]
    done = subprocess.run(
        [python, *launcher, *options], capture_output=True, text=True, env=environment(),
        timeout=240,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = re.findall(r"loss (\S+)  \|w\| (\S+)", done.stdout)
    return [(float(a), float(b)) for a, b in found], done.stdout.splitlines()[-1]


RUN_AND_LIST_THREADS = """
import contextlib, os, runpy, sys

del sys.argv[0]
sys.path[0] = os.path.dirname(sys.argv[0])
runpy.run_path(sys.argv[0], run_name="__main__")
for thread in os.listdir("/proc/self/task"):
    # It may end meanwhile, and one that was joined is listed until the system has cleared it away.
    PF_EXITING = 4
    with contextlib.suppress(OSError), open(f"/proc/self/task/{thread}/stat") as stat:
        start, _, end = stat.read().rpartition(")")
        if not int(end.split()[6]) & PF_EXITING:
            print("thread", start)
"""


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="needs the threads of a process")
def test_threads_of_the_process_group_end_with_it(python, tmp_path):
    """One that still lets go of a tensor at exit finds no interpreter, and the process aborts."""
    script = tmp_path / "run.py"
    script.write_text(RUN_AND_LIST_THREADS)
    done = subprocess.run(
        [python, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", script,
         EXAMPLE, "--scenes", "8", "--steps", "4", "--iterations", "2"],
        capture_output=True, text=True, env=environment(), timeout=240,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "thread" in done.stdout and "gloo" not in done.stdout


@pytest.mark.parametrize(
    "words, line",
    [
        (["--scenes", "0"], "argument --scenes: 0 is impossible; at least 1"),
        (["--steps", "many"], "argument --steps: 'many' is not a whole number"),
        (["--rate", "nan"], "argument --rate: nan is impossible; at least 0"),
        ([], "the ensemble needs torch, which is not installed: pip install torch"),
    ],
)
def test_bad_input(tmp_path, words, line):
    error = "raise ModuleNotFoundError('No module', name='torch')"
    (tmp_path / "torch.py").write_text(error)
    more = environment()
    more["PYTHONPATH"] = f"{tmp_path}{os.pathsep}{more['PYTHONPATH']}"
    done = subprocess.run(
        [sys.executable, EXAMPLE, *words], capture_output=True, text=True, env=more
    )
    assert done.returncode == 2
    assert done.stderr.startswith(f"ensemble: {line}") and done.stderr.count("\n") == 1


def test_two_processes_do_what_one_does(python):
    one, last = train(python, 1, 96)
    two, last_of_two = train(python, 2, 48)
    assert len(one) == 4 and one[-1][0] < 0.8 * one[0][0]
    for (loss, norm), (other, other_norm) in zip(one, two, strict=True):
        assert other == pytest.approx(loss, rel=2e-4)
        assert other_norm == pytest.approx(norm, rel=2e-4)
    assert last.startswith("1 x 96 scenes") and last_of_two.startswith("2 x 48 scenes")
    assert re.search(r"scaling \d\.\d\d of 2$", last_of_two)
