"""`ti.tools`: image and video files, and the report of shadow execution."""

from __future__ import annotations

import contextlib
import importlib
import os
import warnings
from typing import Any

import numpy as np

from ._impl.base.callers import calling_level
from ._impl.base.files import replacing_name, save_picture
from ._impl.base.keywords import check_keywords
from ._impl.base.ply import PLYWriter as PLYWriter
from ._impl.base.shadows import ShadowReport as ShadowReport
from ._impl.base.shadows import ShadowRow as ShadowRow
from ._impl.base.shadows import clear_shadow_report as clear_shadow_report
from ._impl.base.shadows import shadow_report as shadow_report
from ._impl.launch.shadow_values import shadow_values as shadow_values
from ._impl.launch.shadow_values import shadows as shadows
from .errors import TaiRuntimeError, TaiRuntimeTypeError
from .gui import GUI


def _pixels_of(image: Any) -> np.ndarray:
    """The array of a field, of an array or of a list: (width, height) or with channels.

    Raises:
        TaiRuntimeTypeError: it is no picture.
    """
    try:
        pixels = image.to_numpy() if hasattr(image, "to_numpy") else np.asarray(image)
    except ValueError as error:  # lists of several lengths
        raise TaiRuntimeTypeError(
            f"a picture is an array of numbers: {error}", "give all rows one length"
        ) from None
    if not isinstance(pixels, np.ndarray) or pixels.dtype.kind not in "buif":
        what = f"numbers of type {pixels.dtype}" if hasattr(pixels, "dtype") else "a dictionary"
        raise TaiRuntimeTypeError(
            f"a picture is made of whole numbers or floats, but got {what}",
            "pass a field or an array of ti.f32, or of ti.u8",
        )
    has_channels = pixels.ndim == 3 and 1 <= pixels.shape[2] <= 4
    if not (pixels.ndim == 2 or has_channels) or 0 in pixels.shape:
        raise TaiRuntimeTypeError(
            f"a picture has shape (width, height), or (width, height, 1 to 4), but got "
            f"{pixels.shape}",
            "reshape the array, or take a part of it",
        )
    return pixels


def cook_image_to_bytes(image: Any) -> np.ndarray:
    """An array of a field or an array as bytes, rows downward: (height, width, channels)."""
    pixels = _pixels_of(image)
    if pixels.dtype == np.bool_:
        pixels = pixels * np.uint8(255)
    if pixels.dtype != np.uint8:
        if pixels.dtype.kind == "f":
            pixels = np.clip(np.nan_to_num(pixels), 0, 1) * 255
        pixels = pixels.astype(np.uint8)
    if pixels.ndim == 2:
        pixels = pixels[..., None]
    return np.ascontiguousarray(pixels.swapaxes(0, 1)[::-1])


def imwrite(image: Any, filename: str) -> None:
    """Writes a picture; the first index of `image` goes to the right, the second one upward."""
    from PIL import Image

    pixels = cook_image_to_bytes(image)
    picture = Image.fromarray(pixels[..., 0] if pixels.shape[2] == 1 else pixels)
    try:
        save_picture(picture, filename)
    except ValueError as error:
        raise TaiRuntimeError(
            f"the picture cannot be written to '{filename}': {error}",
            "the name ends with the format: .png, .jpg, .bmp",
        ) from None


def imread(filename: str, channels: int = 0) -> np.ndarray:
    """Reads a picture as bytes, first index to the right, second one upward."""
    from PIL import Image

    if isinstance(filename, (str, os.PathLike)) and not os.path.exists(filename):
        raise TaiRuntimeError(
            f"there is no picture '{filename}'", "paths count from the folder where Python started"
        )
    mode = {1: "L", 3: "RGB", 4: "RGBA"}.get(channels)
    with Image.open(filename) as picture:
        pixels = np.asarray(picture.convert(mode) if mode else picture)
    return np.ascontiguousarray(pixels[::-1].swapaxes(0, 1))


def imresize(image: Any, width: int, height: int | None = None) -> np.ndarray:
    """Returns the picture in another size, by nearest pixels."""
    pixels = _pixels_of(image)
    height = width if height is None else height
    if width < 1 or height < 1:
        raise TaiRuntimeError(
            f"a picture has at least one pixel, but got {width} by {height}", "make it larger"
        )
    columns = np.arange(width) * pixels.shape[0] // width
    rows = np.arange(height) * pixels.shape[1] // height
    return pixels[columns][:, rows]


def imshow(image: Any, title: str = "imshow") -> None:
    """Shows a picture: writes it as one frame of a `ti.GUI`."""
    pixels = _pixels_of(image)
    gui = GUI(title, res=pixels.shape[:2])
    gui.set_image(pixels)
    if not gui.frames_dir:
        warnings.warn(
            "ti.tools.imshow has no window and no folder to write to\n  hint: set the folder in "
            "the environment, TAI_GUI_DIR=frames, or call ti.tools.imwrite(image, file)",
            stacklevel=calling_level(),
        )
    gui.show()


def write_gif(frames: list[Any], filename: str, framerate: float = 24) -> None:
    """Writes Pillow images or arrays (rows downward) as an animation that repeats."""
    from PIL import Image

    if not frames:
        raise TaiRuntimeError("an animation needs at least one frame")
    if GUI.screen:
        GUI.screen.play(frames, framerate)
    pictures = [f if isinstance(f, Image.Image) else Image.fromarray(f) for f in frames]
    colors = [p.convert("P", palette=Image.Palette.ADAPTIVE, colors=64) for p in pictures]
    each = round(1000 / framerate)
    save_picture(
        colors[0], filename, save_all=True, append_images=colors[1:], duration=each, loop=0
    )


class VideoManager:
    """Collects frames in a folder and makes a video of them.

    Args:
        output_dir: the folder; frames go to `frames` in it.
        framerate: frames in a second.
        automatic_build: make the video when the program ends.
    """

    def __init__(
        self, output_dir: str, video_filename: str | None = None, framerate: int = 24,
        automatic_build: bool = True, width: int | None = None, height: int | None = None,
        post_processor: Any = None,
    ):  # fmt: skip
        self.directory, self.framerate = output_dir, framerate
        self.filename = video_filename or "video"
        self.post_processor = post_processor
        self.frame_directory = os.path.join(output_dir, "frames")
        os.makedirs(self.frame_directory, exist_ok=True)
        self.frame_fns: list[str] = []

    def get_output_filename(self, suffix: str) -> str:
        return os.path.join(self.directory, self.filename + suffix)

    def write_frame(self, image: Any) -> None:
        """Adds a frame to the video; axes as in `imwrite`."""
        name = os.path.join(self.frame_directory, f"{len(self.frame_fns):06d}.png")
        imwrite(image if self.post_processor is None else self.post_processor(image), name)
        self.frame_fns.append(name)

    def make_video(self, mp4: bool = True, gif: bool = True) -> None:
        """Writes `video.gif` and, where imageio can, `video.mp4`."""
        from PIL import Image

        pictures = [Image.open(name).convert("RGB") for name in self.frame_fns]
        if gif:
            write_gif(pictures, self.get_output_filename(".gif"), self.framerate)
        if mp4:
            try:
                import imageio

                with replacing_name(self.get_output_filename(".mp4")) as part:
                    imageio.mimwrite(part, [np.asarray(p) for p in pictures], fps=self.framerate)
            except (ImportError, ValueError) as error:
                raise TaiRuntimeError(
                    f"no mp4: {error}", "pip install imageio-ffmpeg, or make_video(mp4=False)"
                ) from error


class Progress:
    """A progress bar around an iterable: by rich where it is installed, else plain lines.

    ```python
    bar = ti.tools.Progress(range(100), "optimising")
    for i in bar:
        bar.note(f"loss {loss[None]:.3g}")
    ```
    """

    def __init__(self, items: Any, title: str):
        self.items, self.title = items, title
        self._text = ""

    def note(self, text: str) -> None:
        """Shows a text beside the progress bar from now on."""
        self._text = text

    def __iter__(self) -> Any:
        import sys

        total = len(self.items)
        rich: Any = None
        with contextlib.suppress(ImportError):
            rich = importlib.import_module("rich.progress")
        if rich is None or not sys.stderr.isatty():
            for count, item in enumerate(self.items, 1):
                yield item
                if count % max(1, total // 5) == 0 or count == total:
                    print(f"{self.title} {count}/{total} {self._text}", file=sys.stderr)
            return
        from rich.console import Console

        columns = [rich.TextColumn(self.title), rich.BarColumn(), rich.MofNCompleteColumn()]
        columns += [rich.TimeElapsedColumn(), rich.TextColumn("{task.fields[note]}")]
        with rich.Progress(*columns, console=Console(stderr=True)) as bar:
            task = bar.add_task("", total=total, note="")
            for item in self.items:
                yield item
                bar.update(task, advance=1, note=self._text)


check_keywords(globals())
