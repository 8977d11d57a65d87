"""Pictures of fields, layouts and tapes in notebooks, and the line of a GUI without a window."""

import base64
import io
import re

import numpy as np
import pytest
import tai as ti
from tai._impl.drawing.frames import FrameLoop
from tai._impl.fields import notebook
from tai._impl.fields.root import name_fields
from tai._impl.history import origins


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


def test_statistics_of_arrays():
    a = ti.ndarray(ti.f32, 4, needs_grad=True)
    a.from_numpy(np.array([1, np.nan, 3, 5], np.float32))
    text = a._repr_html_()
    assert text.startswith("<code>&lt;ti.ndarray of f32, shape (4,)&gt;</code>")
    assert "min 1, max 5, mean 3; 1 of 4 not finite" in text and "<img" not in text
    assert "min 0, max 0" in a.grad._repr_html_()
    assert "no elements" in ti.ndarray(ti.i32, (0, 3))._repr_html_()
    whole = ti.ndarray(ti.i32, ())
    whole[None] = 7
    assert "min 7, max 7, mean 7" in whole._repr_html_()
    vectors = ti.Vector.ndarray(3, ti.f64, 2)
    assert repr(vectors) == "<ti.ndarray of f64, shape (2,), elements of shape (3,)>"
    assert "too large" not in vectors._repr_html_()


def test_a_large_array_is_not_summarised(monkeypatch):
    monkeypatch.setattr(notebook, "_MOST", 6)
    assert "too large to summarise" in ti.Vector.ndarray(3, ti.f32, 3)._repr_html_()
    assert "max 0" in ti.Vector.ndarray(3, ti.f32, 2)._repr_html_()


def test_pictures_of_arrays():
    Image = pytest.importorskip("PIL.Image")
    x = ti.ndarray(ti.f32, (4, 2))
    x[3, 1] = 1  # right, at the top
    for array in (x, ti.Vector.ndarray(4, ti.f32, (4, 2))):
        (data,) = re.findall(r"base64,([^\"]*)", array._repr_html_())
        with Image.open(io.BytesIO(base64.b64decode(data))) as picture:
            pixels = np.asarray(picture)
        assert pixels.shape[1] == 2 * pixels.shape[0]
        if array is x:
            assert pixels[0, -1] == 255 and pixels[-1, -1] == pixels[0, 0] == 0
    assert "<img" not in ti.Vector.ndarray(2, ti.f32, (4, 2))._repr_html_()


def test_a_picture_is_no_reading_of_the_tape():
    x = ti.ndarray(ti.f32, (), needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def square(a: ti.types.ndarray()):
        a[None] = 3.0
        loss[None] += a[None] ** 2

    with ti.ad.Tape(loss):
        square(x)
        assert "max 3" in x._repr_html_() and not origins._of_thread.watches
        x.to_numpy()
        assert origins._of_thread.watches


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


class _Scene:
    def __repr__(self):
        return "scene <1>"

    @ti.kernel
    def run(self, x: ti.template(), scale: ti.f32):
        for i in x:
            x[i] *= scale


def test_kernels():
    x = ti.field(ti.f32, shape=4)

    @ti.kernel
    def small(a: ti.f32) -> ti.i32:
        return 1 if a < 2.0 else 0

    before = small._repr_html_()
    assert "small" in before and "not compiled yet" in before and ">IR<" not in before
    assert "a &lt; 2.0" in before and "<summary>source</summary>" in before
    small(1.0)
    assert "one kind of arguments" in small._repr_html_()
    assert "<summary>IR</summary><pre>" in small._repr_html_()
    assert "@small" in small._repr_html_()
    assert re.fullmatch(r"<gradient of <ti.kernel '.*small'>>", repr(small.grad))
    method = _Scene().run
    method(x, 2.0)
    assert repr(method) == "<<ti.kernel '_Scene.run'> of scene <1>>"
    assert "for i in x" in method._repr_html_() and "<summary>IR" in method._repr_html_()
    ti.reset()
    assert "not compiled yet" in small._repr_html_()


def test_a_kernel_without_a_source_and_a_long_one(monkeypatch):
    @ti.kernel
    def one() -> ti.i32:
        return 1

    one()
    monkeypatch.setattr(notebook, "_LETTERS", 10)
    assert "letters more</pre>" in one._repr_html_()

    def gone(function):
        raise OSError("could not get source code")

    monkeypatch.setattr(notebook.inspect, "getsource", gone)
    assert ">source<" not in one._repr_html_() and "<summary>IR" in one._repr_html_()


def test_tables_of_tapes():
    x = ti.field(ti.f32, shape=4, needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def square():
        for i in x:
            x[i] = x[i] * x[i] + 1.0

    @ti.kernel
    def add():
        for i in x:
            loss[None] += x[i]

    tape = ti.ad.Tape(loss)
    assert "nothing recorded yet" in tape._repr_html_()
    with tape:
        square()
        add()
        assert "2 so far" in tape._repr_html_()
    table = tape._repr_html_()
    assert "<td>records</td><td>2</td>" in table
    assert re.search(r"<td>peak bytes</td><td>[1-9][\d,]*</td>", table)


def test_optimisers_and_windows():
    x = ti.field(ti.f32, shape=4, needs_grad=True)
    assert repr(ti.optim.Adam([x], lr=0.1)) == "<ti.optim.Adam of x, lr 0.1>"
    assert repr(ti.optim.SGD([ti.ndarray(ti.f32, 3, needs_grad=True)], lr=1e-3)).endswith(
        "lr 0.001>"
    )
    pytest.importorskip("PIL")
    gui = ti.GUI("demo", res=(8, 4), show_gui=False)
    assert repr(gui) == "<ti.GUI 'demo' of 8×4 pixels, frame 0>"


def test_names_that_notebooks_give():
    first, second = ti.field(ti.f32, shape=2), ti.field(ti.f32, shape=2)
    name_fields({"_": first, "__": first, "_12": first, "_i3": first, "Out": [first]})
    assert first.name == "first"  # the variable that holds it
    name_fields({"_": first, "pressure": first, "_own": second})
    assert first.name == "pressure" and second.name == "_own"


def test_names_of_fields_in_containers():
    class Scene:
        def __init__(self):
            self.velocity = ti.field(ti.f32, shape=2)
            self.layers = [ti.field(ti.f32, shape=2) for _ in range(2)]

    scene = Scene()
    parts = {"left": ti.field(ti.f32, shape=2), 7: (ti.field(ti.f32, shape=2),)}
    assert scene.velocity.name == "velocity" and scene.layers[1].name == "layers_1"
    assert parts["left"].name == "parts_left"
    assert parts[7][0].name == "field"  # deeper than one looks
    assert ti.field(ti.f32, shape=2).name == "field"


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
