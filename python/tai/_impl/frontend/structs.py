"""Structs in kernels: named members, each a value or an lvalue."""

from __future__ import annotations

import ast
import builtins
from collections.abc import Iterator
from typing import Any

from ...errors import TaiNameError, TaiTypeError, did_you_mean
from ..fields.structs import Struct, StructField, StructType, items_of
from ..values.matrix import Matrix
from ..values.types import MatrixType
from ..values.value import Value
from .atomics import takes_reference
from .refs import Component, Place, Variable, VariablePlace, field_element
from .refs import Part as SomeComponents
from .scope import Bound
from .source import AssignedNames, closure_of, dotted, function_ast


class StructMethod:
    """A `@ti.func` of a struct type, together with the struct on which it is called."""

    def __init__(self, function: Any, receiver: Any):
        self._tai_func = function._tai_func
        self.__self__, self.__name__ = receiver, function.__name__

    def __call__(self, *args: Any) -> Any:
        raise TaiTypeError(f"method '{self.__name__}' is called in kernels and functions only")


class _Members:
    """Gives access to the members of struct values and of struct places."""

    type: StructType
    members: dict[str, Any]

    def member(self, name: str) -> Any:
        if name in self.members:
            return self.members[name]
        if name in self.type.methods:
            if not hasattr(self.type.methods[name], "_tai_func"):
                raise TaiTypeError(
                    f"method '{name}' of the struct is one for Python", "decorate it with @ti.func"
                )
            return StructMethod(self.type.methods[name], self)
        if name == "keys":
            return list(self.members)
        raise TaiNameError(
            f"the struct has no member '{name}'", did_you_mean(name, list(self.members))
        )


class StructValue(_Members):
    """A struct value without storage: made by a constructor, or read from an element."""

    def __init__(self, type_: StructType, members: dict[str, Any]):
        self.type, self.members = type_, members

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name in ("emit_operand", "is_matrix"):
            raise AttributeError(name)
        return self.member(name)

    def leaves(self) -> Iterator[Value]:
        """Yields the numbers and matrices of a struct value, in the order of the members."""
        for value in self.members.values():
            if isinstance(value, StructValue):
                yield from value.leaves()
            else:
                yield value


class StructPlace(_Members, Place):
    """A struct whose members can be assigned to: a variable, or an element of a struct field."""

    dt: Any = None
    shape = ()

    def __init__(self, emitter: Any, type_: StructType, members: dict[str, Place]):
        self.emitter, self.type, self.members = emitter, type_, members

    def load(self) -> StructValue:
        return StructValue(self.type, {k: m.load() for k, m in self.members.items()})

    def convert(self, value: Any) -> StructValue:
        if not isinstance(value, StructValue) or set(value.members) != set(self.members):
            got = repr(value.type) if isinstance(value, StructValue) else "something else"
            raise TaiTypeError(f"expects a {self.type!r}, but got {got}")
        members = self.members.items()
        return StructValue(self.type, {k: m.convert(value.members[k]) for k, m in members})

    def store(self, value: StructValue) -> None:
        for name, place in self.members.items():
            place.store(value.members[name])


class Reference(Bound):
    """A name that refers to an element or a component, which was passed to a template parameter."""

    def store(self, value: Any) -> None:
        self.thing.store(self.thing.convert(value))


class StructVariable(Reference):
    """A local variable that holds a struct: a variable for each member."""

    def __init__(self, emitter: Any, name: str, value: StructValue):
        super().__init__(_variable_place(emitter, name, value))


def _variable_place(emitter: Any, name: str, value: StructValue) -> StructPlace:
    members: dict[str, Place] = {}
    for key, member in value.members.items():
        inner = f"{name}_{key}"
        if isinstance(member, StructValue):
            members[key] = _variable_place(emitter, inner, member)
        else:
            members[key] = VariablePlace(emitter, Variable(inner, member))
    return StructPlace(emitter, value.type, members)


def make_value(emitter: Any, type_: StructType, given: dict[str, Any]) -> StructValue:
    """Makes a struct value of these members, each converted to its type."""
    members = {}
    for name, kind in type_.members.items():
        value = given[name]
        if isinstance(kind, StructType):
            if not isinstance(value, StructValue):
                value = kind(value) if isinstance(value, dict) else kind()
            members[name] = value
            continue
        if kind.shape and not hasattr(value, "emit_operand"):
            value = kind(value)
        members[name] = kind.convert(emitter, value)
    return StructValue(type_, members)


def as_struct_value(emitter: Any, thing: Struct | dict[str, Any]) -> StructValue:
    """A struct of Python, or one that a kernel makes by `ti.Struct(…)`, as a value of the kernel.

    Its members have the types of the given values.
    """
    members: dict[str, Any] = {}
    kinds: dict[str, Any] = {}
    for name, value in items_of(thing):
        if isinstance(value, (dict, Struct)):
            value = as_struct_value(emitter, value)
        elif not isinstance(value, StructValue):
            value = emitter.as_value(value)
        members[name] = value
        kinds[name] = value.type if isinstance(value, StructValue) else _type_of(value)
    return StructValue(StructType(kinds, getattr(thing, "methods", None)), members)


def _type_of(value: Value) -> Any:
    if not value.shape:
        return value.dt
    rows, *columns = value.shape
    return MatrixType(rows, columns[0] if columns else None, value.dt)


def variables_of(meaning: Any) -> Iterator[Variable]:
    """The local variables that a name stands for, or that are parts of its meaning.

    A template parameter may stand for a component of a vector, or for a member of a struct, and
    `self` stands for the struct that a method is called of.
    """
    if isinstance(meaning, Variable):
        yield meaning
    elif isinstance(meaning, Bound):
        yield from variables_of(meaning.thing)
    elif isinstance(meaning, VariablePlace):
        yield meaning.variable
    elif isinstance(meaning, StructPlace):
        for member in meaning.members.values():
            yield from variables_of(member)
    elif isinstance(meaning, (Component, SomeComponents)):
        yield from variables_of(meaning.base)


def changes_struct(type_: StructType, name: str, known: dict[tuple, bool]) -> bool:
    """Whether a method may change the struct on which it is called.

    Args:
        type_: the type of the struct.
        name: the name of the method.
        known: earlier results, by type and name.
    """
    if (type_, name) not in known:
        known[type_, name] = False  # which a method that calls itself adds nothing to
        known[type_, name] = _changes_struct(type_, name, known)
    return known[type_, name]


def _changes_struct(type_: StructType, name: str, known: dict[tuple, bool]) -> bool:
    info = getattr(type_.methods.get(name), "_tai_func", None)
    if info is None:
        return False
    method = info.function
    tree = function_ast(method)
    if not tree.args.args:
        return False
    own = tree.args.args[0].arg
    space = {**vars(builtins), **method.__globals__, **closure_of(method)}

    def method_of(call: ast.Call) -> tuple[Any, str]:
        """The type of this struct, or of a member of it, whose method is called."""
        root, *path = dotted(call.func) or [""]
        kind: Any = type_ if root == own and path else None
        for member in path[:-1]:
            kind = kind.members.get(member) if isinstance(kind, StructType) else None
        return (kind, path[-1]) if isinstance(kind, StructType) else (None, "")

    def gives_reference(call: ast.Call) -> bool:
        kind, name = method_of(call)
        if kind is not None:
            return takes_reference(kind.methods.get(name))
        root, *path = dotted(call.func) or [""]
        if root not in space:
            # A parameter or a variable: of a vector, or of a struct that is known at the call.
            return not (path and hasattr(Matrix, path[-1]))
        callee = space[root]
        for attribute in path:
            callee = getattr(callee, attribute, None)
        return takes_reference(callee)

    def changes_receiver(call: ast.Call) -> bool:
        kind, name = method_of(call)
        return kind is not None and changes_struct(kind, name, known)

    collector = AssignedNames(gives_reference, changes_receiver, lambda call: True, {})
    return own in collector.collect(tree.body)


def struct_element(emitter: Any, field: StructField, key: Any) -> StructPlace:
    """Returns the element of a struct field that a subscript names."""
    members: dict[str, Place] = {}
    for name, member in field.members.items():
        if isinstance(member, StructField):
            members[name] = struct_element(emitter, member, key)
        else:
            members[name] = field_element(emitter, member, key)
    return StructPlace(emitter, field.struct_type, members)
