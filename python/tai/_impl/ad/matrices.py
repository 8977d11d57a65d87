"""Matrices of derivatives: Jacobians and Hessians, whole, sparse by colours, or as operators.

A product with a Jacobian is a run in forward mode, and one with its transpose is a reverse sweep.
Each run begins with the fields as they were at the call, so the function may work in place.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ...errors import TaiAutodiffError, TaiRuntimeTypeError
from ..base.program import get_program
from ..base.scipy import get_scipy
from ..fields.field import Field
from ..fields.root import materialize
from .forward import as_function, hessian_product, run_forward
from .mode import caller_names
from .seeds import as_float_field, require_grad
from .snapshot import Snapshot
from .tape import Tape

Function = Callable[[], Any]


def _as_fields(value: Any, what: str) -> list[Field]:
    fields = list(value) if isinstance(value, (list, tuple)) else [value]
    for field in fields:
        as_float_field(field, what[:-1])
    if not fields:
        raise TaiRuntimeTypeError(f"{what} are an empty list", "name at least one field")
    if len({id(field) for field in fields}) < len(fields):
        raise TaiRuntimeTypeError(f"{what} name a field twice")
    return fields


def _shape(field: Any) -> tuple[int, ...]:
    return tuple(field.shape) + tuple(field.element_shape)


class _Numbers:
    """The numbers of several fields as one vector, one field after the other."""

    def __init__(self, fields: Sequence[Any]):
        self.fields = fields
        self.shapes = [_shape(field) for field in fields]
        self.ends = np.cumsum([math.prod(shape) for shape in self.shapes])
        self.size = int(self.ends[-1])
        self.bits = min(field.dtype.bits for field in fields)

    def split(self, vector: np.ndarray) -> list[np.ndarray]:
        parts = np.split(vector, self.ends[:-1])
        return [part.reshape(shape) for part, shape in zip(parts, self.shapes, strict=True)]

    def join(self, arrays: Sequence[np.ndarray]) -> np.ndarray:
        return np.concatenate([np.asarray(array, np.float64).ravel() for array in arrays])


class _Products:
    """Computes products with the Jacobian of a program; the fields have their initial values before
    each product.
    """

    def __init__(self, function: Function, inputs: Any, outputs: Any):
        self.function = as_function(function)
        self.columns = _Numbers(_as_fields(inputs, "the inputs"))
        self.rows = _Numbers(_as_fields(outputs, "the outputs"))
        self.bits = min(self.rows.bits, self.columns.bits)
        materialize(get_program(), caller_names())
        self._start: Snapshot | None = None
        self._tape: Tape | None = None

    def __enter__(self) -> _Products:
        self._start = Snapshot()
        return self

    def __exit__(self, *error: Any) -> None:
        if self._start is not None:
            self._start.restore()
        self._tape = None

    def has_forward(self) -> bool:
        fields = [*self.columns.fields, *self.rows.fields]
        return all(getattr(field.dual, "snode", None) is not None for field in fields)

    def has_reverse(self) -> bool:
        fields = [*self.columns.fields, *self.rows.fields]
        return all(getattr(field.grad, "snode", None) is not None for field in fields)

    def forward(self, direction: np.ndarray) -> np.ndarray:
        """J · direction."""
        assert self._start is not None
        self._start.restore(only_primal=True)
        pairs = list(zip(self.columns.fields, self.columns.split(direction), strict=True))
        return self.rows.join(run_forward(self.function, pairs, self.rows.fields))

    def reverse(self, weights: np.ndarray) -> np.ndarray:
        """Jᵀ · weights."""
        seeds = self.rows.split(weights)
        if self._tape is None:
            assert self._start is not None
            for field in [*self.columns.fields, *self.rows.fields]:
                require_grad(field, None)
            self._start.restore(only_primal=True)
            with Tape() as self._tape:
                self.function()
        self._tape.backward(dict(zip(self.rows.fields, seeds, strict=True)))
        return self.columns.join([field.grad.to_numpy() for field in self.columns.fields])


def vjp(function: Function, inputs: Any, outputs: Any, weights: Any) -> Any:
    """A product of the transposed Jacobian matrix and a vector, by one reverse sweep.

    ```python
    gradient = ti.ad.vjp(simulate, x, y, weights)
    ```

    Args:
        function: launches the kernels that compute the outputs.
        inputs: a field, or a list of fields, with gradients.
        outputs: a field, or a list of fields, with gradients. They keep their first values.
        weights: for each output an array of shape `shape + element_shape`.

    Returns:
        The derivative of the weighted sum of the outputs by the inputs, an array of shape
        `shape + element_shape`, or a list of these for a list of inputs.

    Raises:
        TaiAutodiffError: a field has no gradient, or something has no derivative.
        TaiRuntimeTypeError: weights of the wrong shape, or something that is no field.
    """
    as_function(function)
    columns = _as_fields(inputs, "the inputs")
    rows = _as_fields(outputs, "the outputs")
    is_list = isinstance(outputs, (list, tuple))
    materialize(get_program(), caller_names())
    given = list(weights) if is_list else [weights]
    if len(given) != len(rows):
        raise TaiRuntimeTypeError(
            f"there are {len(rows)} outputs and {len(given)} arrays of weights"
        )
    for field in [*columns, *rows]:
        require_grad(field, None)
    with Tape() as tape:
        function()
    tape.backward(dict(zip(rows, given, strict=True)))
    found = [field.grad.to_numpy() for field in columns]
    return found if isinstance(inputs, (list, tuple)) else found[0]


def _as_pattern(pattern: Any, rows: int, columns: int) -> Any:
    sparse, _ = get_scipy("patterns need")
    try:
        found = sparse.csc_array(pattern, dtype=bool)
    except (TypeError, ValueError):
        raise TaiRuntimeTypeError(
            f"the pattern is a sparse matrix or an array of bools, but got {type(pattern).__name__}"
        ) from None
    if found.shape != (rows, columns):
        raise TaiRuntimeTypeError(
            f"the pattern has shape {found.shape}, but there are {rows} outputs and {columns} "
            "inputs, counted in numbers"
        )
    found.eliminate_zeros()
    return found


def _colour(pattern: Any) -> np.ndarray:
    """Gives each column of a sparsity pattern a colour, so that two columns of one colour have no
    row in common.

    The largest columns get theirs first, and each the least that is free.
    """
    by_row = pattern.tocsr()
    colours = np.full(pattern.shape[1], -1)
    for column in np.argsort(-np.diff(pattern.indptr), kind="stable"):
        rows = pattern.indices[pattern.indptr[column] : pattern.indptr[column + 1]]
        near = [by_row.indices[by_row.indptr[row] : by_row.indptr[row + 1]] for row in rows]
        used = np.unique(colours[np.concatenate(near)]) if near else np.empty(0, int)
        used = used[used >= 0]
        free = np.flatnonzero(used != np.arange(len(used)))
        colours[column] = free[0] if len(free) else len(used)
    return colours


def _compress(
    pattern: Any, colours: np.ndarray, product: Callable[[np.ndarray], np.ndarray], what: str,
    bits: int,
) -> Any:  # fmt: skip
    """Computes a sparse matrix whose pattern is known, by one product for each colour of its
    columns, and one more product to check the result.

    Args:
        what: a row is a number of this: "output".
        bits: the width of the narrowest field in a product.
    """
    sparse, _ = get_scipy()
    rows, columns = pattern.tocoo().coords
    values = np.zeros(len(rows))
    of_entry = colours[columns]
    for colour in range(int(colours.max(initial=-1)) + 1):
        column = product((colours == colour).astype(np.float64))
        entries = of_entry == colour
        values[entries] = column[rows[entries]]
    found = sparse.csr_array((values, (rows, columns)), shape=pattern.shape)
    _check_pattern(found, product, what, bits)
    return found


def _check_pattern(
    matrix: Any, product: Callable[[np.ndarray], np.ndarray], what: str, bits: int
) -> None:
    """Compares a product with a random vector: it differs if the matrix has entries outside of the
    pattern, which were then added to other entries.

    Raises:
        TaiAutodiffError: they differ by more than rounding.
    """
    direction = np.random.default_rng(7).uniform(0.5, 1.5, matrix.shape[1])
    expected, found = product(direction), matrix @ direction
    size = np.maximum(abs(matrix) @ direction, np.abs(expected))
    # The tolerance is wide, since rounding may cost many digits within a program, and parts of the
    # program may be in f32.
    tolerance = {16: 0.1, 32: 1e-3}.get(bits, 1e-5)
    off = np.abs(expected - found) > tolerance * size
    if off.any():
        row = int(np.argmax(off))
        raise TaiAutodiffError(
            f"the pattern lacks an entry of {what} {row}: a product with all inputs is "
            f"{expected[row]:.6g}, and that of the matrix with this pattern {found[row]:.6g}",
            "let the pattern have each entry that may be nonzero, or leave it out",
        )


def _choose(products: _Products, mode: str | None, forward: int, reverse: int) -> bool:
    """Whether the matrix is computed from products of forward mode, not of reverse mode.

    Args:
        forward, reverse: the numbers of products that the modes need.

    Raises:
        TaiAutodiffError: fields have neither duals nor gradients, or not those of the mode.
    """
    if mode not in (None, "forward", "reverse"):
        raise TaiRuntimeTypeError(f"mode is 'forward', 'reverse' or None, but got {mode!r}")
    has_forward, has_reverse = products.has_forward(), products.has_reverse()
    if not (has_forward if mode == "forward" else has_reverse if mode else True):
        what = "dual" if mode == "forward" else "gradient"
        raise TaiAutodiffError(
            f"mode='{mode}' needs the {what}s of all inputs and outputs",
            f"make the fields with needs_{what[:4]}=True",
        )
    if not has_forward and not has_reverse:
        raise TaiAutodiffError(
            "the inputs and outputs have neither duals nor gradients throughout",
            "make them with needs_dual=True, for forward mode, or with needs_grad=True",
        )
    if mode is not None:
        return mode == "forward"
    return has_forward and (not has_reverse or forward <= reverse)


def _blocks(
    matrix: np.ndarray, rows: _Numbers, columns: _Numbers, outputs: Any, inputs: Any
) -> Any:
    """Divides a whole matrix into arrays with the shapes of the fields."""
    found = []
    for strip, row_shape in zip(np.split(matrix, rows.ends[:-1]), rows.shapes, strict=True):
        parts = np.split(strip, columns.ends[:-1], axis=1)
        blocks = [p.reshape(row_shape + s) for p, s in zip(parts, columns.shapes, strict=True)]
        found.append(blocks if isinstance(inputs, (list, tuple)) else blocks[0])
    return found if isinstance(outputs, (list, tuple)) else found[0]


def jacobian(
    function: Function, inputs: Any, outputs: Any, pattern: Any = None, mode: str | None = None
) -> Any:
    """Computes the Jacobian matrix of a program.

    ```python
    J = ti.ad.jacobian(simulate, x, y)  # J[i, j] is the derivative of y[i] by x[j]
    band = scipy.sparse.diags_array([1, 1, 1], offsets=[-1, 0, 1], shape=(n, n))
    J = ti.ad.jacobian(simulate, x, y, pattern=band)  # four products, for any n
    ```

    Without a pattern there is one run in forward mode for each number of the inputs, or one
    reverse sweep for each number of the outputs. With one, columns (or rows) that share no row
    (or column) have one colour, and there is one product for each colour and one more. Each run
    begins with the fields as they are at the call, and they are put back at the end.

    Args:
        function: launches the kernels that compute the outputs; it may work in place.
        inputs: a field, or a list of fields.
        outputs: a field, or a list of fields.
        pattern: where entries may be nonzero: a SciPy sparse matrix, or an array of bools, of
            shape (numbers of the outputs, numbers of the inputs). One product more checks that
            it lacks no entry.
        mode: "forward" needs duals, "reverse" gradients, of all inputs and outputs. Without it,
            the one with fewer products is taken among those that the fields allow.

    Returns:
        An array of shape `outputs' shape + inputs' shape`, element shapes included; nested
        lists of these for lists. With a pattern, a `scipy.sparse.csr_array` whose rows and
        columns count the numbers of all outputs and inputs in order.

    Raises:
        TaiAutodiffError: fields without duals and gradients, something has no derivative, or an
            entry is nonzero outside of the pattern.
        TaiRuntimeTypeError: something that is no field, or a pattern of another shape.
    """
    products = _Products(function, inputs, outputs)
    rows, columns = products.rows, products.columns
    if pattern is not None:
        where = _as_pattern(pattern, rows.size, columns.size)
        across = _colour(where)
        down = _colour(where.T.tocsc())
        counts = int(across.max(initial=-1)) + 1, int(down.max(initial=-1)) + 1
        with products:
            if _choose(products, mode, *counts):
                return _compress(where, across, products.forward, "output", products.bits)
            back = _compress(where.T.tocsc(), down, products.reverse, "input", products.bits)
            return back.T.tocsr()
    matrix = np.empty((rows.size, columns.size))
    with products:
        if _choose(products, mode, columns.size, rows.size):
            for j, unit in enumerate(np.eye(columns.size)):
                matrix[:, j] = products.forward(unit)
        else:
            for i, unit in enumerate(np.eye(rows.size)):
                matrix[i] = products.reverse(unit)
    return _blocks(matrix, rows, columns, outputs, inputs)


class _HessianProducts:
    """Computes products with the Hessian of a loss; the fields have their initial values before
    each product.
    """

    def __init__(self, function: Function, loss: Any, inputs: Any):
        self.function, self.loss = as_function(function, or_tape=True), loss
        self.numbers = _Numbers(_as_fields(inputs, "the inputs"))
        materialize(get_program(), caller_names())

    def __enter__(self) -> _HessianProducts:
        self._start = Snapshot()
        return self

    def __exit__(self, *error: Any) -> None:
        self._start.restore()

    def product(self, direction: np.ndarray) -> np.ndarray:
        self._start.restore(only_primal=True)
        pairs = list(zip(self.numbers.fields, self.numbers.split(direction), strict=True))
        return self.numbers.join(hessian_product(self.function, self.loss, pairs))


def hessian(function: Function, loss: Any, inputs: Any, pattern: Any = None) -> Any:
    """The Hessian matrix of a loss, by products of forward over reverse mode.

    ```python
    H = ti.ad.hessian(compute_loss, loss, x)
    ```

    Args:
        function: launches the kernels that compute the loss.
        loss: a field without dimensions that has a gradient and a dual.
        inputs: a field, or a list of fields, with gradients and duals.
        pattern: as for `jacobian`, square: one product for each colour, and one.

    Returns:
        As `jacobian`: an array of shape `inputs' shape + inputs' shape`, nested lists for a
        list, or a `scipy.sparse.csr_array`. It is symmetric up to rounding.

    Raises:
        TaiAutodiffError: a field lacks a gradient or a dual, or something has no rule.
        TaiRuntimeTypeError: something that is no field, or a pattern of another shape.
    """
    products = _HessianProducts(function, loss, inputs)
    numbers = products.numbers
    if pattern is not None:
        where = _as_pattern(pattern, numbers.size, numbers.size)
        with products:
            bits = numbers.bits
            return _compress(where, _colour(where), products.product, "input", bits)
    matrix = np.empty((numbers.size, numbers.size))
    with products:
        for j, unit in enumerate(np.eye(numbers.size)):
            matrix[:, j] = products.product(unit)
    return _blocks(matrix, numbers, numbers, inputs, inputs)


def _as_operator(
    products: _Products | _HessianProducts, shape: tuple[int, int],
    forward: Callable[[np.ndarray], np.ndarray], reverse: Callable[[np.ndarray], np.ndarray],
) -> Any:  # fmt: skip
    """Makes a linear operator of SciPy. Each product restores the values that the fields had before
    it.
    """
    _, linalg = get_scipy("operators need")

    def kept(product: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
        def apply(vector: np.ndarray) -> np.ndarray:
            with products:
                return product(np.asarray(vector, np.float64).ravel())

        return apply

    return linalg.LinearOperator(
        shape, matvec=kept(forward), rmatvec=kept(reverse), dtype=np.float64
    )


def jacobian_operator(function: Function, inputs: Any, outputs: Any) -> Any:
    """The Jacobian matrix as an operator of SciPy, for its iterative solvers.

    `operator @ v` is a run in forward mode, which needs duals; `operator.T @ w` is a reverse
    sweep, which needs gradients. Each begins with the values that the fields have then.

    Args:
        function, inputs, outputs: as for `jacobian`.

    Returns:
        A `scipy.sparse.linalg.LinearOperator` of shape (numbers of the outputs, numbers of the
        inputs). Vectors hold the numbers of all fields in order.

    Raises:
        TaiRuntimeTypeError: something that is no field.
    """
    products = _Products(function, inputs, outputs)
    shape = (products.rows.size, products.columns.size)
    return _as_operator(products, shape, products.forward, products.reverse)


def hessian_operator(function: Function, loss: Any, inputs: Any) -> Any:
    """The Hessian matrix of a loss as an operator of SciPy, for its iterative solvers.

    Args:
        function, loss, inputs: as for `hessian`.

    Returns:
        A symmetric `scipy.sparse.linalg.LinearOperator`; vectors hold the numbers of all
        inputs in order.

    Raises:
        TaiRuntimeTypeError: something that is no field.
    """
    products = _HessianProducts(function, loss, inputs)
    shape = (products.numbers.size, products.numbers.size)
    return _as_operator(products, shape, products.product, products.product)
