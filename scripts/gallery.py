"""Runs examples and makes a gallery of their images: docs/gallery.md.

    python scripts/gallery.py                    # all; some minutes on two cores
    python scripts/gallery.py --keep out/gallery # reuses the output of earlier runs

Videos are scaled down, or become a strip of some of their frames.
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
PAGE = ROOT / "docs" / "gallery.md"
PICTURES = ROOT / "docs" / "pictures"


class Entry(NamedTuple):
    """A program, what becomes of its output, and a text."""

    name: str
    options: str
    output: str
    kind: str  # film, strip or picture
    width: int
    text: str


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
]  # fmt: skip
# Made before, by the commands that docs/examples.md names.
OTHERS = {
    "electric.gif": ("python examples/electric.py", "Eight electrodes lead a ball along a path."),
    "liquid.png": (
        "python examples/liquid.py --steps 128 --iterations 3 --rate 100",
        "A robot below a pool of liquid, a quarter of a second after the start.",
    ),
}


def frames_of(path: Path) -> list[Image.Image]:
    with Image.open(path) as film:
        return [frame.convert("RGB") for frame in ImageSequence.Iterator(film)]


def narrowed(image: Image.Image, width: int) -> Image.Image:
    height = round(image.height * width / image.width)
    return image.resize((width, height), Image.Resampling.LANCZOS)


def make(entry: Entry, source: Path) -> Path:
    """The picture for the page."""
    film = entry.kind == "film"
    target = PICTURES / f"gallery_{entry.name}.{'gif' if film else 'png'}"
    if entry.kind == "picture":
        with Image.open(source) as image:
            narrowed(image.convert("RGB"), entry.width).quantize(128).save(target, optimize=True)
        return target
    frames = frames_of(source)
    if film:
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
    found = folder / f"{entry.name}.{entry.output}"
    if keep and found.is_file():
        return found
    program = ROOT / "examples" / f"{entry.name}.py"
    command = [sys.executable, str(program), *entry.options.split(), "--out", str(folder)]
    paths = [str(ROOT / "python"), os.environ.get("PYTHONPATH", "")]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))}
    print(f"{entry.name} {entry.options}", file=sys.stderr, flush=True)
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    if done.returncode or not found.is_file():
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
    parts = ["# Gallery", "What the programs of [examples](examples.md) draw, made by "
             "`python scripts/gallery.py`. Plots of the paper's experiments are on [their page]"
             "(paper.md)."]  # fmt: skip
    for entry in ENTRIES:
        picture = make(entry, run(entry, folder, keep=args.keep is not None))
        command = f"python examples/{entry.name}.py {entry.options}"
        parts += [f"## {entry.name}", f"![{entry.text}](pictures/{picture.name})"]
        parts += [f"{entry.text}\n`{command}`"]
    for name, (command, text) in OTHERS.items():
        parts += [f"## {name.split('.')[0]}", f"![{text}](pictures/{name})", f"{text}\n`{command}`"]
    PAGE.write_text("\n\n".join(parts) + "\n")
    print(PAGE)


if __name__ == "__main__":
    main()
