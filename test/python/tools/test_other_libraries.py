"""Pages for users of other libraries: the programs there run, and ours print the same numbers.

`make test-peers` installs the libraries; a program whose library is missing is skipped.
"""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

GUIDES = Path(__file__).resolve().parents[3] / "docs/guides"
# The library of each page, and the relative error of its numbers.
LIBRARIES = {"taichi": ("taichi", 1e-6), "warp": ("warp", 1e-6), "jax": ("jax", 1e-9),
             "pytorch": ("torch", 1e-9)}  # fmt: skip
QUIET = {"ENABLE_TAICHI_HEADER_PRINT": "0", "JAX_PLATFORMS": "cpu"}


def run(program: str, folder: Path) -> subprocess.CompletedProcess:
    file = folder / "program.py"
    file.write_text(program)
    environment = os.environ | QUIET
    command = [sys.executable, str(file)]
    return subprocess.run(command, capture_output=True, text=True, cwd=folder, env=environment)


def numbers(line: str) -> list[float]:
    return [float(word) for word in re.findall(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?", line)]


def needs(library: str) -> None:
    if importlib.util.find_spec(library) is None:
        pytest.skip(f"{library} is not installed: make peers")


def beside(page: str) -> tuple[str, str]:
    """The first program of another library, and ours behind it."""
    text = (GUIDES / f"from-{page}.md").read_text()
    found = re.search(r"```py\n(.*?)```.*?```python\n(.*?)```", text, re.DOTALL)
    assert found, page
    return found[1], found[2]


@pytest.mark.parametrize("page", LIBRARIES)
def test_both_programs_promise_the_same(page):
    """Ours keeps it in test_guides.py, the other one below."""
    theirs, ours = beside(page)
    assert re.search(rf"^import {LIBRARIES[page][0]}\b", theirs, re.MULTILINE)
    promised = [
        re.findall(r"^print\(.*\)  # (.*)", program, re.MULTILINE) for program in (theirs, ours)
    ]
    assert promised[0] == promised[1] and len(promised[0]) == 1


@pytest.mark.parametrize("page", LIBRARIES)
def test_program_of_the_other_library(page, tmp_path):
    library, error = LIBRARIES[page]
    needs(library)
    theirs, ours = beside(page)
    found = []
    for program in (theirs, ours):
        done = run(program, tmp_path)
        assert done.returncode == 0, done.stderr
        # Libraries print lines of their own first.
        found.append(numbers(done.stdout.splitlines()[-1]))
    assert len(found[0]) == len(found[1]) > 0
    np.testing.assert_allclose(found[0], found[1], rtol=error)


def test_one_program_of_taichi_needs_no_other_change():
    theirs, ours = beside("taichi")
    assert theirs.replace("import taichi as ti", "import tai as ti") == ours


def test_the_pendulum_in_place_has_another_gradient_in_taichi(tmp_path):
    needs("taichi")
    text = (GUIDES / "from-taichi.md").read_text()
    ours = re.findall(r"```python\n(.*?)```", text, re.DOTALL)[1]
    done = run(ours.replace("import tai as ti", "import taichi as ti"), tmp_path)
    assert done.returncode == 0, done.stderr
    said = re.search(r"Taichi 1\.7\.4 prints `(.*?)`", text)
    assert done.stdout.splitlines()[-1] == said[1]


# The table of from-taichi.md: a program for each kind of its rows, what Taichi makes of it, and its
# loss in NumPy.

SCENE = """import {library} as ti
ti.init(arch=ti.cpu, default_fp=ti.f64)
x = ti.field(float, shape=4, needs_grad=True)
y = ti.field(float, shape=4, needs_grad=True)
loss = ti.field(float, shape=(), needs_grad=True)
for i in range(4):
    x[i] = 0.5 + 0.1 * i
{program}
with ti.ad.Tape(loss):
    run()
print(*[x.grad[i] for i in range(4)])
"""

ROWS = {}


def row(cell: str, result: str, program: str):
    """A program of the row with this text in the first column."""

    def keep(function):
        ROWS[function.__name__] = (cell, result, program, function)
        return function

    return keep


@row("more than 31 iterations", "crash", """
@ti.kernel
def run():
    for i in x:
        a = x[i]
        for j in range(40):
            a = 1.1 * ti.sin(a)
        loss[None] += a
""")  # fmt: skip
def carried(x):
    for _ in range(40):
        x = 1.1 * np.sin(x)
    return x.sum()


@row("`while`", "refused", """
@ti.kernel
def run():
    for i in x:
        a = x[i]
        while a < 3.0:
            a = 1.5 * a * a + a
        loss[None] += a
""")  # fmt: skip
def while_loop(x):
    for _ in range(20):
        x = np.where(x < 3.0, 1.5 * x * x + x, x)
    return x.sum()


@row("`break`", "refused", """
@ti.kernel
def run():
    for i in x:
        a = x[i]
        for j in range(10):
            if a > 3.0:
                break
            a = 1.5 * a * a + a
        loss[None] += a
""")  # fmt: skip
def break_of_a_loop(x):
    for _ in range(10):
        x = np.where(x <= 3.0, 1.5 * x * x + x, x)
    return x.sum()


@row("`continue`", "refused", """
@ti.kernel
def run():
    for i in x:
        a = x[i]
        for j in range(4):
            if a > 1.0:
                continue
            a = 1.5 * a * a
        loss[None] += a
""")  # fmt: skip
def continue_of_a_loop(x):
    for _ in range(4):
        x = np.where(x <= 1.0, 1.5 * x * x, x)
    return x.sum()


@row("elements that are overwritten", "wrong gradient", """
@ti.kernel
def start():
    for i in x:
        y[i] = x[i]

@ti.kernel
def step():
    for i in x:
        y[i] += 0.1 * ti.sin(y[i])

@ti.kernel
def measure():
    for i in x:
        loss[None] += y[i]

def run():
    start()
    for _ in range(10):
        step()
    measure()
""")  # fmt: skip
def overwritten(x):
    for _ in range(10):
        x = x + 0.1 * np.sin(x)
    return x.sum()


@row("statements beside loops", "refused", """
@ti.kernel
def run():
    c = 2.0 * x[0]
    for i in x:
        loss[None] += c * x[i]
""")  # fmt: skip
def beside_a_loop(x):
    return (2.0 * x[0] * x).sum()


@row("`atomic_max`", "wrong gradient", """
@ti.kernel
def run():
    for i in x:
        ti.atomic_max(loss[None], x[i] * x[i])
""")  # fmt: skip
def largest(x):
    return (x * x).max()


@row("`atomic_mul`", "wrong gradient", """
@ti.kernel
def start():
    loss[None] = 1.0

@ti.kernel
def multiply():
    for i in x:
        ti.atomic_mul(loss[None], x[i])

def run():
    start()
    multiply()
""")  # fmt: skip
def product(x):
    return x.prod()


@row("values that kernels return", "refused", """
@ti.kernel
def energy() -> float:
    total = 0.0
    for i in range(4):
        total += x[i] * x[i]
    return total

@ti.kernel
def add(value: float):
    loss[None] += 3.0 * value

def run():
    add(energy())
""")  # fmt: skip
def returned(x):
    return 3.0 * (x * x).sum()


def expected(function) -> np.ndarray:
    """Central differences of the loss in NumPy."""
    x, step = 0.5 + 0.1 * np.arange(4), 1e-6
    moves = step * np.eye(4)
    return np.array([function(x + move) - function(x - move) for move in moves]) / (2 * step)


def test_each_row_has_a_program():
    table = (GUIDES / "from-taichi.md").read_text().partition("## Differs")[0]
    lines = re.findall(r"^\| (.*?) \| (crash|refused|wrong gradient) \|", table, re.MULTILINE)
    for cell, result, _, _ in ROWS.values():
        assert any(cell in text and result == there for text, there in lines), cell
    assert all(any(row[0] in text for row in ROWS.values()) for text, _ in lines)
    assert len(lines) == 6


@pytest.mark.parametrize("name", ROWS)
def test_row(name, tmp_path):
    _, _, program, function = ROWS[name]
    done = run(SCENE.format(library="tai", program=program), tmp_path)
    assert done.returncode == 0, done.stderr
    np.testing.assert_allclose(numbers(done.stdout), expected(function), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", ROWS)
def test_row_in_taichi(name, tmp_path):
    needs("taichi")
    _, result, program, function = ROWS[name]
    done = run(SCENE.format(library="taichi", program=program), tmp_path)
    if result == "crash":
        assert done.returncode < 0
    elif result == "refused":
        assert done.returncode == 1 and re.search("auto_?diff", done.stderr), done.stderr
    else:
        assert done.returncode == 0, done.stderr
        found = numbers(done.stdout.splitlines()[-1])
        assert len(found) == 4 and not np.allclose(found, expected(function), rtol=1e-3)
