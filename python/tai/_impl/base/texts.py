"""The texts of functions, as they were when Python made them.

A file may change while a program runs, and a module may be loaded again. A function that is
compiled later still means its old text. So `note` keeps the lines of the file when a function is
decorated, and `definition` checks that the text and the code object belong together: Python
compiles the text once more, and the code is the same.
"""

from __future__ import annotations
import __future__

import ast
import functools
import linecache
import os
import re
import stat
import sys
from collections.abc import Callable, Iterator
from importlib.machinery import SourceFileLoader
from types import CodeType
from typing import Any

from ...errors import LINES, TaiSyntaxError
from .parsing import parse

_BLOCKS = (ast.stmt, ast.excepthandler, ast.match_case)

Definition = ast.FunctionDef | ast.AsyncFunctionDef

# The number of source texts of one file that are kept, besides texts that functions need.
_MOST_TEXTS = 8

_FEATURES = functools.reduce(
    int.__or__, (getattr(__future__, name).compiler_flag for name in __future__.all_feature_names)
)


# The fields of a function definition that are set to remove its decorators.
_BARE: dict[str, Any] = {"decorator_list": []}
if sys.version_info >= (3, 12):
    _BARE["type_params"] = []


class Text:
    """The lines of a source file as they were at some time.

    Attributes:
        filename: of the file.
        lines: as `linecache` has them.
    """

    def __init__(self, filename: str, lines: list[str]):
        self.filename, self.lines = filename, lines

    @functools.cached_property
    def _tree(self) -> ast.Module:
        try:
            return parse("".join(self.lines))
        except (SyntaxError, ValueError):
            return ast.Module(body=[], type_ignores=[])

    @functools.cached_property
    def imports(self) -> list[str]:
        """The names that the text imports. Calls of their attributes are compiled differently."""
        names, left = [], list[ast.AST](self._tree.body)
        while left:
            node = left.pop()
            if isinstance(node, (ast.Import, ast.ImportFrom)):
                names += [(alias.asname or alias.name).split(".")[0] for alias in node.names]
            elif not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
                left += [n for n in ast.iter_child_nodes(node) if isinstance(n, _BLOCKS)]
        return [name for name in names if name != "*"]

    @functools.cached_property
    def definitions(self) -> dict[tuple[int, str], Definition]:
        """The functions of a source text, by name and by the first line of the `def` or of its
        first decorator.
        """
        found = {}
        for node in ast.walk(self._tree):
            if isinstance(node, Definition):
                first = node.decorator_list[0].lineno if node.decorator_list else node.lineno
                found[first, node.name] = node
        return found


# For each file, the versions of its text that were read, oldest first.
_texts: dict[str, list[Text]] = {}


def _read(filename: str, names: dict[str, Any]) -> Text:
    linecache.checkcache(filename)
    lines = linecache.getlines(filename, names) or _typed_lines(filename)
    texts = _texts.setdefault(filename, [])
    # If the file has changed, `linecache` makes another list of lines.
    if not texts or (texts[-1].lines is not lines and texts[-1].lines != lines):
        texts.append(Text(filename, lines))
        del texts[:-_MOST_TEXTS]
    LINES[filename] = texts[-1].lines
    return texts[-1]


@functools.cache
def _typed_lines(filename: str) -> list[str]:
    """The program of `python -c`, or of a file that Python reads as its standard input."""
    given = sys.orig_argv
    if filename == "<string>" and "-c" in given[1:-1]:
        return given[given.index("-c") + 1].splitlines(keepends=True)
    if filename == "<stdin>" and not hasattr(sys, "ps1"):
        try:
            state = os.fstat(0)
            if stat.S_ISREG(state.st_mode):
                return os.pread(0, state.st_size, 0).decode().splitlines(keepends=True)
        except (OSError, ValueError):
            return []
    return []


def _typed_at_prompt(function: Callable[..., Any]) -> Text | None:
    """The source text of a function that was just typed at Python's prompt, where readline keeps
    it.
    """
    readline = sys.modules.get("readline")
    if function.__code__.co_filename != "<stdin>" or readline is None or not hasattr(sys, "ps1"):
        return None
    count = readline.get_current_history_length()
    typed = [readline.get_history_item(i + 1) or "" for i in range(count)]
    lines = [line for entry in typed for line in entry.split("\n")]
    head = re.compile(rf"\s*(async\s+)?def\s+{re.escape(function.__name__)}\b")
    found = next((n for n in reversed(range(len(lines))) if head.match(lines[n])), None)
    if found is None:
        return None
    # Python counts the lines of each statement from 1; the first may be any of those before.
    first = max(0, found + 1 - function.__code__.co_firstlineno)
    while first > 0 and lines[first - 1].lstrip().startswith("@"):
        first -= 1
    for start in range(first, found + 1):
        text = Text("<stdin>", [line + "\n" for line in lines[start:]])
        key = (function.__code__.co_firstlineno, function.__name__)
        if key in text.definitions:
            return text
    return None


def _read_again(filename: str, names: dict[str, Any]) -> Text:
    """Reads the source text of a file again, also where `linecache` asks the loader of the module
    only once.
    """
    entry = linecache.cache.get(filename, ())
    from_loader = len(entry) > 1 and entry[1] is None and not filename.startswith("<")
    if from_loader and hasattr(names.get("__loader__"), "get_source"):
        del linecache.cache[filename]
    return _read(filename, names)


def note(function: Callable[..., Any]) -> None:
    """Keeps the source text of a function that is compiled later."""
    text = _typed_at_prompt(function)
    if text is None:
        text = _read(function.__code__.co_filename, function.__globals__)
    else:
        LINES[text.filename] = text.lines
    function._tai_text = text  # type: ignore[attr-defined]


def text_of(function: Callable[..., Any]) -> Text:
    """The source text of a function's file: the text from which its code was made, if it can be
    found.
    """
    found = getattr(function, "_tai_text", None)
    return found or _read(function.__code__.co_filename, function.__globals__)


def definition(function: Callable[..., Any]) -> Definition:
    """Returns the syntax tree of a function, from the text of its file.

    Raises:
        TaiSyntaxError: its source is not at hand, or is another one by now.
    """
    found = getattr(function, "_tai_definition", None)
    if found is not None and found[0] is function.__code__:
        return found[1]
    code = function.__code__
    texts = list(_candidates(function))
    key = (code.co_firstlineno, code.co_name)
    checks = [_are_same, _has_all_of] if _is_rewritten(function) else [_are_same]
    for check in checks:
        for text in texts:
            node = text.definitions.get(key)
            if node is not None and _belong(function, text, node, check):
                return _settle(function, text, node)
    # IPython's %autoreload compiles a function alone, with line numbers of its own.
    text = _read(str(function.__globals__.get("__file__")), function.__globals__)
    for (_, name), node in text.definitions.items():
        if name == code.co_name and _belong(function, text, node, _are_same):
            return _settle(function, text, node)
    if any(name == code.co_name for text in texts for _, name in text.definitions):
        raise TaiSyntaxError(
            f"function '{function.__name__}' is not in the file as it was when Python loaded it: "
            "the file has changed since",
            "load the module again (importlib.reload), or start Python again",
        ).locate(code.co_filename, code.co_firstlineno, 1)
    hint = "kernels must stand in a file: the compiler reads their text"
    if code.co_filename == "<string>":  # the name that exec gives
        hint += "; for exec, compile the text under a name of its own and register it in linecache"
    if code.co_filename == "<stdin>":
        hint = "Python keeps no text of a program from a pipe: save it in a file, and run that"
    if code.co_filename.startswith("<timed"):  # what IPython calls cells below %%time and %%timeit
        hint = "define kernels in a cell without %%time: the compiler reads their text"
    raise TaiSyntaxError(f"the source of function '{function.__name__}' cannot be read", hint)


def _settle(function: Callable[..., Any], text: Text, node: Definition) -> Definition:
    function._tai_text = text  # type: ignore[attr-defined]
    function._tai_definition = (function.__code__, node)  # type: ignore[attr-defined]
    return node


def _candidates(function: Callable[..., Any]) -> Iterator[Text]:
    """The source texts from which the code of a function may have been made, the likeliest
    first.
    """
    noted = getattr(function, "_tai_text", None)
    if noted is not None:
        yield noted
    filename = function.__code__.co_filename
    yield _read_again(filename, function.__globals__)
    yield from reversed(_texts[filename])


# Whether a source text and a code object belong together


def _belong(
    function: Callable[..., Any], text: Text, node: Definition,
    check: Callable[[CodeType, CodeType], bool],
) -> bool:  # fmt: skip
    """Whether a definition is the one from which Python made the code of a function."""
    # A notebook compiles each statement of a cell alone, without the imports of the others.
    for imports in (text.imports, []):
        made = _compile(function.__code__, node, function.__qualname__, imports)
        if made is not None and check(function.__code__, made):
            return True
    return False


def _is_rewritten(function: Callable[..., Any]) -> bool:
    """Whether a tool may have changed the code between the text and Python's compiler.

    The loader of a module may, as pytest's does with `assert`, and so may a notebook.
    """
    loader = function.__globals__.get("__loader__")
    if loader is not None and type(loader) is not SourceFileLoader:
        return True
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return bool(getattr(shell, "ast_transformers", None))


def _compile(
    code: CodeType, node: Definition, qualname: str, imports: list[str]
) -> CodeType | None:
    """The code object of a definition, compiled alone but with surroundings like those of
    `code`.
    """
    arguments = node.args
    bare = ast.arguments(
        posonlyargs=[ast.arg(a.arg) for a in arguments.posonlyargs],
        args=[ast.arg(a.arg) for a in arguments.args],
        vararg=arguments.vararg and ast.arg(arguments.vararg.arg),
        kwonlyargs=[ast.arg(a.arg) for a in arguments.kwonlyargs],
        kw_defaults=[None] * len(arguments.kwonlyargs),
        kwarg=arguments.kwarg and ast.arg(arguments.kwarg.arg),
        defaults=[],
    )
    kind = type(node)
    inner: ast.stmt = kind(name=node.name, args=bare, body=node.body, returns=None, **_BARE)
    depth = 1
    parts = qualname.split(".")
    if len(parts) > 1 and parts[-2] != "<locals>":  # private names begin with that of the class
        depth += 1
        inner = ast.ClassDef(name=parts[-2], bases=[], keywords=[], body=[inner], **_BARE)
    if free := [name for name in code.co_freevars if name != "__class__"]:
        depth += 1
        outside = ast.arguments(
            posonlyargs=[], args=[ast.arg(name) for name in free], vararg=None, kwonlyargs=[],
            kw_defaults=[], kwarg=None, defaults=[],
        )  # fmt: skip
        inner = ast.FunctionDef(
            name="outer", args=outside, body=[inner], returns=None,
            **_BARE,
        )  # fmt: skip
    first = [ast.Import(names=[ast.alias(name=name)]) for name in imports]
    module = ast.fix_missing_locations(ast.Module(body=[*first, inner], type_ignores=[]))
    try:
        made = compile(module, code.co_filename, "exec", code.co_flags & _FEATURES, True)
    except (SyntaxError, ValueError):
        return None
    for _ in range(depth):
        made = next(constant for constant in made.co_consts if isinstance(constant, CodeType))
    return made


_PARTS = (
    "co_code", "co_names", "co_varnames", "co_cellvars", "co_freevars", "co_argcount",
    "co_posonlyargcount", "co_kwonlyargcount",
)  # fmt: skip


def _are_same(code: CodeType, other: CodeType) -> bool:
    return (
        all(getattr(code, part) == getattr(other, part) for part in _PARTS)
        and len(code.co_consts) == len(other.co_consts)
        and all(map(_are_same_constants, code.co_consts, other.co_consts))
    )


def _are_same_constants(one: Any, other: Any) -> bool:
    if isinstance(one, CodeType) and isinstance(other, CodeType):
        return _are_same(one, other)
    # The items of a set have no order, so sets are compared as wholes.
    return type(one) is type(other) and (
        one == other if isinstance(one, frozenset) else _shown(one) == _shown(other)
    )


def _shown(constant: Any) -> str:
    """A constant as text, which tells -0.0 from 0.0; the qualified name of a class in the function
    is cut to the part that does not depend on the code around it."""
    return repr(constant).rsplit("<locals>.", 1)[-1]


def _has_all_of(code: CodeType, other: CodeType) -> bool:
    """Whether one code object has all names and constants of another one, and perhaps more."""
    return set(_parts(other)) <= set(_parts(code))


def _parts(code: CodeType) -> Iterator[tuple]:
    """The names and constants of a function and of those in it."""
    for name in (*code.co_names, *code.co_varnames, *code.co_cellvars, *code.co_freevars):
        yield ("name", name)
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _parts(constant)
        else:
            yield ("constant", _shown(constant))
