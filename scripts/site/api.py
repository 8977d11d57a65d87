"""The pages of the Python reference: which names stand on which page, and where they are defined.

Names are read from the sources, without an import of the package. `test_site.py` checks that every
public name of `tai` is on a page.
"""

from __future__ import annotations

import ast
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "python" / "tai"


@dataclass(frozen=True)
class Page:
    """A page: its file, its title, an introduction, and names by section."""

    file: str
    title: str
    text: str
    sections: dict[str, str]


# The names of `tai` itself, by subject.
PAGES = (
    Page(
        "programs", "Programs, fields and arrays",
        "A program begins with `ti.init`. Fields are placed in trees of levels (`ti.root`); arrays "
        "(`ti.ndarray`) are memory of their own, which kernels take as arguments.",
        {
            "Programs": "init reset sync info set_logging_level is_logging_effective "
            "is_extension_supported extension",
            "Fields": "field Field ScalarField MatrixField Struct StructField dataclass "
            "deactivate_all_snodes batch",
            "Layouts": "SNode FieldsBuilder Layout axes",
            "Several processes": "mesh Particles ensemble",
            "Arrays": "ndarray Ndarray ScalarNdarray VectorNdarray MatrixNdarray",
            "Memory of other libraries": "from_dlpack wait_for_stream let_stream_wait",
            "Gradients to a given error": "solve_to",
            "Programs in a file": "export",
        },
    ),
    Page(
        "kernels", "Kernels and their language",
        "A kernel is compiled when it is first called. Its outermost loops run in parallel, from "
        "the first to the last.",
        {
            "Kernels and functions": "kernel Kernel func pyfunc real_func data_oriented template",
            "Loops": "ndrange grouped static loop_config block_local cache_read_only no_activate "
            "assume_in_range loop_unique",
            "Decisions at compile time": "static_assert static_print",
            "Updates in one step": "atomic_add atomic_sub atomic_mul atomic_min atomic_max "
            "atomic_and atomic_or atomic_xor",
            "Cells of sparse fields": "activate deactivate is_active append length rescale_index "
            "get_addr",
        },
    ),
    Page(
        "functions", "Functions of numbers, vectors and matrices",
        "In kernels and in Python. A function of numbers is applied to each component of a vector "
        "or matrix. [Derivatives](../derivatives.md) has the rule and the value at kinks of each.",
        {
            "Vectors and matrices": "Matrix Vector solve svd polar_decompose sym_eig eig",
            "Elementary functions": "abs acos acosh asin asinh atan atan2 atanh cbrt ceil copysign "
            "cos cosh erf erfc exp floor hypot log log10 max min pow round rsqrt sin sinh sqrt tan "
            "tanh trunc",
            "Choices and logic": "select logical_and logical_or logical_not",
            "Types and bits": "cast bit_cast bit_shr frexp raw_div raw_mod zero one",
            "Random numbers": "random randn",
            "Gradients": "stop_grad",
        },
    ),
    Page(
        "errors", "Errors",
        "All errors are a `TaiError`, with the line of the kernel, a caret, and a remedy. Each "
        "also has the name that it has in Taichi (`TaichiTypeError` is `TaiTypeError`).",
        {
            "Errors": "TaiError TaiCompilationError TaiSyntaxError TaiNameError TaiTypeError "
            "TaiIndexError TaiRuntimeError TaiRuntimeTypeError TaiAssertionError TaiMemoryError "
            "TaiAutodiffError",
        },
    ),
)  # fmt: skip

# Constants of `tai`; a table gives the meaning of each.
CONSTANTS = {
    "Types of numbers": "f16 f32 f64 bf16 i8 i16 i32 i64 u1 u8 u16 u32 u64 float16 float32 float64 "
    "int8 int16 int32 int64 uint1 uint8 uint16 uint32 uint64",
    "Targets": "cpu cuda gpu python x64 x86_64 arm64 amdgpu vulkan metal opengl gles dx11",
    "Axes of layouts": "i j k l ij ik il jk jl kl ijk ijl ikl jkl ijkl",
    "Levels of messages": "TRACE DEBUG INFO WARN ERROR CRITICAL",
    "The tree of fields that have a shape, and of those placed by hand": "root",
}
# Names that a module of their own documents.
ELSEWHERE = (
    "Tape clear_all_gradients no_grad grad_replaced complex_kernel complex_kernel_grad "
    "BitpackedFields GUI rgb_to_hex hex_to_rgb types"
).split()
# Modules with a page each; the names are those of `__all__`, or all that the module defines.
MODULES = (
    "ad algorithms checkpoint gui jax linalg math optim profiler sparse testing tools torch types "
    "ui volumes"
).split()


def names_of_package() -> dict[str, str]:
    """The public names of `tai`, with the full name of the definition of each."""
    found = {}
    tree = ast.parse((PACKAGE / "__init__.py").read_text())
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and node.level:
            for name in node.names:
                public = name.asname or name.name
                if not public.startswith("_"):
                    found[public] = ".".join(["tai", *filter(None, [node.module]), name.name])
        elif isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "_LAZY":
            table = next(n for n in ast.walk(node.value) if isinstance(n, ast.Dict))
            for module, names in ast.literal_eval(table).items():
                for name in names.split():
                    found[name] = f"tai.{module}.{name}"
    for name in ("alias", "native", "dtypes"):
        found.pop(name, None)
    return found


def names_of_module(module: str) -> dict[str, str]:
    """The public names of a module of `tai`, with the full name of the definition of each.

    Constants have none, but an empty text.
    """
    tree = ast.parse((PACKAGE / f"{module}.py").read_text())
    defined: list[str] = []
    imported: dict[str, str] = {}
    listed = None
    package = f"tai.{module}".rpartition(".")[0]
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            defined.append(node.name)
        elif isinstance(node, ast.ImportFrom) and node.level == 1:
            for name in node.names:
                path = ".".join([package, *filter(None, [node.module]), name.name])
                imported[name.asname or name.name] = path
        elif isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            listed = ast.literal_eval(node.value)
        elif isinstance(node, ast.Assign) and ast.unparse(node.value) in imported:
            imported[ast.unparse(node.targets[0])] = imported[ast.unparse(node.value)]
    if listed is None:
        listed = [name for name in defined if not name.startswith("_")]
    full = {name: f"tai.{module}.{name}" for name in defined} | imported
    return {name: full[name] if name in full and is_visible(full[name]) else "" for name in listed}


def is_visible(full: str) -> bool:
    """Whether griffe sees the definition: not of names that are assigned several at once."""
    *parts, name = full.split(".")[1:]
    path = PACKAGE.joinpath(*parts)
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    for node in ast.parse(file.read_text()).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name == name:
            return True
        if isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            if any(ast.unparse(target) == name for target in targets):
                return True
        if isinstance(node, ast.ImportFrom):
            if any((alias.asname or alias.name) == name for alias in node.names):
                return True
    return False
