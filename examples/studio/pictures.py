"""One look for all pictures: palette, plots, movies."""

import argparse
import importlib
import io
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import tai as ti

from .options import fail, need

# Paper and ink, a soft grey for things that stand still, and colours for compared curves, in order.
PAPER, INK, SOFT = 0xF4F1EA, 0x2B3A55, 0x9A9484
BLUE, RED, GOLD, GREEN, PLUM, TEAL = 0x3E7CB1, 0xC8553D, 0xE0A458, 0x6A994E, 0x7B506F, 0x3A8F8A
# Colours, packed or by channel.
Pixels = npt.NDArray[Any]
SERIES = (BLUE, RED, GOLD, GREEN, PLUM, TEAL)


def plot(
    args: argparse.Namespace, what: str, curves: dict[str, Any], *, x: str, y: str, title: str = "",
    log: bool = False, dots: bool = False,
) -> None:  # fmt: skip
    """Writes `NAME.WHAT.png`.

    Args:
        curves: the values of each curve by its name, or a pair of positions and values, or a
            list of runs, which are drawn thin with their mean. The name of a single curve is
            not shown.
        x, y: labels of the axes, with units.
        log: a logarithmic y axis.
        dots: points instead of lines.
    """
    if not args.picture:
        return
    try:
        matplotlib: Any = importlib.import_module("matplotlib")
        figures: Any = importlib.import_module("matplotlib.figure")
    except ImportError:
        print(f"no plot of {what}: pip install matplotlib", file=sys.stderr)
        return
    look: dict[str, Any] = {
        "axes.edgecolor": css(SOFT), "axes.facecolor": css(PAPER), "axes.labelcolor": css(INK),
        "axes.prop_cycle": matplotlib.cycler(color=[css(color) for color in SERIES]),
        "axes.spines.right": False, "axes.spines.top": False, "axes.titlecolor": css(INK),
        "figure.facecolor": css(PAPER), "font.size": 11, "lines.linewidth": 1.8,
        "legend.frameon": False, "text.color": css(INK),
        "xtick.color": css(INK), "ytick.color": css(INK),
    }  # fmt: skip
    with matplotlib.rc_context(look):
        figure = figures.Figure(figsize=(6.4, 4), layout="constrained")
        axes = figure.subplots()
        for name, given in curves.items():
            values = cast(list[Any] | tuple[Any, Any], given)
            if isinstance(values, tuple):
                axes.plot(*values, "." if dots else "-", markersize=3.5, label=name)
            elif np.ndim(values) == 2:
                (line,) = axes.plot(np.mean(values, axis=0), label=name)
                axes.plot(np.transpose(values), color=line.get_color(), linewidth=0.8, alpha=0.4)
            else:
                axes.plot(values, "." if dots else "-", markersize=3.5, label=name)
        if x == "iteration":
            axes.xaxis.get_major_locator().set_params(integer=True)
        # Numbers that are all zero have no logarithm.
        has_log = log and any(line.get_ydata().max() > 0 for line in axes.lines)
        axes.set(xlabel=x, ylabel=y, title=title, yscale="log" if has_log else "linear")
        if len(curves) > 1:
            axes.legend()
        path = args.out / f"{args.name}.{what}.png"
        save_figure(figure, path, dpi=110)
    print(f"plot     {path.resolve()}")


def save_figure(figure: Any, path: Path, dpi: float) -> None:
    """Writes a matplotlib figure as a PNG of 256 colours, a third of what matplotlib writes."""
    from PIL import Image

    kept = io.BytesIO()
    figure.savefig(kept, dpi=dpi, format="png")
    Image.open(kept).convert("RGB").quantize(256).save(path, optimize=True)


def plot_losses(args: argparse.Namespace, losses: list[float], log: bool = False) -> None:
    """The curve of a descent."""
    if losses:
        plot(args, "losses", {"loss": losses}, x="iteration", y="loss", log=log)


def css(color: int) -> str:
    return f"#{color:06x}"


def blend(one: int, other: int, share: Any) -> Pixels:
    """Colours between two, 0xRRGGBB, by shares from 0 to 1."""
    share = np.clip(np.nan_to_num(np.asarray(share, float)), 0, 1)
    pairs = zip(ti.hex_to_rgb(one), ti.hex_to_rgb(other), strict=True)
    return ti.rgb_to_hex([a + (b - a) * share for a, b in pairs])


def signed(value: Any) -> Pixels:
    """Blue for -1, grey for 0, red for 1, and blends between."""
    value = np.asarray(value, float)
    return np.where(value < 0, blend(SOFT, BLUE, -value), blend(SOFT, RED, value))


def shades(
    values: Any, low: float, high: float, colors: tuple[int, ...] = (PAPER, BLUE, INK)
) -> Pixels:
    """An array of numbers as colours from 0 to 1, (..., 3), from `low` to `high`."""
    place = np.nan_to_num((np.asarray(values, float) - low) / (high - low)).clip(0, 1)
    stops = np.linspace(0, 1, len(colors))
    channels = zip(*map(ti.hex_to_rgb, colors), strict=True)
    return np.stack([np.interp(place, stops, channel) for channel in channels], axis=-1)


def animate(
    args: argparse.Namespace, draw: Callable[[ti.GUI, Any], None], times: Iterable[Any],
    res: tuple[int, int] = (480, 480), framerate: float = 24, what: str = "",
) -> None:  # fmt: skip
    """A movie of what `draw(gui, t)` draws at each time; the last frame stays a while."""
    if not args.picture:
        return
    gui = ti.GUI(args.name, res=res, background_color=PAPER)
    frames: list[Any] = []
    for t in times:
        draw(gui, t)
        frames.append(np.asarray(gui.picture()))
        gui.show()
    movie(args, frames, framerate, what)


def movie(
    args: argparse.Namespace, frames: list[Any], framerate: float = 24, what: str = ""
) -> None:
    """Frames (arrays of bytes, rows downward) as `NAME.gif`, or what --movie says."""
    if not args.picture:
        return
    if not frames:
        print("no film: the run is too short for a frame", file=sys.stderr)
        return
    path = args.out / f"{args.name}{'.' if what else ''}{what}.{args.movie}"
    frames = [np.asarray(frame) for frame in frames]
    frames += frames[-1:] * round(framerate / 2)
    if args.movie == "gif":
        ti.tools.write_gif(frames, str(path), framerate)
    elif args.movie == "mp4":
        _write_mp4(path, frames, framerate)
    else:
        from PIL import Image

        path = path.with_suffix("")
        path.mkdir(exist_ok=True)
        for old in path.glob("[0-9][0-9][0-9][0-9].png"):  # of a longer film
            old.unlink()
        for number, frame in enumerate(frames):
            Image.fromarray(frame).save(path / f"{number:04d}.png")
    print(f"picture  {path.resolve()}")


def _write_mp4(path: Path, frames: list[Any], framerate: float) -> None:
    # The format wants even sizes.
    height, width = (extent // 2 * 2 for extent in frames[0].shape[:2])
    size, rate = (width, height), framerate
    writer = need("imageio_ffmpeg", "--movie mp4", "imageio-ffmpeg").write_frames(
        str(path), size, fps=rate, quality=8, macro_block_size=2
    )
    try:
        writer.send(None)
        for frame in frames:
            writer.send(np.ascontiguousarray(frame[:height, :width, :3]))
        writer.close()
    except OSError as error:  # its text is the log of ffmpeg, many lines
        fail(f"cannot write {path}: {str(error).splitlines()[0]}")


def picture(args: argparse.Namespace, image: Any, what: str = "") -> None:
    """Writes an image (array or Pillow, rows downward) as `NAME.png`."""
    if not args.picture:
        return
    from PIL import Image

    path = args.out / f"{args.name}{'.' if what else ''}{what}.png"
    image = np.asarray(image)
    if image.dtype != np.uint8:
        image = (np.nan_to_num(image).clip(0, 1) * 255).round().astype(np.uint8)
    Image.fromarray(image).save(path)
    print(f"picture  {path.resolve()}")
