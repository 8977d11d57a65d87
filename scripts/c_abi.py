"""Checks the exports of libtai and the C API against the list of the version: test/CAPI/abi.

    scripts/c_abi.py [--build build] [--update]

test/CAPI/abi/MAJOR.MINOR.txt lists the functions, the values of enumerations and the layouts of
structs that programs linked with libtai.so.MAJOR.MINOR rely on. Once a version is released, its
list only grows: nothing of it may change. --update adds new lines, and refuses to change old ones.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LLVM_BIN = Path(os.environ.get("TAI_LLVM_BIN", "/usr/lib/llvm-22/bin"))
# Parts of MLIR's C API whose headers the portable bundle has.
UPSTREAM = ("AffineExpr", "AffineMap", "BuiltinAttributes", "BuiltinTypes", "Diagnostics", "IR",
            "IntegerSet", "Pass", "Support")  # fmt: skip
# C++ symbols that libtai may export: names of the namespace mlir::tai, the identities of its
# types, and objects of MLIR's headers that are compared by address. cmake/libtai.exports says why.
EXPORTED = re.compile(
    r"_Z(N?K?|T[VISTC]N?|TC|GVN?|GVZNK?|ZNK?|Th.*_NK?|Tv.*_NK?)4mlir(3tai|6detail14TypeIDResolverI"
    r"NS_3tai.*2idE$)"
    # Static variables in headers of LLVM and MLIR, whose addresses are identities.
    r"|_Z(GV)?ZNK?4(llvm|mlir)|_ZN4llvm(3Any6TypeId|.*3KeyE$)"
)


def run(*words: object, text: str | None = None) -> str:
    done = subprocess.run(list(map(str, words)), input=text, capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"c_abi: {' '.join(map(str, words))}\n{done.stderr[:3000]}")
    return done.stdout


def clang(text: str, includes: list[Path], *flags: str) -> str:
    words = [LLVM_BIN / "clang", "-x", "c", "-std=c99", "-fsyntax-only"]
    return run(*words, *(f"-I{path}" for path in includes), *flags, "-", text=text)


def declarations(text: str, includes: list[Path], prefix: str) -> dict[str, str]:
    """Functions with their types, and enumerators with their values, by name."""
    tree = json.loads(clang(text, includes, "-Xclang", "-ast-dump=json"))
    found = {}
    for node in tree["inner"]:
        name = node.get("name", "")
        if node["kind"] == "FunctionDecl" and name.startswith(prefix):
            # MLIR's headers have inline functions, too.
            if node.get("storageClass") != "static":
                found[f"function {name}"] = node["type"]["qualType"]
        elif node["kind"] == "EnumDecl":
            value = -1
            for constant in node.get("inner", []):
                if constant["kind"] != "EnumConstantDecl":
                    continue
                given = [part for part in constant.get("inner", []) if "value" in part]
                value = int(given[0]["value"]) if given else value + 1
                if constant["name"].startswith(prefix.upper()):
                    found[f"value {constant['name']}"] = str(value)
    return found


def layouts(text: str, includes: list[Path]) -> dict[str, str]:
    """The offset of each member, and the size, of each struct whose name begins with Tai."""
    found, name = {}, ""
    for line in clang(text, includes, "-Xclang", "-fdump-record-layouts-complete").splitlines():
        member = re.match(r" *(\d+) \| (  )?(.*)", line)
        if member and not member[2]:
            # Structs without a tag are named by their typedef.
            name = member[3].removeprefix("struct ").strip()
        elif member and re.fullmatch(r"Tai\w+", name) and not member[3].startswith(" "):
            found[f"member {name}.{member[3].split()[-1]}"] = f"at {member[1]}"
        elif (size := re.search(r"\[sizeof=(\d+)", line)) and re.fullmatch(r"Tai\w+", name):
            found[f"size {name}"] = size[1]
    return found


def growing(header: str) -> set[str]:
    """The structs whose size is an argument of a function: they may get members."""
    return set(re.findall(r"sizeof\((Tai\w+)\)", header))


def compare(listed: dict[str, str], now: dict[str, str], grows: set[str]) -> list[str]:
    """The changes that a program built with the list would meet."""
    wrong = []
    for name, said in listed.items():
        if name not in now:
            wrong.append(f"{name} is gone")
        elif now[name] != said:
            kind, _, struct = name.partition(" ")
            if kind == "size" and struct in grows and int(now[name]) > int(said):
                continue
            wrong.append(f"{name} was '{said}' and is '{now[name]}'")
    return wrong


def check_exports(names: set[str], api: dict[str, str], upstream: dict[str, str]) -> list[str]:
    declared = {name.split()[1] for name in api if name.startswith("function ")}
    wrong = [f"{name} is declared and not exported" for name in sorted(declared - names)]
    missing = {name.split()[1] for name in upstream if name.startswith("function ")} - names
    wrong += [f"{name} of MLIR's C API is not exported" for name in sorted(missing)]
    for name in sorted(names):
        if re.match(r"tai[A-Z]", name):
            if name not in declared:
                wrong.append(f"{name} is exported and not declared")
        elif not re.match(r"mlir[A-Z]|tai_[a-z]+_", name) and not EXPORTED.match(name):
            wrong.append(f"{name} is exported, and is no symbol of tai")
    return wrong


def read(path: Path) -> dict[str, str]:
    lines = path.read_text().splitlines() if path.exists() else []
    return dict(line.split(": ", 1) for line in lines if line and not line.startswith("#"))


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--build", type=Path, default=ROOT / "build")
    parser.add_argument("--list", type=Path, help="another list than that of the version")
    parser.add_argument("--update", action="store_true", help="write new lines into the list")
    args = parser.parse_args()
    includes = [ROOT / "include", args.build / "include", LLVM_BIN.parent / "include"]
    text = '#include "tai-c/Tai.h"\n#include "tai-c/Mesh.h"\n'
    now = declarations(text, includes, "tai") | layouts(text, includes)
    lines = (f'#include "mlir-c/{part}.h"\n' for part in UPSTREAM)
    upstream = declarations("".join(lines), includes, "mlir")
    version = re.search(r'"(\d+\.\d+)', (ROOT / "python/tai/_version.py").read_text())
    path = args.list or ROOT / f"test/CAPI/abi/{version[1]}.txt"
    listed = read(path)
    grows = growing((ROOT / "include/tai-c/Sizes.h").read_text())
    wrong = compare(listed, now, grows)
    if args.update and not wrong:
        head = path.read_text().splitlines() if path.exists() else []
        comment = [line for line in head if line.startswith("#")]
        # Old sizes stay: the struct had that size in the first version.
        rows = [f"{name}: {said}" for name, said in {**now, **listed}.items()]
        path.write_text("\n".join([*comment, *sorted(rows)]) + "\n")
        listed = read(path)
    hint = "scripts/c_abi.py --update adds it"
    wrong += [f"{name} is not in {path.name}: {hint}" for name in now if name not in listed]
    library = args.build / "lib/libtai.so"
    table = run(LLVM_BIN / "llvm-nm", "-D", "--defined-only", "--format=just-symbols", library)
    names = {name.split("@")[0] for name in table.splitlines()}
    wrong += check_exports(names, now, upstream)
    print("\n".join(wrong) or f"c_abi: {len(listed)} lines hold, {len(names)} symbols are exported")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
