"""Texts of functions: which expressions give values that a tape or forward mode follows.

The text of a function is looked at without regard to the order of its statements. Values are known
by the names, attributes and elements that hold them, in this function, in its callers up to the
one that records, and in functions that these call.
"""

from __future__ import annotations

import ast
import builtins
import functools
import linecache
import math
from collections import deque
from collections.abc import Callable, Iterator
from types import CodeType, FunctionType
from typing import Any

import numpy as np

from ..base.elements import Elements
from ..base.parsing import parse
from . import marks
from .followed import carries_history, is_followed, is_marked

# Functions without a number as their result, or whose result does not change a little with their
# argument.
_DISCRETE = (
    len, range, isinstance, type, print, str, bool, int, round, math.floor, math.ceil, math.trunc,
)  # fmt: skip

# Methods of containers that keep their argument in the container.
_KEEPING = {
    "add", "append", "appendleft", "extend", "extendleft", "insert", "put", "setdefault", "update",
}  # fmt: skip

# The depth to which calls of functions are followed into the text of the callee.
_DEPTH = 3
# The greatest number of callers, from the function that launches up to the function that records,
# that are examined.
_MOST_CALLERS = 8
# The number of passes in which numbers that objects keep are searched for; several passes are
# needed because such numbers depend on each other.
_MOST_PASSES = 4


def as_kernel(called: Any) -> Any:
    """Returns the kernel behind a method or a static method."""
    called = getattr(called, "__func__", called)
    return getattr(called, "_kernel", called)


@functools.lru_cache(maxsize=64)
def _parse(text: str) -> ast.Module | None:
    try:
        return parse(text)
    except (SyntaxError, ValueError):
        return None


def _find_body(filename: str, line: int, name: str) -> ast.AST | None:
    """Returns the definition of a function in its file, or the syntax tree of the module."""
    linecache.checkcache(filename)  # a module may have been loaded again
    module = _parse("".join(linecache.getlines(filename)))
    if module is None or name == "<module>":
        return module
    for node in ast.walk(module):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)) and node.name == name:
            first = min([node.lineno, *(d.lineno for d in node.decorator_list)])
            if first <= line <= (node.end_lineno or line):
                return node
    return module if name.startswith("<") else None


def _block_of(body: ast.AST, line: int) -> ast.AST | None:
    """The block of the `with` statement in a line, if there is one.

    Numbers from outside of it were computed before the tape began, be it in an earlier round of a
    loop: they belong to the point at which one differentiates.
    """
    found: ast.AST | None = None
    for node in ast.walk(body):
        if not isinstance(node, (ast.With, ast.AsyncWith)):
            continue
        heads = [node.lineno, *(i.context_expr.end_lineno or node.lineno for i in node.items)]
        if min(heads) <= line <= max(heads):
            found = ast.Module(node.body, [])
    return found


def _own_nodes(body: ast.AST | None) -> Iterator[ast.AST]:
    """The nodes of a text, but for those of functions that it defines."""
    waiting = [] if body is None else [body]
    while waiting:
        node = waiting.pop()
        yield node
        waiting += [
            child for child in ast.iter_child_nodes(node)
            if not isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda))
        ]  # fmt: skip


def callers(frame: Any, recording: Any) -> list[Any]:
    """The frames of the callers of a function up to the one that records.

    Args:
        frame: of the function.
        recording: the code of the one that records.
    """
    found: list[Any] = []
    while frame.f_code is not recording and frame.f_back is not None:
        frame = frame.f_back
        if not frame.f_globals.get("__name__", "").startswith("tai."):
            found.append(frame)
        if len(found) == _MOST_CALLERS:
            break
    return found


class Reading:
    """Reads the source texts around one place of the program, each once.

    Attributes:
        asks_callers: whether an answer depends on the arguments that callers have given.
    """

    def __init__(self, frame: Any, recording: Any, opened: int = 0):
        """Begins to read around one place of the program.

        Args:
            frame: the Python frame of the place.
            recording: the code that has opened the tape.
            opened: the line in which it has; 0 if none is open.
        """
        self.asks_callers = False
        self._recording, self._opened = recording, opened
        self._frames = [frame, *callers(frame, recording)]
        self._scopes: dict[int, Scope] = {}
        self._kept: dict[int, float] | None = None

    @property
    def scope(self) -> Scope:
        """The text of the function at the place, with the meanings of its names."""
        return self.scope_of(0)

    def scope_of(self, number: int) -> Scope:
        """The source text of a caller; number 0 is the place itself, and 1 is its caller."""
        if number not in self._scopes:
            frame = self._frames[number]
            code = frame.f_code
            body = _find_body(code.co_filename, code.co_firstlineno, code.co_name)
            if body is not None and code is self._recording:
                body = _block_of(body, self._opened) or body
            names = [frame.f_locals, frame.f_globals, vars(builtins)]
            scope = self._scopes[number] = Scope(self, body, names, _DEPTH, caller=number)
            scope.spread()
        return self._scopes[number]

    def code(self, number: int) -> CodeType:
        return self._frames[number].f_code

    def line(self, number: int) -> int:
        return self._frames[number].f_lineno

    @property
    def callers(self) -> int:
        """The number of callers whose texts are known to belong to the recorded program."""
        last = self._frames[-1]
        # Elsewhere in the call stack, the tape was opened by another function.
        is_inside = last.f_code is self._recording or len(self._frames) > _MOST_CALLERS
        return len(self._frames) - 1 if is_inside else 0

    def stored_arrays(self) -> list[marks.Extent]:
        """The memory of arrays into which the program stores numbers that depend on values with a
        gradient.
        """
        found = [e for n in range(self.callers + 1) for e in self.scope_of(n).stored(set())]
        return [extent for extent in found if extent is not None]

    def is_kept(self, value: Any) -> bool:
        """Whether the program keeps this number, which has a gradient, in an object."""
        if self._kept is None:
            self._kept = {}
            for _ in range(_MOST_PASSES):
                found = {
                    id(value): value for n in range(self.callers + 1)
                    for value in self.scope_of(n).kept(set())
                }  # fmt: skip
                is_same = found.keys() == self._kept.keys()
                self._kept = found
                if is_same:
                    break
        return self._kept.get(id(value)) is value


class Scope:
    """The source text of a function, with what its names stand for.

    Values with a history are known by paths: `a`, `a.b`, `a['b']`, or `a[*]` for elements at
    indices that the text does not show.
    """

    def __init__(
        self, reading: Reading, body: ast.AST | None, names: list[dict[str, Any]], depth: int,
        tainted: set[str] | None = None, caller: int | None = None,
    ):  # fmt: skip
        """Keeps a text, in which values with a history are found later.

        Args:
            reading: the reading to which the text belongs.
            body: the text.
            names: dictionaries that give names their values.
            depth: the depth to which calls are followed.
            tainted: paths with a history to begin with.
            caller: the number of the text among the callers; None for the text of a called
                function.
        """
        self._reading, self._body, self._names, self._depth = reading, body, names, depth
        self._nodes = [] if body is None else list(ast.walk(body))
        self._tainted = set() if tainted is None else tainted
        self._caller = caller
        # The parameters that have a gradient, according to the text of the caller; None if unknown.
        self._given: set[str] | None = None
        # The syntax nodes in blocks that are not recorded.
        self._apart = {
            id(part) for node in self._nodes if isinstance(node, ast.With)
            if any(_is_no_grad(item.context_expr) for item in node.items) for part in ast.walk(node)
        }  # fmt: skip

    def spread(self) -> None:
        """Finds the paths, such as `a.b`, that hold values with a history (values that depend on
        recorded ones) at some time.
        """
        pairs: list[tuple[set[str], list[ast.AST]]] = []
        for node in self._nodes:
            if isinstance(node, ast.Assign):
                pairs += [(self._paths(target), [node.value]) for target in node.targets]
            elif isinstance(node, (ast.AugAssign, ast.AnnAssign, ast.NamedExpr)):
                if node.value is not None:
                    pairs.append((self._paths(node.target), [node.value]))
            elif isinstance(node, (ast.For, ast.comprehension)):
                pairs.append((self._paths(node.target), [node.iter]))
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                if node.func.attr in _KEEPING:
                    holder = ast.Subscript(node.func.value, ast.Name("*"))
                    pairs.append((self._paths(holder), _arguments(node)))
        size = -1
        while size != len(self._tainted):
            size = len(self._tainted)
            for paths, values in pairs:
                if not paths <= self._tainted and any(map(self.has_history, values)):
                    self._tainted |= paths

    def _paths(self, target: ast.AST) -> set[str]:
        """The paths, such as `a.b`, to which an assignment binds a value; none for elements of
        fields, which say nothing about the whole field.
        """
        if isinstance(target, (ast.Tuple, ast.List)):
            return {path for item in target.elts for path in self._paths(item)}
        if isinstance(target, ast.Starred):
            return self._paths(target.value)
        path = _path_of(target)
        part: Any = target
        while isinstance(part, (ast.Attribute, ast.Subscript)):
            part = part.value
            if isinstance(self.resolve(part), Elements):
                return set()
        return set() if path is None else {path}

    def calls_at(self, line: int) -> list[ast.Call]:
        return [
            n for n in self._nodes
            if isinstance(n, ast.Call) and n.lineno <= line <= (n.end_lineno or n.lineno)
        ]  # fmt: skip

    def given_to(
        self, kernel: Any, line: int, names: list[str], holds: Callable[[ast.AST], bool]
    ) -> list[str]:
        """The parameters of a kernel that a line gives expressions of some kind.

        Args:
            kernel, line: of the launch.
            names: of its parameters.
            holds: whether an expression is of the kind.
        """
        found, is_called = [], False
        calls = self.calls_at(line)
        for call in calls:
            if as_kernel(self.resolve(call.func)) is not kernel:
                continue
            is_called = True
            of = self.resolve(getattr(call.func, "value", call.func))
            offset = int(kernel._is_method and not isinstance(of, type))
            given = _bind(call, names[offset:])
            found += [name for name in names if name in given and holds(given[name])]
        if is_called:
            return found
        # Other code calls the function, such as `map` or a partial function.
        parts = [part for call in calls for part in [call.func, *_arguments(call)]]
        return names if any(map(holds, parts)) else []

    def written_at(self, line: int) -> list[ast.AST]:
        """The values of assignments in a source line, and the arguments of methods that write."""
        found: list[ast.AST] = []
        for node in self._nodes:
            last = getattr(node, "end_lineno", None) or line
            if not getattr(node, "lineno", line + 1) <= line <= last:
                continue
            if isinstance(node, (ast.Assign, ast.AugAssign)):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                # The statement binds a name anew, and writes no field.
                if any(isinstance(part, (ast.Subscript, ast.Attribute))
                       for target in targets for part in ast.walk(target)):  # fmt: skip
                    found.append(node.value)
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                if node.func.attr in ("fill", "from_numpy", "from_torch"):
                    found += node.args
        return found

    # Numbers and arrays that the program keeps

    def _targets(self) -> Iterator[ast.expr]:
        """Yields the targets of assignments of values with a gradient."""
        for node in _own_nodes(self._body):
            if isinstance(node, (ast.Assign, ast.AugAssign, ast.AnnAssign)):
                if node.value is not None and self.has_history(node.value):
                    if isinstance(node, ast.Assign):
                        yield from node.targets
                    else:
                        yield node.target

    def kept(self, seen: set[Any]) -> list[Any]:
        """The numbers that this text, or a function that it calls, keeps in objects and in names of
        other functions, and that have a history.

        Args:
            seen: code that has been looked at.
        """
        outer = {
            name for node in _own_nodes(self._body)
            if isinstance(node, (ast.Global, ast.Nonlocal)) for name in node.names
        }  # fmt: skip
        found: list[Any] = []
        for target in self._targets():
            parts = target.elts if isinstance(target, (ast.Tuple, ast.List)) else [target]
            for part in parts:
                if not isinstance(part, ast.Name) or part.id in outer:
                    found += self._numbers_at(part)
        for node in _own_nodes(self._body):
            if not isinstance(node, ast.Call):
                continue
            if isinstance(node.func, ast.Attribute) and node.func.attr in _KEEPING:
                if any(map(self.has_history, _arguments(node))):
                    found += _numbers_in(self.resolve(node.func.value))
            inner = self._callee(node, seen)
            found += [] if inner is None else inner.kept(seen)
        return found

    def _numbers_at(self, target: ast.AST) -> list[Any]:
        value = self.resolve(target)
        if value is None and isinstance(target, ast.Subscript):
            value = self.resolve(target.value)
        return _numbers_in(value)

    def stored(self, seen: set[Any]) -> list[marks.Extent | None]:
        """The memory of arrays to which this text, or a function that it calls, stores numbers
        with a history.

        Args:
            seen: code that has been looked at.
        """
        found = list(map(self._memory_of, self._targets()))
        for node in _own_nodes(self._body):
            if isinstance(node, ast.Call):
                found += self._stored_by(node, seen)
        return found

    def _memory_of(self, target: ast.AST) -> marks.Extent | None:
        """The array to which an assignment stores, or that an attribute holds now."""
        while isinstance(target, ast.Subscript):
            value = self.resolve(target)
            if marks.extent_of(value) is not None:
                break
            target = target.value
        return marks.extent_of(self.resolve(target))

    def _stored_by(self, call: ast.Call, seen: set[Any]) -> list[marks.Extent | None]:
        values = [*call.args, *(k.value for k in call.keywords if k.arg != "out")]
        outs = [k.value for k in call.keywords if k.arg == "out"]
        called = self.resolve(call.func)
        if called in (np.copyto, np.put, np.place, np.putmask):
            outs, values = call.args[:1], call.args[1:]
        elif isinstance(call.func, ast.Attribute):
            # The method is one of arrays or of torch's tensors that changes them.
            name = call.func.attr
            if name in ("fill", "put") or (name.endswith("_") and not name.startswith("_")):
                outs = [*outs, call.func.value]
        if outs:
            is_stored = any(map(self.has_history, values))
            return [self._memory_of(out) for out in outs] if is_stored else []
        inner = self._callee(call, seen)
        return [] if inner is None else inner.stored(seen)

    def _callee(self, call: ast.Call, seen: set[Any]) -> Scope | None:
        """The source text of a called function, unless it has been examined already."""
        called = self.resolve(call.func)
        function = getattr(called, "__func__", called)
        if not isinstance(function, FunctionType) or function.__code__ in seen:
            return None
        seen.add(function.__code__)
        return self._inner(function, call)

    # Expressions

    def resolve(self, node: ast.AST) -> Any:
        """The value that a name or an attribute stands for now; None if that is unknown."""
        if isinstance(node, ast.Name):
            return next((names[node.id] for names in self._names if node.id in names), None)
        if isinstance(node, ast.Subscript):
            base, key = self.resolve(node.value), _constant(node.slice)
            if type(base) is dict and key is not None:
                return base.get(key)
            is_item = type(base) in (list, tuple) and type(key) is int
            return base[key] if is_item and -len(base) <= key < len(base) else None
        if not isinstance(node, ast.Attribute):
            return None
        base = self.resolve(node.value)
        if base is None:
            return None
        members = getattr(base, "__dict__", {})
        if node.attr in members:
            return members[node.attr]
        if node.attr in members.get("members", ()):
            return members["members"][node.attr]
        return next(
            (vars(cls)[node.attr] for cls in type(base).__mro__ if node.attr in vars(cls)), None
        )

    def has_history(self, node: ast.AST) -> bool:
        """Whether the value of an expression is computed from a value with a gradient."""
        if isinstance(node, ast.Name):
            # A list counts as having a gradient if one of its elements has.
            return (
                node.id in self._tainted or self._has_tainted_element(node.id)
                or self._is_known(node) or self._is_given(node.id)
            )  # fmt: skip
        if isinstance(node, (ast.Compare, ast.Constant, ast.Lambda)):
            return False
        if isinstance(node, ast.Attribute):
            path = _path_of(node)
            if path in self._tainted or self._is_known(node):
                return True
            if path is not None and self._has_tainted_element(path):
                return True
            found = self.resolve(node)
            # A number that an object holds is a plain one here, and has no gradient.
            if isinstance(found, (int, float)):
                return False
            if isinstance(found, property) and isinstance(found.fget, FunctionType):
                return self._returns_history(found.fget, ast.Call(node, [node.value], []))
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.FloorDiv):
            return False
        if isinstance(node, ast.Subscript):
            return self._element_has_history(node)
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
            # The product with a sparse matrix reads the vector on its right.
            if carries_history(self.resolve(node.right)):
                return True
        if isinstance(node, ast.IfExp):
            return self.has_history(node.body) or self.has_history(node.orelse)
        if isinstance(node, ast.Call):
            return self._call_has_history(node)
        return any(self.has_history(child) for child in ast.iter_child_nodes(node))

    def _has_tainted_element(self, path: str) -> bool:
        return any(tainted.startswith(path + "[") for tainted in self._tainted)

    def _element_has_history(self, node: ast.Subscript) -> bool:
        if self._is_known(node):
            return True
        field = self.resolve(node.value)
        if isinstance(field, Elements):
            return carries_history(field)
        path, base = _path_of(node), _path_of(node.value)
        if base is None or path is None:
            return self.has_history(node.value)
        if base in self._tainted or path in self._tainted or f"{base}[*]" in self._tainted:
            return True
        if path == f"{base}[*]" and self._has_tainted_element(base):
            return True
        if isinstance(node.value, ast.Subscript):  # perhaps a component of an element
            field = self.resolve(node.value.value)
            if isinstance(field, Elements) and self._element_has_history(node.value):
                return True
        return self._is_known(node.value) or (
            isinstance(node.value, ast.Name) and self._is_given(node.value.id)
        )

    def is_computed(self, node: ast.AST) -> bool:
        """Whether an expression gives an array that was computed from values with a gradient.

        The memory of an array that it merely names has been looked at.
        """
        if isinstance(node, ast.Name):
            return node.id in self._tainted
        if isinstance(node, (ast.Subscript, ast.Attribute)):
            return self.is_computed(node.value)
        if isinstance(node, ast.IfExp):
            return self.is_computed(node.body) or self.is_computed(node.orelse)
        return self.has_history(node)

    def _is_known(self, node: ast.AST) -> bool:
        """Whether a name or an attribute stands for a value with a gradient at present."""
        value = self.resolve(node)
        if isinstance(value, float) and self._reading.is_kept(value):
            return True
        return is_followed(value) or (not marks.is_empty() and is_marked(value))

    def _is_given(self, name: str) -> bool:
        """Whether callers have passed a value with a gradient for a parameter."""
        if self._caller is None or self._caller >= self._reading.callers:
            return False
        code = self._reading.code(self._caller)
        if name in code.co_freevars:
            return self._has_history_outside(name)
        count = code.co_argcount + code.co_kwonlyargcount
        count += bool(code.co_flags & 4) + bool(code.co_flags & 8)  # *args, **kwargs
        if name not in code.co_varnames[:count]:
            return False
        if not isinstance(self.resolve(ast.Name(name)), _GIVEN):
            return False
        self._reading.asks_callers = True
        if self._given is None:
            self._given = set()
            self._given = self._reading.scope_of(self._caller + 1).gives(
                code, self._reading.line(self._caller + 1)
            )
        return name in self._given

    def _has_history_outside(self, name: str) -> bool:
        """Whether a variable of an enclosing function, which calls this one, has a gradient."""
        assert self._caller is not None
        for number in range(self._caller + 1, self._reading.callers + 1):
            if name in self._reading.code(number).co_cellvars:
                self._reading.asks_callers = True
                return self._reading.scope_of(number).has_history(ast.Name(name))
        return False

    def gives(self, code: CodeType, line: int) -> set[str]:
        """The parameters of a function to which a line gives values with a history.

        Args:
            code: of the function.
            line: that calls it.
        """
        calls, found, is_called = self.calls_at(line), set(), False
        for call in calls:
            called = self.resolve(call.func)
            function = getattr(called, "__func__", called)
            if getattr(function, "__code__", None) is code:
                is_called = True
                given = self._given_by(function, call)
                found |= {name for name, value in given.items() if self.has_history(value)}
        if is_called:
            return found
        # Other code calls the function, such as `map` or a decorator.
        parts = [part for call in calls for part in _arguments(call)]
        return set(code.co_varnames) if any(map(self.has_history, parts)) else set()

    def _call_has_history(self, node: ast.Call) -> bool:
        called = self.resolve(node.func)
        kernel = as_kernel(called)
        if getattr(kernel, "_tai_kernel", False):
            if id(node) in self._apart:
                return False
            result = kernel._result
            return result is not None and result.dtype.is_float
        if isinstance(node.func, ast.Attribute):
            base = self.resolve(node.func.value)
            if isinstance(base, Elements):
                return node.func.attr in ("to_numpy", "to_torch") and carries_history(base)
            if self.has_history(node.func.value):
                return True
        if _is_in(called, _DISCRETE) or getattr(called, "_is_unrecorded", False):
            return False
        if getattr(called, "__name__", None) in ("array", "asarray", "from_dlpack"):
            if any(carries_history(self.resolve(argument)) for argument in node.args):
                return True
        if isinstance(called, FunctionType) and self._returns_history(called, node):
            return True
        return any(map(self.has_history, _arguments(node)))

    def _given_by(self, function: FunctionType, call: ast.Call) -> dict[str, ast.AST]:
        """Returns the arguments of a call by the names of the parameters."""
        code = function.__code__
        arguments: list[ast.AST] = []
        if isinstance(call.func, ast.Attribute):
            base = self.resolve(call.func.value)
            if getattr(type(base), function.__name__, None) is function:
                arguments.append(call.func.value)
        names = list(code.co_varnames[: code.co_argcount + code.co_kwonlyargcount])
        given: dict[str, ast.AST] = dict(zip(names, arguments, strict=False))
        given.update(_bind(call, names[len(arguments) :]))
        if code.co_flags & 4:  # *args
            rest = names[len(arguments) : code.co_argcount]
            given[code.co_varnames[len(names)]] = ast.Tuple(call.args[len(rest) :])
        return given

    def _inner(self, function: FunctionType, call: ast.Call) -> Scope | None:
        """The source text of a function, with the arguments of a call; None if it is not
        examined.
        """
        module = function.__module__ or ""
        if self._depth == 0 or module.split(".")[0] in ("tai", "numpy", "torch"):
            return None
        code = function.__code__
        body = _find_body(code.co_filename, code.co_firstlineno, code.co_name)
        cells = zip(code.co_freevars, function.__closure__ or (), strict=True)
        closure = {name: cell.cell_contents for name, cell in cells if _is_set(cell)}
        given = self._given_by(function, call)
        values = {name: self.resolve(argument) for name, argument in given.items()}
        scopes = [values, closure, function.__globals__, vars(builtins)]
        tainted: set[str] = set()
        for name, argument in given.items():
            path = _path_of(argument)
            if path is not None:  # an object whose attributes have a history
                tainted |= {
                    name + known[len(path) :] for known in self._tainted
                    if known.startswith((path + ".", path + "["))
                }  # fmt: skip
            if not isinstance(argument, ast.Name) or not self._has_tainted_element(argument.id):
                tainted |= {name} if self.has_history(argument) else set()
        scope = Scope(self._reading, body, scopes, self._depth - 1, tainted)
        scope.spread()
        return scope

    def _returns_history(self, function: FunctionType, call: ast.Call) -> bool:
        inner = self._inner(function, call)
        if inner is None:
            return False
        returns = (n.value for n in inner._nodes if isinstance(n, ast.Return) and n.value)
        return any(inner.has_history(value) for value in returns)


# Types of parameter values for which callers are examined.
_GIVEN = (float, np.floating, np.ndarray, list, tuple, dict, deque)


def _arguments(call: ast.Call) -> list[ast.AST]:
    return [*call.args, *(keyword.value for keyword in call.keywords)]


def _bind(call: ast.Call, names: list[str]) -> dict[str, ast.AST]:
    """Returns the expressions that a call passes for parameters, by name.

    An unpacked list may give all parameters from its place on, and an unpacked dictionary all.
    """
    given: dict[str, ast.AST] = {}
    for number, name in enumerate(names):
        if number < len(call.args):
            given[name] = call.args[number]
        if call.args and isinstance(call.args[-1], ast.Starred) and number >= len(call.args):
            given[name] = call.args[-1]
    for keyword in call.keywords:
        for name in names if keyword.arg is None else [keyword.arg]:
            if keyword.arg is not None or name not in given:
                given[name] = keyword.value
    return given


def _constant(node: ast.AST) -> Any:
    """Returns the value of a constant index, or None."""
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        value = _constant(node.operand)
        return -value if isinstance(value, int) else None
    return node.value if isinstance(node, ast.Constant) else None


def _path_of(node: ast.AST) -> str | None:
    """Returns the path of names that an expression consists of; None if it is no such path."""
    if isinstance(node, ast.Name):
        return node.id
    if not isinstance(node, (ast.Attribute, ast.Subscript)):
        return None
    base = _path_of(node.value)
    if base is None:
        return None
    if isinstance(node, ast.Attribute):
        return f"{base}.{node.attr}"
    key = _constant(node.slice)
    # The last elements of a list, at negative indices, may be any elements.
    is_known = key is not None and not (isinstance(key, int) and key < 0)
    return f"{base}[{key!r}]" if is_known else f"{base}[*]"


def _numbers_in(value: Any) -> list[Any]:
    """The plain numbers in a value: the value itself, or the elements of a container."""
    if isinstance(value, float):
        return [value]
    if isinstance(value, dict):
        return [item for item in value.values() if isinstance(item, float)]
    if isinstance(value, (list, tuple, set, deque)):
        return [item for item in value if isinstance(item, float)]
    return []


def _is_in(value: Any, values: tuple[Any, ...]) -> bool:
    return any(value is other for other in values)


def _is_no_grad(node: ast.AST) -> bool:
    """Whether an expression is a call of `ti.ad.no_grad()`."""
    called = node.func if isinstance(node, ast.Call) else node
    return getattr(called, "attr", getattr(called, "id", None)) == "no_grad"


def _is_set(cell: Any) -> bool:
    try:
        return cell.cell_contents is not cell
    except ValueError:
        return False
