"""The peer taichi: the source of tai_scenes.py with taichi under the name tai."""

from __future__ import annotations

import sys
from importlib.metadata import version
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import harness


def load(cache: Path, arch: str, **options):
    """Starts it; `options` are further arguments of its `init`."""
    import taichi

    sys.modules["tai"] = taichi
    chosen = {"default_fp": taichi.f32, **options}
    taichi.init(
        arch=getattr(taichi, arch),
        offline_cache=True,
        offline_cache_file_path=str(cache),
        log_level=taichi.ERROR,
        **chosen,
    )
    import tai_scenes

    return version("taichi"), tai_scenes.SCENES, tai_scenes.make_launch


if __name__ == "__main__":
    sys.exit(harness.main("taichi", load))
