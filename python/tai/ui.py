"""`ti.ui`: windows with a canvas, scenes in three dimensions, and panels of widgets.

A window shows its frames where a display is. Elsewhere they are drawn without one, for
`save_image`, a folder of frames (`frames_dir=` or TAI_GUI_DIR) and `python -m tai.view`. OpenGL
draws both, so that the pictures are the same. Positions, colours and indices are fields, arrays,
NumPy arrays or tensors, which are read when they are passed.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from ._impl.base.files import save_picture
from ._impl.base.keywords import check_keywords
from ._impl.drawing import events, library
from ._impl.drawing.arrays import canvas_size, numbers, pixels_of, vectors
from ._impl.drawing.camera import Steering, look_at, orthographic, perspective
from ._impl.drawing.frames import FrameLoop
from ._impl.drawing.panels import Panels, layer
from ._impl.drawing.renderer import CANVAS, Renderer, View
from ._impl.drawing.shaders import MOST_LIGHTS
from ._impl.values.matrix import Vector
from .errors import TaiRuntimeError, TaiRuntimeTypeError

__all__ = ["Camera", "Canvas", "Gui", "ProjectionMode", "Scene", "Window", "make_camera"]

ESCAPE, SPACE, RETURN, TAB = events.ESCAPE, events.SPACE, events.RETURN, events.TAB
SHIFT, CTRL, ALT, CAPSLOCK = events.SHIFT, events.CTRL, events.ALT, events.CAPSLOCK
LEFT, RIGHT, UP, DOWN = events.LEFT, events.RIGHT, events.UP, events.DOWN
BACKSPACE, LMB, MMB, RMB = events.BACKSPACE, events.LMB, events.MMB, events.RMB
PRESS, RELEASE = events.PRESS, events.RELEASE

Color = tuple[float, float, float]
GREY: Color = (0.5, 0.5, 0.5)


class ProjectionMode:
    """How a camera projects."""

    Perspective = 0
    Orthogonal = 1


class Camera:
    """The eye of a scene; at first at the origin, looking along z, with y upward.

    Attributes:
        curr_position, curr_lookat, curr_up: vectors, as they are now.
    """

    def __init__(self) -> None:
        self._position, self._lookat = np.zeros(3), np.array([0.0, 0.0, 1.0])
        self._up = np.array([0.0, 1.0, 0.0])
        self._mode, self._fov = ProjectionMode.Perspective, 45.0
        self._planes = {"left": -1.0, "right": 1.0, "bottom": -1.0, "top": 1.0}
        self._near, self._far = 0.1, 1000.0
        self._steering = Steering()

    @property
    def curr_position(self) -> Any:
        """Where the camera is."""
        return Vector(self._position.tolist())

    @property
    def curr_lookat(self) -> Any:
        """The point at which the camera looks."""
        return Vector(self._lookat.tolist())

    @property
    def curr_up(self) -> Any:
        """The direction that is upward in the camera's picture."""
        return Vector(self._up.tolist())

    def position(self, x: Any, y: Any = None, z: Any = None) -> None:
        """Puts the camera at a point, given by three numbers or one vector."""
        self._position = _point(x, y, z)

    def lookat(self, x: Any, y: Any = None, z: Any = None) -> None:
        """Turns the camera toward a point."""
        self._lookat = _point(x, y, z)

    def up(self, x: Any, y: Any = None, z: Any = None) -> None:
        """Sets the direction that is upward in the picture."""
        self._up = _point(x, y, z)

    def projection_mode(self, mode: int) -> None:
        """Sets the projection: `ProjectionMode.Perspective`, or `Orthogonal` with the planes of a
        box.
        """
        self._mode = mode

    def fov(self, fov: float) -> None:
        """Sets the angle from the lower to the upper edge of the picture, in degrees."""
        if not 0 < fov < 180:
            raise TaiRuntimeError(f"a field of view has between 0 and 180 degrees, got {fov}")
        self._fov = float(fov)

    def left(self, left: float) -> None:
        """Sets the left plane of an orthogonal projection."""
        self._planes["left"] = float(left)

    def right(self, right: float) -> None:
        """Sets the right plane of an orthogonal projection."""
        self._planes["right"] = float(right)

    def top(self, top: float) -> None:
        """Sets the upper plane of an orthogonal projection."""
        self._planes["top"] = float(top)

    def bottom(self, bottom: float) -> None:
        """Sets the lower plane of an orthogonal projection."""
        self._planes["bottom"] = float(bottom)

    def z_near(self, z_near: float) -> None:
        """Sets the distance from the camera from which on things are seen."""
        self._near = float(z_near)

    def z_far(self, z_far: float) -> None:
        """Sets the distance from the camera up to which things are seen."""
        self._far = float(z_far)

    def get_view_matrix(self) -> np.ndarray:
        """The matrix from world coordinates to camera coordinates, whose x is to the right and
        whose z is backward; it acts on columns.
        """
        return look_at(self._position, self._lookat, self._up)

    def get_projection_matrix(self, aspect: float) -> np.ndarray:
        """The matrix from camera coordinates to the cube from -1 to 1, for a picture `aspect` times
        as wide as high; it acts on columns.
        """
        if self._mode == ProjectionMode.Orthogonal:
            return orthographic(**self._planes, near=self._near, far=self._far)
        return perspective(self._fov, aspect, self._near, self._far)

    def track_user_inputs(
        self, window: Window, movement_speed: float = 1.0, yaw_speed: float = 2.0,
        pitch_speed: float = 2.0, hold_key: str | None = None,
    ) -> None:  # fmt: skip
        """Moves the camera by the keys W, A, S, D, E (up) and Q (down), and turns it by the mouse.

        Args:
            movement_speed: distance in a sixtieth of a second.
            yaw_speed, pitch_speed: radians for a motion over the whole window.
            hold_key: the camera turns only while this key or button is held.
        """
        self._position, self._lookat = self._steering.step(
            window, self._position, self._lookat, self._up,
            movement_speed, yaw_speed, pitch_speed, hold_key,
        )  # fmt: skip


def make_camera() -> Camera:
    """A new camera."""
    return Camera()


def _point(*values: Any) -> np.ndarray:
    given = [value for value in values if value is not None]
    point = numbers(given[0] if len(given) == 1 else given, float).ravel()
    if point.shape != (3,) or not np.isfinite(point).all():
        raise TaiRuntimeTypeError(f"a point has three finite coordinates, got {point.tolist()}")
    return point


def _color(value: Any) -> np.ndarray:
    color = numbers(value, float).ravel()
    if color.shape != (3,) or not np.isfinite(color).all():
        raise TaiRuntimeTypeError(
            f"a colour is three numbers from 0 to 1, but got {value!r}",
            "write (1.0, 0.5, 0.0); ti.hex_to_rgb(0xFF8000) makes them",
        )
    return color


def _three(points: np.ndarray) -> np.ndarray:
    """Gives points of the plane a third coordinate, 0."""
    if points.shape[1] == 3:
        return points
    return np.concatenate([points, np.zeros((len(points), 1), np.float32)], 1)


def _colors(color: Any, each: Any, count: int) -> np.ndarray:
    """Returns colours with opacity, as an array (count, 4)."""
    found = vectors(color if each is None else each, (3, 4), "colours")
    if each is not None and len(found) != count:
        raise TaiRuntimeTypeError(
            f"per_vertex_color has {len(found)} colours for {count} vertices",
            "give one for each vertex",
        )
    if found.shape[1] == 3:
        found = np.concatenate([found, np.ones((len(found), 1), np.float32)], 1)
    return np.broadcast_to(found, (count, 4))


def _indices(indices: Any, count: int, size: int, what: str) -> np.ndarray:
    """Rows of `size` indices of vertices; without indices, one vertex after the other."""
    flat = np.arange(count) if indices is None else numbers(indices, np.int64).ravel()
    if len(flat) % size:
        raise TaiRuntimeTypeError(
            f"{what} have {size} vertices each, but there are {len(flat)} of them"
        )
    if len(flat) and not (flat.min() >= 0 and flat.max() < count):
        wrong = flat.min() if flat.min() < 0 else flat.max()
        raise TaiRuntimeError(
            f"an index of {what} is {wrong}, but there are {count} vertices",
            "indices begin with 0",
        )
    return flat.reshape(-1, size)


def _part(array: np.ndarray, offset: int, count: int | None) -> np.ndarray:
    return array[offset : None if count is None else offset + count]


def _normals(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """A normal for each vertex: the mean of those of its triangles, by their areas."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    with np.errstate(invalid="ignore", over="ignore"):
        each = np.nan_to_num(np.cross(b - a, c - a))
    weights = np.repeat(each, 3, axis=0)
    corners = faces.ravel()
    columns = [np.bincount(corners, weights[:, k], minlength=len(points)) for k in range(3)]
    normals = np.stack(columns, 1).astype(float)  # of no vertices they are integers
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)


class Scene:
    """The particles, meshes and lines of a picture in three dimensions, and its lights.

    `canvas.scene(scene)` draws the scene and empties it, except for the camera: a program adds
    everything in each frame. A scene without a light shows the plain colours.
    """

    def __init__(self) -> None:
        self._camera = Camera()
        self._empty()

    def _empty(self) -> None:
        self._things: list[Callable[[Renderer, View], None]] = []
        self._ambient: Color | None = None
        self._lights: list[tuple[Any, Any]] = []

    def set_camera(self, camera: Camera) -> None:
        """Sets the camera, which stays until another one is set."""
        self._camera = camera

    def ambient_light(self, color: Any) -> None:
        """Adds light from everywhere: each number multiplies a channel of the colours."""
        self._ambient = tuple(_color(color).tolist())

    def point_light(self, pos: Any, color: Any) -> None:
        """A lamp at a point. It lights a surface by the cosine of the angle to its normal, at any
        distance, and casts no shadows."""
        if len(self._lights) == MOST_LIGHTS:
            raise TaiRuntimeError(f"a scene has at most {MOST_LIGHTS} point lights")
        self._lights.append((_point(pos), _color(color)))

    def particles(
        self, centers: Any, radius: float, color: Any = GREY, per_vertex_color: Any = None,
        per_vertex_radius: Any = None, index_offset: int = 0, index_count: int | None = None,
    ) -> None:  # fmt: skip
        """Adds balls to the scene.

        Args:
            centers: vectors of 3; those that are no numbers are left out.
            radius: of all, in units of the world.
            color: of all, three numbers from 0 to 1.
            per_vertex_color, per_vertex_radius: of each ball.
            index_offset, index_count: the first one, and the number, if not all are drawn.
        """
        points = vectors(centers, (3,), "centers")
        colors = _colors(color, per_vertex_color, len(points))
        radii = numbers(radius if per_vertex_radius is None else per_vertex_radius).ravel()
        if len(radii) not in (1, len(points)):
            raise TaiRuntimeTypeError(f"there are {len(radii)} radii for {len(points)} particles")
        radii = np.broadcast_to(radii, len(points))
        some = [_part(array, index_offset, index_count) for array in (points, radii, colors)]
        if len(some[0]):
            self._things.append(lambda renderer, view: renderer.particles(view, *some))

    def mesh(
        self, vertices: Any, indices: Any = None, normals: Any = None, color: Any = GREY,
        per_vertex_color: Any = None, two_sided: bool = False, vertex_offset: int = 0,
        vertex_count: int | None = None, index_offset: int = 0, index_count: int | None = None,
        show_wireframe: bool = False,
    ) -> None:  # fmt: skip
        """Adds triangles to the scene.

        Args:
            vertices: vectors of 3.
            indices: three of vertices for each triangle; without them each three vertices are one.
            normals: of the vertices; computed from the triangles, if there are none. They point to
                the side from which the corners run counterclockwise.
            color: of all, three numbers from 0 to 1.
            per_vertex_color: of each vertex; interpolated.
            two_sided: lamps light the back as well.
            vertex_offset, vertex_count: the first vertex and their number, if not all are used.
            index_offset, index_count: likewise of indices.
            show_wireframe: edges alone.
        """
        points = vectors(vertices, (3,), "vertices")
        colors = _colors(color, per_vertex_color, len(points))
        ups = None if normals is None else vectors(normals, (3,), "normals")
        if ups is not None and len(ups) != len(points):
            raise TaiRuntimeTypeError(f"there are {len(ups)} normals for {len(points)} vertices")
        points, colors = (_part(a, vertex_offset, vertex_count) for a in (points, colors))
        chosen = np.arange(len(points)) if indices is None else numbers(indices, np.int64).ravel()
        faces = _indices(_part(chosen, index_offset, index_count), len(points), 3, "triangles")
        if ups is None:
            ups = _normals(points, faces)
        else:
            ups = _part(ups, vertex_offset, vertex_count)
        faces = faces[np.isfinite(points).all(1)[faces].all(1)]
        if len(faces):
            self._things.append(
                lambda renderer, view: renderer.mesh(
                    view, points, ups, colors, faces, two_sided, show_wireframe
                )
            )

    def mesh_instance(
        self, vertices: Any, indices: Any = None, normals: Any = None, color: Any = GREY,
        per_vertex_color: Any = None, two_sided: bool = False, transforms: Any = None,
        instance_offset: int = 0, instance_count: int | None = None,
        show_wireframe: bool = False,
    ) -> None:  # fmt: skip
        """Adds a mesh at many places to the scene.

        Args:
            transforms: a matrix of 4×4 for each place, which acts on columns.
            instance_offset, instance_count: the first place and their number, if not all are used.
        """
        points = vectors(vertices, (3,), "vertices")
        faces = _indices(indices, len(points), 3, "triangles")
        moves = np.eye(4)[None] if transforms is None else numbers(transforms, float)
        if moves.shape[-2:] != (4, 4):
            raise TaiRuntimeTypeError(f"transforms are matrices of 4×4, got {moves.shape}")
        moves = _part(moves.reshape(-1, 4, 4), instance_offset, instance_count)
        if not len(moves) or not len(points):
            return
        placed = np.einsum("kij,nj->kni", moves[:, :3, :3], points) + moves[:, None, :3, 3]
        ups = None
        if normals is not None:
            turns = np.linalg.pinv(moves[:, :3, :3]).swapaxes(1, 2)
            ups = np.einsum("kij,nj->kni", turns, vectors(normals, (3,), "normals"))
        colors = np.tile(_colors(color, per_vertex_color, len(points)), (len(moves), 1))
        starts = np.arange(len(moves))[:, None, None] * len(points)
        self.mesh(placed.reshape(-1, 3), faces + starts, None if ups is None else
                  ups.reshape(-1, 3), per_vertex_color=colors, two_sided=two_sided,
                  show_wireframe=show_wireframe)  # fmt: skip

    def lines(
        self, vertices: Any, width: float, indices: Any = None, color: Any = GREY,
        per_vertex_color: Any = None, vertex_offset: int = 0, vertex_count: int | None = None,
        index_offset: int = 0, index_count: int | None = None,
    ) -> None:  # fmt: skip
        """Adds lines, which no light changes, to the scene.

        Args:
            vertices: vectors of 3.
            width: in pixels.
            indices: two of vertices for each line; without them each two vertices are one.
            color, per_vertex_color: of all, or of each vertex and interpolated.
        """
        points = vectors(vertices, (3,), "vertices")
        colors = _colors(color, per_vertex_color, len(points))
        points, colors = (_part(a, vertex_offset, vertex_count) for a in (points, colors))
        chosen = np.arange(len(points)) if indices is None else numbers(indices, np.int64).ravel()
        pairs = _indices(_part(chosen, index_offset, index_count), len(points), 2, "lines")
        if len(pairs):
            self._things.append(
                lambda renderer, view: renderer.lines(view, points[pairs], colors[pairs], width)
            )


class Canvas:
    """The picture of a window; coordinates run from 0 to 1, the second one upward.

    Later shapes cover earlier ones. Each frame begins with the background.
    """

    def __init__(self) -> None:
        self.background: Color = (0.0, 0.0, 0.0)
        self._commands: list[Callable[[Renderer, tuple[int, int]], None]] = []

    def set_background_color(self, color: Any) -> None:
        """The colour of frames that nothing covers, three numbers from 0 to 1."""
        self.background = tuple(_color(color).tolist())

    def set_image(self, img: Any) -> None:
        """A picture that fills the canvas: (n, m), (n, m, 3) or (n, m, 4), first index to the
        right; numbers from 0 to 1, or bytes."""
        rows = np.ascontiguousarray(pixels_of(img).swapaxes(0, 1)[::-1])
        self._commands.append(lambda renderer, size: renderer.image(rows))

    def circles(
        self, centers: Any, radius: float, color: Any = GREY, per_vertex_color: Any = None
    ) -> None:
        """Discs; the radius is a share of the height of the canvas."""
        points = _three(vectors(centers, (2, 3), "centers"))
        colors = _colors(color, per_vertex_color, len(points))
        radii = np.full(len(points), radius, np.float32)
        if len(points):
            self._commands.append(
                lambda renderer, size: renderer.discs(CANVAS, points, radii * size[1], colors)
            )

    def lines(
        self, vertices: Any, width: float, indices: Any = None, color: Any = GREY,
        per_vertex_color: Any = None,
    ) -> None:  # fmt: skip
        """Lines; the width is a share of the height of the canvas."""
        points = _three(vectors(vertices, (2, 3), "vertices"))
        colors = _colors(color, per_vertex_color, len(points))
        pairs = _indices(indices, len(points), 2, "lines")
        if len(pairs):
            self._commands.append(
                lambda renderer, size: renderer.lines(
                    CANVAS, points[pairs], colors[pairs], width * size[1], is_deep=False
                )
            )

    def triangles(
        self, vertices: Any, color: Any = GREY, indices: Any = None, per_vertex_color: Any = None
    ) -> None:
        """Filled triangles."""
        points = _three(vectors(vertices, (2, 3), "vertices"))
        colors = _colors(color, per_vertex_color, len(points))
        faces = _indices(indices, len(points), 3, "triangles")
        faces = faces[np.isfinite(points).all(1)[faces].all(1)]
        if len(faces):
            self._commands.append(
                lambda renderer, size: renderer.mesh(
                    CANVAS, points, np.zeros_like(points), colors, faces, is_deep=False
                )
            )

    def scene(self, scene: Scene) -> None:
        """Draws a scene as its camera sees it, and empties it."""
        camera, things = scene._camera, scene._things
        ambient, lights = scene._ambient, scene._lights
        # The camera is copied as it is now; the size of the window is known only when the frame is
        # drawn.
        eye, near, square = camera.get_view_matrix(), camera._near, camera.get_projection_matrix(1)
        is_flat = camera._mode == ProjectionMode.Orthogonal
        if ambient is None and lights:
            ambient = (0.0, 0.0, 0.0)

        def draw(renderer: Renderer, size: tuple[int, int]) -> None:
            matrix = square.copy()
            if not is_flat:
                matrix[0, 0] *= size[1] / size[0]
            view = View(eye, matrix, is_flat, near, ambient, lights)
            for thing in things:
                thing(renderer, view)

        self._commands.append(draw)
        scene._empty()


class Gui:
    """Panels of widgets over a window; places and sizes are shares of the window, from its upper
    left corner. A program calls each widget in each frame, with its value, and gets the new one."""

    def __init__(self, panels: Panels):
        self._panels = panels

    def begin(self, name: str, x: float, y: float, width: float, height: float) -> None:
        """Begins a panel of widgets with a title."""
        across, down = self._panels.size
        self._panels.begin(name, x * across, y * down, width * across, height * down)

    def end(self) -> None:
        """Ends the panel."""
        self._panels.end()

    @contextlib.contextmanager
    def sub_window(
        self, name: str, x: float, y: float, width: float, height: float
    ) -> Iterator[Gui]:
        """Opens a panel to which the widgets of the `with` block belong."""
        self.begin(name, x, y, width, height)
        try:
            yield self
        finally:
            self.end()

    def text(self, text: str, color: Any = None) -> None:
        """Lines of text."""
        if color is None:
            self._panels.text(text)
        else:
            red, green, blue = (round(255 * value) for value in _color(color).clip(0, 1).tolist())
            self._panels.text(text, (red, green, blue, 255))

    def button(self, text: str) -> bool:
        """Adds a button; returns whether it was clicked since the last frame."""
        return self._panels.button(text)

    def checkbox(self, text: str, old_value: bool) -> bool:
        """Adds a check box; returns its state, which clicks change."""
        return self._panels.checkbox(text, old_value)

    def slider_float(self, text: str, old_value: float, minimum: float, maximum: float) -> float:
        """Adds a slider; returns the number that the mouse has chosen, or the old one."""
        return self._panels.slider(text, old_value, minimum, maximum)

    def slider_int(self, text: str, old_value: int, minimum: int, maximum: int) -> int:
        """Adds a slider; returns the integer that the mouse has chosen, or the old one."""
        return round(self._panels.slider(text, old_value, minimum, maximum, ".0f"))

    def color_edit_3(self, text: str, old_value: Any) -> Color:
        """Adds three sliders for a colour; returns the colour."""
        return self._panels.color(text, old_value)


class Window(FrameLoop):
    """A window for a canvas; without a display, frames are drawn for files alone.

    Args:
        name: its title.
        res: width and height of its inside in pixels.
        vsync: frames wait for the screen.
        show_window: false to draw without one.
        fps_limit: frames in a second, at most; None or 0 for no limit.
        pos: its place on the screen in pixels.
        frames_dir: folder for the frames of `show()`.
        max_frames: frames after which `running` is false, where no window is.

    Attributes:
        frame: number of frames that were shown.
        event: the last one that `get_event` found.
    """

    def __init__(
        self, name: str = "tai", res: Any = (640, 480), vsync: bool = False,
        show_window: bool = True, fps_limit: float | None = 60, pos: tuple[int, int] = (100, 100),
        frames_dir: str | None = None, max_frames: int | None = None,
    ):  # fmt: skip
        self.name = name
        self.res = canvas_size(res, "a window")
        super().__init__(self.res, frames_dir, max_frames)
        self.fps_limit = fps_limit
        if show_window:
            self._open(name, self.res, False, pos, vsync, is_shared=False)
        self._canvas = Canvas()
        self._scene = Scene()
        self._gui = Gui(self._panels)
        self._renderer: Renderer | None = None
        self._offscreen: Any = None
        self._is_drawn = -1  # the number of commands that the frame has

    def get_canvas(self) -> Canvas:
        """Returns the canvas on which the window's frames are drawn."""
        return self._canvas

    def get_scene(self) -> Scene:
        """Returns the scene of this window."""
        return self._scene

    def get_gui(self) -> Gui:
        """Returns the panels of widgets in this window."""
        return self._gui

    @property
    def GUI(self) -> Gui:
        """Its panels of widgets."""
        return self._gui

    def get_window_shape(self) -> tuple[int, int]:
        """Returns width and height in pixels, as the user has resized the window."""
        if self._window is not None and self._window.is_open:
            return self._window.pixels
        return self.res

    def destroy(self) -> None:
        """Closes the window."""
        self.close()

    @property
    def _context(self) -> Any:
        if self._window is not None and self._window.is_open:
            return self._window.context
        if self._offscreen is None:
            self._offscreen = library.offscreen_context()
        return self._offscreen

    def _draw(self) -> Any:
        """Draws the commands of the canvas, unless that was done, in its current context."""
        context = self._context
        if self._renderer is None or self._renderer.context is not context:
            self._renderer, self._is_drawn = Renderer(context), -1
        size, commands = self.get_window_shape(), self._canvas._commands
        if self._is_drawn != len(commands):
            self._renderer.begin(size, self._canvas.background)
            for command in commands:
                command(self._renderer, size)
            if self._panels.shown:
                self._renderer.image(layer(self._panels.size, self._panels.shown))
            self._texture = self._renderer.finish()
            self._is_drawn = len(commands)
        return self._texture

    def _read(self, depth: bool = False) -> np.ndarray:
        with self._context:
            self._draw()
            assert self._renderer is not None
            return self._renderer.read_depth() if depth else self._renderer.read()

    def picture(self) -> Any:
        """Returns the frame as a Pillow image."""
        from PIL import Image

        return Image.fromarray(np.ascontiguousarray(self._read()[::-1, :, :3]))

    def save_image(self, filename: Any) -> None:
        """Writes the frame to a file; must be called before `show()` ends the frame."""
        save_picture(self.picture(), filename)

    def get_image_buffer_as_numpy(self) -> np.ndarray:
        """The frame as numbers from 0 to 1, (width, height, 4), first index to the right."""
        pixels = self._read().swapaxes(0, 1).astype(np.float32) / 255
        pixels[..., 3] = 1
        return pixels

    def get_depth_buffer_as_numpy(self) -> np.ndarray:
        """The depths of the frame, (width, height): 0 at the nearest plane, 1 at the farthest."""
        return np.ascontiguousarray(self._read(depth=True).swapaxes(0, 1))

    def show(self) -> None:
        """Ends a frame: shows it in the window, or writes it where there is a place for it."""
        self._panels.finish()
        self._is_drawn = -1
        self._show(self.picture, None, "ti.ui.Window")
        if self._window is not None:
            if self._window.is_open:
                with self._context:
                    self._window.present(self._draw())
        elif self.screen:
            self.screen.show(self.picture())
        self._keep_pace()
        self._canvas._commands.clear()
        self._is_drawn = -1


check_keywords(globals())
