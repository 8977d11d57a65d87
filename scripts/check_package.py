"""Builds and runs the projects of examples/ and of test/Downstream against a package of tai.

    scripts/check_package.py PREFIX [--only host ...] [--folder FOLDER] [--compiler clang-22]

PREFIX is an installation, the build folder, or the portable bundle. The bundle has the C API alone:
of the projects in C++ it must say in one line that they need an installation. The projects are
copied out of this tree, and built with an environment that has a path of programs and nothing else.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LLVM_BIN = Path(os.environ.get("TAI_LLVM_BIN", "/usr/lib/llvm-22/bin"))
INPUTS = ROOT / "test/Downstream/Inputs"
REFUSED = "the C++ API needs an installation of tai beside libmlir-22-dev"


class Failed(Exception):
    pass


def make_environment(folder: Path, compiler: str) -> dict[str, str]:
    """An environment as in a bare system: the folders of the programs that are needed."""
    system = "/usr/bin:/bin"
    found = [
        shutil.which(name, path=system) or shutil.which(name)
        for name in ("cmake", "ninja", "pkg-config", compiler)
    ]
    places = [str(Path(name).parent) for name in found if name] + ["/usr/bin", "/bin"]
    # A program in the folder of a user may need that folder.
    is_plain = set(places) <= {"/usr/bin", "/bin"}
    home = str(folder) if is_plain else os.environ.get("HOME", str(folder))
    return {"PATH": ":".join(dict.fromkeys(places)), "HOME": home, "LANG": "C.UTF-8"}


ENVIRONMENT: dict[str, str] = {}


def run(*words: object, text: str | None = None, must: bool = True, **options: object) -> str:
    """The output of a command; its errors too if it may fail."""
    options.setdefault("env", ENVIRONMENT)
    done = subprocess.run(
        [str(word) for word in words], text=True, input=text, capture_output=True, **options
    )  # type: ignore[call-overload]
    if must and done.returncode != 0:
        command = " ".join(map(str, words))
        raise Failed(f"$ {command}\n{done.stdout[-3000:]}{done.stderr[-3000:]}")
    return done.stdout + ("" if must else done.stderr)


def expect(text: str, *patterns: str) -> None:
    for pattern in patterns:
        if not re.search(pattern, text):
            raise Failed(f"'{pattern}' is missing in\n{text[-3000:]}")


@dataclass
class Project:
    """A folder with a CMakeLists.txt, the component that it needs, and its run."""

    source: Path
    component: str
    check: Callable[[Package, Path], None]


class Package:
    """A package of tai, and where projects are built against it."""

    def __init__(self, prefix: Path, folder: Path, compiler: str):
        self.prefix = prefix.resolve()
        self.folder = folder.resolve()
        self.compiler = compiler
        self.config = next(iter(self.prefix.glob("lib*/**/cmake/tai")), None)
        if not self.config:
            raise Failed(f"{prefix} has no lib/cmake/tai")
        self.portable = not (self.config / "TaiTargets.cmake").exists()

    def tool(self, name: str) -> Path:
        return self.prefix / "bin" / name

    def configure(self, project: Project, must: bool = True) -> str:
        build = self.folder / project.source.name
        source = self.folder / f"{project.source.name}-source"
        for path in (build, source):
            shutil.rmtree(path, ignore_errors=True)
        shutil.copytree(project.source, source)
        cxx = self.compiler.replace("clang", "clang++").replace("gcc", "g++")
        return run(
            "cmake", "-G", "Ninja", "-S", source, "-B", build, f"-DTai_DIR={self.config}",
            f"-DCMAKE_C_COMPILER={self.compiler}", f"-DCMAKE_CXX_COMPILER={cxx}",
            "-DCMAKE_CXX_FLAGS=-O0", must=must,
        )  # fmt: skip

    def check(self, name: str, project: Project) -> str:
        if self.portable and project.component == "Cxx":
            expect(" ".join(self.configure(project, must=False).split()), re.escape(REFUSED))
            return f"{name}: refused, as it is to be"
        self.configure(project)
        build = self.folder / project.source.name
        run("cmake", "--build", build)
        project.check(self, build)
        return f"{name}: builds and runs"


def check_host(package: Package, build: Path) -> None:
    expect(run(build / "host"), r"host: y = 1108\.201500, dy/dx\[0\] = -5\.4")
    # The same without CMake.
    flags = pkg_config(package, "tai-c", package.prefix)
    program = build / "by-pkg-config"
    run(package.compiler, INPUTS / "host/host.c", "-o", program, *flags, "-lm")
    places = [flag[2:] for flag in flags if flag.startswith("-L")]
    run(program, env={**ENVIRONMENT, "LD_LIBRARY_PATH": ":".join(places)})


def pkg_config(package: Package, name: str, prefix: Path) -> list[str]:
    assert package.config
    folder = package.config.parents[1] / "pkgconfig"
    environment = {**ENVIRONMENT, "PKG_CONFIG_PATH": str(folder)}
    return run("pkg-config", "--cflags", "--libs", name, env=environment).split()


def check_compiler(package: Package, build: Path) -> None:
    file = INPUTS / "compiler/kernels.mlir"
    passes = "builtin.module(name-stores,tai-to-llvm)"
    lowered = run(build / "other-opt", file, f"--pass-pipeline={passes}")
    run(LLVM_BIN / "FileCheck", file, text=lowered)


def check_ahead(package: Package, build: Path) -> None:
    expect(run(build / "pendulum"), r"pendulum: 0\.7759\d+", r"pendulum: 0\.9284\d+")


def check_capi(package: Package, build: Path) -> None:
    file = ROOT / "examples/capi/rest_length.mlir"
    expect(run(build / "rest_length", file), r"rest length 1\.\d{4}, loss \d\.\de-")


def check_embedding(package: Package, build: Path) -> None:
    expect(run(build / "embedding"), r"llvm\.func @double\(", r"llvm\.fadd")


def check_layout(package: Package, build: Path) -> None:
    file = INPUTS / "levels.mlir"
    fields = [f"--print-field=@{name}" for name in ("x", "x_grad", "loss")]
    plugin = f"--load-dialect-plugin={build}/Levels.so"
    output = run(package.tool("tai-run"), file, plugin, "--no-cache", *fields)
    run(LLVM_BIN / "FileCheck", file, text=output)


def check_dialect(package: Package, build: Path) -> None:
    file = INPUTS / "soft.mlir"
    passes = ["--tai-make-adjoint", "--canonicalize", "--cse"]
    plugin = f"--load-dialect-plugin={build}/Soft.so"
    output = run(package.tool("tai-opt"), file, plugin, *passes)
    run(LLVM_BIN / "FileCheck", file, text=output)


EXAMPLES = ROOT / "examples"
PROJECTS = {
    "host": Project(INPUTS / "host", "C", check_host),
    "compiler": Project(INPUTS / "compiler", "Cxx", check_compiler),
    "ahead": Project(INPUTS / "ahead", "Cxx", check_ahead),
    "capi": Project(EXAMPLES / "capi", "C", check_capi),
    "embedding": Project(EXAMPLES / "embedding", "Cxx", check_embedding),
    "layout": Project(EXAMPLES / "layout", "Cxx", check_layout),
    "dialect": Project(EXAMPLES / "dialect", "Cxx", check_dialect),
}


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("prefix", type=Path)
    parser.add_argument("--only", nargs="*", choices=sorted(PROJECTS), help="these projects")
    parser.add_argument("--folder", type=Path, help="where to build; default: a temporary one")
    parser.add_argument("--compiler", default="clang-22", help="for C; that for C++ is beside it")
    args = parser.parse_args()
    unknown = {path.parent.name for path in EXAMPLES.glob("*/CMakeLists.txt")} - set(PROJECTS)
    if unknown:
        sys.exit(f"check_package: {', '.join(unknown)} of examples/ is not checked here")
    with tempfile.TemporaryDirectory(prefix="tai-package-") as temporary:
        try:
            folder = args.folder or Path(temporary)
            folder.mkdir(parents=True, exist_ok=True)
            ENVIRONMENT.update(make_environment(folder.resolve(), args.compiler))
            package = Package(args.prefix, folder, args.compiler)
            for name in args.only or PROJECTS:
                print(package.check(name, PROJECTS[name]), flush=True)
        except Failed as failure:
            print(f"check_package: {failure}")
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
