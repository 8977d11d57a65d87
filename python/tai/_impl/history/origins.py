"""Warnings for numbers whose derivatives a tape or forward mode cannot track.

A number that a kernel returns is tracked through arithmetic. The results of `math.sin(r)`,
`float(r)`, NumPy, and reads of fields are plain numbers, which are constants to kernels and fields.
That is right for numbers that are printed, but gradients miss a contribution if such a number is
passed to a kernel or stored in a field. So when that happens while tracked values are alive, the
source of the calling function is analysed, once for each place: is the number computed from one?
"""

from __future__ import annotations

import ast
import builtins
import functools
import linecache
import math
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from types import FunctionType
from typing import Any

import numpy as np

from ...errors import TaiGradientWarning
from ..base import native, state
from ..base.elements import Elements
from ..base.parsing import parse
from ..base.program import at_close
from . import marks
from .marks import Mark

# Functions without a number as their result, or whose result does not change a little with their
# argument.
_DISCRETE = (
    len, range, isinstance, type, print, str, bool, int, round, math.floor, math.ceil, math.trunc,
)  # fmt: skip

# Calls of functions that are followed into their text.
_DEPTH = 3
# Callers of a function that launches, up to the one that records.
_MOST_CALLERS = 8

# Places that have been looked at, by the addresses of code objects and of the objects they use, and
# these objects, which are kept so that their addresses are not reused.
_sites: set[tuple[int, int, int]] = set()
_kept: dict[int, Any] = {}
# More places than a program has. Programs that generate code all day exceed it.
_MOST_SITES = 4096


class _OfThread(threading.local):
    def __init__(self) -> None:
        self.watches = False
        # The code that has opened the tape.
        self.recording: Any = None
        # Fields that other libraries have views of, and the owners of their memory.
        self.views: list[tuple[Any, Any]] = []


_of_thread = _OfThread()


def begin() -> None:
    """A value with a history has come to Python."""
    if not _of_thread.watches and (state.tape is not None or state.forward):
        _of_thread.watches = True
        native.watch_numbers(True)


def end() -> None:
    """Nothing is recorded or followed any more."""
    marks.clear()
    if _of_thread.views:
        native.watch_views(None, [], False)
        _of_thread.views.clear()
    if _of_thread.watches:
        _of_thread.watches = False
        native.watch_numbers(False)


def forget() -> None:
    """The program is over: its places are looked at again."""
    end()
    _forget_sites()


at_close.append(forget)


def _forget_sites() -> None:
    _sites.clear()
    _kept.clear()
    native.forget_sites()


def has_history(field: Any) -> bool:
    """Whether the values of a field or `ti.ndarray` have a gradient in the tape, or a tangent in
    forward mode."""
    if hasattr(field, "array"):
        return field.grad is not None and state.tape is not None
    if getattr(field, "role", None) != "primal" or not field.dtype.is_float:
        return False
    which = "grad" if state.tape is not None else "dual"
    companion = field._companions.get(which)
    return companion is not None and companion.level is not None and not _is_internal(field)


def _leaves_of(field: Any) -> list[Any]:
    """The field, or those of all members of a struct."""
    members = getattr(field, "members", None)
    if members is None:
        return [field]
    return [leaf for member in members.values() for leaf in _leaves_of(member)]


def _is_internal(field: Any) -> bool:
    program = state.program
    return program is not None and any(pool.field is field for pool in program.pools)


def dual_of_written(field: Any) -> Any:
    """The dual of a place that Python writes to in forward mode, if its tangent ends there.

    A value that Python writes is a constant, but before the first launch it is the point at which
    one differentiates.
    """
    dual = field._companions.get("dual")
    ends = native.forward_launches() > 0 and getattr(dual, "_core", None) is not None
    return dual.core if ends else None


def end_tangent(field: Any) -> None:
    """Python has written all of a place."""
    dual = dual_of_written(field) if state.forward else None
    if dual is not None:
        dual.fill(0.0)


def note_read(field: Any) -> None:
    """Python reads a field; to be called under a tape or in forward mode."""
    if not _of_thread.watches and has_history(field):
        begin()


def note_tape(tape: Any, looks_at_all: bool) -> None:
    """A tape begins to record.

    Args:
        tape: the core.
        looks_at_all: whether all of a view is compared between launches, or a few pieces.
    """
    frame = calling_frame()
    _of_thread.recording = None if frame is None else frame.f_code
    if marks.has_views():
        begin()
        _watch_views(tape, looks_at_all)


def _watch_views(tape: Any, looks_at_all: bool) -> None:
    """Watches the memory of fields that other libraries may write to between launches."""
    _of_thread.views = []
    memory = []
    for field, extent in marks.viewed():
        # On a GPU, the host would have to wait to compare.
        owner = field._lend_memory() if has_history(field) else None
        if owner is not None:
            _of_thread.views.append((field, owner))
            memory.append((extent.begin, extent.end - extent.begin))
    native.watch_views(tape, memory, looks_at_all)


def check_views() -> None:
    """Looks for writes to fields through views since the last recorded launch."""
    changed = native.take_changed_views() if _of_thread.views else ()
    frame = calling_frame() if changed else None
    fields = [_of_thread.views[number][0] for number in changed]
    if frame is None or not is_new_place(frame, fields[0]):
        return
    # Elements of fields in common cells lie between each other.
    names = " or ".join(f"'{field.name}'" for field in fields)
    warn_at(
        frame,
        f"field {names} was written through a view of it (DLPack) after a kernel had been "
        "recorded: the tape does not see such writes, and the gradient is wrong if that kernel "
        "has used these elements. Write to the field in a kernel or by from_numpy or from_torch, "
        "or before the tape begins",
    )


def note_view(field: Any, address: int, steps: tuple[int, ...]) -> None:
    """Another library has got a view of the memory of a field.

    Args:
        field: which.
        address, steps: of its first element, and the bytes from index to index.
    """
    extents = (*field.shape, *field.element_shape)
    if 0 in extents or not field.dtype.is_float or not field._companions:
        return
    pairs = zip(extents, steps, strict=True)
    marks.mark_view(field, marks.made_of(address, field.dtype.bits // 8, pairs))
    if state.tape is not None or state.forward:
        note_read(field)


def note_stored(array: Any) -> None:
    """A recorded kernel stores numbers that depend on values with a gradient to an array."""
    marks.mark(array, Mark.KERNEL)
    begin()


def note_computed(result: Any, *operands: Any) -> Any:
    """Marks a result of the host if an operand depends on values with a gradient.

    Returns:
        The result.
    """
    if (state.tape is not None or state.forward) and any(map(carries_history, operands)):
        marks.mark(result)
        begin()
    return result


def carries_history(value: Any) -> bool:
    """Whether the numbers that Python reads of a value depend on values with a gradient."""
    if _is_followed(value):
        return True
    if isinstance(value, Elements) and any(map(has_history, _leaves_of(value))):
        return True
    return not marks.is_empty() and _is_marked(value)


def _is_marked(value: Any) -> bool:
    if marks.mark_of(value) is not None:
        return True
    field = marks.field_behind(value)
    return field is not None and has_history(field)


def calling_frame() -> Any:
    """The frame of the program that has called the package; None if there is none."""
    frame: Any = sys._getframe(2)
    while frame is not None and frame.f_globals.get("__name__", "").startswith("tai."):
        frame = frame.f_back
    return frame


def is_new_place(frame: Any, what: Any) -> bool:
    """Whether the line has not been looked at for `what`, an object that is kept from now on."""
    code = frame.f_code
    site = (id(code), frame.f_lineno, id(what))
    if site in _sites:
        return False
    if len(_sites) >= _MOST_SITES:
        _forget_sites()
    _sites.add(site)
    _kept[id(code)], _kept[id(what)] = code, what
    return True


def _as_kernel(called: Any) -> Any:
    """The kernel behind a method or a static method."""
    called = getattr(called, "__func__", called)
    return getattr(called, "_kernel", called)


def check_call(kernel: Any, names: list[str], values: dict[str, Any]) -> None:
    """Looks at the plain numbers that a kernel is called with.

    Args:
        kernel, names: of the call, and its parameters.
        values: the arguments by name. Members of structs have names of their own.
    """
    if not _of_thread.watches:
        return
    frame = calling_frame()
    if frame is None:
        return
    # The launcher need not come here again.
    native.note_site(frame.f_code, frame.f_lineno, kernel)
    if not is_new_place(frame, kernel):
        return
    for name in _names_of(frame, kernel, names, _Scope.has_history):
        if name in values and _is_plain(values[name]):
            _warn(frame, f"what parameter '{name}' of kernel '{kernel.__name__}' is given")


def _names_of(
    frame: Any, kernel: Any, names: list[str], holds: Callable[[_Scope, ast.AST], bool]
) -> list[str]:
    """The parameters of a kernel that a line gives expressions of some kind."""
    scope, found = _Scope.of_frame(frame), []
    for call in scope.calls_at(frame.f_lineno):
        if _as_kernel(scope.resolve(call.func)) is not kernel:
            continue
        of = scope.resolve(getattr(call.func, "value", call.func))
        offset = int(kernel._is_method and not isinstance(of, type))
        given = {n + offset: argument for n, argument in enumerate(call.args)}
        named = {keyword.arg: keyword.value for keyword in call.keywords}
        for number, name in enumerate(names):
            expression = given.get(number, named.get(name))
            if expression is not None and holds(scope, expression):
                found.append(name)
    return found


def check_arrays(kernel: Any, names: list[str], arrays: dict[str, Any]) -> None:
    """Looks at arrays without a gradient that a recorded launch reads.

    The tape follows an array from a launch that stores to it to one that reads it. It sees neither
    an array that Python computes in between, nor that the memory is that of a field.

    Args:
        kernel: of the launch.
        names: its parameters.
        arrays: the arguments for such parameters, by name.
    """
    if not arrays or not _of_thread.watches and marks.is_empty():
        return
    frame = calling_frame()
    if frame is None:
        return
    for name, value in arrays.items():
        field = marks.field_behind(value)
        if field is not None and has_history(field) and is_new_place(frame, field):
            warn_at(
                frame,
                f"array '{name}' of kernel '{kernel.__name__}' is a view of field '{field.name}', "
                "which has a gradient: to the tape it is a constant. Use the field in the kernel",
            )
        if marks.mark_of(value) is Mark.HOST and is_new_place(frame, _warn):
            _warn(frame, f"what array '{name}' of kernel '{kernel.__name__}' is given")
    # Arrays that kernels have stored to are followed by the tape.
    unknown = {
        n: v for n, v in arrays.items()
        if marks.mark_of(v) is None and marks.field_behind(v) is None
    }  # fmt: skip
    if unknown and _of_thread.watches and is_new_place(frame, kernel.grad):
        found = _names_of(frame, kernel, names, _Scope.is_computed)
        stored = _stored_arrays(frame)
        for name, value in unknown.items():
            if name in found or _shares_memory(value, stored):
                _warn(frame, f"what array '{name}' of kernel '{kernel.__name__}' is given")


def check_write(field: Any, value: Any) -> None:
    """Checks a write of Python to a field; to be called under a tape or in forward mode."""
    if not has_history(field):
        return
    is_field = hasattr(field, "_companions")
    what = f"what Python writes to field '{field.name}'" if is_field else "what an array is given"
    tracked = _is_followed(value) or (not marks.is_empty() and _is_marked(value))
    if not tracked and (not _of_thread.watches or isinstance(value, int)):
        return
    frame = calling_frame()
    if frame is None or not is_new_place(frame, _warn if tracked else check_write):
        return
    is_array = marks.extent_of(value) is not None
    if is_array and not tracked and _shares_memory(value, _stored_arrays(frame)):
        tracked = True
    if tracked or any(
        (scope.is_computed if is_array else scope.has_history)(expression)
        for scope in [_Scope.of_frame(frame)]
        for expression in scope.written_at(frame.f_lineno)
    ):
        _warn(frame, what)


def _is_plain(value: Any) -> bool:
    if isinstance(value, (float, np.floating)):
        return not _is_followed(value)
    return getattr(value, "is_matrix", False) and not _is_followed(value)


def _is_followed(value: Any) -> bool:
    """Whether the value has a history, as kernels see it."""
    return (
        getattr(value, "_gradient", None) is not None or getattr(value, "_cell", None) is not None
    )


def _warn(frame: Any, what: str) -> None:
    mode = "the tape" if state.tape is not None else "forward mode"
    warn_at(
        frame,
        f"{what} was computed by Python from a value that has a gradient: to {mode} it is a "
        "constant from here on. Compute it in a kernel and pass it on in a field; if that is "
        "meant, read the value in a function under ti.ad.no_grad or before",
    )


def warn_at(frame: Any, message: str) -> None:
    """Warns of a gradient that is lost in the line of a frame."""
    warnings.warn_explicit(
        message,
        TaiGradientWarning,
        frame.f_code.co_filename,
        frame.f_lineno,
        module=frame.f_globals.get("__name__"),
    )


# Arrays that the program keeps


def _stored_arrays(frame: Any) -> list[marks.Extent]:
    """The memory of arrays into which the program stores numbers with a history.

    The texts are those of the function of the frame, of its callers up to the one that records,
    and of the functions that they call.
    """
    scopes = []
    for _ in range(_MOST_CALLERS):
        scopes.append(_Scope.of_frame(frame))
        is_last = frame.f_code is _of_thread.recording
        frame = frame.f_back
        if is_last or frame is None:
            break
    else:
        # The tape has been opened somewhere else.
        scopes = scopes[:1]
    found = [extent for scope in scopes for extent in scope.stored(set())]
    return [extent for extent in found if extent is not None]


def _shares_memory(value: Any, stored: list[marks.Extent]) -> bool:
    extent = marks.extent_of(value) if stored else None
    return extent is not None and any(extent.overlaps(other) for other in stored)


# The text of a function


@functools.lru_cache(maxsize=64)
def _parse(text: str) -> ast.Module | None:
    try:
        return parse(text)
    except (SyntaxError, ValueError):
        return None


def _find_body(filename: str, line: int, name: str) -> ast.AST | None:
    """The definition of a function, or the module."""
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


class _Scope:
    """The text of a function, and the meanings of its names."""

    def __init__(
        self, body: ast.AST | None, names: list[dict[str, Any]], depth: int,
        tainted: set[str] | None = None,
    ):  # fmt: skip
        self._body = body
        self._nodes = [] if body is None else list(ast.walk(body))
        self._names, self._depth = names, depth
        self._tainted = set() if tainted is None else tainted
        self._spread()

    @classmethod
    def of_frame(cls, frame: Any) -> _Scope:
        code = frame.f_code
        body = _find_body(code.co_filename, code.co_firstlineno, code.co_name)
        return cls(body, [frame.f_locals, frame.f_globals, vars(builtins)], _DEPTH)

    def _spread(self) -> None:
        """Finds the variables that hold values with a history at some time."""
        pairs = []
        for node in self._nodes:
            if isinstance(node, ast.Assign):
                pairs += [(target, node.value) for target in node.targets]
            elif isinstance(node, (ast.AugAssign, ast.AnnAssign, ast.NamedExpr)):
                pairs += [(node.target, node.value)] if node.value is not None else []
            elif isinstance(node, (ast.For, ast.comprehension)):
                pairs.append((node.target, node.iter))
        size = -1
        while size != len(self._tainted):
            size = len(self._tainted)
            for target, value in pairs:
                names = [n.id for n in ast.walk(target) if isinstance(n, ast.Name)]
                if not set(names) <= self._tainted and self.has_history(value):
                    # An element of a field that is stored to says nothing of the field.
                    if not isinstance(target, (ast.Subscript, ast.Attribute)):
                        self._tainted.update(names)

    def calls_at(self, line: int) -> list[ast.Call]:
        return [
            n for n in self._nodes
            if isinstance(n, ast.Call) and n.lineno <= line <= (n.end_lineno or n.lineno)
        ]  # fmt: skip

    def written_at(self, line: int) -> list[ast.AST]:
        """The values of assignments in a line, and the arguments of methods that write."""
        found: list[ast.AST] = []
        for node in self._nodes:
            last = getattr(node, "end_lineno", None) or line
            if not getattr(node, "lineno", line + 1) <= line <= last:
                continue
            if isinstance(node, (ast.Assign, ast.AugAssign)):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                # A name is bound anew, and no field is written.
                if any(isinstance(part, (ast.Subscript, ast.Attribute))
                       for target in targets for part in ast.walk(target)):  # fmt: skip
                    found.append(node.value)
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                if node.func.attr in ("fill", "from_numpy", "from_torch"):
                    found += node.args
        return found

    def stored(self, seen: set[Any]) -> list[marks.Extent | None]:
        """The memory of arrays to which this text, or a function that it calls, stores numbers
        with a history.

        Args:
            seen: code that has been looked at.
        """
        found = []
        for node in _own_nodes(self._body):
            if isinstance(node, (ast.Assign, ast.AugAssign, ast.AnnAssign)):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                if node.value is not None and self.has_history(node.value):
                    found += [self._memory_of(t) for t in targets]
            elif isinstance(node, ast.Call):
                found += self._stored_by(node, seen)
        return found

    def _memory_of(self, target: ast.AST) -> marks.Extent | None:
        """The array that an assignment stores to, or that an attribute holds now."""
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
            # Methods of arrays and of torch's tensors that change them.
            name = call.func.attr
            if name in ("fill", "put") or (name.endswith("_") and not name.startswith("_")):
                outs = [*outs, call.func.value]
        if outs:
            is_stored = any(map(self.has_history, values))
            return [self._memory_of(out) for out in outs] if is_stored else []
        function = getattr(called, "__func__", called)
        if not isinstance(function, FunctionType) or function.__code__ in seen:
            return []
        seen.add(function.__code__)
        inner = self._inner(function, call)
        return [] if inner is None else inner.stored(seen)

    def resolve(self, node: ast.AST) -> Any:
        """The value that a name or an attribute stands for now; None if that is unknown."""
        if isinstance(node, ast.Name):
            return next((names[node.id] for names in self._names if node.id in names), None)
        if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Constant):
            base, key = self.resolve(node.value), node.slice.value
            if type(base) is dict:
                return base.get(key)
            is_item = type(base) in (list, tuple) and type(key) is int and 0 <= key < len(base)
            return base[key] if is_item else None
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
        """Whether the value of an expression comes from one with a history."""
        if isinstance(node, ast.Name):
            return node.id in self._tainted or self._is_known(node)
        if isinstance(node, (ast.Compare, ast.Constant, ast.Lambda)):
            return False
        if isinstance(node, ast.Attribute) and self._is_known(node):
            return True
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.FloorDiv):
            return False
        if isinstance(node, ast.Subscript):
            if self._is_known(node):
                return True
            field = self.resolve(node.value)
            if isinstance(field, Elements):
                return carries_history(field)
            return self.has_history(node.value)
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
            # A sparse matrix reads the vector.
            if carries_history(self.resolve(node.right)):
                return True
        if isinstance(node, ast.IfExp):
            return self.has_history(node.body) or self.has_history(node.orelse)
        if isinstance(node, ast.Call):
            return self._call_has_history(node)
        return any(self.has_history(child) for child in ast.iter_child_nodes(node))

    def is_computed(self, node: ast.AST) -> bool:
        """Whether an expression gives an array that was computed from values with a history.

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
        """Whether a name or an attribute stands for a value with a history now."""
        value = self.resolve(node)
        return _is_followed(value) or (not marks.is_empty() and _is_marked(value))

    def _call_has_history(self, node: ast.Call) -> bool:
        called = self.resolve(node.func)
        kernel = _as_kernel(called)
        if getattr(kernel, "_tai_kernel", False):
            result = kernel._result
            return result is not None and result.dtype.is_float
        if isinstance(node.func, ast.Attribute):
            base = self.resolve(node.func.value)
            if isinstance(base, Elements):
                return node.func.attr in ("to_numpy", "to_torch") and carries_history(base)
            if self.has_history(node.func.value):
                return True
        if called in _DISCRETE:
            return False
        if getattr(called, "__name__", None) == "from_dlpack":
            if any(carries_history(self.resolve(argument)) for argument in node.args):
                return True
        if isinstance(called, FunctionType) and self._returns_history(called, node):
            return True
        arguments = [*node.args, *(keyword.value for keyword in node.keywords)]
        return any(self.has_history(argument) for argument in arguments)

    def _inner(self, function: FunctionType, call: ast.Call) -> _Scope | None:
        """The text of a function, with the arguments of a call; None if it is not looked at."""
        module = function.__module__ or ""
        if self._depth == 0 or module.split(".")[0] in ("tai", "numpy", "torch"):
            return None
        code = function.__code__
        body = _find_body(code.co_filename, code.co_firstlineno, code.co_name)
        cells = zip(code.co_freevars, function.__closure__ or (), strict=True)
        closure = {name: cell.cell_contents for name, cell in cells if _is_set(cell)}
        arguments: list[ast.AST] = list(call.args)
        if isinstance(call.func, ast.Attribute):
            base = self.resolve(call.func.value)
            if getattr(type(base), function.__name__, None) is function:
                arguments.insert(0, call.func.value)
        given = dict(zip(code.co_varnames, arguments, strict=False))
        given.update({keyword.arg: keyword.value for keyword in call.keywords if keyword.arg})
        values = {name: self.resolve(argument) for name, argument in given.items()}
        scopes = [values, closure, function.__globals__, vars(builtins)]
        tainted = {name for name, argument in given.items() if self.has_history(argument)}
        return _Scope(body, scopes, self._depth - 1, tainted)

    def _returns_history(self, function: FunctionType, call: ast.Call) -> bool:
        inner = self._inner(function, call)
        if inner is None:
            return False
        returns = (n.value for n in inner._nodes if isinstance(n, ast.Return) and n.value)
        return any(inner.has_history(value) for value in returns)


def _is_set(cell: Any) -> bool:
    try:
        return cell.cell_contents is not cell
    except ValueError:
        return False
