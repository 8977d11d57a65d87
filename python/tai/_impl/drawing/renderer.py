"""Draws particles, meshes, lines, discs and images into a frame by OpenGL."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .shaders import MOST_LIGHTS, PROGRAMS

_IDENTITY = np.eye(4, dtype=np.float32)
# Triangles and squares are clipped at the eye, and not at the nearest and farthest planes, since
# balls test these planes pixel by pixel.
_DEPTH_CLAMP = 0x864F
_SAMPLES = 4


@dataclass
class View:
    """How a scene is seen: the matrices of a camera, which act on columns, and the lights.

    Attributes:
        nearest: distance of the first plane that is seen.
        ambient: light from everywhere; None for colours without light and shade.
        lights: place and colour of each lamp.
    """

    view: np.ndarray = field(default_factory=lambda: _IDENTITY)
    projection: np.ndarray = field(default_factory=lambda: _IDENTITY)
    is_orthographic: bool = True
    nearest: float = 0.0
    ambient: tuple[float, ...] | None = None
    lights: list[tuple[Any, Any]] = field(default_factory=list)


# The unit square of a canvas, x to the right and y upward.
CANVAS = View(
    view=np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -1], [0, 0, 0, 1]], np.float32),
    projection=np.array([[2, 0, 0, -1], [0, 2, 0, -1], [0, 0, 0, 0], [0, 0, 0, 1]], np.float32),
)


class Renderer:
    """Draws frames in one OpenGL context.

    Args:
        context: that of ModernGL; the owner has made it the current one before each call.
    """

    def __init__(self, context: Any):
        self.context = context
        self._programs: dict[str, Any] = {}
        self._size = (0, 0)
        self._smooth: Any = None
        self._plain: Any = None
        self._texture: Any = None

    def begin(self, size: tuple[int, int], background: tuple[float, ...]) -> None:
        """Begins a frame of `size` pixels with a background colour."""
        if size != self._size:
            self._make(size)
        context = self.context
        self._smooth.use()
        context.viewport = (0, 0, *size)
        context.wireframe = False
        context.enable_direct(_DEPTH_CLAMP)
        context.blend_func = context.SRC_ALPHA, context.ONE_MINUS_SRC_ALPHA
        self._smooth.clear(*background[:3], 1.0, depth=1.0)

    def _make(self, size: tuple[int, int]) -> None:
        context = self.context
        for old in (self._smooth, self._plain):
            if old is not None:
                for part in (*old.color_attachments, old.depth_attachment, old):
                    part.release()
        samples = min(_SAMPLES, context.max_samples)
        self._smooth = context.framebuffer(
            context.renderbuffer(size, 4, samples=samples),
            context.depth_renderbuffer(size, samples=samples),
        )
        self._texture = context.texture(size, 4)
        self._plain = context.framebuffer(self._texture, context.depth_renderbuffer(size))
        self._size = size

    def finish(self) -> Any:
        """Ends the frame, and returns its picture as a texture."""
        self.context.copy_framebuffer(self._plain, self._smooth)
        return self._texture

    def read(self) -> np.ndarray:
        """Returns the finished frame as bytes (height, width, 4), rows upward."""
        width, height = self._size
        data = self._plain.read(components=4, alignment=1)
        return np.frombuffer(data, np.uint8).reshape(height, width, 4)

    def read_depth(self) -> np.ndarray:
        """The depths of the pixels of the finished frame, from 0 to 1, as an array (height, width)
        with rows upward.
        """
        width, height = self._size
        data = self._plain.read(attachment=-1, components=1, dtype="f4", alignment=1)
        return np.frombuffer(data, np.float32).reshape(height, width)

    def _render(
        self, name: str, view: View, per: str, arrays: dict[str, np.ndarray], indices: Any = None,
        is_deep: bool = True, **uniforms: Any,
    ) -> None:  # fmt: skip
        """Runs a shader program on the given vertices.

        Args:
            per: "i" for a square for each element of the arrays, "v" for a vertex each.
            is_deep: whether the nearer thing covers the other one; otherwise the later one does.
        """
        context = self.context
        if name not in self._programs:
            corners, pixels = PROGRAMS[name]
            self._programs[name] = context.program(vertex_shader=corners, fragment_shader=pixels)
        program = self._programs[name]
        uniforms["resolution"] = tuple(map(float, self._size))
        uniforms["is_orthographic"] = view.is_orthographic
        uniforms |= {"nearest": view.nearest, "is_lit": view.ambient is not None}
        for key, value in uniforms.items():
            if key in program:
                program[key].value = value
        for key in ("view", "projection"):
            if key in program:
                program[key].write(np.ascontiguousarray(getattr(view, key).T, np.float32))
        if view.ambient is not None and "ambient" in program:
            program["ambient"].value = tuple(view.ambient)
            program["light_count"].value = len(view.lights)
            table = np.zeros((2, MOST_LIGHTS, 3), np.float32)
            for k, (place, color) in enumerate(view.lights):
                table[0, k] = (view.view @ [*place, 1])[:3]
                table[1, k] = color
            program["light_places"].write(table[0])
            program["light_colors"].write(table[1])
        (context.enable if is_deep else context.disable)(context.DEPTH_TEST)
        (context.disable if is_deep else context.enable)(context.BLEND)
        kept, content = [], []
        for key, array in arrays.items():
            array = np.ascontiguousarray(array, np.float32)
            kept.append(context.buffer(array))
            content.append((kept[-1], f"{array.size // len(array)}f/{per}", key))
        if indices is not None:
            kept.append(context.buffer(np.ascontiguousarray(indices, np.uint32)))
        vertices = context.vertex_array(
            program, content, index_buffer=kept[-1] if indices is not None else None
        )
        if per == "i":
            count = len(next(iter(arrays.values()))) if arrays else 1
            vertices.render(context.TRIANGLE_STRIP, vertices=4, instances=count)
        else:
            vertices.render(context.TRIANGLES)
        for one in (vertices, *kept):
            one.release()

    def particles(
        self, view: View, centers: np.ndarray, radii: np.ndarray, colors: np.ndarray
    ) -> None:
        """Draws balls with centres (n, 3), radii (n,) and colours (n, 4)."""
        arrays = {"center": centers, "radius": radii, "color": colors}
        self._render("particles", view, "i", arrays)

    def discs(self, view: View, centers: np.ndarray, radii: np.ndarray, colors: np.ndarray) -> None:
        """Draws discs on the canvas, with radii in pixels."""
        arrays = {"center": centers, "radius": radii, "color": colors}
        self._render("discs", view, "i", arrays, is_deep=False)

    def mesh(
        self, view: View, positions: np.ndarray, normals: np.ndarray, colors: np.ndarray,
        faces: np.ndarray, is_two_sided: bool = False, is_wireframe: bool = False,
        is_deep: bool = True,
    ) -> None:  # fmt: skip
        """Draws triangles, given by rows of three indices of vertices."""
        arrays = {"position": positions, "normal": normals, "color": colors}
        self.context.wireframe = is_wireframe
        self._render("mesh", view, "v", arrays, faces, is_deep, is_two_sided=is_two_sided)
        self.context.wireframe = False

    def lines(
        self, view: View, ends: np.ndarray, colors: np.ndarray, width: float, is_deep: bool = True
    ) -> None:
        """Draws lines: ends (n, 2, 3), colours (n, 2, 4), and a width in pixels."""
        arrays = {"begin": ends[:, 0], "end": ends[:, 1],
                  "begin_color": colors[:, 0], "end_color": colors[:, 1]}  # fmt: skip
        self._render("lines", view, "i", arrays, is_deep=is_deep, width=width)

    def image(self, pixels: np.ndarray) -> None:
        """Draws a picture over the whole frame: bytes (height, width, 3 or 4), rows downward."""
        height, width, channels = pixels.shape
        texture = self.context.texture(
            (width, height), channels, np.ascontiguousarray(pixels), alignment=1
        )
        texture.filter = (self.context.NEAREST, self.context.NEAREST)
        texture.use(0)
        self._render("image", CANVAS, "i", {}, is_deep=False, is_upright=False)
        texture.release()
