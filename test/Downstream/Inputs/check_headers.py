"""Compiles each header of an installation by itself.

The arguments: the prefix, a folder for a precompiled header, LLVM's include
folder, the compiler, and the part of the headers, as in 1/2. MLIR's headers,
which take most of the time, are precompiled. A header that another one includes
before all others of tai is compiled with that one. Prints the errors of headers
that fail.
"""

import concurrent.futures
import pathlib
import re
import subprocess
import sys

prefix, folder, llvm, compiler, part = sys.argv[1:]
include = pathlib.Path(prefix) / "include"
headers = sorted(include.glob("tai/**/*.h")) + sorted(include.glob("tai-c/**/*.h"))
assert len(headers) > 90, f"{len(headers)} headers in {include}"
flags = [compiler, "-std=c++17", "-O0", "-Wall", "-Werror", f"-I{include}", "-isystem", llvm]
flags += ["-fno-exceptions", "-D__STDC_LIMIT_MACROS", "-D__STDC_CONSTANT_MACROS"]

upstream = [
    "Dialect/Arith/IR/Arith.h",
    "Dialect/Func/IR/FuncOps.h",
    "Dialect/LLVMIR/LLVMDialect.h",
    "Dialect/MemRef/IR/MemRef.h",
    "Dialect/SCF/IR/SCF.h",
    "Dialect/Vector/IR/VectorOps.h",
    "Analysis/DataFlow/SparseAnalysis.h",
    "Pass/PassManager.h",
    "Transforms/DialectConversion.h",
]
source = pathlib.Path(folder) / "upstream.h"
source.write_text("".join(f'#include "mlir/{name}"\n' for name in upstream))
precompiled = source.with_suffix(".pch")
# Templates are instantiated once, not for each header.
once = ["-fpch-instantiate-templates", "-x", "c++-header"]
subprocess.run([*flags, *once, source, "-o", precompiled], check=True)


def find_first(header: pathlib.Path) -> pathlib.Path | None:
    """The header of tai that this one includes first: nothing of tai stands before it."""
    named = re.search(r'^#include "(tai(?:-c)?/[^"]*)"', header.read_text(), re.MULTILINE)
    return include / named[1] if named else None


def check(header: pathlib.Path) -> str:
    """The errors of a file that includes this header and no other."""
    name = header.relative_to(include)
    given = [] if name.parts[0] == "tai-c" else ["-include-pch", precompiled]
    command = [*flags, *given, "-fsyntax-only", "-x", "c++", "-"]
    text = f'#include "{name}"\n'
    result = subprocess.run(command, input=text, capture_output=True, text=True)
    return f"{name}:\n{result.stderr[:1000]}" if result.returncode else ""


def check_as_c(header: pathlib.Path) -> str:
    """The errors of a C99 file that includes this header twice, and no other."""
    name = header.relative_to(include)
    command = [compiler.replace("clang++", "clang"), "-std=c99", "-Wall", "-Wextra", "-Wpedantic"]
    command += ["-Werror", f"-I{include}", "-isystem", llvm, "-fsyntax-only", "-x", "c", "-"]
    # A header of macros alone leaves nothing to compile.
    text = f'#include "{name}"\n' * 2 + "extern int declared;\n"
    result = subprocess.run(command, input=text, capture_output=True, text=True)
    return f"{name}, in C:\n{result.stderr[:1000]}" if result.returncode else ""


with concurrent.futures.ThreadPoolExecutor(2) as pool:
    covered = {find_first(header) for header in headers}
    number, parts = map(int, part.split("/"))
    roots = [header for header in headers if header not in covered][number - 1 :: parts]
    failures = [text for text in pool.map(check, roots) if text]
    headers_of_c = [*sorted(include.glob("tai-c/*.h")), include / "tai/ABI/Abi.h"]
    assert len(headers_of_c) > 3, headers_of_c
    failures += filter(None, pool.map(check_as_c, headers_of_c if number == 1 else []))
print("\n".join(failures))
sys.exit(bool(failures))
