"""Checks that tai works on this machine: `python -m tai doctor`.

Each check prints one line: `ok`, `note` for a feature that is missing and that most programs do
not need, or `FAIL`, with the remedy below. The exit status is 1 if a check failed.
"""

from __future__ import annotations

import dataclasses
import importlib.util
import math
import os
import sys
import tempfile
from collections.abc import Callable

from . import about
from ._impl.base import dtypes, native
from ._impl.base.program import reset
from ._impl.base.start import init
from ._impl.base.targets import cpu, cuda, why_no_cuda
from ._impl.fields.make import field
from ._impl.launch.kernels import kernel
from ._impl.values.ops import sin
from ._version import __version__
from .ad import Tape
from .errors import TaiError


@dataclasses.dataclass
class Found:
    """The outcome of a check: `grade` is "ok", "note" or "FAIL"."""

    grade: str
    text: str
    remedy: str = ""


def _versions() -> Found:
    library = native.version()
    if library != __version__:
        return Found(
            "FAIL",
            f"the package is {__version__}, and libtai is {library}",
            "install them together: an old installation may be on PYTHONPATH",
        )
    return Found("ok", about.version_line())


def _where() -> Found:
    return Found("ok", f"libtai is {about.loaded('libtai.so')}")


def _gradient(arch: str) -> str:
    """Checks that a kernel compiles and has a gradient; returns the complaint, or nothing."""
    init(arch=cuda if arch == "cuda" else cpu, offline_cache=False)
    x = field(dtypes.f64, shape=64, needs_grad=True)
    loss = field(dtypes.f64, shape=(), needs_grad=True)

    @kernel
    def energy():  # type: ignore[no-untyped-def]
        for i in x:
            loss[None] += sin(x[i]) ** 2

    for i in range(64):
        x[i] = 0.03125 * i
    with Tape(loss):
        energy()
    worst = max(abs(x.grad[i] - math.sin(0.0625 * i)) for i in range(64))
    return "" if worst < 1e-12 else f"the gradient of a kernel is off by {worst:.1e}"


def _kernel() -> Found:
    complaint = _gradient("cpu")
    if complaint:
        return Found("FAIL", complaint, "report it with the output of `python -m tai info`")
    return Found("ok", "a kernel and its gradient are compiled and right on the CPU")


def _vectors() -> Found:
    if about.loaded("libsleef.so.3"):
        return Found("ok", "loops call the vector functions of SLEEF")
    return Found(
        "note",
        "no libsleef.so.3: functions such as sin are computed one at a time",
        "install SLEEF (Debian: libsleef3); the wheels contain it",
    )


def _cache() -> Found:
    folder = about.cache_folder()
    if not folder:
        return Found("note", "each process compiles its kernels again", "unset TAI_CACHE_DIR")
    try:
        os.makedirs(folder, mode=0o700, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        return Found(
            "note",
            f"compiled kernels are not kept: {error}",
            "set TAI_CACHE_DIR to a folder of your own",
        )
    if os.stat(folder).st_mode & 0o022:
        return Found(
            "note",
            f"compiled kernels are not kept: other users may write to {folder}",
            f"chmod go-w {folder}",
        )
    return Found("ok", f"compiled kernels are kept in {folder}")


def _gpu() -> Found:
    reason = why_no_cuda()
    if reason:
        return Found("note", f"no GPU: {reason}", "programs with arch=ti.gpu run on the CPU")
    complaint = _gradient("cuda")
    if complaint:
        return Found("FAIL", f"{complaint} on the GPU", "report it with `python -m tai info`")
    return Found("ok", "a kernel and its gradient are compiled and right on the GPU")


def _window() -> Found:
    if not importlib.util.find_spec("matplotlib"):
        return Found("note", "no window: matplotlib is missing", 'pip install "tai[view]"')
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return Found("note", "no display: `python -m tai view` writes frames to files")
    return Found("ok", "`python -m tai view` opens a window")


CHECKS: dict[str, Callable[[], Found]] = {
    "versions": _versions,
    "library": _where,
    "cache": _cache,
    "compiler": _kernel,
    "vectors": _vectors,
    "GPU": _gpu,
    "window": _window,
}


def examine() -> dict[str, Found]:
    """Runs all checks, in order. The running program is discarded, as by `ti.reset`."""
    reset()
    found = {}
    for name, check in CHECKS.items():
        try:
            found[name] = check()
        except (TaiError, OSError) as error:
            found[name] = Found("FAIL", str(error), "report it with `python -m tai info`")
    reset()
    return found


def main() -> int:
    """Prints the findings of all checks; returns 1 if a check failed."""
    found = examine()
    for name, one in found.items():
        print(f"{one.grade:<5} {name:<9} {one.text}")
        if one.remedy and one.grade != "ok":
            print(f"{'':15} hint: {one.remedy}")
    failed = sum(one.grade == "FAIL" for one in found.values())
    print("all is well" if not failed else f"{failed} of {len(found)} checks failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
