"""Drawing without a window."""

import sys

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


def test_many_discs():
    """A thousand at once, partly outside, of several sizes: the same pixels as one by one."""
    random = np.random.default_rng(1)
    places = random.uniform(-0.2, 1.2, (1000, 2))
    radii = random.choice([0.0, 0.4, 1, 2.2, 9, 40.5], 1000)
    colors = random.integers(0, 0xFFFFFF, 1000)
    at_once, in_turn = ti.GUI(res=(120, 90)), ti.GUI(res=(120, 90))
    at_once.circles(places, radii, colors)
    for place, radius, color in zip(places, radii, colors, strict=True):
        in_turn.circle(place, color, radius)
    assert at_once.get_image().std() > 0.1
    np.testing.assert_array_equal(at_once.get_image(), in_turn.get_image())


def test_kinds_of_arrays():
    """Fields, arrays and tensors of any shape are drawn as the NumPy array of their values."""
    values = np.random.default_rng(2).random((6, 7, 2), np.float32)
    colors = np.arange(42, dtype=np.int32).reshape(6, 7) * 99_991
    field = ti.Vector.field(2, ti.f32, shape=(6, 7))
    array = ti.Vector.ndarray(2, ti.f32, (6, 7)) if hasattr(ti.Vector, "ndarray") else values
    shades = ti.field(ti.i32, shape=(6, 7))
    field.from_numpy(values), shades.from_numpy(colors)
    if array is not values:
        array.from_numpy(values)
    pictures = []
    for places in (values, values.tolist(), field, array, values.astype(np.float64)):
        gui = ti.GUI(res=64)
        gui.circles(places, 3, shades)
        pictures.append(gui.get_image())
    for picture in pictures:
        np.testing.assert_array_equal(picture, pictures[0])
    assert pictures[0].std() > 0.05


def test_places_that_are_no_numbers():
    gui = ti.GUI(res=32)
    gui.circles(np.full((100, 2), np.nan), 2)
    gui.circles(np.full((100, 2), np.inf), 2)
    gui.circles(np.zeros((0, 2)), 2)
    gui.lines(np.array([[0.5, 0.5]]), np.array([[np.nan, 0.5]]))
    gui.triangles([(0, 0)], [(1, 0)], [(0, np.inf)])
    gui.arrows(np.full((3, 2), 0.5), np.array([[np.nan, 0], [0, 0], [0, np.inf]]))
    assert gui.get_image()[..., :3].max() == 0
    with pytest.raises(ti.TaiRuntimeTypeError, match="2 coordinates"):
        gui.circles(np.zeros((9, 3)), 2)
    with pytest.raises(ti.TaiRuntimeTypeError, match="3 colours for 9 shapes"):
        gui.circles(np.zeros((9, 2)), 2, [1, 2, 3])
    with pytest.raises(ti.TaiRuntimeTypeError, match="no numbers"):
        gui.circles(gui, 2)


def test_fields_of_points_and_arrows():
    gui = ti.GUI(res=90)
    radii = np.zeros((3, 3))
    radii[0, 2] = 9
    gui.point_field(radii, 0xFF0000)  # at (1/6, 5/6)
    image = gui.get_image()
    area = (image[..., 0] > 0.5).sum()
    assert image[15, 75, 0] == 1 and area == pytest.approx(81 * np.pi, rel=0.1)
    gui.clear()
    ways = np.zeros((3, 3, 2))
    ways[1, 1] = (0.3, 0)
    gui.arrow_field(ways, radius=1, color=0x00FF00)
    image = gui.get_image()[..., 1]
    assert image[45:72, 45].min() > 0.4 and image[76:, :].max() == 0 and image[:43].max() < 1


def test_vector_field():
    """The longest arrow is as long as the distance of two, and its middle is at its element."""
    gui = ti.GUI(res=100)
    ways = np.zeros((10, 10, 2), np.float32)
    ways[2, 2], ways[7, 7] = (0, 8), (4, 0)
    field = ti.Vector.field(2, ti.f32, shape=(10, 10))
    field.from_numpy(ways)
    gui.vector_field(field, arrow_spacing=5, color=0xFF0000)
    image = gui.get_image()[..., 0]
    assert image[25, 2:46].min() > 0.4 and image[25, 52:].max() == 0
    assert image[64:86, 75].min() > 0.4 and image[90:, 75].max() == 0 and image[:60, 75].max() == 0
    gui.clear()
    gui.vector_field(np.zeros((4, 4, 2)))  # without a direction
    gui.vector_field(np.full((4, 4, 2), np.nan))
    assert gui.get_image()[..., :3].max() == 0
    with pytest.raises(ti.TaiRuntimeTypeError, match=r"\(n, m, 2\), but got \(4, 4\)"):
        gui.vector_field(np.zeros((4, 4)))


def test_contour():
    gui = ti.GUI(res=(80, 40))
    values = ti.field(ti.f32, shape=(4, 2))
    values.from_numpy(np.repeat(np.arange(4.0, dtype=np.float32)[:, None], 2, 1) * 10)
    gui.contour(values, normalize=True)
    low, high = gui.get_image()[0, 20, :3], gui.get_image()[-1, 20, :3]
    assert np.abs(low - ti.hex_to_rgb(0x440154)).max() < 0.01
    assert np.abs(high - ti.hex_to_rgb(0xFDE725)).max() < 0.01
    greens = gui.get_image()[:, 20, 1]
    assert (np.diff(greens) >= 0).all() and len(set(greens.tolist())) > 30  # interpolated
    gui.contour(np.full((3, 3), 7.0), normalize=True)  # all equal
    gui.contour(np.full((3, 3), np.nan))
    assert np.abs(gui.get_image()[5, 5, :3] - ti.hex_to_rgb(0x440154)).max() < 0.01
    with pytest.raises(ti.TaiRuntimeTypeError, match="slice"):
        gui.contour(np.zeros((3, 3, 3)))


def test_widgets_without_a_window():
    gui = ti.GUI(res=(200, 100))
    slider = gui.slider("x", 2, 5, step=0.5)
    label = gui.label("speed")
    assert gui.button("go") == "WidgetButton_go" and gui.button("stop", "halt") == "halt"
    assert slider.value == 2
    slider.value, label.value = 3.3, 1.5
    for _ in range(3):
        gui.show()
    assert (slider.value, label.value) == (3.3, 1.5)
    assert not gui.get_event("halt")
    with pytest.raises(ti.TaiRuntimeError, match="no room"):
        gui.slider("y", 2, 2)


def test_images_of_one_channel_and_four():
    gui = ti.GUI(res=(4, 2))
    for channels in (1, 3, 4):
        gui.set_image(np.full((4, 2, channels), 0.5, np.float32))
        assert (gui.get_image()[..., :3] == np.float32(127 / 255)).all()
    with pytest.raises(ti.TaiRuntimeTypeError, match="one, three or four"):
        gui.set_image(np.zeros((4, 2, 2)))


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


def test_an_arrow():
    """A shaft, and two lines from the tip back to either side; one alone is drawn as many are."""
    pictures = []
    for many in (False, True):
        gui = ti.GUI(res=100)
        if many:
            gui.arrows([(0.2, 0.5)], [(0.6, 0.0)], radius=2, color=0xFF0000)
        else:
            gui.arrow((0.2, 0.5), (0.6, 0.0), radius=2, color=0xFF0000)
        pictures.append(gui.get_image()[..., 0] == 1)
    drawn = pictures[0]
    np.testing.assert_array_equal(drawn, pictures[1])
    head = [(80 - 15 * t, 50 + side * 9 * t) for t in (0.5, 0.9) for side in (-1, 1)]
    for x, y in [(25, 50), (50, 50), (79, 50), *head]:
        assert drawn[int(x) - 2 : int(x) + 3, int(y) - 2 : int(y) + 3].any(), (x, y)
    # Nothing besides.
    columns, rows = np.nonzero(drawn)
    assert columns.min() >= 17 and columns.max() <= 83
    assert rows.min() >= 38 and rows.max() <= 62
    assert np.abs(rows[columns < 60] - 50).max() <= 3


def test_pictures_of_truth_values(tmp_path):
    mask = np.zeros((4, 2), bool)
    mask[3, 1] = True
    ti.tools.imwrite(mask, str(tmp_path / "a.png"))
    picture = np.asarray(Image.open(tmp_path / "a.png"))
    assert picture.max() == picture[0, 3] == 255 and picture.sum() == 255


def test_progress_on_a_terminal_without_rich(capsys, monkeypatch):
    """Lines, as in a file."""
    monkeypatch.setitem(sys.modules, "rich.progress", None)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert list(ti.tools.Progress(range(5), "work")) == list(range(5))
    assert capsys.readouterr().err.splitlines()[-1].startswith("work 5/5")


def _gui():
    return ti.GUI("test", res=(64, 32), show_gui=False)


FIVE = np.random.default_rng(0).uniform(size=(5, 2))
MISTAKES = {
    "radius": (lambda gui: gui.circle((0.5, 0.5), radius=-3), "a radius is -3"),
    "palette": (
        lambda gui: gui.circles(FIVE, 1, palette=[1, 2], palette_indices=[0, 1, 0, 1, 2]),
        "palette_indices are from 0 to 2, but the palette has 2 colours",
    ),
    "negative": (
        lambda gui: gui.circles(FIVE, 1, palette=[1, 2], palette_indices=[0, 1, 0, 1, -1]),
        "palette_indices are from -1 to 1",
    ),
    "lines": (lambda gui: gui.lines(FIVE, FIVE[:4]), "the points of the shapes are 5 and 4"),
    "arrows": (lambda gui: gui.arrows(FIVE, FIVE[:1]), "the points of the shapes are 5 and 1"),
    "triangles": (lambda gui: gui.triangles(FIVE, FIVE, FIVE[:2]), "are 5 and 5 and 2"),
    "colour": (lambda gui: gui.clear("red"), "a colour is one number, but got 'red'"),
    "res": (lambda gui: ti.GUI("x", res=0, show_gui=False), "but got res=0"),
    "width": (lambda gui: ti.GUI("x", res=(-1, 3), show_gui=False), "a GUI has a width"),
    "fraction": (lambda gui: ti.GUI("x", res=3.5, show_gui=False), "but got res=3.5"),
    "three": (lambda gui: ti.GUI("x", res=(3, 3, 3), show_gui=False), r"res=\(3, 3, 3\)"),
    "text": (lambda gui: setattr(gui.slider("s", 0, 1), "value", "a"), "slider 's' is a number"),
    "nan": (lambda gui: setattr(gui.slider("s", 0, 1), "value", np.nan), "but got nan"),
    "label": (lambda gui: setattr(gui.label("l"), "value", "a"), "label 'l' is a number"),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes_have_a_hint(name):
    call, message = MISTAKES[name]
    gui = _gui()
    before = np.asarray(gui.picture())
    with pytest.raises(ti.TaiRuntimeTypeError, match=message) as caught:
        call(gui)
    assert caught.value.hint
    np.testing.assert_array_equal(np.asarray(gui.picture()), before)
    gui.show()  # the frame of a refused value can still be drawn


def test_a_file_of_no_known_format(tmp_path):
    gui = _gui()
    for name in ("a.xyz", "a"):
        with pytest.raises(ti.TaiRuntimeError, match="the end of its name is no format") as caught:
            gui.show(str(tmp_path / name))
        assert ".png" in caught.value.hint
    gui.show(str(tmp_path / "a.JPG"))
    assert [path.name for path in tmp_path.iterdir()] == ["a.JPG"]


def test_numbers_as_text_and_labels_that_are_not_finite():
    gui = _gui()
    gui.text(30, (0.1, 0.9), font_size=20)
    assert np.asarray(gui.picture()).any()
    gui.label("loss").value = np.nan
    gui.show()


def test_contours_of_numbers_that_are_not_finite(recwarn):
    values = np.array([[5.0, 6.0], [7.0, np.nan]])
    gui = _gui()
    gui.contour(values, normalize=True)
    found = np.asarray(gui.picture())
    gui.contour(np.array([[0.0, 0.5], [1.0, 0.0]]))
    np.testing.assert_array_equal(found, np.asarray(gui.picture()))
    for other in (np.inf, -np.inf, np.nan, 1e300):
        for normalize in (False, True):
            gui.contour(np.array([[5.0, 6.0], [7.0, other]]), normalize)
            gui.contour(np.full((2, 2), other), normalize)
    assert not recwarn.list


def test_discs_whose_radii_are_not_finite():
    gui = _gui()
    gui.circles(FIVE, [np.nan, np.inf, np.nan, np.inf, np.nan])
    gui.point_field(np.full((3, 3), np.nan))
    assert not np.asarray(gui.picture()).any()
