"""Structs: fields of named members, and the types and values that go with them."""

from __future__ import annotations

import functools
import inspect
import sys
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from ...errors import TaiRuntimeTypeError, TaiTypeError
from ..base import dtypes, fitting, state
from ..base.keywords import CELL_OPERATIONS, check_keywords, missing_attribute
from ..base.program import get_program
from ..values.matrix import Matrix
from ..values.types import MatrixType, NdarrayType, ScalarType
from . import pickled
from .field import Field, index_tuple
from .make import make_field
from .root import open_root
from .shapes import to_order, to_shape
from .snode import Layout, Place, SNode


class StructType:
    """A type with named members: `ti.types.struct(pos=vec3, mass=ti.f32)`.

    Called, it makes a value; `P.field(shape=n)` makes a field. Members are number types, vector
    and matrix types, and struct types.
    """

    # A mark by which fields and matrices recognise a struct type, since they cannot import its
    # class.
    _is_struct_type = True

    # The name of the class that it was made of, as in Python.
    __name__: str
    __qualname__: str

    def __init__(self, members: dict[str, Any], methods: dict[str, Any] | None = None):
        if not members:
            raise TaiRuntimeTypeError("a struct type has at least one member")
        self.members: dict[str, Any] = {}
        self.methods = dict(methods or {})
        for name, kind in members.items():
            if isinstance(kind, dict):
                kind = StructType(kind)
            elif not isinstance(kind, (MatrixType, ScalarType, StructType)):
                if dtypes.to_dtype(kind) is None:
                    raise TaiRuntimeTypeError(
                        f"member '{name}' of a struct has a type {kind!r}, which is none of numbers"
                    )
                kind = ScalarType(kind)
            self.members[name] = kind

    def __setattr__(self, name: str, value: Any) -> None:
        """Sets an attribute of the type; a function becomes a method of its structs."""
        if not inspect.isfunction(value):
            object.__setattr__(self, name, value)
            return
        former = getattr(self.methods.get(name), "_tai_func", None)
        self.methods[name] = value
        if former is not None:
            former.drop_users()

    def __getattr__(self, name: str) -> Any:
        """A method of a struct type, called by the name of the type: `Base.step(self)` in a method
        of a struct that derives from `Base`.
        """
        if name in vars(self).get("methods", ()):
            method = self.methods[name]
            return _OfReceiver(method) if hasattr(method, "_tai_func") else method
        known = [*self.methods, *vars(self), *dir(type(self))] if "methods" in vars(self) else []
        raise missing_attribute(f"the struct type has no attribute '{name}'", name, known)

    def __mro_entries__(self, bases: tuple) -> tuple[type]:
        """Called for a Python class that derives from this struct type: a stand-in class becomes
        its base; see `dataclass`.
        """
        return (self._stand_in,)

    @functools.cached_property
    def _stand_in(self) -> type:
        name = vars(self).get("__name__", "struct")
        return type(name, (_StandIn,), {"_tai_struct": self})

    def __reduce__(self) -> Any:
        name, home = vars(self).get("__qualname__", ""), vars(self).get("__module__", "")
        found: Any = sys.modules.get(home)
        for part in name.split("."):
            found = getattr(found, part, None)
        # A struct type is pickled by name, as classes are, because the functions that are its
        # methods cannot be pickled alone.
        return name if found is self else (StructType, (self.members, self.methods))

    def adopt(self, other: StructType) -> None:
        """Takes over the methods of the struct type that a reloaded module defines under the same
        name.
        """
        self.methods.clear()
        self.methods.update(other.methods)

    def bind(self, args: tuple, kwargs: dict) -> dict[str, Any]:
        """The values of the members from the arguments of a constructor; a member that is not given
        is zero.
        """
        if len(args) == 1 and not kwargs and isinstance(args[0], (dict, Struct)):
            kwargs = dict(items_of(args[0]))
            args = ()
        if len(args) > len(self.members):
            raise TaiTypeError(f"{self!r} has {len(self.members)} members, but got {len(args)}")
        given = dict(zip(self.members, args, strict=False))
        for name, value in kwargs.items():
            if name not in self.members or name in given:
                why = "twice" if name in given else "of that name"
                raise TaiTypeError(
                    f"{self!r} cannot take a member '{name}' {why}",
                    f"its members are {', '.join(self.members)}",
                )
            given[name] = value
        return {name: given.get(name, 0) for name in self.members}

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        given = self.bind(args, kwargs)
        if state.emitter is not None:
            return state.emitter.make_struct(self, given)
        entries = {}
        for name, kind in self.members.items():
            value = given[name]
            if isinstance(kind, StructType):
                value = kind(value) if isinstance(value, (dict, Struct)) else kind()
            elif isinstance(kind, MatrixType):
                value = kind(value)
            else:
                value = fitting.stored(value, kind.dtype, f"member '{name}'")
                value = kind.dtype.numpy.type(value).item()
            entries[name] = value
        return self.value_of(entries)

    def value_of(self, entries: dict[str, Any]) -> Struct:
        """Makes a struct in Python from members that already have their types."""
        made = Struct(entries, self.methods)
        object.__setattr__(made, "_type", self)
        return made

    def field(self, shape: Any = None, layout: Any = Layout.AOS, **options: Any) -> StructField:
        """Makes a field of such structs; for the arguments see `ti.field`."""
        return make_struct_field(self, shape, layout, **options)

    def __repr__(self) -> str:
        members = (
            f"{name}={kind.dtype if isinstance(kind, ScalarType) else kind!r}"
            for name, kind in self.members.items()
        )
        return f"struct({', '.join(members)})"


class ArgPackType(StructType):
    """The type of arguments that go to kernels together: `ti.types.argpack(dt=ti.f32, x=…)`.

    A struct type whose members may be arrays, too: `ti.types.ndarray()`.
    """

    def __init__(self, members: dict[str, Any]):
        arrays = {name: kind for name, kind in members.items() if _is_array_type(kind)}
        numbers = {name: kind for name, kind in members.items() if name not in arrays}
        if numbers or not arrays:
            super().__init__(numbers)
        else:
            self.methods = {}
            self.members = {}
        kinds = {name: kind() if isinstance(kind, type) else kind for name, kind in arrays.items()}
        self.members = {name: kinds.get(name, self.members.get(name)) for name in members}
        self._arrays = set(arrays)

    def __reduce__(self) -> Any:
        return ArgPackType, (self.members,)

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        given = self.bind(args, kwargs)
        missing = [name for name in self._arrays if isinstance(given[name], int)]
        if missing:
            raise TaiTypeError(f"{self!r} needs an array for its member '{missing[0]}'")
        numbers = {k: kind for k, kind in self.members.items() if k not in self._arrays}
        entries = {name: given[name] for name in self._arrays}
        if numbers:
            entries.update(StructType(numbers)(**{k: given[k] for k in numbers}).entries)
        return self.value_of({name: entries[name] for name in self.members})

    def field(self, shape: Any = None, layout: Any = Layout.AOS, **options: Any) -> StructField:
        if self._arrays:
            raise TaiTypeError("a pack of arguments with arrays in it is no element of a field")
        return super().field(shape, layout, **options)


def _is_array_type(kind: Any) -> bool:
    return isinstance(kind, NdarrayType) or kind is NdarrayType


class _OfReceiver:
    """A method that is called by the name of its type, with the struct as an argument."""

    def __init__(self, method: Any):
        self._tai_func, self._method = method._tai_func.of_receiver(), method
        self.__name__ = method.__name__

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        return self._method(*args, **kwargs)


class _StandIn:
    """A Python class that represents a struct type when another class derives from the struct
    type.
    """

    _tai_struct: StructType

    def __new__(cls, *args: Any, **members: Any) -> Any:
        raise TaiTypeError(
            f"class '{cls.__name__}' derives from a struct type, and is none itself",
            "decorate it with @ti.dataclass",
        )


def _method(struct: Struct, name: str, problem: str) -> Any:
    """Finds a method of the class from which a struct type was made.

    Raises:
        AttributeError: it has none of that name, as `problem` says.
    """
    if name not in struct.methods:
        raise missing_attribute(
            problem, name, [*struct.entries, *struct.methods, *dir(type(struct))]
        )
    return struct.methods[name].__get__(struct)


class Struct:
    """A struct in Python: `ti.Struct(a=1, b=ti.Vector([1.0, 2.0]))`, with members as attributes."""

    # The name of the attribute by which template arguments of this class are compared.
    _tai_content = "_content"

    def __init__(self, entries: dict[str, Any] | None = None, methods: Any = None, **more: Any):
        object.__setattr__(self, "entries", {**(entries or {}), **more})
        object.__setattr__(self, "methods", dict(methods or {}))

    # The struct type that made this struct, or None.
    _type: StructType | None = None

    def __reduce__(self) -> Any:
        if self._type is None:
            return Struct, (dict(self.entries), self.methods)
        return StructType.value_of, (self._type, dict(self.entries))

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name == "entries":  # of one that is being copied
            raise AttributeError(name)
        try:
            return self.entries[name]
        except KeyError:
            return _method(self, name, f"the struct has no member '{name}'")

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in self.entries:
            raise missing_attribute(f"the struct has no member '{name}'", name, self.entries)
        self.entries[name] = value

    def __getitem__(self, name: str) -> Any:
        return self.entries[name]

    def __setitem__(self, name: str, value: Any) -> None:
        self.entries[name] = value

    @property
    def _content(self) -> tuple[dict, dict]:
        return self.entries, self.methods

    @property
    def keys(self) -> list[str]:
        return list(self.entries)

    @property
    def items(self) -> Any:
        return self.entries.items()

    def to_dict(self) -> dict[str, Any]:
        return {
            name: value.to_dict() if isinstance(value, Struct) else (
                value.to_list() if isinstance(value, Matrix) else value)
            for name, value in self.entries.items()
        }  # fmt: skip

    def __repr__(self) -> str:
        return repr(self.to_dict())

    @staticmethod
    def field(
        members: dict[str, Any], shape: Any = None, layout: Any = Layout.AOS, **options: Any
    ) -> StructField:
        """Makes a field of structs; `members` gives each member its type."""
        return make_struct_field(StructType(members), shape, layout, **options)


def items_of(struct: Any) -> Any:
    """The names and values of the members of a struct, or of a dictionary that stands for one."""
    return struct.entries.items() if isinstance(struct, Struct) else struct.items()


def leaves_of(field: StructField) -> Iterator[Field]:
    """Yields the fields of numbers, vectors and matrices in a struct field, in order."""
    for member in field.members.values():
        if isinstance(member, StructField):
            yield from leaves_of(member)
        else:
            yield member


def first_of(field: StructField) -> Field:
    """Returns the first field in a struct field, which has the shape of all members."""
    return next(leaves_of(field))


def parts_of(field: Field) -> list:
    """The storage places of a field: of a struct field, the places of all members; of a vector
    field, a place for each separate component.
    """
    if isinstance(field, StructField):
        return [part for leaf in leaves_of(field) for part in parts_of(leaf)]
    return list(getattr(field, "parts", [field]))


def _or_member(name: str, own: Callable[[StructField], Any]) -> Any:
    """Gets an attribute of a struct field; if a member has the same name, the member goes first, as
    in Taichi.
    """
    return property(
        lambda self: self.members[name] if name in self.members else own(self), doc=own.__doc__
    )


class StructField(Field):
    """A field of structs: a field for each member, side by side in the same cells.

    A member may have the name of an attribute that programs seldom ask a field for (`level`,
    `parent`, `type`, …), and hides it then. So the package asks for these by functions, or the
    first leaf.

    Attributes:
        members: the fields by name; `f.pos` is `f.members["pos"]`.
    """

    # Names of methods that a member of the same name may hide.
    _YIELDING = ("copy_from", "fill", "parent")

    def __init__(self, type_: StructType, members: dict[str, Field], role: str = "primal"):
        self.struct_type, self.members, self.role = type_, members, role
        self.element_shape, self.primal = (), None
        self._name, self._place = None, None
        self.__dict__.update({k: m for k, m in members.items() if k in self._YIELDING})
        taken = [
            name for name in members
            if hasattr(StructField, name) and name not in self._YIELDING
            and name not in self._OR_MEMBER
        ]  # fmt: skip
        if taken:
            raise TaiRuntimeTypeError(
                f"a struct field has an attribute '{taken[0]}' of its own",
                "give the member another name",
            )

    def __reduce_ex__(self, protocol: Any) -> Any:
        if self.primal is not None:
            return pickled.companion_of, (self.primal, self.role)
        return StructField, (self.struct_type, self.members)

    def __getattr__(self, name: str) -> Any:
        members = self.__dict__.get("members", {})
        if name in members:
            return members[name]
        text = f"field '{self.name}' has no member '{name}'"
        if name in CELL_OPERATIONS:
            raise AttributeError(f"{text}\n  hint: {CELL_OPERATIONS[name]}", name=name)
        raise missing_attribute(text, name, [*members, *dir(self)])

    @property
    def keys(self) -> list[str]:
        return list(self.members)

    def get_member_field(self, key: str) -> Field:
        """Returns the field of one member."""
        return self.members[key]

    # Names of attributes that a member of the same name may hide.
    _OR_MEMBER = {
        "name": lambda self: super().name,
        "level": lambda self: first_of(self).level,
        "offset": lambda self: first_of(self).offset,
        "type": lambda self: self.struct_type,
        "grad": lambda self: self._companion("grad"),
        "dual": lambda self: self._companion("dual"),
    }
    name, level, offset, type, grad, dual = (_or_member(*row) for row in _OR_MEMBER.items())

    @property
    def snode(self) -> Place | None:
        return first_of(self).snode

    def _placed_node(self) -> SNode:
        level = first_of(self).level
        return super()._placed_node() if level is None else level

    def storage(self) -> Any:
        return first_of(self).storage()

    def suggest_name(self, name: str) -> None:
        super().suggest_name(name)
        for key, member in self.members.items():
            member.suggest_name(f"{name}_{key}")

    def _companion(self, which: str) -> StructField | None:
        companions = {k: m._companion(which) for k, m in self.members.items()}
        found = {k: m for k, m in companions.items() if m is not None}
        if not found:
            return None
        made = StructField(self.struct_type, found, which)
        made.primal = self
        return made

    def put_into(self, node: SNode, offset: Any = None) -> None:
        for member in self.members.values():
            member.put_into(node, offset)

    def materialize(self, frame: Any = None) -> None:
        """Allocates the tree that holds the field."""
        self._placed_node()
        for leaf in leaves_of(self):
            leaf.materialize(frame)

    def __getitem__(self, key: Any) -> ElementOfStruct:
        self._placed_node()
        return ElementOfStruct(self, index_tuple(key))

    def __setitem__(self, key: Any, value: Any) -> None:
        if not isinstance(value, (dict, Struct)):
            raise TaiRuntimeTypeError(
                f"an element of field '{self.name}' is a struct, not {value!r}",
                f"{self.struct_type!r}(…)",
            )
        entries = dict(items_of(value))
        self._check_members(entries)
        for name, member in entries.items():
            self.members[name][key] = member

    def _check_members(self, names: Any) -> None:
        """Raises an error for a name that is no member of the struct."""
        for name in names:
            if name not in self.members:
                raise TaiRuntimeTypeError(
                    f"field '{self.name}' has no member {name!r}",
                    f"its members are {', '.join(self.members)}",
                )

    def to_numpy(self, dtype: Any = None) -> dict[str, Any]:  # type: ignore[override]
        """Returns a copy as a dictionary of arrays."""
        return {name: member.to_numpy(dtype=dtype) for name, member in self.members.items()}

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        """A copy as a structured array, whose members have the names of those of the struct."""
        if copy is False:
            raise ValueError("np.asarray of a field of structs makes a copy")
        members = {name: np.asarray(member) for name, member in self.members.items()}
        shape = first_of(self).shape
        kinds = [(name, a.dtype, a.shape[len(shape) :]) for name, a in members.items()]
        made = np.empty(shape, kinds)
        for name, array in members.items():
            made[name] = array
        return made if dtype is None else made.astype(dtype)

    def from_numpy(self, arrays: dict[str, Any]) -> None:
        """Copies a dictionary of arrays, or a structured array, into the members that it names."""
        if isinstance(arrays, np.ndarray) and arrays.dtype.names is not None:
            arrays = {name: arrays[name] for name in arrays.dtype.names}
        self._check_arrays(arrays)
        for name, array in arrays.items():
            self.members[name].from_numpy(array)

    def to_torch(self, device: Any = None) -> dict[str, Any]:
        return {name: member.to_torch(device=device) for name, member in self.members.items()}

    def _check_arrays(self, arrays: Any) -> None:
        """Raises an error for anything but a dictionary with arrays of members."""
        if not isinstance(arrays, Mapping):
            raise TaiRuntimeTypeError(
                f"field '{self.name}' takes a dictionary of arrays, not {type(arrays).__name__}",
                "{" + ", ".join(f"{name!r}: …" for name in self.members) + "}",
            )
        self._check_members(arrays)

    def from_torch(self, tensors: dict[str, Any]) -> None:
        self._check_arrays(tensors)
        for name, tensor in tensors.items():
            self.members[name].from_torch(tensor)

    def fill(self, value: Any) -> None:
        for member in self.members.values():
            member.fill(value)

    def copy_from(self, other: Field) -> None:
        if not isinstance(other, StructField) or set(other.members) != set(self.members):
            raise TaiRuntimeTypeError("copy_from expects a struct field with the same members")
        for name, member in self.members.items():
            member.copy_from(other.members[name])

    def _repr_html_(self) -> str:
        """Shows the fields of all members in a notebook."""
        return "<br>".join(member._repr_html_() for member in self.members.values())

    def __str__(self) -> str:
        unplaced = first_of(self).level is None
        return f"<field '{self.name}', not placed>" if unplaced else str(self.to_numpy())

    def __repr__(self) -> str:
        place = "not placed" if first_of(self).level is None else f"shape {self.shape}"
        return f"<field '{self.name}' of {self.struct_type!r}, {place}>"


class ElementOfStruct(Struct):
    """An element of a struct field: its members are read from the field and written to it."""

    def __init__(self, field: StructField, key: tuple):
        object.__setattr__(self, "_field", field)
        object.__setattr__(self, "_key", key)
        object.__setattr__(self, "methods", field.struct_type.methods)

    @property
    def entries(self) -> dict[str, Any]:
        return {name: member[self._key] for name, member in self._field.members.items()}

    def __getattr__(self, name: str) -> Any:
        if name not in self._field.members:
            return _method(self, name, f"field '{self._field.name}' has no member '{name}'")
        return self._field.members[name][self._key]

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in self._field.members:
            text = f"field '{self._field.name}' has no member '{name}'"
            raise missing_attribute(text, name, self._field.members)
        self._field.members[name][self._key] = value

    __getitem__, __setitem__ = __getattr__, __setattr__

    def __reduce__(self) -> Any:
        return self._field.struct_type(self.to_dict()).__reduce__()  # as it is now

    def to_dict(self) -> dict[str, Any]:
        return {
            name: value.to_dict() if isinstance(value, Struct) else np.asarray(value).tolist()
            for name, value in self.items
        }


def make_struct_field(
    type_: StructType, shape: Any, layout: Any, name: str | None = None, offset: Any = None,
    needs_grad: bool = False, needs_dual: bool = False, order: str | None = None,
) -> StructField:  # fmt: skip
    """Implements `.field` of structs; without a shape the members are placed by hand."""

    def struct_of(kind: StructType) -> StructField:
        return StructField(kind, {k: bare(m) for k, m in kind.members.items()})

    def bare(kind: Any) -> Field:
        if isinstance(kind, StructType):
            return struct_of(kind)
        shaped = kind.shape
        made = make_field(shaped, kind.dtype, None, None, None, None, False, False)
        made.needs_grad, made.needs_dual = (
            flag and made.dtype.is_float for flag in (needs_grad, needs_dual)
        )
        return made

    made = struct_of(type_)
    if name:
        made.suggest_name(name)
    if shape is None:
        if offset is not None or order is not None:
            raise TaiRuntimeTypeError("offset and order need a shape")
        return made
    program, extents = get_program(), to_shape(shape)
    with program.layout:
        root = open_root(program)
        axes = to_order(order, len(extents))
        sizes = tuple(extents[a] for a in axes)
        node = root.dense(axes, sizes) if extents else root
        for leaf in leaves_of(made):
            if layout == Layout.SOA and extents:
                node = root.dense(axes, sizes)
            node.place(leaf, offset=offset)
            for which, wanted in (("grad", leaf.needs_grad), ("dual", leaf.needs_dual)):
                if wanted:
                    node.place(getattr(leaf, which), offset=offset)
    return made


def dataclass(cls: type) -> StructType:
    """A struct type with the annotations of a class as members, and its methods.

    Methods that are `@ti.func` are for kernels, the others for Python. Members and methods of the
    classes and struct types that the class derives from come first.
    """
    methods: dict[str, Any] = {}
    members: dict[str, Any] = {}
    for base in reversed(cls.__mro__[:-1]):
        struct = vars(base).get("_tai_struct")
        if struct is not None:
            members.update(struct.members)
            methods.update(struct.methods)
            continue
        if base is _StandIn:
            continue
        own = inspect.get_annotations(base)
        if any(isinstance(kind, str) for kind in own.values()):
            own = inspect.get_annotations(base, eval_str=True)
        members.update(own)
        methods.update((name, f) for name, f in vars(base).items() if inspect.isfunction(f))
    made = StructType(members, methods)
    made.__name__, made.__qualname__ = cls.__name__, cls.__qualname__
    made.__module__, made.__doc__ = cls.__module__, cls.__doc__
    return made


check_keywords(globals(), ["StructField", "StructType"], attributes=False)
