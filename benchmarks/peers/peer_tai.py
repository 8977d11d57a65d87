"""Our own side of the benchmark: tai_scenes.py on tai."""

from __future__ import annotations

import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import harness


def load(cache: Path, arch: str, **options):
    """Starts tai; `options` are further arguments of its `init`."""
    import tai

    chosen = {"default_fp": tai.f32, **options}
    tai.init(
        arch=getattr(tai, arch),
        offline_cache=True,
        offline_cache_file_path=str(cache),
        **chosen,
    )
    used = tai.lang.impl.current_cfg().arch
    if used != arch:
        raise RuntimeError(f"asked for arch={arch}, and got {used}")
    import tai_scenes

    tai_scenes.elements_whole = used == "cuda"

    try:
        name = version("tai")
    except PackageNotFoundError:
        name = "in tree"
    return name, tai_scenes.SCENES, tai_scenes.make_launch


if __name__ == "__main__":
    sys.exit(harness.main("tai", load))
