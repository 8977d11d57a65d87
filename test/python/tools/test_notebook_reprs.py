"""Pictures of fields, layouts and tapes in notebooks, and the line of a GUI without a window."""

import base64
import io
import re

import numpy as np
import pytest
import tai as ti
from tai._impl.drawing.frames import FrameLoop
from tai._impl.fields.root import name_fields


@pytest.fixture(autouse=True)
def program(fresh_program):
    ti.init(offline_cache=False)


def test_statistics_of_fields():
    x = ti.field(ti.f32, shape=4, name="x")
    x.from_numpy(np.array([1, np.nan, 3, np.inf], np.float32))
    assert "min 1, max 3, mean 2; 2 of 4 not finite" in x._repr_html_()
    i = ti.field(ti.i32, shape=3)
    i.from_numpy(np.array([1, 2, 6]))
    assert "min 1, max 6, mean 3" in i._repr_html_()
    assert "not placed" in ti.field(ti.f32)._repr_html_()
    x.fill(np.nan)
    assert "none of 4 numbers is finite" in x._repr_html_()


def test_pictures_of_fields():
    Image = pytest.importorskip("PIL.Image")
    x = ti.field(ti.f32, shape=(4, 2))
    x[3, 1] = 1  # right, at the top
    for field in (x, ti.Vector.field(3, ti.f32, (4, 2))):
        (data,) = re.findall(r"base64,([^\"]*)", field._repr_html_())
        with Image.open(io.BytesIO(base64.b64decode(data))) as picture:
            pixels = np.asarray(picture)
        assert pixels.shape[1] == 2 * pixels.shape[0]
        if field is x:
            assert pixels[0, -1] == 255 and pixels[-1, -1] == pixels[0, 0] == 0
    assert "<img" not in ti.Vector.field(2, ti.f32, (4, 2))._repr_html_()
    s = ti.types.struct(a=ti.f32, b=ti.i32).field(shape=3)
    assert s._repr_html_().count("min 0") == 2


def test_layouts():
    x, v = ti.field(ti.f32, name="x"), ti.Vector.field(2, ti.f64, name="v")
    block = ti.root.pointer(ti.ij, 4)
    block.dense(ti.ij, (2, 8)).place(x, v)
    assert block.as_tree().splitlines() == [
        "pointer(ti.ij, (4, 4))", "  dense(ti.ij, (2, 8))", "    x: f32", "    v: f64 of shape (2,)"
    ]  # fmt: skip
    assert block._repr_html_().startswith("<pre>pointer")
    assert ti.root._repr_html_().startswith("<pre>ti.root\n  pointer")


def test_tapes():
    x = ti.field(ti.f32, shape=4, needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def run():
        for i in x:
            loss[None] += x[i]

    tape = ti.ad.Tape(loss)
    assert repr(tape) == "<ti.ad.Tape: nothing recorded yet>"
    with tape:
        run()
        assert repr(tape) == "<ti.ad.Tape: records, 1 so far>"
    pattern = r"<ti.ad.Tape: 1 records, 0 skipped .*, \d+ bytes of old values>"
    assert re.fullmatch(pattern, repr(tape))


def test_names_that_notebooks_give():
    first, second = ti.field(ti.f32, shape=2), ti.field(ti.f32, shape=2)
    name_fields({"_": first, "__": first, "_12": first, "_i3": first, "Out": [first]})
    assert first.name == "first"  # the variable that holds it
    name_fields({"_": first, "pressure": first, "_own": second})
    assert first.name == "pressure" and second.name == "_own"


def test_a_gui_without_a_window_says_so_once(capsys, monkeypatch, tmp_path):
    pytest.importorskip("PIL")
    monkeypatch.setattr(FrameLoop, "_is_told", False)
    monkeypatch.delenv("TAI_GUI_DIR", raising=False)
    gui = ti.GUI("a", res=16)
    gui.show(str(tmp_path / "a.png"))
    assert capsys.readouterr().err == ""
    gui.show()
    gui.show()
    (line,) = capsys.readouterr().err.splitlines()
    assert "python -m tai.view" in line and "TAI_GUI_DIR" in line
    monkeypatch.setattr(FrameLoop, "_is_told", False)
    gui = ti.GUI("a", res=16, frames_dir=str(tmp_path / "frames"))
    gui.show()
    assert str(tmp_path / "frames") in capsys.readouterr().err
