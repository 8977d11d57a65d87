"""The definition of an essential line of a simulator."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "scripts"))

import line_counts  # noqa: E402

SOURCE = '''"""A program.

Its text does not count."""

import tai as ti

DT = 1e-3  # counts
TABLE = [1, 2]
args = options.parse_args()

x = ti.field(
    float, shape=3
)


@ti.func
def helper(i):
    """Not this line."""
    return x[i]


@ti.kernel
def step():
    for i in x:

        # Nor these two.
        x[i] = helper(i)


@ti.kernel
def descend():
    x[0] -= 1


@ti.ad.grad_replaced
def advance():
    step()


@ti.ad.grad_for(advance)
def back():
    step.grad()


@ti.kernel
def other():
    x[1] = 0


def iteration(first):
    second = other
    with ti.ad.Tape(loss):
        first()
        second()
    descend()


iteration(advance)
'''


def test_essential_lines():
    lines = SOURCE.splitlines()
    found = [lines[number - 1].strip() for number in sorted(line_counts.essential(SOURCE))]
    expected = [
        "DT = 1e-3  # counts", "x = ti.field(", "float, shape=3", ")", "@ti.func",
        "def helper(i):", "return x[i]", "@ti.kernel", "def step():", "for i in x:",
        "x[i] = helper(i)", "@ti.ad.grad_replaced", "def advance():", "step()",
        "@ti.ad.grad_for(advance)", "def back():", "step.grad()", "@ti.kernel",
        "def other():", "x[1] = 0",
    ]  # fmt: skip
    assert found == expected
    # Docstrings, comments and blank lines are no code.
    assert len(line_counts.code_lines(SOURCE)) == len(expected) + 13


def test_the_table_has_all_simulators():
    command = [sys.executable, str(ROOT / "scripts/line_counts.py")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    for name in ("billiards", "electric", "mass_spring", "rigid_body", "smoke"):
        assert f"| {name} | " in done.stdout
    assert "| 75 |" in done.stdout
