"""The peer quadrants: the source of tai_scenes.py with quadrants under the name tai."""

from __future__ import annotations

import sys
from importlib.metadata import version
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import harness


def load(cache: Path, arch: str):
    import quadrants

    sys.modules["tai"] = quadrants
    quadrants.init(
        arch=getattr(quadrants, arch),
        default_fp=quadrants.f32,
        offline_cache=True,
        offline_cache_file_path=str(cache),
        log_level=quadrants.ERROR,
    )
    import tai_scenes

    return version("quadrants"), tai_scenes.SCENES, tai_scenes.make_launch


if __name__ == "__main__":
    sys.exit(harness.main("quadrants", load))
