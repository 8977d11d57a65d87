"""Names that are loaded on first use stay the same, in any order of use."""

import subprocess
import sys

import pytest


@pytest.mark.parametrize("first", ["func", "data_oriented", "ad", "Tape", "math", "profiler"])
def test_kernel_is_the_decorator(first: str):
    program = f"import tai as ti; ti.{first}; assert callable(ti.kernel), ti.kernel"
    subprocess.run([sys.executable, "-c", program], check=True)
