"""Kernels in cells of notebooks: their source is found, also when a cell is run again."""

from pathlib import Path

import numpy as np
import pytest

nbclient = pytest.importorskip("nbclient")
nbformat = pytest.importorskip("nbformat")

NOTEBOOKS = Path(__file__).resolve().parents[3] / "examples/notebooks"


@pytest.fixture(autouse=True)
def folders(tmp_path, monkeypatch):
    """Empty folders in the place of the user's set-up of Jupyter."""
    for name in ("IPYTHONDIR", "JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR"):
        monkeypatch.setenv(name, str(tmp_path / name))


def run(cells, tmp_path):
    """Runs cells one after the other; returns the output of each."""
    client = nbclient.NotebookClient(cells, timeout=280, resources={"metadata": {"path": tmp_path}})
    client.execute()
    shown = []
    for cell in cells.cells:
        outputs = cell.get("outputs", [])
        texts = [o.get("text") or o.get("data", {}).get("text/plain", "") for o in outputs]
        shown.append("".join(texts))
    return shown


def notebook(*sources):
    return nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(s) for s in sources])


def test_the_tutorial(tmp_path):
    made = nbformat.read(NOTEBOOKS / "tutorial.ipynb", as_version=4)
    assert not any(cell.get("outputs") for cell in made.cells), "commit it without outputs"
    text = run(made, tmp_path)
    (fill,) = (t for t in text if t.startswith("array"))
    assert eval(fill.replace("float32", "np.float32"), {"array": np.array, "np": np})[7] == 3.5
    first, last = eval(next(t for t in text if t.startswith("(8.0")))
    assert first == 8 and last < 1e-3
    error = next(t for t in text if "spede" in t)
    assert "4 |         x[i] = spede * i" in error.replace("    4", "4") and "^^^^^" in error


KERNEL = """
@ti.kernel
def set(a: ti.f32):
    for i in x:
        x[i] = {}
"""


def test_cells_that_are_run_again(tmp_path):
    start = "import tai as ti\nti.init()\nx = ti.field(ti.f32, 3, needs_grad=True)"
    start += "\nloss = ti.field(ti.f32, (), needs_grad=True)"
    helper = "@ti.func\ndef twice(a):\n    return 2 * a"
    show = "set(3.0)\nx.to_numpy().tolist()"
    cells = notebook(
        start, KERNEL.format("a"), show, KERNEL.format("a + i"), show,
        # Magics, comments, and functions of other cells.
        "%time print(1)\n" + KERNEL.format("a * a") + "set(2.0)\nprint(x[0])",
        helper, "# A comment.\n\n" + KERNEL.format("twice(a)"), show,
        "@ti.kernel\ndef total():\n    for i in x:\n        loss[None] += x[i] ** 2\n"
        "with ti.ad.Tape(loss):\n    total()\nx.grad.to_numpy().tolist()",
        "import linecache\nlinecache.checkcache()\n" + KERNEL.format("a - 1") + "set(2.0)\nx[1]",
    )  # fmt: skip
    text = run(cells, tmp_path)
    assert text[2] == "[3.0, 3.0, 3.0]" and text[4] == "[3.0, 4.0, 5.0]"
    assert "4.0\n" in text[5] and text[8] == "[6.0, 6.0, 6.0]"
    assert text[9] == "[12.0, 12.0, 12.0]" and text[10] == "1.0"


def test_cells_without_a_source(tmp_path):
    # IPython keeps the text of such a cell nowhere.
    cells = notebook(
        "import tai as ti\nti.init()\nx = ti.field(ti.f32, 3)",
        "%%time\n" + KERNEL.format("a") + "try: set(1.0)\nexcept ti.TaiError as e: print(e)",
    )
    text = run(cells, tmp_path)[1]
    assert "define kernels in a cell without %%time" in text
