"""Errors for invalid code: conditions that are not scalar, mutation of Python objects in code that
runs later, and calls whose result would be frozen into the kernel."""

from __future__ import annotations

import ast
import builtins
import warnings
from collections import deque
from types import BuiltinFunctionType, BuiltinMethodType
from typing import Any

import numpy as np

from ...errors import TaiCompilationWarning, TaiSyntaxError, TaiTypeError
from ..base.dtypes import DataType
from ..fields.arrays import Ndarray
from ..fields.field import Field
from ..fields.snode import SNode
from ..values.matrix import Matrix
from ..values.misuse import describe_misuse, misuse_hint
from ..values.value import Value
from .compile_time import CompileTime
from .context import Context, Part
from .refs import ArrayArgument, Place, VariablePlace
from .sparse import ListElement
from .structs import StructPlace, StructValue

# Methods that change the object on which they are called.
_CHANGES = {
    list: {"append", "extend", "insert", "remove", "pop", "clear", "sort", "reverse"},
    dict: {"update", "pop", "popitem", "clear", "setdefault"},
    set: {"add", "remove", "discard", "pop", "clear", "update", "difference_update",
          "intersection_update", "symmetric_difference_update"},
    deque: {"append", "appendleft", "extend", "extendleft", "pop", "popleft", "clear", "insert",
            "remove", "reverse", "rotate"},
    bytearray: {"append", "extend", "insert", "pop", "clear", "remove", "reverse"},
    np.ndarray: {"fill", "sort", "put", "resize", "itemset", "partition", "setfield"},
}  # fmt: skip

_OUTSIDE = {
    builtins.open, builtins.input, builtins.exec, builtins.eval, builtins.compile,
    builtins.__import__, builtins.setattr, builtins.delattr, builtins.breakpoint,
    builtins.globals, builtins.locals, builtins.memoryview,
}  # fmt: skip

# Modules whose functions have side effects, or a result that differs from call to call.
_MODULES = {
    "random": "use ti.random()",
    "numpy.random": "use ti.random()",
    "secrets": "use ti.random()",
    "uuid": None,
    "time": "measure around the launch",
    "subprocess": None,
    "socket": None,
    "shutil": None,
    "tempfile": None,
    "threading": None,
    "_thread": None,
    "_io": None,
    "io": None,
    "posix": None,
}
# Names of methods of fields, arrays and levels that move data or change the layout, and functions
# of this package with side effects.
_MOVES = {
    "fill", "to_numpy", "from_numpy", "copy_from", "to_torch", "from_torch", "to_paddle",
    "from_paddle", "to_dlpack", "__dlpack__", "deactivate_all", "destroy", "active_cells",
    "place", "lazy_grad", "lazy_dual", "dense", "pointer", "bitmasked", "hash", "dynamic",
}  # fmt: skip
_ACTS = {"init", "reset", "sync", "field", "ndarray", "Tape", "clear_all_gradients"}
_NOW = {"now", "utcnow", "today"}
# Functions of the operating system that only read or compute.
_QUIET = {"getcwd", "getenv", "cpu_count", "getpid", "fspath", "sched_getaffinity", "get_environ"}


def holds_value(thing: Any) -> bool:
    """Whether a container holds a value that is known only when the kernel runs."""
    if isinstance(thing, (tuple, list, set, frozenset, deque)):
        return any(holds_value(t) for t in thing)
    if isinstance(thing, dict):
        return any(holds_value(t) for t in (*thing, *thing.values()))
    return isinstance(thing, (Value, Place, StructValue))


def refuse_condition(thing: Any) -> None:
    """Refuses as conditions those objects that Python would take for true, whatever they
    contain.
    """
    if isinstance(thing, (StructValue, StructPlace)):
        raise TaiTypeError("the truth of a struct is not one answer", "compare its members")
    if isinstance(thing, ListElement):
        raise TaiTypeError("a list of cells is no condition", "compare its length: x.length() > 0")
    if isinstance(thing, (Field, ArrayArgument)) or (
        callable(thing) and not isinstance(thing, (Value, type))
    ):
        raise TaiTypeError(describe_misuse(thing), misuse_hint(thing))
    if not isinstance(thing, Value) and holds_value(thing):
        raise TaiTypeError(
            f"a {type(thing).__name__} is no condition: it is true whatever the values in it are",
            "compare the values, or use ti.Vector([…]).any()",
        )


def is_struct(thing: Any) -> bool:
    return isinstance(thing, (StructValue, StructPlace))


def refuse_non_number(thing: Any, operands: tuple) -> None:
    """Raises an error if an operand is a field, a function or a text, described in the words of the
    user.
    """
    if isinstance(thing, (Field, ArrayArgument)) or thing is None or (
        callable(thing) and not isinstance(thing, (Value, DataType)) and not hasattr(
            thing, "is_matrix")
    ):  # fmt: skip
        raise TaiTypeError(describe_misuse(thing), misuse_hint(thing))
    if isinstance(thing, str) and any(isinstance(o, Value) for o in operands):
        raise TaiTypeError(describe_misuse(thing), 'to print it: print(f"… {x}")')


class Checks(Part):
    """The part of the compiler that looks at calls of Python functions.

    Args:
        context, compile_time: other parts of the compiler, which it uses.
    """

    def __init__(self, context: Context, compile_time: CompileTime):
        super().__init__(context)
        self.compile_time = compile_time
        # Containers that the program has made while the kernel is compiled, by identity, and the
        # loop depth at which each was made.
        self._made: dict[int, tuple[Any, int]] = {}

    def remember(self, thing: Any) -> Any:
        """Remembers that the program has made a container at this depth of the kernel, and returns
        the container.
        """
        if isinstance(thing, tuple(_CHANGES)):
            self._made[id(thing)] = (thing, self.context.depth_below_top)
        return thing

    def check_python_call(self, function: Any) -> None:
        """Refuses calls that make no sense while a kernel is compiled.

        Raises:
            TaiSyntaxError: it changes a Python object where the kernel runs many times or perhaps
                not, or it would give another answer each time.
        """
        if self.compile_time.in_static:
            return
        receiver = getattr(function, "__self__", None)
        name = getattr(function, "__name__", "")
        if isinstance(function, (BuiltinFunctionType, BuiltinMethodType)):
            for kind, names in _CHANGES.items():
                if isinstance(receiver, kind) and name in names:
                    self._check_change(receiver, kind, name)
                    return
        self._check_own(function, receiver, name)
        try:
            outside = function in _OUTSIDE
        except TypeError:  # not hashable
            outside = False
        if outside:
            raise TaiSyntaxError(
                f"{name}(…) would run once, while the kernel is compiled, and not when it runs",
                "call it in Python, and pass what the kernel needs as an argument",
            )
        self._check_answer(function, receiver, name)

    def _check_own(self, function: Any, receiver: Any, name: str) -> None:
        """Refuses calls of functions of this package that make or move data."""
        if isinstance(receiver, Matrix) and name == "fill":
            raise TaiSyntaxError(
                "a vector or matrix from outside the kernel is a constant in it",
                "copy it first: v = …; v.fill(…)",
            )
        is_data = isinstance(receiver, (Field, Ndarray, SNode)) and name in _MOVES
        module = getattr(function, "__module__", None) or ""
        if is_data or (module.startswith("tai.") and name in _ACTS):
            hints = {
                "fill": "assign to the elements in a loop",
                "copy_from": "assign to the elements in a loop",
                "field": "make fields outside",
            }
            raise TaiSyntaxError(
                f"{name}(…) would run once, while the kernel is compiled, and not when it runs",
                hints.get(name, "call it in Python, before or after the launch"),
            )

    def warn_of_hidden_field(self, name: str) -> None:
        """Warns that a new variable has the name of a field, since an element of the field may have
        been meant.
        """
        frame = self.frame
        found = frame.closure.get(name, frame.globals.get(name))
        if not isinstance(found, Field) or found.level is None:
            return
        index = ", ".join("ijklmnop"[: len(found.shape)]) or "None"
        text = (
            f"kernel '{self.context.kernel_name}': variable '{name}' hides the field of that name, "
            f"which stays as it is\n  hint: write {name}[{index}] = …, or take another name"
        )
        line = self.context.diagnostics.last_node.lineno
        warnings.warn_explicit(text, TaiCompilationWarning, frame.filename, line, registry=_shown)

    def may_change(self, thing: Any) -> bool:
        """Whether the program has made a container in the block that is being compiled."""
        made = self._made.get(id(thing))
        return made is not None and made[0] is thing and made[1] == self.context.depth_below_top

    def _check_change(self, receiver: Any, kind: type, name: str) -> None:
        if self.may_change(receiver):
            return
        made = self._made.get(id(receiver))
        what = "an array" if kind is np.ndarray else f"a Python {kind.__name__}"
        if made is None:
            raise TaiSyntaxError(
                f"'{name}' would change {what} once, while the kernel is compiled, and not when "
                "it runs",
                "use a field for what a kernel writes; for lists of cells there is ti.root.dynamic",
            )
        raise TaiSyntaxError(
            f"'{name}' changes {what} once, while the kernel is compiled, but the branch or loop "
            "around it is run when the kernel is",
            "loop with ti.static(range(…)), branch with if ti.static(…), or use a field",
        )

    def _check_answer(self, function: Any, receiver: Any, name: str) -> None:
        if isinstance(function, type):
            return
        holder = type(receiver) if receiver is not None and not isinstance(receiver, type) else None
        is_module = holder is not None and holder.__name__ == "module"
        if is_module:
            module = receiver.__name__
        elif holder is not None:
            module = holder.__module__
        else:
            module = getattr(function, "__module__", None) or ""
        if module.startswith("numpy.random"):
            module = "numpy.random"
        is_now = isinstance(receiver, type) and receiver.__module__ == "datetime" and name in _NOW
        if (module not in _MODULES or (module == "posix" and name in _QUIET)) and not is_now:
            return
        raise TaiSyntaxError(
            f"{name}(…) would be called once, while the kernel is compiled, and not when it runs",
            (_MODULES.get(module) or "call it in Python")
            + ", or pass the answer as an argument; ti.static(…) says that once is meant",
        )

    def warn_of_stopped_counter(self, node: ast.stmt, place: Place, value: Any) -> None:
        """Warns that steps of one size end in a number whose neighbours are farther away than a
        step.

        Args:
            node: the statement `target += value`.
        """
        bits = _DIGITS.get(place.dt.name)
        step = value.const if isinstance(value, Value) else value
        if bits is None or not isinstance(step, (int, float)) or not step:
            return
        names = {n.id for n in ast.walk(node.target) if isinstance(n, ast.Name)}  # type: ignore
        trips = 1.0
        for loop in self.frame.loops:
            if loop.kind not in ("for", "while"):
                continue
            if isinstance(place, VariablePlace):
                repeats = any(variable is place.variable for variable in loop.carried)
            else:
                repeats = names.isdisjoint(loop.names)
            trips *= loop.trips if repeats else 1
        if trips <= 2**bits:
            return
        end = abs(step) * 2**bits
        text = (
            f"kernel '{self.context.kernel_name}': this sum of steps of {step:g} in {place.dt} "
            f"stops growing at about {end:g}: from there on, {place.dt} has no number a step away\n"
            "  hint: count in ti.i32 or add in ti.f32, and convert at the end"
        )
        warnings.warn_explicit(
            text, TaiCompilationWarning, self.frame.filename, node.lineno, registry=_shown
        )

    def warn_of_fraction(self, what: str) -> None:
        """Warns, once for each line, that a float is stored in a whole number."""
        node, frame = self.context.diagnostics.last_node, self.frame
        text = (
            f"kernel '{self.context.kernel_name}': {what} takes a float, and drops its fraction\n"
            "  hint: say so by int(…) or ti.cast(…), or use a float type"
        )
        warnings.warn_explicit(
            text, TaiCompilationWarning, frame.filename, node.lineno, registry=_shown
        )


# The types that a counter may overflow in precision, with their digits in bits: once a sum has
# reached 2^bits steps, further steps change nothing.
_DIGITS = {"f16": 11, "bf16": 8}
_shown: dict = {}
