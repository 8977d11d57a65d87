"""Drawing without a window."""

import numpy as np
import pytest
import tai as ti
from PIL import Image


def test_shapes_and_axes(tmp_path):
    gui = ti.GUI("test", res=(64, 32), background_color=0x102030)
    gui.circle((0.25, 0.75), color=0xFF0000, radius=4)
    gui.line((0.5, 0.25), (1.0, 0.25), color=0x00FF00, radius=2)
    gui.triangle((0.6, 0.6), (0.9, 0.6), (0.75, 0.95), color=0x0000FF)
    gui.text("hi", (0.05, 0.3))
    gui.rect((0.05, 0.95), (0.1, 0.9))
    gui.show(str(tmp_path / "frames" / "a.png"))
    picture = np.asarray(Image.open(tmp_path / "frames" / "a.png"))
    assert picture.shape == (32, 64, 3)
    assert picture[8, 16].tolist() == [255, 0, 0]  # the second coordinate runs upward
    assert picture[24, 48].tolist() == [0, 255, 0]
    assert picture[10, 48].tolist() == [0, 0, 255]
    assert picture[31, 0].tolist() == [0x10, 0x20, 0x30]
    assert gui.frame == 1
    assert gui.get_image()[16, 24].tolist() == pytest.approx([16 / 255, 32 / 255, 48 / 255, 1])


def test_many_circles():
    gui = ti.GUI(res=32)
    gui.circles(
        np.array([[0.25, 0.25], [0.75, 0.75]]),
        radius=4,
        palette=[0xFF0000, 0x00FF00],
        palette_indices=np.array([0, 1]),
    )
    image = gui.get_image()
    assert image[8, 8].tolist() == [1, 0, 0, 1] and image[24, 24].tolist() == [0, 1, 0, 1]
    gui.clear(0xFFFFFF)
    assert gui.get_image().min() == 1


def test_set_image():
    gui = ti.GUI(res=(4, 2))
    image = np.zeros((4, 2, 3))
    image[3, 1] = [1, 0.5, 0]  # right, top
    gui.set_image(image)
    assert gui.get_image()[3, 1].tolist() == pytest.approx([1, 127 / 255, 0, 1])
    field = ti.field(ti.f32, shape=(4, 2))
    field[0, 0] = 1
    gui.set_image(field)
    assert gui.get_image()[0, 0, 0] == 1
    with pytest.raises(ti.TaiRuntimeTypeError, match="shape"):
        gui.set_image(np.zeros((2, 4)))


def test_frames_in_a_folder(tmp_path):
    gui = ti.GUI(res=8, frames_dir=str(tmp_path), max_frames=3)
    count = 0
    while gui.running:
        gui.show()
        count += 1
    assert count == 3
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"{i:06d}.png" for i in range(3)]
    assert gui.get_event() is False and gui.get_cursor_pos() == (0.5, 0.5)


def test_colors():
    assert ti.rgb_to_hex((1, 0.5, 0)) == 0xFF7F00
    assert ti.rgb_to_hex((np.ones(2), np.zeros(2), np.zeros(2))).tolist() == [0xFF0000] * 2
    assert ti.gui.hex_to_rgb(0xFF0000) == (1, 0, 0)


def test_pictures_and_videos(tmp_path):
    image = np.zeros((6, 4, 3), np.uint8)
    image[5, 3] = 255
    name = str(tmp_path / "a.png")
    ti.tools.imwrite(image, name)
    assert Image.open(name).size == (6, 4)
    assert (ti.tools.imread(name) == image).all()
    assert ti.tools.imresize(image, 3, 2).shape == (3, 2, 3)
    video = ti.tools.VideoManager(str(tmp_path), framerate=10)
    for value in (0, 100, 200):
        video.write_frame(np.full((8, 8), value, np.uint8))
    video.make_video(mp4=False)
    assert Image.open(tmp_path / "video.gif").n_frames == 3


def test_progress(capsys):
    bar = ti.tools.Progress(range(10), "work")
    for i in bar:
        bar.note(f"at {i}")
    lines = capsys.readouterr().err.splitlines()
    assert lines[-1] == "work 10/10 at 9"
