"""Runs examples and makes a gallery of their images: docs/start/gallery.md.

    python scripts/gallery.py                    # all; some minutes on two cores
    python scripts/gallery.py --keep out/gallery # reuses the output of earlier runs

Videos are scaled down, or become a strip of some of their frames, or a part of the last one.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from PIL import Image, ImageSequence

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "start" / "gallery.md"
PICTURES = PAGE.parent / "pictures"
# The part of a "last" frame that is kept: left, top, right and bottom as shares of it.
CUT = (0.13, 0.24, 0.865, 0.977)


class Entry(NamedTuple):
    """A program, what becomes of its output, and a text."""

    name: str
    options: str
    output: str  # suffix of a file; empty: a folder of frames
    kind: str  # film, strip, last or picture
    width: int
    text: str
    target: str = ""  # of the picture; empty: gallery_NAME

    def path(self) -> Path:
        suffix = "gif" if self.kind == "film" else "png"
        return PICTURES / f"{self.target or f'gallery_{self.name}'}.{suffix}"


ENTRIES = [
    Entry("mass_spring", "--robot 2 --iterations 30", "gif", "film", 480,
          "A robot of springs has learned to run, in thirty steps of descent. Muscles are red when "
          "long and blue when short."),
    Entry("rigid_body", "--robot 2 --iterations 20", "gif", "film", 480,
          "Two legs of boxes and joints reach for the goal, after twenty steps."),
    Entry("billiards", "--iterations 200", "gif", "film", 360,
          "Where the cue ball must start, and how fast, for the red ball to reach the pocket."),
    Entry("diffmpm3d", "--steps 96 --iterations 2 --rate 300", "gif", "strip", 900,
          "Thirty thousand particles on four legs with sixteen muscles."),
    Entry("smoke", "--iterations 40", "gif", "strip", 900,
          "Chequered smoke, stirred at the start so that it becomes the yin-yang sign."),
    Entry("wave", "--iterations 100", "gif", "strip", 900,
          "A ripple that becomes the sign, 256 steps later."),
    Entry("volume_renderer", "--res 128 --views 4 --iterations 30", "png", "picture", 600,
          "Above, four shadows of a body; below, those of the body that was found from them."),
    Entry("electric", "", "gif", "film", 480, "Eight electrodes steer a ball along a new path.",
          "electric"),
    Entry("liquid", "--steps 128 --iterations 3 --rate 100 --movie png", "", "last", 470,
          "A robot below a pool of liquid, a quarter of a second after the start.", "liquid"),
]  # fmt: skip


def frames_of(path: Path) -> list[Image.Image]:
    with Image.open(path) as film:
        return [frame.convert("RGB") for frame in ImageSequence.Iterator(film)]


def narrowed(image: Image.Image, width: int) -> Image.Image:
    height = round(image.height * width / image.width)
    return image.resize((width, height), Image.Resampling.LANCZOS)


def make(entry: Entry, source: Path) -> Path:
    """The picture for the page."""
    target = entry.path()
    if entry.kind == "picture":
        with Image.open(source) as image:
            narrowed(image.convert("RGB"), entry.width).quantize(128).save(target, optimize=True)
        return target
    if entry.kind == "last":
        with Image.open(max(source.iterdir())) as image:
            box = [round(share * n) for share, n in zip(CUT, image.size * 2, strict=True)]
            narrowed(image.convert("RGB").crop(box), entry.width).save(target, optimize=True)
        return target
    frames = frames_of(source)
    if entry.kind == "film":
        step = -(-len(frames) // 60)
        small = [narrowed(frame, entry.width).quantize(64) for frame in frames[::step]]
        small[0].save(
            target,
            save_all=True,
            append_images=small[1:],
            duration=42 * step,
            loop=0,
            optimize=True,
        )
        return target
    count = 3 if frames[0].width > frames[0].height else 5
    chosen = [frames[round(k * (len(frames) - 1) / (count - 1))] for k in range(count)]
    small = [narrowed(frame, entry.width // count - 6) for frame in chosen]
    strip = Image.new("RGB", (entry.width, small[0].height), "#f4f1ea")
    for number, image in enumerate(small):
        strip.paste(image, (3 + number * (entry.width // count), 0))
    strip.quantize(128).save(target, optimize=True)
    return target


def run(entry: Entry, folder: Path, keep: bool) -> Path:
    found = folder / (f"{entry.name}.{entry.output}" if entry.output else entry.name)
    if keep and found.exists():
        return found
    program = ROOT / "examples" / f"{entry.name}.py"
    command = [sys.executable, str(program), *entry.options.split(), "--out", str(folder)]
    paths = [str(ROOT / "python"), os.environ.get("PYTHONPATH", "")]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))}
    print(f"{entry.name} {entry.options}", file=sys.stderr, flush=True)
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    if done.returncode or not found.exists():
        lines = done.stderr.strip().splitlines() or ["it wrote no film"]
        sys.exit(f"gallery: {entry.name}: {lines[-1]}")
    return found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--keep", type=Path, help="a folder of outputs, which are not made again")
    args = parser.parse_args()
    folder = args.keep or Path("out/gallery")
    folder.mkdir(parents=True, exist_ok=True)
    parts = ["# Gallery", "The pictures of the programs of [examples](examples.md), made by "
             "`python scripts/gallery.py`. Plots of the paper's experiments are on [their page]"
             "(../reports/paper.md)."]  # fmt: skip
    for entry in ENTRIES:
        picture = make(entry, run(entry, folder, keep=args.keep is not None))
        command = f"python examples/{entry.name}.py {entry.options}".strip()
        parts += [f"## {entry.name}", f"![{entry.text}](pictures/{picture.name})"]
        parts += [f"{entry.text}\n`{command}`"]
    PAGE.write_text("\n\n".join(parts) + "\n")
    print(PAGE)


if __name__ == "__main__":
    main()
