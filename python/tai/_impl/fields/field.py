"""The base class of fields: names, gradients, shape, copies."""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import TaiAutodiffError, TaiRuntimeError, TaiRuntimeTypeError, TaiTypeError
from ..base import dtypes, fitting, state
from ..base.elements import Elements
from ..base.keywords import CELL_OPERATIONS, MissingMethod
from . import copies
from .shareable import Shareable
from .snode import Place, SNode

if TYPE_CHECKING:
    from .scalar import ScalarField


# The greatest length of a list that is searched for a field.
_LONGEST = 1000


def _variable_of(field: Any) -> str | None:
    """Finds the variable of the program that holds a field, or the attribute of an object in a
    variable, or a list or dictionary in one of them, because no kernel may have named the field
    yet.
    """
    frame: Any = sys._getframe(1)
    while frame is not None and frame.f_globals.get("__name__", "").startswith("tai."):
        frame = frame.f_back
    if frame is None:
        return None
    variables = [frame.f_locals, frame.f_globals]
    objects = [
        vars(value) for names in variables for value in list(names.values())
        if hasattr(value, "__dict__") and not isinstance(value, (type, ModuleType, Elements))
    ]  # fmt: skip
    places = [
        (str(name), value) for names in (*variables, *objects)
        for name, value in list(names.items())
        if str(name).isidentifier() and not str(name).startswith("_")
    ]  # fmt: skip
    for name, value in places:
        if value is field:
            return name
    for name, value in places:
        if isinstance(value, (list, tuple, dict)) and len(value) <= _LONGEST:
            items = value.items() if isinstance(value, dict) else enumerate(value)
            for key, item in list(items):
                if item is field:
                    return f"{name}_{key}"
    return None


class Field(Elements, Shareable):
    """The base class of scalar, vector and matrix fields.

    Attributes:
        dtype: scalar type of the components.
        n, m: rows and columns of an element; 1 for a scalar, m is 1 for a vector.
        element_shape: `()`, `(n,)` or `(n, m)`.
        role: `primal`, `grad` or `dual`.
        level: the level that holds the field, or None before it is placed.
        offset: the first index along each dimension; () for zeros.
    """

    offset: Any
    # The `ti.batch` to which the field belongs, or None.
    batch: Any = None
    append, length, activate, deactivate, is_active = (
        MissingMethod(CELL_OPERATIONS[name])
        for name in ("append", "length", "activate", "deactivate", "is_active")
    )

    def __reduce_ex__(self, protocol: Any) -> Any:
        """A copied or unpickled field has the same type, levels and values, but its own memory."""
        describe = importlib.import_module("tai._impl.fields.pickled").describe
        return describe(self)

    def __init__(self, dtype: Any, element_shape: tuple[int, ...], name: str | None, role: str):
        resolved = dtypes.stored_as(dtype)
        if resolved is None:
            raise TaiRuntimeTypeError(
                f"a field holds numbers, not {dtype!r}", "use a type such as ti.f32 or ti.i32"
            )
        if name is not None and not isinstance(name, str):
            raise TaiRuntimeTypeError(f"the name of a field is text, not {name!r}", 'name="x"')
        self.dtype = resolved
        self.element_shape = element_shape
        self.role = role
        self.primal: Field | None = None
        self.needs_grad = self.needs_dual = False
        self._name = name
        self._companions: dict[str, Field] = {}
        self._place: Place | None = None

    # Names

    def suggest_name(self, name: str) -> None:
        """Takes the name of the variable that holds the field, if it has none yet."""
        if self._name is None:
            self._name = name

    @property
    def name(self) -> str:
        """The name of the field in messages: a variable that holds it, or its symbol."""
        if self.primal is not None:
            return f"{self.primal.name}.{self.role}"
        return self._name or _variable_of(self) or "field"

    def _described(self) -> str:
        return f"field '{self.name}'"

    def _shown_name(self) -> str:
        return self.name

    def _example(self) -> str:
        scalar = self.snode is None or not self.shape
        indices = "None" if scalar else ", ".join("ijklmnop"[: len(self.shape)])
        return f"{self.name}[{indices}]"

    # Companions

    def _companion(self, which: str) -> Field | None:
        # A gradient can have a dual field, the derivative of the gradient.
        nests = self.role == "primal" or (self.role == "grad" and which == "dual")
        if not self.dtype.is_float or not nests:
            return None
        if which not in self._companions:
            made = self._make_companion(which)
            made.primal = self
            self._companions[which] = made
        return self._companions[which]

    @property
    def grad(self) -> Any:
        """The field that accumulates the derivative of the loss, or None for integers."""
        return self._companion("grad")

    @property
    def dual(self) -> Any:
        """The field of tangents in forward mode, or None for a field of integers."""
        return self._companion("dual")

    def placed_grad(self) -> Any:
        """Returns the gradient of the field, which has a place in a layout.

        Raises:
            TaiAutodiffError: the field is of integers, is itself a gradient or a dual, or has no
                gradient.
        """
        grad = self.grad
        if grad is None and not self.dtype.is_float:
            raise TaiAutodiffError(f"field '{self.name}' is of type {self.dtype}, not a float")
        if grad is None:
            what = "gradient" if self.role == "grad" else "dual"
            raise TaiAutodiffError(
                f"'{self.name}' is a {what}, which has no gradient of its own",
                "name the field itself; ti.ad.hvp and ti.ad.hessian give second derivatives",
            )
        if grad.snode is None:
            grad._placed_node()  # raises
        return grad

    def _make_companion(self, which: str) -> Field:
        raise NotImplementedError

    # Shape

    @property
    def level(self) -> SNode | None:
        raise NotImplementedError

    @property
    def shape(self) -> tuple[int, ...]:
        """The extents, in the order of the axes i, j, k, …"""
        node = self._placed_node()
        return node.shape

    def _placed_node(self) -> SNode:
        if self.level is None:
            of = self.name if self.primal is None else self.primal.name
            if self.role in ("grad", "dual"):
                what = "gradient" if self.role == "grad" else "dual"
                first = f"make it with needs_{self.role}=True"
                if getattr(self.primal, f"needs_{self.role}", False):
                    # The place of the companion is not known, because the field was placed by hand.
                    first = f"place it too: level.place({of}, {of}.{self.role})"
                raise TaiAutodiffError(
                    f"field '{of}' has no {what}",
                    f"{first}, or call ti.root.lazy_{self.role}() after placing it",
                )
            raise TaiRuntimeError(
                f"field '{self.name}' is not placed",
                "give it a shape, or place it: ti.root.dense(ti.i, n).place(x)",
            )
        return self.level

    @property
    def snode(self) -> Place | None:
        """The storage place of the field below its level; None before the field is placed."""
        if self.level is None:
            return None
        if self._place is None:
            self._place = Place(self)
        return self._place

    def parent(self, n: int = 1) -> SNode | None:
        """Returns the level `n` levels above the field; for 0, the place of the field."""
        self._placed_node()
        place = self.snode
        assert place is not None
        return place.parent(n)

    @property
    def num_indices(self) -> int:
        return len(self.shape)

    def put_into(self, node: SNode, offset: Any = None) -> None:
        """Makes the field a place of the cells of `node`."""
        raise NotImplementedError

    def materialize(self, frame: Any = None) -> None:
        """Allocates the field, with all fields of its tree, unless that has been done."""
        raise NotImplementedError

    def storage(self) -> tuple[ScalarField, int]:
        """The field of numbers, vectors or matrices to which this storage belongs, and the
        component of that field.
        """
        raise NotImplementedError

    # Whole-field operations

    def to_numpy(self, dtype: Any = None) -> np.ndarray:
        """Returns a copy as an array of shape `shape + element_shape`."""
        raise NotImplementedError

    def from_numpy(self, array: Any) -> None:
        """Copies an array of shape `shape + element_shape` into the field."""
        raise NotImplementedError

    def __getitem__(self, key: Any) -> Any:
        raise NotImplementedError

    def __setitem__(self, key: Any, value: Any) -> None:
        raise NotImplementedError

    def fill(self, value: Any) -> None:
        """Sets all elements to `value`; of a sparse field, those that are active."""
        raise NotImplementedError

    def _check_array(self, array: Any) -> np.ndarray:
        array = fitting.unmasked(array)
        wanted = self.shape + self.element_shape
        if array.shape != wanted:
            raise TaiRuntimeTypeError(
                f"field '{self.name}' expects an array of shape {wanted}, but got {array.shape}"
            )
        return fitting.stored_array(array, self.dtype, self)

    def copy_from(self, other: Field) -> None:
        """Copies all elements of a field of the same shape; tapes and forward mode follow it."""
        if not isinstance(other, Field) or hasattr(other, "members"):
            raise TaiRuntimeTypeError(f"copy_from expects a field, but got {other!r}")
        if other is self:
            return
        if copies.is_followed(self, other):
            copies.copy_field(self, other)
        else:
            copies.check_shapes(self, other)
            self.from_numpy(other.to_numpy())

    def __str__(self) -> str:
        if self.level is None:
            return f"<field '{self.name}', not placed>"
        return str(self.to_numpy())

    def __repr__(self) -> str:
        kind = "field" if not self.element_shape else f"field of {self.element_shape}"
        place = "not placed" if self.level is None else f"shape {self.shape}"
        return f"<{self.dtype} {kind} '{self.name}', {place}>"

    def _repr_html_(self) -> str:
        """Shows the field in a notebook: its statistics, and a picture."""
        return importlib.import_module("tai._impl.fields.notebook").field_html(self)

    def __iter__(self) -> Any:
        name = self.name
        if state.emitter is not None:
            raise TaiTypeError(
                f"field '{name}' is no list: Python looks at it while the kernel is compiled",
                f"loop over its indices: for i in {name}",
            )
        raise TaiRuntimeTypeError(
            f"field '{name}' is no list of numbers in Python",
            f"loop over {name}.to_numpy(), or over {name} in a kernel",
        )

    def __bool__(self) -> bool:
        """True: a field is there, whatever its shape. Without this, its length would be asked."""
        return True

    def __len__(self) -> int:
        return self.shape[0]


def index_tuple(key: Any) -> tuple:
    if key is None:
        return ()
    if isinstance(key, tuple):
        return key
    if isinstance(key, np.ndarray) and key.ndim == 0:
        return (key.item(),)
    if isinstance(key, (list, np.ndarray)) or hasattr(key, "to_numpy"):
        return tuple(key)
    return (key,)
