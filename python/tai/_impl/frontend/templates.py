"""Template arguments, and the attributes of them that kernels read while they are compiled.

The code of a kernel is compiled for its template arguments. Template arguments that are numbers,
texts, containers, arrays, matrices or structs are compared by contents (`_core.Constant`), other
objects by identity. A kernel depends on those attributes of such an object that it read, which
`Reads` records: if one of them has changed at a later launch, the kernel is compiled again.
"""

from __future__ import annotations

import enum
import inspect
import warnings
import weakref
from collections import deque
from types import (
    BuiltinFunctionType,
    FunctionType,
    MemberDescriptorType,
    MethodType,
    ModuleType,
)
from typing import Any

import numpy as np

from ...errors import TaiCompilationWarning, TaiRuntimeTypeError
from ..base import native
from ..base.callers import calling_level

_CONTAINERS = (tuple, list, set, frozenset, deque)
_FUNCTIONS = (FunctionType, BuiltinFunctionType, MethodType)
_LEAVES = (bool, int, float, complex, str, bytes, type(None), np.generic, np.ndarray, np.dtype,
           enum.Enum, range)  # fmt: skip

# Attributes of an array that do not depend on its elements.
ARRAY_FORM = ("shape", "ndim", "size", "dtype")

# If a kernel is compiled this many times because attributes have changed, it warns.
_MANY = 16


def hint(value: Any) -> Any:
    """A hashable key of a template argument; arguments with equal keys may share compiled code."""
    kind = type(value)
    return (kind, value) if kind in (int, str) else kind


def take(value: Any, parameter: str, kernel: str) -> Any:
    """Returns the constant that a template argument stands for at present.

    Code does not keep the objects alive that it was compiled for; see `is_weak`.
    """
    if is_weak(value):
        return native.Constant.weakly(value)
    try:
        return native.Constant(value)
    except RecursionError:
        raise TaiRuntimeTypeError(
            f"template argument '{parameter}' of kernel '{kernel}' contains itself, or is nested "
            "too deeply"
        ) from None


def is_weak(value: Any) -> bool:
    """Whether kernels hold a template argument weakly: an object of a `data_oriented` class."""
    kind = type(value)
    return getattr(kind, "_tai_data_oriented", False) and kind.__weakrefoffset__ != 0


def owner_of(held: Any) -> Any:
    """The object whose attribute was read, which may be held by a weak reference; None if the
    object no longer exists.
    """
    return held() if isinstance(held, weakref.ref) else held


def _is_own(kind: type) -> bool:
    return kind.__module__.split(".")[0] in ("tai", "builtins", "numpy")


def _is_open(thing: Any) -> bool:
    """Whether a kernel may depend on attributes of `thing` that can change."""
    if isinstance(thing, (*_LEAVES, *_FUNCTIONS, ModuleType)):
        return False
    return not _is_own(thing if isinstance(thing, type) else type(thing))


class Reads:
    """The attributes of template arguments, and of objects inside them, that a kernel reads.

    Args:
        templates: the arguments.
    """

    def __init__(self, templates: list[Any]):
        self._followed: dict[int, Any] = {}
        self._noted: dict[tuple[int, str], tuple[Any, str, Any]] = {}
        # Template arguments that the compiled code does not keep alive.
        self._weak = {id(thing): weakref.ref(thing) for thing in templates if is_weak(thing)}
        for thing in templates:
            if isinstance(thing, ModuleType):
                self._followed[id(thing)] = thing
            self._follow(thing)

    def all(self) -> list[tuple[Any, str, Any]]:
        """A triple for each attribute that was read: the owner or a weak reference to it, the name,
        and the `Constant`.
        """
        return [
            (self._weak.get(id(owner), owner), name, constant)
            for owner, name, constant in self._noted.values()
        ]

    def note(self, owner: Any, name: str, value: Any, form_only: bool = False) -> None:
        """Notes that the attribute `owner.name` was read and had the value `value`.

        Args:
            owner, name, value: of the attribute.
            form_only: whether no more than the shape of an array is wanted of it.
        """
        if id(owner) not in self._followed or (id(owner), name) in self._noted:
            return
        if self._is_stored(owner, name):
            if form_only and isinstance(value, np.ndarray):
                self._add(owner, name, native.Constant.identity(value))
                for part in ARRAY_FORM:
                    self._add(value, part, native.Constant(getattr(value, part)))
                return
            of_argument = id(value) in self._weak
            make = native.Constant.weakly if of_argument else native.Constant
            self._add(owner, name, make(value))
        elif isinstance(value, _LEAVES):
            self._add(owner, name, native.Constant(value))
        elif not isinstance(value, _FUNCTIONS) and not _is_own(type(value)):
            self.note_all(owner)  # the source of an object that a property makes
        self._follow(value)

    def note_all(self, *things: Any) -> None:
        """Notes that Python code has seen these objects while compiling, so that the code depends
        on everything they hold.
        """
        for thing in things:
            if isinstance(thing, _CONTAINERS):
                self.note_all(*thing)
            elif id(thing) in self._followed:
                names = list(getattr(thing, "__dict__", ()))
                for kind in type(thing).__mro__:
                    slots = vars(kind).get("__slots__", ())
                    names += [slots] if isinstance(slots, str) else slots
                for name in names:
                    if not name.startswith("__") and hasattr(thing, name):
                        self.note(thing, name, getattr(thing, name))

    def _add(self, owner: Any, name: str, constant: Any) -> None:
        self._noted.setdefault((id(owner), name), (owner, name, constant))

    def _follow(self, thing: Any) -> None:
        if isinstance(thing, dict):
            thing = list(thing.values())
        if isinstance(thing, _CONTAINERS):
            for item in thing:
                self._follow(item)
        elif _is_open(thing):
            self._followed[id(thing)] = thing

    @staticmethod
    def _is_stored(owner: Any, name: str) -> bool:
        """Whether the attribute is stored in the object, and not computed when it is read."""
        if name in getattr(owner, "__dict__", ()):
            found = vars(owner)[name]
            return not isinstance(owner, type) or not hasattr(type(found), "__get__")
        found = inspect.getattr_static(type(owner), name, None)
        return isinstance(found, MemberDescriptorType) or not hasattr(type(found), "__get__")


def still_hold(reads: list[tuple[Any, str, Any]]) -> bool:
    """Whether all attributes that were read still have their recorded values."""
    missing = object()
    return all(
        constant.matches(getattr(owner_of(owner), name, missing)) for owner, name, constant in reads
    )


def warn_of_many(name: str, variants: list[Any]) -> None:
    """Warns once that a kernel is compiled again and again because attributes change."""
    if len(variants) != _MANY:
        return
    changed = []
    before = {(id(owner_of(o)), n): c for o, n, c in variants[-2].reads}
    for held, attribute, constant in variants[-1].reads:
        owner = owner_of(held)
        previous = before.get((id(owner), attribute))
        current = getattr(owner, attribute, None)
        if not constant.matches(current) or (previous and not previous.matches(current)):
            changed.append(f"'{attribute}'")
    what = ", ".join(dict.fromkeys(changed)) or "a template argument"
    warnings.warn(
        f"kernel '{name}' has been compiled {_MANY} times, as {what} changes between launches\n"
        "  hint: it is part of the code; pass what changes as an argument, or keep it in a field",
        TaiCompilationWarning,
        stacklevel=calling_level(),
    )
