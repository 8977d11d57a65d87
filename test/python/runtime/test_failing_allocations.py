"""Memory that runs out in any allocation is an exception, and the program goes on."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import needed

HERE = Path(__file__).parent
SCENES = ("launches", "taped", "recomputed", "again", "copies", "sparse", "replayed")
MORE_SCENES = (
    "recomputed_replay", "forward", "hessian", "sparse_tape", "arrays", "batch", "vectors", "saved",
)  # fmt: skip
# 0 threads stand for the emulated device.
RUNS = [
    *((scene, threads) for scene in SCENES for threads in (1, 2)),
    *((scene, 1) for scene in MORE_SCENES),
    *((scene, 0) for scene in (*SCENES, *MORE_SCENES) if scene != "saved"),
]


@pytest.fixture(scope="module")
def hook(tmp_path_factory):
    compiler = needed.program("cc", "clang", "clang-22")
    library = tmp_path_factory.mktemp("hook") / "failing_allocations.so"
    source = HERE / "failing_allocations.c"
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", library, source], check=True)
    return library


@pytest.mark.parametrize(("scene", "threads"), RUNS)
def test_each_allocation_may_fail(hook, scene, threads):
    done = subprocess.run(
        [sys.executable, HERE / "failing_allocations.py", scene, str(threads)],
        env={
            **os.environ,
            "LD_PRELOAD": str(hook),
            "TI_ARCH": "cpu" if threads else "cuda",
            "TAI_CUDA_EMULATION": "" if threads else "1",
        },
        capture_output=True, text=True, timeout=550, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
    allocations, failed = map(int, done.stdout.split())
    assert 0 < failed <= allocations
