"""`ti.GUI` in windows of a display in memory: pictures on the screen, keys and clicks."""

import gc
import os
import subprocess
import sys

import numpy as np
import pytest
import tai as ti
from tai._impl.drawing import library
from tai._impl.drawing.frames import FrameLoop

from xvfb import display, screen  # noqa: F401  (fixtures)


def shown(gui, draw=lambda gui: None):
    """The picture that a GUI shows; draws twice, since events of a frame change the next one."""
    for _ in range(2):
        draw(gui)
        picture = np.asarray(gui.picture())
        gui.show()
    return picture


def test_the_screen_shows_the_picture(screen):  # noqa: F811
    with ti.GUI("toy", res=(120, 80), background_color=0x102030) as gui:
        assert gui.running

        def draw(gui):
            gui.circle((0.25, 0.75), color=0xFF0000, radius=9)
            gui.line((0.5, 0.25), (0.9, 0.25), color=0x00FF00, radius=2)
            gui.text("window", (0.1, 0.4))

        picture = shown(gui, draw)
        np.testing.assert_array_equal(screen.grab()[:80, :120], picture)
        assert picture[20, 30].tolist() == [255, 0, 0]
        assert screen.titles() == ["toy"]
    assert screen.titles() == [] and not gui.running


def test_a_window_of_an_odd_size(screen):  # noqa: F811
    """Rows of 3 × 37 bytes are no multiple of four."""
    with ti.GUI("odd", res=(37, 53)) as gui:
        picture = shown(gui, lambda gui: gui.circles(np.random.rand(40, 2), 3, 0x3366FF))
        np.testing.assert_array_equal(screen.grab()[:53, :37], picture)


def test_keys_and_mice(screen):  # noqa: F811
    with ti.GUI("keys", res=(400, 200)) as gui:
        gui.show()
        screen.focus("keys")
        screen.press("Control_L")
        screen.press("a")
        screen.release("a")
        screen.point(300, 50)
        screen.press(3)
        screen.point(100, 150)
        screen.tap(5)  # the wheel, downward
        gui.show()
        assert gui.get_cursor_pos() == (0.25, 0.25)
        assert gui.is_pressed("b", gui.RMB) and gui.is_pressed(gui.CTRL)
        assert not gui.is_pressed("a")
        assert gui.has_key_event()
        # Events that do not fit are skipped; events behind them can wait.
        assert gui.get_event((gui.PRESS, "a"))
        assert gui.event.modifier == (gui.CTRL,)
        assert gui.get_event(gui.RMB)
        assert gui.event == (gui.PRESS, gui.RMB, (0.75, 0.75), (gui.CTRL,), (0, 0))
        (wheel,) = gui.get_events([gui.WHEEL])
        assert (wheel.type, wheel.delta) == (gui.MOTION, (0.0, -1.0))
        screen.release(3)
        screen.release("Control_L")
        assert [(e.type, e.key) for e in gui.get_events()] == [
            ("Release", "RMB"), ("Release", "Control"),
        ]  # fmt: skip
        assert not gui.is_pressed(gui.RMB, gui.CTRL) and gui.get_key_event() is None
        for symbol, name in {"Return": gui.RETURN, "space": gui.SPACE, "Left": gui.LEFT,
                             "Tab": gui.TAB, "BackSpace": gui.BACKSPACE, "F2": "F2",
                             "Shift_R": gui.SHIFT, "Z": "z", "7": "7"}.items():  # fmt: skip
            screen.tap(symbol)
            assert [e.key for e in gui.get_events(gui.PRESS)] == [name]
        assert gui.running


@pytest.mark.parametrize("way", ["button", "escape"])
def test_closing(screen, way):  # noqa: F811
    gui = ti.GUI("closing", res=(90, 60), max_frames=1)
    for _ in range(3):
        gui.show()
        assert gui.running  # as long as nobody closes it: `max_frames` is for files
    if way == "button":
        screen.close("closing")
    else:
        screen.focus("closing")
        screen.tap("Escape")
    gui.show()
    assert not gui.running and screen.titles() == []
    assert gui.get_event(gui.EXIT if way == "button" else gui.ESCAPE)
    gui.show()  # is allowed, and shows nothing
    # Another window can be opened afterwards.
    again = ti.GUI("again", res=(90, 60))
    shown(again, lambda gui: gui.clear(0x00FF00))
    assert again.running and screen.grab()[30, 40].tolist() == [0, 255, 0]
    del again
    gc.collect()
    assert screen.titles() == []


def test_two_windows(screen):  # noqa: F811
    with ti.GUI("left", res=(100, 90)) as left, ti.GUI("right", res=(110, 90)) as right:
        shown(left), shown(right)
        screen.move("right", 200, 0)
        for _ in range(2):
            left.clear(0xFF0000), right.clear(0x0000FF)
            left.show(), right.show()
        picture = screen.grab()
        assert picture[45, 50].tolist() == [255, 0, 0]
        assert picture[45, 250].tolist() == [0, 0, 255]
        screen.focus("right")
        screen.point(255, 45)
        screen.tap("q")
        left.show(), right.show()
        assert right.get_event((right.PRESS, "q")) and not left.get_event(left.PRESS)
        assert right.get_cursor_pos() == (0.5, 0.5)
        screen.close("left")
        left.show(), right.show()
        assert not left.running and right.running


def test_resizing(screen):  # noqa: F811
    """The picture fills the window, and places of the mouse are shares of it."""
    with ti.GUI("resized", res=(100, 100)) as gui:

        def draw(gui):
            gui.triangle((0, 0), (0.5, 0), (0, 1), color=0xFF0000)
            gui.triangle((0.5, 1), (0.5, 0), (0, 1), color=0xFF0000)

        shown(gui, draw)
        screen.resize("resized", 300, 200)
        shown(gui, draw)
        picture = screen.grab()
        assert picture[150, 140].tolist() == [255, 0, 0] and picture[150, 160].max() == 0
        assert picture[199, 10].tolist() == [255, 0, 0] and picture[210, 10].max() == 0
        screen.point(75, 50)
        gui.show()
        assert gui.get_cursor_pos() == (0.25, 0.75)


def test_widgets(screen):  # noqa: F811
    """The panel begins 8 pixels from the corner, and each row has 20 of them."""
    with ti.GUI("widgets", res=(300, 200)) as gui:
        slider = gui.slider("size", 10, 20, step=2)
        go = gui.button("go")
        named = gui.button("named", "mine")
        label = gui.label("count")
        label.value = 3
        assert slider.value == 10 and (go, named) == ("WidgetButton_go", "mine")
        without = shown(gui)
        picture = screen.grab()[:200, :300]
        assert (picture[:100, :180] != without[:100, :180]).any()
        np.testing.assert_array_equal(picture[120:], without[120:])
        # The slider is from 13 to 173 across.
        screen.point(94, 20)
        screen.press(1)
        shown(gui)
        assert slider.value == 16  # 15.06, and steps are of 2
        screen.point(299, 20)
        shown(gui)
        assert slider.value == 20
        screen.release(1)
        screen.point(20, 20)
        shown(gui)
        assert slider.value == 20  # nobody holds it any more
        assert list(gui.get_events(gui.LMB)) == []  # the panel has taken them
        screen.point(20, 40)
        screen.tap(1)
        screen.point(20, 60)
        screen.press(1)
        shown(gui)
        screen.point(20, 150)
        screen.release(1)  # beside the button that was pressed
        shown(gui)
        assert [e.key for e in gui.get_events(gui.PRESS)] == [go]
        screen.point(20, 60)
        screen.tap(1)
        screen.point(250, 150)
        screen.tap(1)  # the canvas
        shown(gui)
        assert [e.key for e in gui.get_events(gui.PRESS)] == [gui.LMB, named]


def test_files_have_the_widgets_too(screen, tmp_path):  # noqa: F811
    """A frame in a file is the picture of the window, without a display as well."""
    pictures = []
    for shows in (True, False):
        gui = ti.GUI("both", res=(200, 100), frames_dir=str(tmp_path / str(shows)), show_gui=shows)
        gui.slider("x", 0, 1, 0.5).value = 0.5
        gui.button("press")
        gui.circle((0.7, 0.5), radius=20, color=0x446688)
        gui.show()
        if shows:
            pictures.append(screen.grab()[:100, :200])
        pictures.append(np.asarray(ti.tools.imread(str(tmp_path / str(shows) / "000000.png"))))
        gui.close()
    pictures[1:] = [p.swapaxes(0, 1)[::-1] for p in pictures[1:]]
    assert pictures[0].std() > 0
    for other in pictures[1:]:
        np.testing.assert_array_equal(other, pictures[0])


PROGRAM = """
import tai as ti
gui = ti.GUI("toy", res=30, max_frames=2)
while gui.running:
    gui.show()
print(gui.frame)
"""


@pytest.mark.parametrize(
    "reason, environment, prelude",
    [
        ("there is no display", {}, ""),
        ("X11: Failed to open display :4711", {"DISPLAY": ":4711"}, ""),
        ("glfw is missing", {"DISPLAY": ":0"}, "import sys; sys.modules['glfw'] = None"),
        ("moderngl is missing", {"DISPLAY": ":0"}, "import sys; sys.modules['moderngl'] = None"),
    ],
)
def test_one_line_where_no_window_is(tmp_path, reason, environment, prelude):
    pytest.importorskip("glfw", reason="glfw is not installed")
    clean = {k: v for k, v in os.environ.items() if not k.startswith("TAI_GUI")}
    clean |= {"TAI_GUI_DIR": str(tmp_path), **environment}
    command = [sys.executable, "-W", "error", "-c", prelude + PROGRAM]
    done = subprocess.run(command, capture_output=True, text=True, env=clean)
    assert (done.returncode, done.stdout) == (0, "2\n"), done.stderr
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith(f"ti.GUI opens no window ({reason}")
    assert f"frames go to the folder {tmp_path}, and `python -m tai.view` shows" in done.stderr


def test_no_window_is_asked_for(screen, capsys, monkeypatch):  # noqa: F811
    monkeypatch.setattr(FrameLoop, "_is_told", False)
    gui = ti.GUI("hidden", res=30, show_gui=False, max_frames=1)
    gui.show()
    assert screen.titles() == [] and not gui.running
    assert "opens no window: frames_dir" in capsys.readouterr().err


def test_other_displays_afterwards(screen):  # noqa: F811
    """GLFW can be stopped, and started again."""
    gui = ti.GUI("first", res=30)
    gui.show()
    library.stop()
    gui.close()
    with ti.GUI("second", res=30) as gui:
        gui.show()
        assert screen.titles() == ["second"]
