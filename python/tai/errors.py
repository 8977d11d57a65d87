"""Exceptions. Each shows the source line, with a caret, and a hint."""

from __future__ import annotations

import difflib
import linecache
import os
import re
import warnings
from collections.abc import Iterable

# Whether errors of kernels include the traceback in the compiler, for developers of the package.
SHOW_TRACEBACK = bool(os.environ.get("TAI_TRACEBACK"))


# Hints for errors of calls from Python that have no hint: the first pattern that is found in the
# message counts; groups of the pattern fill the hint.
_HINTS_OF_CALLS = [
    (r"index \S+ is out of range", "indices count from 0; negative ones have no meaning"),
    (r"^an element of field '(.*)' has shape \((\d+),\)", "give a list of {1} numbers"),
    (r"^an element of field '(.*)' has shape", "give a list of rows: [[1.0, 2.0], [3.0, 4.0]]"),
    (r"^field '(.*)' is filled by", "fill it with one number, or {0}.from_numpy(array)"),
    (r"^copy_from expects a field", "an array goes in by from_numpy(array)"),
    (r"members?, but got \d+$", "members are named where the struct type is made"),
    (r"^order must hold", "name the axes, slowest first: order='ij' or order='ji'"),
    (r"^the offset has", "give one number for each dimension of the shape"),
    (r"^a matrix has at least one row", "write ti.Vector.field(3, ti.f32, shape=8) or "
     "ti.Matrix.field(3, 3, ti.f32, shape=8)"),
    (r"expects \d+ dimensions, but got", "annotate the number of dimensions that it has: "
     "ti.types.ndarray(ndim=2)"),
    (r"expects an array, but got", "pass an array: np.zeros(8, np.float32), or a ti.ndarray"),
    (r"^default_fp must", "write default_fp=ti.f32 or default_fp=ti.f64"),
    (r"^default_ip must", "write default_ip=ti.i32 or default_ip=ti.i64"),
    (r"^option '(\w+)' expects", "docs/reference/options.md lists the values of each option"),
    (r"is not a type of numbers$|which is none of numbers$", "use a type such as ti.f32, "
     "or a vector type such as ti.math.vec3"),
    (r"^a struct type has at least", "write ti.types.struct(mass=ti.f32, pos=ti.math.vec3)"),
    (r"^an array of shape .* does not exist", "extents are whole numbers from 0 on"),
    (r"is placed already$", "give each field one place: drop its shape= to place it by hand"),
    (r"^expects axes such as", "write ti.root.dense(ti.ij, (4, 3))"),
    (r"axes need \d+ extents", "give one extent for each axis, or one number for all"),
    (r"^place expects fields", "make the field without a shape first: x = ti.field(ti.f32)"),
    (r"^the program cannot be reset", "close it first: ti.init belongs before it"),
    (r"expects numbers, but got", "convert it: array.astype(np.float32)"),
    (r"expects an array, but got NoneType", "pass an array: np.zeros(n, np.float32)"),
    (r"^(?:field '(.*)'|an array).* expects an array of shape|^expects an array of shape",
     "give the array that shape: array.reshape(…), or take a part of it"),
    (r"an index is a whole number", "write an index from 0 on, such as [2] or [1, 0]"),
    (r"expects \d+ ind(ex|ices), but got", "give one index for each dimension"),
    (r"a matrix is made of numbers", "write ti.Vector([1.0, 2.0]) or ti.Matrix([[1.0, 2.0], …])"),
    (r"the rows of a matrix have one length", "give each row as many numbers as the first has"),
    (r"an extent must be (?:positive|a whole number)", "extents are whole numbers from 1 on"),
    (r"holds numbers of type (\w+), not", "store a number; a vector goes into a vector field"),
    (r"^shapes .* do not go together", "make both of one shape; '@' multiplies matrices"),
    (r"^shapes .* do not chain", "the columns of the left one are the rows of the right one"),
    (r"^needs a square matrix", "a matrix has as many rows as columns then"),
    (r"^@ti\.(kernel|func) takes a function", "write @ti.{0} above a def"),
    (r"^ti\.(max|min) takes at least two", "ti.{0}(a, b), or v.{0}() over the components of a "
     "vector"),
    (r"^(ti\.\S+) stands in kernels and", "call {0} in a function with @ti.kernel or @ti.func"),
    (r"^ti\.\w+ takes numbers", "pass a number, a vector or a matrix; a field is looped over in a "
     "kernel"),
    (r"^the annotation '.*' has no meaning", "import or define the name above the kernel"),
    (r"^kernel '.*' has no mode|^the mode '.*' of kernel", "help(ti.kernel) says which there are"),
    (r"has at most \d+ dimensions", "put several of them into one index, or use elements that are "
     "vectors"),
]  # fmt: skip


def _hint_of_call(message: str) -> str | None:
    for pattern, hint in _HINTS_OF_CALLS:
        if found := re.search(pattern, message):
            return hint.format(*found.groups())
    return None


class TaiError(Exception):
    """Base of all errors of this package.

    Attributes:
        message: the problem, in one line.
        filename, lineno, column: where in the user's program (1-based), or None.
        end_column: end of the offending text on that line, or None.
        hint: how to put it right, or None.
        trail: lines "in kernel 'f'", "called from file:line", innermost first.
    """

    def __init__(self, message: str, hint: str | None = None):
        # A number of hundreds of digits would hide the rest of the message.
        message = re.sub(r"\d{50,}", lambda found: found[0][:12] + "…", message)
        super().__init__(message)
        # The hint of an error that has none of its own; in a kernel, the compiler has better hints.
        self.general_hint = _hint_of_call(message)
        self.message, self.hint = message, hint or self.general_hint
        self.filename: str | None = None
        self.lineno: int | None = None
        self.column: int | None = None
        self.end_column: int | None = None
        self.trail: list[str] = []
        self.details: str | None = None
        # The source line, where the file may have another one by now.
        self.source: str | None = None

    def locate(
        self, filename: str, lineno: int, column: int, end_column: int | None = None
    ) -> TaiError:
        """Sets the source location of an error, unless a more precise one is known already."""
        if self.lineno is None:
            self.filename, self.lineno = filename, lineno
            self.column, self.end_column = column, end_column
        return self

    def __str__(self) -> str:
        lines = [self.message]
        if self.lineno is not None:
            lines.append(f"  --> {shorten(self.filename)}:{self.lineno}:{self.column}")
            lines += show_line(
                self.filename, self.lineno, self.column, self.end_column, self.source
            )
        lines += [f"  {line}" for line in self.trail]
        if self.details:
            lines += [f"  {line}" for line in self.details.splitlines()]
        if self.hint:
            lines.append(f"  hint: {self.hint}")
        return "\n".join(lines)


class TaiCompilationError(TaiError):
    """Raised for a kernel that cannot be compiled."""


class TaiSyntaxError(TaiCompilationError, SyntaxError):
    """Python syntax that kernels do not have, or use of a construct in the wrong place."""

    # SyntaxError has its own attributes for the location, from which Python prints an uncaught
    # error, so the whole text must be in `msg`.
    filename = lineno = text = None

    @property
    def msg(self) -> str:  # type: ignore[override]
        return TaiError.__str__(self)

    __str__ = TaiError.__str__


class TaiNameError(TaiCompilationError, NameError):
    """Raised for a name in a kernel that is not defined."""


class TaiTypeError(TaiCompilationError, TypeError):
    """Raised for a value of the wrong type, rank or shape."""


class TaiIndexError(TaiCompilationError, IndexError):
    """An index that is out of range, or too many or too few of them."""


class TaiAutodiffError(TaiCompilationError):
    """A gradient that cannot be had: no rule, no adjoint field, an access rule broken."""


class TaiRuntimeError(TaiError, RuntimeError):
    """A failure while a kernel runs, or a call that makes no sense now."""


class TaiRuntimeTypeError(TaiRuntimeError, TypeError):
    """Raised for an argument of the wrong type."""


class TaiAssertionError(TaiRuntimeError, AssertionError):
    """An `assert` in a kernel that did not hold, or an index out of range in debug mode."""


class TaiMemoryError(TaiRuntimeError, MemoryError):
    """Raised if there is not enough memory for a tree of fields."""


class TaiGradientWarning(UserWarning):
    """Warns of a gradient that is right, but perhaps not the wanted one."""


class TaiConvergenceWarning(UserWarning):
    """Warns that a solver stopped before it had reached its tolerance."""


class TaiCompilationWarning(UserWarning):
    """Warns of code that compiles and is probably a mistake."""


def shorten(filename: str | None) -> str:
    """Returns a path relative to the working directory, if that is shorter."""
    if not filename:
        return "<unknown>"
    try:
        relative = os.path.relpath(filename)
    except ValueError:
        return filename
    return relative if len(relative) < len(filename) else filename


# The lines of source files as they were when kernels were read from them.
LINES: dict[str, list[str]] = {}


def source_line(filename: str | None, lineno: int) -> str:
    """A line of a source file; empty if the file is not available."""
    lines = LINES.get(filename or "")
    if not lines:
        return linecache.getline(filename or "", lineno)
    return lines[lineno - 1] if 0 < lineno <= len(lines) else ""


def show_line(
    filename: str | None, lineno: int, column: int | None, end_column: int | None = None,
    source: str | None = None,
) -> list[str]:  # fmt: skip
    """The source line and a line with carets below it; nothing if the source is not available."""
    source = (source_line(filename, lineno) if source is None else source).rstrip("\n")
    if not source.strip():
        return []
    margin = f"{lineno:5d} | "
    lines = [margin + source.replace("\t", " ")]
    if column:
        width = max(1, (end_column or column + 1) - column)
        width = min(width, max(1, len(source) - column + 1))
        lines.append(" " * (len(margin) - 2) + "| " + " " * (column - 1) + "^" * width)
    return lines


def did_you_mean(name: str, known: Iterable[str]) -> str | None:
    """Returns a hint with the nearest of the known names, or None."""
    names = [k for k in known if isinstance(k, str)]
    # Capital letters, and letters in another order, are the likeliest mistakes of all.
    close = [k for k in names if k.lower() == name.lower()]
    close = close or [k for k in names if sorted(k) == sorted(name)]
    close = close or difflib.get_close_matches(name, names, n=1)
    return f"did you mean '{close[0]}'?" if close else None


# For each number of TaiStatus in the C API, the class of errors.
_BY_STATUS = {
    1: TaiSyntaxError,
    2: TaiTypeError,
    3: TaiAutodiffError,
    4: TaiRuntimeError,
    5: TaiMemoryError,
    6: TaiCompilationError,
    7: TaiRuntimeError,
}


# Names of the IR, which are ASCII, and the spelling of each in the program.
SPELLINGS: dict[str, str] = {}


# Variables that the iterations of a parallel loop share, by the field of the IR that holds them.
SHARED_VARIABLES: dict[str, str] = {}

# Phrases of compiler messages about the IR, and the phrases for Python that replace them.
_IN_PYTHON = {
    "accumulate with 'tai.atomic add', or store to an element for each iteration": (
        "accumulate by +=, store to an element for each iteration, or run this loop on one thread: "
        "ti.loop_config(serialize=True)"
    ),
    "accumulate with 'tai.atomic add'": "accumulate by +=",
    "or update it by one operation": "or update it by one operation, or by ti.atomic_…,",
    "a field with 'tai.atomic add'": "a field by +=",
    "on one thread ('serialize')": "on one thread: ti.loop_config(serialize=True)",
}


def in_python(text: str) -> str:
    """Rewrites a message of the compiler in the words of the Python program."""
    for ours, theirs in _IN_PYTHON.items():
        text = text.replace(ours, theirs)
    if SHARED_VARIABLES:
        text = re.sub(r"(?:an element of )?field '@?(\w+)'", _name_variable, text)
    return text


def _name_variable(found: re.Match) -> str:
    name = SHARED_VARIABLES.get(found[1])
    return found[0] if name is None else f"variable '{name}', which all iterations share,"


def spelled(name: str) -> str:
    """The name in the program for a name of the IR, or for a name that the compiler derived from
    one.
    """
    base = name.removesuffix("_grad")
    return SPELLINGS.get(name) or SPELLINGS.get(base, base) + name[len(base) :]


def as_written(text: str) -> str:
    """Replaces names of the IR in a text by the names that the program uses."""
    if not SPELLINGS:
        return text
    return re.sub(r"'(\w+)'", lambda match: f"'{spelled(match[1])}'", text)


def from_core(
    status: int, message: str, file: str, line: int, column: int, diagnostics: str
) -> TaiError:
    """The exception for a failure of the C API; called from the extension module."""
    kind = _BY_STATUS.get(status, TaiRuntimeError)
    if status == 4 and file:  # a failure at a line of a kernel is an assertion or an index
        kind = TaiAssertionError
    message = in_python(message)
    # The sign @ before names of fields is dropped, since Python has no such sign.
    message = re.sub(r"'@(\"?)([^'\"]+)\1'", r"'\2'", message)
    message = as_written(message)
    error = kind(message or "unknown failure")
    if file and line > 0:
        error.locate(file, line, max(column, 1))
    error.details = _notes(diagnostics)
    if kind is TaiAssertionError and "out of range" in message:
        error.hint = "indices count from 0: change the range of the loop, or test the index before"
    if status == 6:
        error.hint = "this is a bug of tai, not of the program: please report it"
    return error


def warn_from_core(
    message: str, file: str, line: int, column: int, diagnostics: str, of_gradient: bool
) -> None:
    """Issues a warning of the compiler, at its line; called from the extension module."""
    lines = [as_written(message)]
    if file and line > 0:
        lines.append(f"  --> {shorten(file)}:{line}:{column}")
        lines += show_line(file, line, max(column, 1))
    if notes := _notes(diagnostics):
        lines += [f"  {part}" for part in notes.splitlines()]
    category = TaiGradientWarning if of_gradient else TaiCompilationWarning
    # A context reports each warning only once.
    warnings.warn_explicit("\n".join(lines), category, file or "<kernel>", max(line, 1))


def _notes(diagnostics: str) -> str | None:
    """The notes of a diagnostic, each with the line that it points to."""
    shown = []
    for line in as_written(in_python(diagnostics)).splitlines():
        place, mark, text = line.partition(": note: ")
        if not mark:
            continue
        parts = place.rsplit(":", 2)
        if len(parts) == 3 and parts[1].isdigit() and parts[2].isdigit():
            shown.append(f"note: {text}")
            shown.append(f"  --> {shorten(parts[0])}:{parts[1]}:{parts[2]}")
            shown += show_line(parts[0], int(parts[1]), int(parts[2]))
        else:
            shown.append(f"note: {text}")
    return "\n".join(shown) or None


# Taichi's names.
TaichiCompilationError = TaiCompilationError
TaichiSyntaxError = TaiSyntaxError
TaichiNameError = TaiNameError
TaichiTypeError = TaiTypeError
TaichiIndexError = TaiIndexError
TaichiAutodiffError = TaiAutodiffError
TaichiRuntimeError = TaiRuntimeError
TaichiRuntimeTypeError = TaiRuntimeTypeError
TaichiAssertionError = TaiAssertionError
