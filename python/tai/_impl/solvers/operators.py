"""A user's kernel as a function from a field to a field, and its derivative."""

from __future__ import annotations

import weakref
from typing import Any

from ...errors import TaiAutodiffError, TaiRuntimeTypeError, shorten
from ..ad.mode import suspended
from ..ad.seeds import parts_of
from ..ad.snapshot import Snapshot
from ..ad.sparse import sparse_level
from ..base import state
from ..base.program import at_close, get_program
from ..fields.field import Field
from ..fields.make import make_field
from ..launch.bound_kernel import BoundKernel
from ..launch.kernels import Kernel
from ..tracking import tracked
from .vectors import get_kernels

# Scratch fields of the solvers, by thread, role, type and shape, while the program lasts.
_scratch: dict[tuple, Any] = {}
_WITH_DUALS = {"image", "unknown", "solution_tangent", "adjoint_tangent"}
at_close.append(_scratch.clear)


def check_unknown(field: Any, what: str, solver: str) -> None:
    """Raises an error for a field that a solver cannot take as its unknown.

    Raises:
        TaiRuntimeTypeError: no field, not of f32 or f64, sparse, or one vector alone.
    """
    if not isinstance(field, Field):
        raise TaiRuntimeTypeError(f"{solver} takes a field for {what}, but got {field!r}")
    if field.dtype.name not in ("f32", "f64"):
        raise TaiRuntimeTypeError(
            f"{solver}: field '{field.name}' is of type {field.dtype}",
            "solvers work on fields of f32 and f64",
        )
    placed: Any = field
    placed.materialize()
    if sparse_level(parts_of(field)[0][0]) is not None:
        raise TaiRuntimeTypeError(
            f"{solver}: field '{field.name}' is sparse",
            "solvers work on dense fields",
        )
    if field.shape == () and field.element_shape:
        raise TaiRuntimeTypeError(
            f"{solver}: field '{field.name}' has no dimensions", "make it with shape=1"
        )


def check_alike(field: Any, other: Any, solver: str) -> None:
    """Refuses two fields that do not have the same elements, or are one."""
    if field is other:
        raise TaiRuntimeTypeError(f"{solver}: field '{field.name}' is given twice")
    for what in ("shape", "element_shape", "dtype"):
        own, wanted = getattr(field, what), getattr(other, what)
        if own != wanted:
            kind = "type" if what == "dtype" else what.replace("_", " ")
            raise TaiRuntimeTypeError(
                f"{solver}: field '{field.name}' has {kind} {own}, but field '{other.name}' has "
                f"{wanted}"
            )
    if _offset(field) != _offset(other):
        raise TaiRuntimeTypeError(
            f"{solver}: indices of field '{field.name}' start at {_offset(field)}, those of "
            f"field '{other.name}' at {_offset(other)}"
        )


def _offset(field: Any) -> tuple[int, ...]:
    return tuple(getattr(field, "offset", ()) or (0,) * len(field.shape))


def scratch(like: Any, role: str, rows: int = 0, columns: int = 0) -> Any:
    """A scratch field with the elements of another field, for the solvers of this thread.

    Scratch fields whose role is `image` have a gradient, and some have a dual. With `rows`, it
    holds that many times the elements, by an index in front of theirs; with `columns`, that many
    rows and one column more of numbers in the place of each element.
    """
    get_program()
    offset, shape, element = _offset(like), like.shape, like.element_shape
    key = (state.thread, role, like.dtype.name, shape, element, offset, rows, columns)
    if key not in _scratch:
        if rows:
            offset, shape = (0, *offset), (rows, *shape)
        if columns:
            offset, shape = (*offset, 0, 0), (*shape, columns, columns + 1)
            element = ()
        made: Any = make_field(
            element, like.dtype, shape, None, f"solver_{role}",
            offset if any(offset) else None, role == "image", role in _WITH_DUALS,
        )  # fmt: skip
        made.materialize()
        _scratch[key] = made
    return _scratch[key]


class Operator:
    """A kernel that computes one field from another one, `kernel(x, y, *args)`.

    Attributes:
        name, place: of the kernel, and where it is defined.
        x: the unknown.
        image: where the kernel writes in reverse and forward: a field of the solvers.
    """

    def __init__(self, solver: str, kernel: Any, x: Any, args: tuple):
        if isinstance(kernel, BoundKernel):
            self._kernel: Any = kernel._kernel
            self._first: tuple = (kernel._instance,)
        elif isinstance(kernel, Kernel):
            self._kernel, self._first = kernel, ()
        else:
            raise TaiRuntimeTypeError(
                f"{solver} takes a kernel, but got {kernel!r}",
                "@ti.kernel def f(x: ti.template(), y: ti.template()): computes field y from x",
            )
        if not isinstance(args, tuple):
            raise TaiRuntimeTypeError(f"{solver}: args must be a tuple, but got {args!r}")
        self.name = self._kernel.__name__
        code = self._kernel._function.__code__
        self.place = f"{shorten(code.co_filename)}:{code.co_firstlineno}"
        self.solver, self.x, self.args = solver, x, args
        # Arguments that the tape follows are constants in all launches except the one that the tape
        # records.
        self._plain = tuple(float(a) if tracked.gradient_of(a) is not None and isinstance(a, float)
                            else a for a in args)  # fmt: skip
        self.image = scratch(x, "image")
        self._accumulates = False
        self._check()

    def _places(self, source: Any, target: Any, args: tuple) -> Any:
        values = self._kernel._get_signature().bind((*self._first, source, target, *args), {})
        return self._kernel._specialize(values)

    def _check(self) -> None:
        """Refuses kernels that are no functions from their first field to their second."""
        found = self._places(self.x, self.image, self._plain)
        source, target = _parts(self.x), _parts(self.image)
        written = set(found.stored) | set(found.accumulated)
        called = f"{self.solver}: kernel '{self.name}' ({self.place})"
        if source & written:
            raise TaiRuntimeTypeError(
                f"{called} writes to its first field, '{self.x.name}'",
                f"it must compute its second field from the first: {self.name}(x, y)",
            )
        if not target & written:
            raise TaiRuntimeTypeError(
                f"{called} does not write to its second field",
                f"it must compute its second field from the first: {self.name}(x, y)",
            )
        if not source & set(found.fields):
            raise TaiRuntimeTypeError(
                f"{called} does not read its first field",
                f"it must compute its second field from the first: {self.name}(x, y)",
            )
        self._accumulates = not target & set(found.stored)

    def check_differentiable(self) -> None:
        """Refuses arguments of the operator through which the adjoint of a solution cannot pass.

        Raises:
            TaiAutodiffError: the unknown, or an array, has the wrong kind of gradient.
        """
        grad = self.x.grad
        if grad is None or grad.snode is None:
            raise TaiAutodiffError(
                f"{self.solver}: field '{self.x.name}' has no gradient, so none passes through "
                "the solution",
                "make it with needs_grad=True, or call the solver in a function under "
                "ti.ad.no_grad",
            )
        for value in self.args:
            if isinstance(value, Field):
                continue
            if getattr(value, "grad", None) is not None and hasattr(value, "__array__"):
                raise TaiAutodiffError(
                    f"{self.solver}: an array with a gradient is given to kernel '{self.name}'",
                    "keep it in a field",
                )

    def apply(self, source: Any, target: Any) -> None:
        """target = f(source)."""
        self._run(self._kernel, source, target, self._plain)

    def record(self) -> None:
        """Launches both forms of the kernel at the solution, for a tape to record.

        In reverse, the first restores the values that the adjoint solve reads; the other adds to
        the gradients of all parameters.
        """
        self._run(self._linear(), self.x, self.image, self._plain)
        self._run(self._kernel, self.x, self.image, self.args)

    def pull(self) -> None:
        """Adds Jᵀ image.grad to x.grad at the present x; sets the gradient of the image to zero."""
        self._linear().grad(*self._first, self.x, self.image, *self._plain)
        self.image.grad.fill(0)

    def pull_tangent(self, adjoint: Any) -> None:
        """Computes x.grad.dual, the tangent of Jᵀ adjoint by all that the kernel reads; in forward
        mode. Their gradients stay as they are.

        Raises:
            TaiAutodiffError: one of them is sparse.
        """
        found = self._places(self.x, self.image, self._plain)
        kept = []
        for place in found.fields:
            if place in _parts(self.x) or place in _parts(self.image):
                continue
            for grad in _gradients_of(place):
                if sparse_level(grad) is not None:
                    raise TaiAutodiffError(
                        f"{self.solver} has no second derivative: kernel '{self.name}' "
                        f"({self.place}) reads field '{place.name}', which is sparse",
                        "make it dense",
                    )
                kept.append((grad, Snapshot._take(grad)))
        kernels = get_kernels()
        with suspended():
            self.x.grad.fill(0)
            self.x.grad.dual.fill(0)
        kernels.copy(self.image.grad, adjoint)
        self._kernel.grad(*self._first, self.x, self.image, *self._plain)
        with suspended():
            self.image.grad.fill(0)
            self.image.grad.dual.fill(0)
        for grad, array in kept:
            grad.core.copy_from(array)

    def push(self, source: Any) -> None:
        """Computes image.dual = J source.dual in forward mode, at the present `source`."""
        self._run(self._linear(), source, self.image, self._plain)

    def push_parameters(self, source: Any) -> None:
        """Computes image.dual, the tangent of all fields that the kernel reads; in forward mode."""
        self._run(self._kernel, source, self.image, self.args)

    def _run(self, kernel: Any, source: Any, target: Any, args: tuple) -> None:
        if self._accumulates:
            target.fill(0)
        kernel(*self._first, source, target, *args)

    def _linear(self) -> Kernel:
        """The kernel with all that it reads and does not write as a constant, but its first
        field: so its gradient is that by this field alone."""
        made = getattr(self._kernel, "_linearized", None)
        if made is None:
            base = weakref.ref(self._kernel)
            skipped = len(self._first)
            made = Kernel(self._kernel._function, self._kernel._is_method)

            def find_constants(values: list[Any]) -> set[Any]:
                kernel = base()
                assert kernel is not None
                found = kernel._specialize(values)
                changed = set(found.stored) | set(found.accumulated) | _parts(values[skipped])
                return {place for place in set(found.fields) - changed if place.dtype.is_float}

            made._specializations.find_constants = find_constants
            self._kernel._linearized = made
        return made


def _gradients_of(place: Any) -> list[Any]:
    """The gradient of a field, and the tangents of the gradient, as far as they are in memory."""
    grad = place._companions.get("grad")
    if grad is None or grad.snode is None:
        return []
    dual = grad._companions.get("dual")
    return [grad] if dual is None or dual.snode is None else [grad, dual]


def _parts(field: Any) -> set[Any]:
    return {part for part, _ in parts_of(field)}
