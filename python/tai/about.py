"""`ti.info`: the versions, the machine and the libraries that a program runs with.

A report of a bug should contain them: `python -m tai info`.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib.metadata
import json
import os
import platform
import subprocess
from pathlib import Path

from ._impl.base import native, state
from ._impl.base.keywords import check_keywords
from ._impl.base.targets import why_no_cuda
from ._version import __version__

_PACKAGE = Path(__file__).resolve().parent
# Optional packages that some features of tai use.
_PEERS = ("numpy", "torch", "jax", "matplotlib", "scipy")


@dataclasses.dataclass(frozen=True)
class Info:
    """The result of `ti.info`, which `str` turns into a table.

    Attributes:
        version: of the package, as `ti.__version__`.
        commit: of the sources; "unknown" if they were built outside of a checkout.
        llvm: the version of the LLVM and MLIR inside of libtai.
        libtai: the path of the library.
        python: the interpreter and its version.
        system: the kernel and the C library.
        processor: its name, and how many of its cores the process may use.
        cuda: "available", or the reason why `arch=ti.cuda` is not.
        arch: the target of the running program; None before `ti.init`.
        cache: the folder of compiled kernels; empty if there is none.
        packages: the versions of optional packages that are installed.
    """

    version: str
    commit: str
    llvm: str
    libtai: str
    python: str
    system: str
    processor: str
    cuda: str
    arch: str | None
    cache: str
    packages: dict[str, str]

    def __str__(self) -> str:
        rows = dataclasses.asdict(self)
        rows["arch"] = self.arch or "no program yet"
        rows["cache"] = self.cache or "none"
        rows["packages"] = ", ".join(" ".join(item) for item in self.packages.items())
        return "\n".join(f"{name:<10} {text}" for name, text in rows.items())

    __repr__ = __str__

    def to_json(self) -> str:
        """The same as JSON."""
        return json.dumps(dataclasses.asdict(self), indent=2)


def info() -> Info:
    """Returns the versions and the machine that this process runs with.

    It loads libtai, and asks the driver of a GPU whether there is one.
    """
    llvm = native.llvm_version()
    return Info(
        version=__version__,
        commit=commit(),
        llvm=llvm,
        libtai=loaded("libtai.so") or "unknown",
        python=f"{platform.python_implementation()} {platform.python_version()}",
        system=f"{platform.system()} {platform.release()}, {' '.join(platform.libc_ver())}",
        processor=f"{_processor()}, {len(os.sched_getaffinity(0))} cores",
        cuda=why_no_cuda() or "available",
        arch=str(state.program.options.arch) if state.program else None,
        cache=cache_folder(),
        packages=_installed(),
    )


def version_line() -> str:
    """The version of tai with its commit and its LLVM, in one line."""
    return f"tai {__version__} (commit {commit()}, LLVM {native.llvm_version()})"


@functools.cache
def commit() -> str:
    """The commit of the sources: from the build of a wheel or bundle, or of this checkout."""
    built = _PACKAGE / "build.json"
    if built.exists():
        return str(json.loads(built.read_text())["commit"])
    checkout = _PACKAGE.parents[1]
    if not (checkout / ".git").exists():
        return "unknown"
    describe = ["git", "-C", str(checkout), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        done = subprocess.run(
            [*describe, "--exclude=*"], capture_output=True, text=True, check=False
        )
    except OSError:
        return "unknown"
    return done.stdout.strip() or "unknown"


def loaded(library: str) -> str | None:
    """The path of a library of this process; None if it is not loaded."""
    with open("/proc/self/maps", errors="replace") as maps:
        for line in maps:
            path = line.rstrip("\n").partition("/")
            if path[2].rpartition("/")[2].startswith(library):
                return "/" + path[2]
    return None


def cache_folder() -> str:
    """The folder of compiled kernels of the program, or of the next one."""
    if state.program:
        options = state.program.options
        if not options.offline_cache:
            return ""
        if options.offline_cache_file_path:
            return str(options.offline_cache_file_path)
    if "TAI_CACHE_DIR" in os.environ:
        return os.environ["TAI_CACHE_DIR"]
    user = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    return os.path.join(user, "tai")


def _installed() -> dict[str, str]:
    found = {}
    for name in _PEERS:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


check_keywords(globals())
