"""The drawings of programs, in a window or as files."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import tai as ti
from PIL import Image
from tai._impl.drawing.frames import FrameLoop
from tai.view import Frames, Window

from xvfb import display, screen  # noqa: F401  (fixtures)

ROOT = Path(__file__).resolve().parents[3]
DRAWS = """import sys
import tai as ti
gui = ti.GUI("toy", res=(40, 30), max_frames=3)
while gui.running:
    gui.circle((0.5, 0.5), radius=5)
    gui.show()
if "film" in sys.argv:
    ti.tools.write_gif([gui.picture()] * 5, sys.argv[2])
print(gui.frame)
"""


def view(*words, **environment):
    command = [sys.executable, "-m", "tai.view", *map(str, words)]
    clean = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    return subprocess.run(command, capture_output=True, text=True, env=clean | environment)


@pytest.fixture
def program(tmp_path):
    path = tmp_path / "toy.py"
    path.write_text(DRAWS)
    return path


def arrives(condition):
    """Asks until the display has handed over what a test has typed."""
    until = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < until, "the events have not arrived"


def test_frames_where_no_display_is(tmp_path, program, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "out/view/toy"
    folder.mkdir(parents=True)
    (folder / "000003.png").touch()  # of a longer run
    done = view(program, "film", tmp_path / "film.gif")
    assert (done.returncode, done.stdout) == (0, "3\n")
    assert done.stderr == f"view: there is no display: frames go to {folder}\n"
    # The frames of the film are those that were drawn.
    assert sorted(p.name for p in folder.iterdir()) == ["000000.png", "000001.png", "000002.png"]
    picture = np.asarray(Image.open(folder / "000001.png"))
    assert (
        picture.shape == (30, 40, 3) and picture[15, 20].min() == 255 and picture[0, 0].max() == 0
    )


def test_a_window_that_cannot_be_opened(tmp_path, program):
    done = view("--frames", tmp_path / "a", program)
    assert done.returncode == 0 and f"as asked: frames go to {tmp_path}/a" in done.stderr
    # A display that nobody listens at, or no library for windows.
    os.chdir(tmp_path)
    done = view(program, DISPLAY=":4711")
    assert done.returncode == 0 and done.stderr.count("\n") == 1
    assert f"frames go to {tmp_path}/out/view/toy" in done.stderr


def test_an_example(tmp_path):
    words = ("--iterations", 1, "--n", 16, "--steps", 20, "--out", tmp_path)
    done = view("--frames", tmp_path / "frames", ROOT / "examples/wave.py", *words)
    assert done.returncode == 0, done.stderr
    assert len(list((tmp_path / "frames").iterdir())) > 5
    assert (tmp_path / "wave.gif").is_file()


def test_bad_input(tmp_path, program):
    done = view("--frames")
    assert done.returncode == 2 and done.stderr.startswith("view: argument --frames: expected")
    assert done.stderr.count("\n") == 1
    done = view(tmp_path / "none.py")
    assert (done.returncode, done.stderr) == (2, f"view: there is no program {tmp_path}/none.py\n")
    done = view("--frames", program / "below", program)
    assert done.returncode == 2 and done.stderr.startswith("view: cannot write frames to ")
    assert done.stderr.count("\n") == 1


@pytest.fixture
def window(screen, monkeypatch):  # noqa: F811
    made = Window("toy")
    monkeypatch.setattr(FrameLoop, "screen", made)
    yield made
    made.close()


def test_a_window(window, screen, tmp_path):  # noqa: F811
    assert screen.titles() == []  # before the first picture
    gui = ti.GUI("another", res=(40, 30), max_frames=2)
    for _ in range(5):
        gui.circle((0.5, 0.5), radius=5, color=0xFF0000)
        drawn = np.asarray(gui.picture())
        gui.show()
        assert gui.running  # as long as nobody closes it
    assert screen.titles() == ["toy"]
    np.testing.assert_array_equal(screen.grab()[:30, :40], drawn)
    film = [np.full((30, 40, 3), k, np.uint8) for k in range(3)]
    ti.tools.write_gif(film, str(tmp_path / "film.gif"), framerate=100)
    np.testing.assert_array_equal(screen.grab()[:30, :40], film[2])
    # Another size is another picture.
    for _ in range(2):
        window.show(np.full((8, 9, 3), 77, np.uint8))
    assert window.pixels == (9, 8) and (screen.grab()[:8, :9] == 77).all()
    screen.close("toy")
    gui.show()
    assert not gui.running and screen.titles() == []
    window.wait()
    window.play(film, 1)  # shows nothing more, and takes no time


def test_keys_and_mice(window, screen):  # noqa: F811
    gui = ti.GUI("another", res=(400, 200))
    assert not gui.get_event() and not gui.has_key_event()
    gui.show()
    screen.focus("toy")
    screen.point(200, 100)
    screen.press("Control_L")
    screen.point(100, 150)
    screen.tap("a")
    screen.point(300, 100)
    screen.press(3)
    screen.point(200, 100)
    screen.tap(5)
    arrives(lambda: gui.has_key_event() and gui.get_cursor_pos() == (0.5, 0.5))
    assert gui.is_pressed("q", gui.RMB) and not gui.is_pressed("a")
    assert gui.get_cursor_pos() == (0.5, 0.5)  # of the wheel
    # Events that do not fit are skipped; events behind them can wait.
    assert gui.get_event("a") and gui.event == (gui.PRESS, "a", (0.25, 0.25), (gui.CTRL,), (0, 0))
    assert gui.get_event((gui.PRESS, gui.RMB)) and gui.event.pos == (0.75, 0.5)
    arrives(lambda: gui.get_event([gui.WHEEL]))
    wheel = gui.event
    assert (wheel.type, wheel.delta) == (gui.MOTION, (0.0, -1.0))
    # The escape closes the window, which then holds no key: it comes last.
    assert gui.running
    screen.tap("Escape")
    arrives(lambda: gui.get_event(gui.ESCAPE))
    assert gui.event[:2] == (gui.PRESS, gui.ESCAPE) and not gui.running
    assert list(gui.get_events(gui.PRESS)) == []


def test_widgets_in_a_shared_window(window, screen):  # noqa: F811
    gui = ti.GUI("another", res=(300, 200))
    button = gui.button("go")
    gui.show()
    gui.show()
    screen.point(20, 20)
    screen.tap(1)
    gui.show()
    gui.show()
    assert gui.get_event((gui.PRESS, button))


def test_a_program_in_a_window(display, tmp_path):  # noqa: F811
    """The window stays with the film until somebody closes it."""
    path = tmp_path / "toy.py"
    path.write_text(DRAWS.replace("gui.running", "gui.frame < 3"))
    command = [sys.executable, "-m", "tai.view", str(path), "film", str(tmp_path / "a.gif")]
    environment = os.environ | {"DISPLAY": display.name, "PYTHONUNBUFFERED": "1"}
    running = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
    assert running.stdout.readline() == "3\n"
    assert display.titles() == ["toy"] and running.poll() is None
    display.close("toy")
    assert running.wait() == 0


def test_nobody_is_at_the_keyboard(tmp_path, monkeypatch):
    monkeypatch.setattr(ti.GUI, "screen", Frames(tmp_path))
    gui = ti.GUI("toy", res=8)
    assert not gui.get_event(gui.PRESS) and list(gui.get_events()) == []
    assert not gui.is_pressed("a") and not gui.has_key_event()
    assert gui.get_cursor_pos() == (0.5, 0.5)


def test_frames_of_films(tmp_path):
    frames = Frames(tmp_path)
    frames.play([np.zeros((3, 4, 3), np.uint8)] * 2, 24)
    assert len(list(tmp_path.glob("*.png"))) == 2
