"""`ti.ui`: pictures of OpenGL against what geometry says, without a display and on one."""

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tai as ti
from tai._impl.drawing import library

from xvfb import display, screen  # noqa: F401  (fixtures)

WIDTH, HEIGHT = 200, 150
RED, GREEN, BLUE = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


@pytest.fixture(scope="module")
def opengl():
    pytest.importorskip("moderngl", reason="moderngl is not installed")
    try:
        library.offscreen_context().release()
    except ti.TaiRuntimeError as error:
        pytest.skip(str(error))


class View:
    """A window without a display, a camera five units in front of the origin."""

    def __init__(self, size=(WIDTH, HEIGHT), **settings):
        settings = {"show_window": False} | settings
        self.window = ti.ui.Window("view", size, pos=(0, 0), **settings)
        self.canvas, self.scene = self.window.get_canvas(), ti.ui.Scene()
        self.camera = ti.ui.Camera()
        self.camera.position(0, 0, 5)
        self.camera.lookat(0, 0, 0)

    def picture(self):
        """The colours, (height, width, 3), rows downward."""
        self.scene.set_camera(self.camera)
        self.canvas.scene(self.scene)
        made = np.asarray(self.window.picture())
        self.window.show()
        return made


@pytest.fixture
def view(opengl):
    return View()


def rays(camera, width=WIDTH, height=HEIGHT):
    """The ray through the middle of each pixel: begin and direction in the world."""
    x = (np.arange(width) + 0.5) / width * 2 - 1
    y = 1 - (np.arange(height) + 0.5) / height * 2
    inverse = np.linalg.inv(camera.get_projection_matrix(width / height) @ camera.get_view_matrix())
    corners = np.stack([*np.meshgrid(x, y)], -1)
    ends = []
    for depth in (-1, 1):
        points = np.concatenate(
            [corners, np.full((height, width, 1), depth), np.ones((height, width, 1))], -1
        )
        points = points @ inverse.T
        ends.append(points[..., :3] / points[..., 3:])
    way = ends[1] - ends[0]
    return ends[0], way / np.linalg.norm(way, axis=-1, keepdims=True)


def misses(camera, center, **size):
    """How far the ray of each pixel passes by a point."""
    begin, way = rays(camera, **size)
    off = np.asarray(center, float) - begin
    return np.linalg.norm(off - (off * way).sum(-1, keepdims=True) * way, axis=-1)


def test_the_disc_of_a_ball(view):
    """In the middle, as large as the cone that touches it, in its colour."""
    view.scene.particles(np.zeros((1, 3)), 0.6, color=RED)
    picture = view.picture()
    assert set(map(tuple, picture.reshape(-1, 3).tolist())) == {(255, 0, 0), (0, 0, 0)}
    rows, columns = np.nonzero(picture[..., 0])
    assert rows.mean() == pytest.approx(HEIGHT / 2 - 0.5, abs=0.1)
    assert columns.mean() == pytest.approx(WIDTH / 2 - 0.5, abs=0.1)
    radius = math.tan(math.asin(0.6 / 5)) * HEIGHT / 2 / math.tan(math.radians(22.5))
    assert len(rows) == pytest.approx(math.pi * radius**2, rel=0.01)


@pytest.mark.parametrize("mode", ["perspective", "orthogonal", "close"])
def test_balls_pixel_by_pixel(view, mode):
    """Each pixel whose ray hits a ball has its colour: also at the border of a wide picture."""
    camera = view.camera
    camera.position(1.0, 2.0, 4.0)
    camera.up((0.2, 1.0, 0.1))
    camera.lookat(0.1, 0.2, -0.3)
    radius = 0.4
    centers = np.array([[0, 0, 0], [1.7, 0.6, 0.2], [-1.6, 1.2, 0.5], [0.3, -1.4, -2]], np.float32)
    if mode == "orthogonal":
        camera.projection_mode(ti.ui.ProjectionMode.Orthogonal)
        for name, value in {"left": -3, "right": 2, "bottom": -2, "top": 2.5}.items():
            getattr(camera, name)(value)
    if mode == "close":
        camera.fov(110)
        radius = 0.9
    colors = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0]], np.float32)
    view.scene.particles(centers, radius, per_vertex_color=colors)
    picture = view.picture() / 255
    begin, way = rays(camera)
    nearest, wanted = np.full((HEIGHT, WIDTH), np.inf), np.zeros((HEIGHT, WIDTH, 3))
    is_sure = np.ones((HEIGHT, WIDTH), bool)
    for center, color in zip(centers, colors, strict=True):
        off = misses(camera, center)
        along = ((center - begin) * way).sum(-1) - np.sqrt((radius**2 - off**2).clip(0))
        is_hit = (off < radius) & (along > 0)
        is_sure &= np.abs(off - radius) > 0.01 * radius
        is_nearer = is_hit & (along < nearest)
        is_sure &= ~is_hit | (np.abs(along - nearest) > 1e-3)
        wanted[is_nearer], nearest[is_nearer] = color, along[is_nearer]
    assert is_sure.mean() > 0.9 and len(np.unique(wanted.reshape(-1, 3), axis=0)) == 5
    np.testing.assert_array_equal(picture[is_sure], wanted[is_sure])


def test_light(view):
    """Ambient light, and the cosine of each lamp: none behind the surface."""
    view.scene.ambient_light((0.2, 0.2, 0.3))
    view.scene.point_light(pos=(0, 0, 50), color=(0.5, 0, 0))
    view.scene.point_light(pos=(0, 50, 1), color=(0, 0.4, 0))
    view.scene.point_light(pos=(0, 0, -50), color=(0, 0, 1))
    view.scene.particles(np.zeros((1, 3)), 1.0, color=(1, 1, 1))
    middle = view.picture()[HEIGHT // 2, WIDTH // 2] / 255
    np.testing.assert_allclose(middle, [0.7, 0.2, 0.3], atol=0.02)
    # The picture's upper edge of a ball that is lit from above is brighter.
    view.scene.point_light(pos=(0, 50, 0), color=(1, 1, 1))
    view.scene.particles(np.zeros((1, 3)), 1.0, color=(1, 1, 1))
    column = view.picture()[:, WIDTH // 2, 0].astype(int)
    lit = column[HEIGHT // 2 - 30 : HEIGHT // 2 + 30]
    assert (np.diff(lit) <= 0).all() and lit[0] > 150 and lit[-1] == 0
    with pytest.raises(ti.TaiRuntimeError, match="at most 16"):
        for _ in range(17):
            view.scene.point_light((0, 0, 0), (1, 1, 1))


TRIANGLE = np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0]], np.float32)


def test_the_area_of_a_triangle(view):
    view.scene.mesh(TRIANGLE, color=GREEN)
    picture = view.picture()
    scale = HEIGHT / 2 / math.tan(math.radians(22.5)) / 5
    cover = picture[..., 1].sum() / 255  # the edges are smooth
    assert cover == pytest.approx(2 * scale**2, rel=0.005)
    assert picture[..., [0, 2]].max() == 0


def test_colours_between_vertices(view):
    view.scene.mesh(TRIANGLE, np.array([0, 1, 2]), per_vertex_color=np.eye(3, dtype=np.float32))
    scale = HEIGHT / 2 / math.tan(math.radians(22.5)) / 5
    picture = view.picture()
    middle = picture[round(HEIGHT / 2 + scale / 3), WIDTH // 2]
    np.testing.assert_allclose(middle / 255, 1 / 3, atol=0.03)
    # Near a corner, its own colour.
    assert picture[HEIGHT // 2 - round(0.93 * scale), WIDTH // 2].argmax() == 2


@pytest.mark.parametrize("two_sided", [False, True])
def test_the_back_of_a_mesh(view, two_sided):
    """Its normals point away: lamps light it if both sides are wanted."""
    view.scene.ambient_light((0.25, 0.25, 0.25))
    view.scene.point_light((0, 0, 100), (0.5, 0.5, 0.5))
    view.scene.mesh(TRIANGLE, np.array([[0, 2, 1]]), color=(1, 1, 1), two_sided=two_sided)
    middle = view.picture()[HEIGHT // 2, WIDTH // 2, 0] / 255
    assert middle == pytest.approx(0.75 if two_sided else 0.25, abs=0.01)


def test_normals(view):
    """A ball of triangles has the normals of the ball, computed and given."""
    steps = np.linspace(0, math.pi, 25), np.linspace(0, 2 * math.pi, 49)
    theta, phi = (a.ravel() for a in np.meshgrid(*steps, indexing="ij"))
    points = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), -np.sin(theta) * np.sin(phi)], 1)
    at = np.arange(24)[:, None] * 49 + np.arange(48)
    quads = np.stack([at, at + 49, at + 50, at + 1], -1).reshape(-1, 4)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    pictures = []
    for way in ("computed", "given", "ball"):
        view.scene.ambient_light((0.1, 0.1, 0.1))
        view.scene.point_light((4, 6, 9), (0.8, 0.8, 0.8))
        if way == "ball":
            view.scene.particles(np.zeros((1, 3)), 1.0, color=(1, 1, 1))
        else:
            view.scene.mesh(points, faces, points if way == "given" else None, color=(1, 1, 1))
        pictures.append(view.picture().astype(int))
    inner = misses(view.camera, (0, 0, 0)) < 0.9
    assert pictures[2][inner].std() > 30
    for picture in pictures[:2]:
        assert np.abs(picture - pictures[2])[inner].max() <= 8


def test_what_is_nearer_covers_the_rest(view):
    """In whatever order it is drawn: a triangle, a ball and a line."""
    near = TRIANGLE * 0.5 + np.array([0, 0, 1], np.float32)
    line = np.array([[-4, 0, 0.5], [4, 0, 0.5]], np.float32)
    pictures = []
    for order in ("tbl", "lbt", "blt"):
        for kind in order:
            if kind == "t":
                view.scene.mesh(near, color=RED)
            elif kind == "b":
                view.scene.particles(np.zeros((1, 3)), 0.8, color=GREEN)
            else:
                view.scene.lines(line, 6, color=BLUE)
        pictures.append(view.picture())
    row = pictures[0][HEIGHT // 2]
    assert row[WIDTH // 2].tolist() == [255, 0, 0]  # the triangle is before both
    assert row[4].tolist() == [0, 0, 255] and row[-4].tolist() == [0, 0, 255]
    # Beside the triangle the line enters the ball where its surface is half a unit high.
    # There, 0.62 beside the axis, the line is seen at 0.62 / 4.5 * 5 = 0.69 of the plane at 0.
    hits = misses(view.camera, (0, 0, 0))[HEIGHT // 2]
    assert row[np.searchsorted(-hits, -0.74)].tolist() == [0, 0, 255]
    assert row[np.searchsorted(-hits, -0.6)].tolist() == [0, 255, 0]
    for picture in pictures[1:]:
        assert (picture != pictures[0]).any(-1).sum() < 30  # pixels of smooth edges


def test_balls_pierce_a_mesh(view):
    """The depth of a ball is that of its surface: the plane through its centre halves it."""
    view.camera.position(0, 5, 0.001)
    view.scene.particles(np.array([[0, 0, 0], [1, -0.7, 0]], np.float32), 0.5, color=GREEN)
    plane = np.array([[-3, 0, -3], [3, 0, -3], [3, 0, 3], [-3, 0, 3]], np.float32)
    view.scene.mesh(plane, np.array([0, 1, 2, 0, 2, 3]), color=RED)
    picture = view.picture()
    scale = HEIGHT / 2 / math.tan(math.radians(22.5)) / 5
    assert (picture[..., 1] > 128).sum() == pytest.approx(
        math.pi * (5 * math.tan(math.asin(0.1)) * scale) ** 2, rel=0.01
    )
    assert picture[HEIGHT // 2, round(WIDTH / 2 + scale)].tolist() == [255, 0, 0]


@pytest.mark.parametrize("width", [1, 4, 9])
def test_the_width_of_lines(view, width):
    view.scene.lines(np.array([[-1, -1, 0], [1, -1, 0], [0, -1, 1], [0, 1, 1]]), width,
                     indices=np.array([[2, 3], [0, 1]]), color=RED)  # fmt: skip
    picture = view.picture()[..., 0].astype(float) / 255
    assert picture[HEIGHT // 2 - 20].sum() == pytest.approx(width, abs=0.3)
    assert picture[:, WIDTH // 2 - 20].sum() == pytest.approx(width, abs=0.3)


def test_lines_that_begin_behind_the_eye(view):
    ends = np.array([[0.5, 0, 20], [0.5, 0, -1e4]], np.float32)
    view.scene.lines(ends, 3, color=RED)
    view.scene.lines(np.array([[0, 0, 6], [0, 0, 7]], np.float32), 3, color=GREEN)
    picture = view.picture()
    assert picture[HEIGHT // 2, -5].tolist() == [255, 0, 0]
    assert picture[HEIGHT // 2, WIDTH // 2 + 5].tolist() == [255, 0, 0]
    assert picture[..., 1].max() == 0 and picture[:, : WIDTH // 2 - 3].max() == 0


def test_wireframe_and_instances(view):
    moves = np.tile(np.eye(4, dtype=np.float32), (3, 1, 1))
    moves[0, 0, 3], moves[1, 0, 3] = -1.2, 1.2
    moves[2, 1, 1] = -1
    view.scene.mesh_instance(TRIANGLE * 0.5, color=RED, transforms=moves, instance_count=2)
    filled = view.picture()[..., 0] > 128
    for move in moves[:2]:
        view.scene.mesh(TRIANGLE * 0.5 + move[:3, 3], color=RED)
    np.testing.assert_array_equal(filled, view.picture()[..., 0] > 128)
    view.scene.mesh_instance(TRIANGLE * 0.5, color=RED, transforms=moves[:2], show_wireframe=True)
    edges = view.picture()[..., 0] > 128
    assert 0 < edges.sum() < 0.4 * filled.sum()


def test_parts_of_arrays(view):
    centers = np.array([[-2, 0, 0], [0, 0, 0], [2, 0, 0]], np.float32)
    view.scene.particles(centers, 0.3, color=RED, index_offset=1, index_count=1)
    columns = np.nonzero(view.picture()[..., 0])[1]
    assert abs(columns.mean() - WIDTH / 2) < 1 and np.ptp(columns) < 40
    view.scene.particles(centers, 0, per_vertex_radius=np.array([0.1, 0, 0.3]), color=RED)
    picture = view.picture()[..., 0] > 0
    assert picture[:, : WIDTH // 2].sum() * 9 == pytest.approx(
        picture[:, WIDTH // 2 :].sum(), rel=0.2
    )
    two = np.concatenate([TRIANGLE + [0, 0, -50], TRIANGLE])
    view.scene.mesh(two, np.array([0, 1, 2]), color=RED, vertex_offset=3)
    assert view.picture()[HEIGHT // 2, WIDTH // 2, 0] == 255


def test_fields_arrays_and_tensors(view):
    """All give the picture of the NumPy array of their values; layouts do not matter."""
    random = np.random.default_rng(3)
    values = random.uniform(-1, 1, (40, 3)).astype(np.float32)
    colors = random.random((40, 3), np.float32)
    faces = random.integers(0, 40, 60).astype(np.int32)
    kinds = [(values, colors, faces), (values.astype(float), colors.tolist(), faces.astype(int))]
    for layout in (ti.Layout.AOS, ti.Layout.SOA):
        x = ti.Vector.field(3, ti.f32, shape=40, layout=layout)
        c = ti.Vector.field(3, ti.f64, shape=(5, 8), layout=layout)
        f = ti.field(ti.i32, shape=60)
        (
            x.from_numpy(values),
            c.from_numpy(colors.reshape(5, 8, 3).astype(float)),
            f.from_numpy(faces),
        )
        kinds.append((x, c, f))
    array, indices = ti.ndarray(ti.f32, (40, 3)), ti.ndarray(ti.i32, 60)
    array.from_numpy(values), indices.from_numpy(faces)
    kinds.append((array, colors, indices))
    try:
        import torch

        kinds.append(
            (torch.tensor(values, requires_grad=True), torch.tensor(colors), torch.tensor(faces))
        )
    except ImportError:
        pass
    pictures = []
    for x, c, f in kinds:
        view.scene.particles(x, 0.05, per_vertex_color=c)
        view.scene.mesh(x, f, per_vertex_color=c)
        view.scene.lines(x, 2, f, per_vertex_color=c)
        pictures.append(view.picture())
    assert pictures[0].std() > 20
    for picture in pictures[1:]:
        np.testing.assert_array_equal(picture, pictures[0])


def test_places_that_are_no_numbers(view):
    bad = np.array([[np.nan, 0, 0], [np.inf, 0, 0], [0, -np.inf, np.nan], [1e30, 0, 0]], np.float32)
    view.scene.particles(bad, 0.5, color=RED)
    view.scene.mesh(bad, np.array([0, 1, 2, 1, 2, 0]), color=RED)
    view.scene.lines(bad, 2, color=RED)
    view.canvas.circles(bad[:, :2], 0.1, RED)
    view.canvas.triangles(bad[:3, :2], RED)
    view.scene.particles(np.zeros((0, 3)), 0.5)
    view.scene.mesh(np.zeros((0, 3)))
    view.scene.lines(np.zeros((0, 3)), 1)
    view.canvas.circles(np.zeros((0, 2)), 1)
    view.scene.particles(np.array([[0, 0, 5.1]]), 0.5, color=RED)  # the eye is in the ball
    view.scene.particles(np.array([[0, 0, 20]]), 0.5, color=RED)  # behind the eye
    assert view.picture().max() == 0


def test_wrong_arguments(view):
    cases = [
        (lambda s: s.particles(np.zeros((4, 2)), 1), "3 components, but the shape is"),
        (lambda s: s.particles(np.zeros((4, 3)), 1, per_vertex_color=np.zeros((3, 3))),
         "3 colours for 4"),
        (lambda s: s.particles(np.zeros((4, 3)), [1, 2]), "2 radii for 4"),
        (lambda s: s.mesh(np.zeros((4, 3)), [0, 1]), "3 vertices each"),
        (lambda s: s.mesh(np.zeros((4, 3)), [0, 1, 4]), "is 4, but there are 4 vertices"),
        (lambda s: s.mesh(np.zeros((4, 3)), [0, -1, 2]), "is -1"),
        (lambda s: s.mesh(np.zeros((3, 3)), normals=np.zeros((2, 3))), "2 normals for 3"),
        (lambda s: s.lines(np.zeros((3, 3)), 1), "2 vertices each"),
        (lambda s: s.particles("abc", 1), "no numbers"),
        (lambda s: s.ambient_light((1, 2)), "three numbers from 0 to 1"),
        (lambda s: s.mesh_instance(TRIANGLE, transforms=np.eye(3)), "matrices of 4×4"),
    ]  # fmt: skip
    for call, message in cases:
        with pytest.raises(ti.TaiRuntimeError, match=message):
            call(view.scene)
    with pytest.raises(ti.TaiRuntimeError, match="180 degrees"):
        view.camera.fov(180)
    with pytest.raises(ti.TaiRuntimeError, match="finite"):
        view.camera.position(0, math.nan, 0)
    assert view.picture().max() == 0


def test_the_canvas(view):
    """Sizes are shares of the height, and later shapes cover earlier ones."""
    canvas = view.canvas
    canvas.set_background_color((0, 0, 1))
    canvas.circles(np.array([[0.25, 0.75]]), 0.1, RED)
    canvas.lines(np.array([[0.5, 0.2], [1.0, 0.2]]), 0.04, color=GREEN)
    canvas.triangles(np.array([[0.6, 0.6], [0.9, 0.6], [0.6, 0.9]]), (1, 1, 1))
    picture = view.picture() / 255
    red = picture[..., 0] - (picture[..., 1] > 0.5) * picture[..., 0]
    assert red.sum() == pytest.approx(math.pi * 15**2, rel=0.02)
    rows, columns = np.nonzero(red > 0.5)
    assert (columns.mean(), rows.mean()) == pytest.approx((49.5, 37), abs=0.2)
    white = picture.min(-1).sum()
    assert white == pytest.approx(0.5 * 0.3 * WIDTH * 0.3 * HEIGHT, rel=0.02)
    green = (picture[..., 1] - picture[..., 0]).clip(0).sum()
    assert green == pytest.approx(0.5 * WIDTH * 0.04 * HEIGHT, rel=0.02)
    # An image is upright, and later shapes cover it.
    image = np.zeros((4, 2, 3), np.float32)
    image[3, 1] = RED  # right, top
    canvas.set_image(image)
    canvas.circles(np.array([[0.9, 0.9]]), 0.05, GREEN)
    picture = view.picture()
    assert picture[HEIGHT // 4, 155].tolist() == [255, 0, 0]
    assert picture[15, 180].tolist() == [0, 255, 0] and picture[-1, 0].max() == 0
    # Nothing stays for the next frame but the background.
    assert (view.picture() == (0, 0, 255)).all()


def test_planes_of_a_camera(view):
    """Things before the near plane and behind the far one are not seen; an orthogonal camera sees
    the box between its planes."""
    scene, camera = view.window.get_scene(), ti.ui.make_camera()
    camera.position([0, 0, 5])
    camera.lookat([0, 0, 0])
    view.scene, view.camera = scene, camera
    balls = np.array([[-1.2, 0, 2], [0, 0, 0], [2.5, 0, -4]], np.float32)

    def seen():
        scene.particles(balls, 0.3, per_vertex_color=np.eye(3, dtype=np.float32))
        return (view.picture().reshape(-1, 3).max(0) > 0).tolist()

    assert seen() == [True, True, True]
    camera.z_near(4.0)
    assert seen() == [False, True, True]
    camera.z_far(6.0)
    assert seen() == [False, True, False]
    camera.projection_mode(ti.ui.ProjectionMode.Orthogonal)
    camera.z_near(0.1), camera.z_far(100.0)
    camera.left(-4), camera.right(4), camera.bottom(-3), camera.top(3)
    assert seen() == [True, True, True]
    camera.left(-0.5), camera.right(0.5)
    assert seen() == [False, True, False]
    assert list(camera.curr_up) == [0, 1, 0]
    # Directions along `up` have a picture, too.
    camera.position(0, 9, 0)
    camera.left(-9), camera.right(9), camera.bottom(-9), camera.top(9)
    assert seen() == [True, True, True]


def test_names_of_keys():
    names = (
        "ALT BACKSPACE CAPSLOCK CTRL DOWN ESCAPE LEFT LMB MMB PRESS RELEASE RETURN RIGHT RMB SHIFT"
    )
    for name in [*names.split(), "SPACE", "TAB", "UP"]:
        assert getattr(ti.ui, name) == getattr(ti.GUI, name)
    assert {ti.ui.ALT, ti.ui.BACKSPACE, ti.ui.CAPSLOCK, ti.ui.CTRL, ti.ui.DOWN, ti.ui.ESCAPE} == {
        "Alt", "BackSpace", "Caps_Lock", "Control", "Down", "Escape",
    }  # fmt: skip
    assert (ti.ui.LEFT, ti.ui.RIGHT, ti.ui.UP) == ("Left", "Right", "Up")
    assert (ti.ui.LMB, ti.ui.MMB, ti.ui.RMB) == ("LMB", "MMB", "RMB")
    assert (ti.ui.PRESS, ti.ui.RELEASE) == ("Press", "Release")
    assert (ti.ui.RETURN, ti.ui.SHIFT, ti.ui.SPACE, ti.ui.TAB) == ("Return", "Shift", " ", "Tab")


def test_images_of_buffers(view):
    view.scene.particles(np.array([[0, 0, 1.0]]), 0.5, color=RED)
    view.scene.set_camera(view.camera)
    view.canvas.scene(view.scene)
    colors, depths = (
        view.window.get_image_buffer_as_numpy(),
        view.window.get_depth_buffer_as_numpy(),
    )
    assert colors.shape == (WIDTH, HEIGHT, 4) and depths.shape == (WIDTH, HEIGHT)
    assert colors[WIDTH // 2, HEIGHT // 2].tolist() == [1, 0, 0, 1]
    near, far, distance = 0.1, 1000.0, 3.5
    depth = far * (distance - near) / (distance * (far - near))
    assert depths[WIDTH // 2, HEIGHT // 2] == pytest.approx(depth, rel=1e-4)
    assert depths[0, 0] == 1


def test_frames_and_files(opengl, tmp_path, monkeypatch):
    window = ti.ui.Window("frames", (30, 20), frames_dir=str(tmp_path), max_frames=3)
    canvas = window.get_canvas()
    count = 0
    while window.running:
        canvas.set_background_color((0.2 * count, 0, 0))
        window.save_image(str(tmp_path / "now.png"))
        window.show()
        count += 1
    assert count == 3 and len(list(tmp_path.iterdir())) == 4
    last = ti.tools.imread(str(tmp_path / "000002.png"))
    assert last.shape == (30, 20, 3) and last[0, 0].tolist() == [102, 0, 0]
    assert (ti.tools.imread(str(tmp_path / "now.png")) == last).all()
    assert not window.get_event() and not window.is_pressed(ti.ui.SPACE)
    assert window.get_cursor_pos() == (0.5, 0.5) and window.get_window_shape() == (30, 20)
    window.destroy()


def test_widgets_without_a_window(view):
    gui = view.window.get_gui()
    assert gui is view.window.GUI
    for _ in range(2):
        with gui.sub_window("panel", 0, 0, 0.5, 1) as panel:
            panel.text("text", color=RED)
            assert panel.button("go") is False
            assert panel.checkbox("on", True) is True
            assert panel.slider_int("n", 3, 0, 10) == 3
            assert panel.slider_float("x", 0.25, 0, 1) == 0.25
            assert panel.color_edit_3("c", (0.5, 0.25, 1)) == (0.5, 0.25, 1)
        picture = view.picture()
    assert picture[:, : WIDTH // 2].std() > 5 and picture[:, WIDTH // 2 + 1 :].max() == 0


def test_a_window_shows_the_same_picture(opengl, screen):  # noqa: F811
    """And others, before and after it, with and without a display."""
    pictures = []
    for shows in (False, True, False):
        view = View(show_window=shows)
        for _ in range(2):
            view.scene.ambient_light((0.3, 0.3, 0.3))
            view.scene.point_light((3, 4, 5), (0.7, 0.7, 0.7))
            view.scene.particles(np.array([[0, 0, 0], [1, 0.5, 0]]), 0.4, (1, 0.5, 0))
            view.scene.mesh(TRIANGLE, color=(0, 0.5, 1))
            pictures.append(view.picture())
        if shows:
            assert screen.titles() == ["view"]
            pictures.append(screen.grab()[:HEIGHT, :WIDTH])
        view.window.destroy()
    for picture in pictures[1:]:
        np.testing.assert_array_equal(picture, pictures[0])
    assert screen.titles() == []


def test_resize_and_close(opengl, screen):  # noqa: F811
    view = View(show_window=True)
    view.picture()
    screen.resize("view", 300, 300)
    for _ in range(2):
        view.scene.particles(np.zeros((1, 3)), 0.6, color=RED)
        picture = view.picture()
    assert view.window.get_window_shape() == (300, 300) and picture.shape == (300, 300, 3)
    inside = misses(view.camera, (0, 0, 0), width=300, height=300) < 0.6
    assert (inside != (picture[..., 0] > 128)).sum() < 60  # still round
    np.testing.assert_array_equal(screen.grab()[:300, :300], picture)
    screen.close("view")
    view.picture()
    assert not view.window.running
    view.scene.particles(np.zeros((1, 3)), 0.6, color=RED)
    assert view.picture()[HEIGHT // 2, WIDTH // 2].tolist() == [255, 0, 0]  # without a window
    view.window.destroy()


def test_two_scenes_in_two_windows(opengl, screen):  # noqa: F811
    one, other = View(show_window=True), View(show_window=True)
    for _ in range(3):
        one.scene.particles(np.zeros((1, 3)), 0.6, color=RED)
        other.scene.particles(np.zeros((1, 3)), 0.6, color=GREEN)
        pictures = one.picture(), other.picture()
    middles = [p[HEIGHT // 2, WIDTH // 2].tolist() for p in pictures]
    assert middles == [[255, 0, 0], [0, 255, 0]]
    one.window.destroy()
    other.scene.particles(np.zeros((1, 3)), 0.6, color=GREEN)
    assert other.picture()[HEIGHT // 2, WIDTH // 2].tolist() == [0, 255, 0]
    other.window.destroy()


def test_a_user_moves_the_camera(opengl, screen):  # noqa: F811
    view = View(show_window=True)
    view.window.fps_limit = None
    view.picture()
    screen.focus("view")

    def step(**settings):
        view.camera.track_user_inputs(view.window, hold_key=ti.ui.LMB, **settings)
        view.picture()

    step()
    screen.press("w")
    for _ in range(3):
        step(movement_speed=0.01)
    screen.release("w")
    x, y, z = view.camera.curr_position
    assert (x, y) == (0, 0) and z < 5
    target = view.camera.curr_lookat
    assert target[2] == pytest.approx(z - 5, abs=1e-5)  # it is moved along
    view.picture()
    place = list(view.camera.curr_position)
    screen.point(100, 75)
    step()
    assert list(view.camera.curr_lookat) == list(target)  # no button is held
    screen.press(1)
    step()
    step()
    screen.point(150, 75)  # a quarter of the width
    view.picture()
    step(yaw_speed=math.pi)
    assert list(view.camera.curr_position) == place
    way = np.subtract(view.camera.curr_lookat, place) / 5
    np.testing.assert_allclose(way, [math.sqrt(0.5), 0, -math.sqrt(0.5)], atol=1e-5)
    screen.point(150, 0)  # up, farther than it can look
    view.picture()
    step(pitch_speed=50)
    way = np.subtract(view.camera.curr_lookat, place) / 5
    assert 0.999 < way[1] < 1
    screen.release(1)
    view.window.destroy()


def test_widgets_of_a_window(opengl, screen):  # noqa: F811
    view = View((300, 200), show_window=True)
    values = {"count": 2, "on": False, "clicks": 0}

    def frame():
        with view.window.get_gui().sub_window("panel", 0, 0, 0.5, 0.6) as panel:
            values["count"] = panel.slider_int("count", values["count"], 0, 10)
            values["on"] = panel.checkbox("on", values["on"])
            values["clicks"] += panel.button("go")
        view.picture()

    frame(), frame()
    # The panel is 150 wide; its rows begin at 25, and are 20 high.
    for place in ((75, 30), (15, 52), (75, 72), (75, 72)):
        screen.point(*place)
        screen.tap(1)
    frame(), frame(), frame()
    # Both clicks on the button are of one frame.
    assert values == {"count": 5, "on": True, "clicks": 1}
    view.window.destroy()


PROGRAM = """
import numpy as np, tai as ti
window = ti.ui.Window("toy", (30, 20), max_frames=2)
scene = ti.ui.Scene()
while window.running:
    scene.particles(np.zeros((1, 3)), 1.0)
    window.get_canvas().scene(scene)
    window.show()
print(window.frame)
window.save_image("a.png")
"""


@pytest.mark.slow
def test_an_example(opengl, tmp_path):
    """The frames of `diffmpm3d.py --show` where no display is: the robot above its floor."""
    words = [
        "--steps",
        "16",
        "--iterations",
        "1",
        "--density",
        "1",
        "--out",
        str(tmp_path),
        "--show",
    ]
    environment = os.environ | {"TAI_GUI_DIR": str(tmp_path / "frames")}
    done = subprocess.run(
        [sys.executable, "diffmpm3d.py", *words, "--no-picture"], capture_output=True, text=True,
        env=environment, cwd=Path(__file__).parents[3] / "examples",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert sorted(p.name for p in (tmp_path / "frames").iterdir()) == ["000000.png", "000001.png"]
    picture = ti.tools.imread(str(tmp_path / "frames" / "000001.png"))
    assert picture.shape == (960, 540, 3)
    floor, paper = picture[480, 20].astype(int), picture[480, 520].astype(int)
    assert (np.abs(picture.astype(int) - paper).sum(-1) > 60).sum() > 2000
    assert np.abs(floor - paper).sum() > 20


def test_without_opengl(tmp_path):
    """One line, and frames are counted; an error where a picture is needed, with the remedy."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("TAI_GUI")}
    prelude = "import sys; sys.modules['moderngl'] = None\n"
    done = subprocess.run(
        [sys.executable, "-c", prelude + PROGRAM], capture_output=True, text=True,
        env=environment, cwd=tmp_path,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (1, "2\n")
    assert done.stderr.startswith("ti.ui.Window opens no window (there is no display): ")
    assert "a 3-D scene needs the package moderngl" in done.stderr
    assert 'pip install "tai[view]"' in done.stderr and "line 11, in <module>" in done.stderr


@pytest.mark.parametrize("color", [(1, 1), 0xFF, (1, np.nan, 0)])
def test_what_is_no_colour(color):
    for call in (ti.ui.Scene().ambient_light, lambda c: ti.ui.Scene().point_light((0, 0, 0), c)):
        with pytest.raises(ti.TaiRuntimeTypeError, match="a colour is three numbers") as caught:
            call(color)
        assert "ti.hex_to_rgb" in caught.value.hint


@pytest.mark.parametrize("res", [0, (0, 80), (1.5, 80), (1, 2, 3)])
def test_windows_of_no_size(res):
    with pytest.raises(ti.TaiRuntimeTypeError, match="a window has a width and a height"):
        ti.ui.Window("w", res, show_window=False)
