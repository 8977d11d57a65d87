"""`ti.field`, and fields of vectors and matrices."""

from __future__ import annotations

from typing import Any

from ...errors import TaiAutodiffError, TaiRuntimeTypeError
from ..base import dtypes
from ..base.keywords import check_keywords, checked
from ..base.program import get_program
from ..values.matrix import Matrix, Vector, to_extent
from ..values.types import MatrixType
from .field import Field
from .matrix_field import MatrixField
from .root import open_root
from .scalar import ScalarField
from .shapes import to_order, to_shape
from .snode import Layout


def make_field(
    element_shape: tuple[int, ...],
    dtype: Any,
    shape: Any,
    order: str | None,
    name: str | None,
    offset: Any,
    needs_grad: bool,
    needs_dual: bool,
    layout: str = Layout.AOS,
) -> Field:
    """Makes a field, which is placed under `ti.root` if it has a shape."""
    if dtype is float and shape is not None and not to_shape(shape):
        # A field of one element keeps all digits, because it is a sum or a parameter of the
        # program.
        dtype = dtypes.default_fp()
    made: Any
    if element_shape:
        made = MatrixField(element_shape, dtype, name)
    else:
        made = ScalarField(dtype, name)
    if (needs_grad or needs_dual) and not made.dtype.is_float:
        raise TaiAutodiffError(
            f"a field of type {made.dtype} can have no gradient",
            "needs_grad=True goes with a float type such as ti.f32",
        )
    made.needs_grad, made.needs_dual = bool(needs_grad), bool(needs_dual)
    if shape is None:
        if offset is not None:
            raise TaiRuntimeTypeError("offset needs a shape", "or give it to place(x, offset=…)")
        if order is not None:
            raise TaiRuntimeTypeError("order needs a shape")
        return made
    shape = to_shape(shape)
    axes = to_order(order, len(shape))
    extents = tuple(shape[a] for a in axes)

    program = get_program()

    def put(field: Any) -> None:
        root = open_root(program)
        if layout == Layout.SOA and element_shape:
            for component in field.components:
                node = root.dense(axes, extents) if shape else root
                node.place(component, offset=offset)
        else:
            node = root.dense(axes, extents) if shape else root
            node.place(field, offset=offset)

    with program.layout:
        put(made)
        if needs_grad:
            put(made.grad)
        if needs_dual:
            put(made.dual)
    return made


def field(
    dtype: Any,
    shape: Any = None,
    order: str | None = None,
    name: str | None = "",
    offset: Any = None,
    needs_grad: bool = False,
    needs_dual: bool = False,
) -> Any:
    """Makes a field of numbers, or of vectors or matrices.

    Args:
        dtype: `ti.f32`, `ti.i32`, …, `int` or `float`, or a type such as `ti.math.vec3`, or a
            struct type.
        shape: extents; without it the field is placed by hand: `ti.root.dense(…).place(x)`.
        order: layout order of the axes, such as `"ji"`, slowest first.
        name: the name of the field in messages and IR.
        offset: the first index along each dimension.
        needs_grad, needs_dual: place a gradient, a tangent.
    """
    if hasattr(dtype, "_is_struct_type"):
        return dtype.field(
            shape, order=order, name=name or None, offset=offset, needs_grad=needs_grad,
            needs_dual=needs_dual,
        )  # fmt: skip
    element_shape: tuple[int, ...] = ()
    if isinstance(dtype, MatrixType):
        element_shape, dtype = dtype.shape, dtype.dtype
    return make_field(
        element_shape, dtype, shape, order, name or None, offset, needs_grad, needs_dual
    )


def _matrix_field(
    n: int, m: int, dtype: Any, shape: Any = None, order: str | None = None, name: str = "",
    offset: Any = None, needs_grad: bool = False, needs_dual: bool = False,
    layout: str = "aos", ndim: int | None = None,
) -> Any:  # fmt: skip
    """Makes a field of n×m matrices; for the other arguments see `ti.field`."""
    return make_field(
        (to_extent(n), to_extent(m)), dtype, shape, order, name or None, offset, needs_grad,
        needs_dual, layout,
    )  # fmt: skip


def _vector_field(
    n: int, dtype: Any, shape: Any = None, order: str | None = None, name: str = "",
    offset: Any = None, needs_grad: bool = False, needs_dual: bool = False,
    layout: str = "aos",
) -> Any:  # fmt: skip
    """A field of vectors of n components; for the other arguments see `ti.field`."""
    return make_field(
        (to_extent(n),), dtype, shape, order, name or None, offset, needs_grad, needs_dual,
        layout,
    )  # fmt: skip


# The class Matrix does not know fields, so its methods `field` are set here.
for _function, _class in ((_matrix_field, Matrix), (_vector_field, Vector)):
    _function.__name__ = "field"
    _function.__qualname__ = f"{_class.__name__}.field"
    _class.field = staticmethod(checked(_function))


check_keywords(globals(), ["field"])
