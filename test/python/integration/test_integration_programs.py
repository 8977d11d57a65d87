"""Whole programs in IR have the same results on a GPU as on the CPU.

The commands are those of the tests in `test/Integration/CPU`: their checks of the CPU's output hold
for the GPU's, which may differ in the last digits of numbers. Without `--arch=cuda`, on the
emulated device.
"""

import os
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from device_tensors import ON_GPU

ROOT = Path(__file__).resolve().parents[3]
FOLDER = ROOT / "test" / "Integration" / "CPU"
BIN = Path(os.environ.get("TAI_BUILD_DIR", ROOT / "build")) / "bin"
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
# Options for the CPU alone: it counts visited cells, has assembly, merges loops as host functions,
# keeps sums without a lost digit.
ABOUT_THE_CPU = (
    "--skips", "--compile-profile", "--print-ir=asm", "--threads=2", "--threads=7",
    "--sums=compensated",
)  # fmt: skip


def commands():
    """(file, options) of the tests that run one whole file."""
    found = {}
    for path in sorted(FOLDER.glob("*.mlir")):
        for line in re.findall(r"RUN: (?:not )?tai-run %s(.*)", path.read_text()):
            options = re.split(r"2>&1|\||>", line)[0].split()
            if not any(option in ABOUT_THE_CPU for option in options):
                options = [option for option in options if option != "--threads=1"]
                found[path.name, *options] = (path, options)
    return [pytest.param(*value, id="".join(key)) for key, value in found.items()]


def run(path, options, arch):
    environment = os.environ | {"TI_ARCH": ""}
    if os.environ.get("TI_ARCH") != "cuda":
        environment["TAI_CUDA_EMULATION"] = "1"
    return subprocess.run(
        [BIN / "tai-run", path, *options, f"--arch={arch}"],
        capture_output=True, text=True, check=False, env=environment,
    )  # fmt: skip


@pytest.mark.parametrize("path, options", commands())
def test_as_on_the_cpu(path, options):
    if path.name == "words.mlir" and os.environ.get("TI_ARCH") == "cuda":
        pytest.skip("it shows what a sum loses in the order of a CPU")
    if path.name == "bf16-denormals.mlir" and ON_GPU:
        pytest.skip("it shows bits of a NaN, which are others on a GPU")
    cpu, gpu = (run(path, options, arch) for arch in ("cpu", "cuda"))
    assert gpu.returncode == cpu.returncode, gpu.stderr
    for ours, theirs in ((gpu.stdout, cpu.stdout), (gpu.stderr, cpu.stderr)):
        assert NUMBER.sub("#", ours) == NUMBER.sub("#", theirs)
        np.testing.assert_allclose(
            np.array(NUMBER.findall(ours), float), np.array(NUMBER.findall(theirs), float),
            rtol=1e-5, atol=1e-7,
        )  # fmt: skip


def test_commands_were_found():
    names = {parameter.values[0].name for parameter in commands()}
    assert {"mass-spring.mlir", "sparse-tape.mlir", "debug-index.mlir"} <= names
    assert len(names) > 20
