"""The gallery: its page and pictures are those that its script makes of what examples draw."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "scripts"))

import gallery  # noqa: E402

LIMIT = 4_000_000  # bytes of all pictures together


@pytest.fixture
def folders(tmp_path, monkeypatch):
    """Runs that are there already, of films with few frames; page and pictures beside them."""
    kept = tmp_path / "kept"
    for folder in (kept, tmp_path / "pictures"):
        folder.mkdir()
    monkeypatch.setattr(gallery, "PICTURES", tmp_path / "pictures")
    monkeypatch.setattr(gallery, "PAGE", tmp_path / "gallery.md")
    for entry in gallery.ENTRIES:
        shades = [np.full((60, 60, 3), 25 * k, np.uint8) for k in range(9)]
        frames = [Image.fromarray(shade) for shade in shades]
        if not entry.output:
            (kept / entry.name).mkdir()
            for k, frame in enumerate(frames):
                frame.save(kept / entry.name / f"{k:04d}.png")
            continue
        more = {"save_all": True, "append_images": frames[1:]} if entry.output == "gif" else {}
        frames[0].save(kept / f"{entry.name}.{entry.output}", **more)
    return tmp_path


def test_what_the_script_makes(folders, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["gallery.py", "--keep", str(folders / "kept")])
    gallery.main()
    # The committed page is this one, and has its pictures.
    assert (folders / "gallery.md").read_text() == (ROOT / "docs/start/gallery.md").read_text()
    for path in (folders / "pictures").iterdir():
        assert (ROOT / "docs/start/pictures" / path.name).is_file()
    # Every picture that the page shows is made again.
    shown = re.findall(r"\(pictures/([^)]+)\)", (ROOT / "docs/start/gallery.md").read_text())
    assert {path.name for path in (folders / "pictures").iterdir()} == set(shown)
    last = Image.open(folders / "pictures/liquid.png").convert("L")
    assert last.size[0] == 470 and last.getpixel((50, 50)) > 190
    film = Image.open(folders / "pictures/gallery_billiards.gif")
    assert film.n_frames == 9 and film.size == (360, 360)
    strip = np.asarray(Image.open(folders / "pictures/gallery_smoke.png").convert("L"))
    assert strip.shape[1] == 900 and strip[50, 50] < 10 and strip[50, -50] > 190


def test_a_program_that_draws_nothing(folders, monkeypatch):
    entry = gallery.ENTRIES[0]._replace(name="rigid_body_toi", options="--steps 5")
    with pytest.raises(SystemExit, match="gallery: rigid_body_toi: "):
        gallery.run(entry, folders, keep=False)


def test_the_pictures_are_small():
    pictures = [*(ROOT / "docs").glob("*/pictures/*")]
    assert sum(path.stat().st_size for path in pictures) < LIMIT
    readme = (ROOT / "README.md").read_text()
    shown = re.findall(r"!\[[^\]]+\]\((docs/start/pictures/[^)]+)\)", readme)
    assert len(shown) == 3 and all((ROOT / name).is_file() for name in shown)


@pytest.mark.parametrize("entry", gallery.ENTRIES, ids=lambda entry: entry.name)
def test_its_options_exist(entry):
    program = ROOT / "examples" / f"{entry.name}.py"
    done = subprocess.run([sys.executable, program, "--help"], capture_output=True, text=True)
    assert set(re.findall(r"--[a-z]+", entry.options)) <= set(re.findall(r"--[a-z-]+", done.stdout))
