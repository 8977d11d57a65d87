"""The peer quadrants: the source of tai_scenes.py with quadrants under the name tai."""

from __future__ import annotations

import sys
from importlib.metadata import version
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import harness


def load(cache: Path, arch: str, **options):
    """Starts it; `options` are further arguments of its `init`."""
    import quadrants

    sys.modules["tai"] = quadrants
    chosen = {"default_fp": quadrants.f32, **options}
    quadrants.init(
        arch=getattr(quadrants, arch),
        offline_cache=True,
        offline_cache_file_path=str(cache),
        log_level=quadrants.ERROR,
        **chosen,
    )
    import tai_scenes

    return version("quadrants"), tai_scenes.SCENES, tai_scenes.make_launch


if __name__ == "__main__":
    sys.exit(harness.main("quadrants", load))
