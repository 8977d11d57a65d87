"""The MLIR operations that the front end emits, a method each.

Nothing else contains names of operations and attributes, or the order of operands. Operands and
results are handles of the extension module: typed SSA values of the module that is built.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from ..base import native

# Handles of the extension module. They have no classes here: it is loaded when it is needed.
Handle = Any
Type = Any
Region = Any
Block = Any

# For each comparison of ordered floats or integers, the number of its predicate in `arith.cmpf` and
# `arith.cmpi`.
ORDERED = {"==": 1, ">": 2, ">=": 3, "<": 4, "<=": 5, "!=": 6}
UNORDERED = {"==": 8, ">": 9, ">=": 10, "<": 11, "<=": 12, "!=": 13}
IS_NAN = 14
SIGNED = {"==": 0, "!=": 1, "<": 2, "<=": 3, ">": 4, ">=": 5}
UNSIGNED = {"==": 0, "!=": 1, "<": 6, "<=": 7, ">": 8, ">=": 9}

# `TAI_FAIL_INDEX` of the ABI.
FAIL_INDEX = 2

# In `static_position`, the number that stands for an index which is an operand.
_DYNAMIC = -(2**63)

# The combinations of `memref.atomic_rmw`, by their numbers.
_ARRAY_ATOMICS = {
    "addf": 0, "addi": 1, "andi": 2, "assign": 3, "maximumf": 4, "maxnumf": 5, "maxs": 6, "maxu": 7,
    "minimumf": 8, "minnumf": 9, "mins": 10, "minu": 11, "mulf": 12, "muli": 13, "ori": 14,
    "xori": 15,
}  # fmt: skip


class Builder:
    """Appends operations where it stands, with the location that was set last.

    Args:
        context: the program's context.
        filename: the source file of the kernel.

    Attributes:
        filename: the source file of the kernel.
    """

    def __init__(self, context: Any, filename: str):
        made = native.Builder(context, filename)
        self.filename = filename
        self._op, self._attribute, self._string = made.op, made.attribute, made.string
        # Types by their text, and constants at the start of a block.
        self.type, self.constant = made.type, made.constant
        # Places.
        self.region, self.block = made.region, made.block
        self.set_block, self.get_block = made.set_block, made.get_block
        self.op_names, self.splice = made.op_names, made.splice
        self.set_file, self.set_location = made.set_file, made.set_location
        self.enter_module = made.enter_module
        # The module.
        self.text, self.verify, self.finish = made.text, made.verify, made.finish

    # Attributes

    def _symbol(self, name: str) -> Any:
        return self._attribute(f"@{name}")

    def _number(self, number: int) -> Any:
        return self._attribute(f"{number} : i64")

    def _sizes(self, *sizes: int) -> Any:
        """Makes the attribute with the number of operands in each group of an op."""
        return self._attribute(f"array<i32: {', '.join(map(str, sizes))}>")

    def _position(self, position: Sequence[int]) -> dict[str, Any]:
        text = ", ".join(map(str, position))
        return {"static_position": self._attribute(f"array<i64: {text}>")}

    # Arithmetic

    def apply(self, name: str, operands: Sequence[Handle], type_: Type) -> Handle:
        """Appends an operation of the dialects `arith` or `math` that has operands, one result and
        no attributes.
        """
        return self._op(name, operands, [type_])

    def compare_floats(self, predicate: int, a: Handle, b: Handle, type_: Type) -> Handle:
        """Compares two floats by a predicate, such as `ORDERED["<"]`; the result is of type
        `type_`.
        """
        return self._op("arith.cmpf", [a, b], [type_], {"predicate": self._number(predicate)})

    def compare_integers(self, predicate: int, a: Handle, b: Handle, type_: Type) -> Handle:
        """Compares two integers by a predicate, such as `SIGNED["<"]`."""
        return self._op("arith.cmpi", [a, b], [type_], {"predicate": self._number(predicate)})

    def select(self, condition: Handle, a: Handle, b: Handle, type_: Type) -> Handle:
        return self._op("arith.select", [condition, a, b], [type_])

    def from_elements(self, elements: Sequence[Handle], type_: Type) -> Handle:
        """Makes the vector or matrix of these components, row by row."""
        return self._op("vector.from_elements", elements, [type_])

    def extract(self, matrix: Handle, position: Sequence[int], type_: Type) -> Handle:
        """One component."""
        return self._op("vector.extract", [matrix], [type_], self._position(position))

    def insert(
        self, value: Handle, matrix: Handle, position: Sequence[int], type_: Type
    ) -> Handle:
        """Makes a copy of the matrix with one component replaced."""
        return self._op("vector.insert", [value, matrix], [type_], self._position(position))

    def extract_at(self, vector: Handle, index: Handle, type_: Type) -> Handle:
        """The component at an index that is known when the kernel runs, and in range."""
        return self._op("vector.extract", [vector, index], [type_], self._position([_DYNAMIC]))

    def insert_at(self, value: Handle, vector: Handle, index: Handle, type_: Type) -> Handle:
        """Makes a copy of the vector with the component at a run-time index replaced."""
        operands = [value, vector, index]
        return self._op("vector.insert", operands, [type_], self._position([_DYNAMIC]))

    def broadcast(self, value: Handle, type_: Type) -> Handle:
        """Makes the matrix all of whose components are the number."""
        return self._op("vector.broadcast", [value], [type_])

    # Vectors and matrices

    def dot(self, a: Handle, b: Handle, type_: Type) -> Handle:
        """Σ aᵢ bᵢ."""
        return self._op("tai.dot", [a, b], [type_])

    def cross(self, a: Handle, b: Handle, type_: Type) -> Handle:
        """Emits the cross product of 3-vectors."""
        return self._op("tai.cross", [a, b], [type_])

    def outer(self, a: Handle, b: Handle, type_: Type) -> Handle:
        """The matrix aᵢ bⱼ."""
        return self._op("tai.outer", [a, b], [type_])

    def matmul(self, a: Handle, b: Handle, type_: Type) -> Handle:
        """Emits the product of a matrix and a matrix or vector."""
        return self._op("tai.matmul", [a, b], [type_])

    def solve(self, a: Handle, b: Handle, type_: Type) -> Handle:
        """Emits the solution x of a x = b."""
        return self._op("tai.solve", [a, b], [type_])

    def transpose(self, a: Handle, type_: Type) -> Handle:
        """Rows for columns."""
        return self._op("tai.transpose", [a], [type_])

    def inverse(self, a: Handle, type_: Type) -> Handle:
        """The inverse matrix."""
        return self._op("tai.inverse", [a], [type_])

    def determinant(self, a: Handle, type_: Type) -> Handle:
        """The determinant."""
        return self._op("tai.determinant", [a], [type_])

    def trace(self, a: Handle, type_: Type) -> Handle:
        """Emits the sum of the diagonal of a matrix."""
        return self._op("tai.trace", [a], [type_])

    def sum(self, a: Handle, type_: Type) -> Handle:
        """Emits the sum of all components of a matrix."""
        return self._op("tai.sum", [a], [type_])

    def stop_gradient(self, a: Handle, type_: Type) -> Handle:
        """Emits a number or matrix that gradients take for a constant."""
        return self._op("tai.stop_gradient", [a], [type_])

    def norm(self, vector: Handle, type_: Type, fast: bool) -> Handle:
        """The norm; `fast`: it may over- or underflow where the squares do."""
        attributes = {"fast": self._attribute("unit")} if fast else None
        return self._op("tai.norm", [vector], [type_], attributes)

    def decompose(self, name: str, matrix: Handle, types: Sequence[Type]) -> Sequence[Handle]:
        """Emits the factors of a matrix: `polar`, `svd` or `sym_eig`."""
        return self._op(f"tai.{name}", [matrix], types)

    def random(self, stream: int, type_: Type) -> Handle:
        """A random number; each operation of a kernel has a stream of its own."""
        return self._op("tai.random", [], [type_], {"stream": self._number(stream)})

    # Branches and loops

    def condition_of_while(self, go_on: Handle, carried: Sequence[Handle]) -> None:
        """Ends the condition region of an `scf.while`."""
        self._op("scf.condition", [go_on, *carried], [])

    def yield_(self, values: Sequence[Handle] = ()) -> None:
        """Ends a branch, or the body of a loop that carries values."""
        self._op("scf.yield", values, [])

    def if_(
        self, condition: Handle, types: Sequence[Type], then: Region, orelse: Region
    ) -> Any:
        """Emits a branch; returns nothing, one handle, or one handle for each type."""
        return self._op("scf.if", [condition], types, None, [then, orelse])

    def for_(
        self, begin: Handle, end: Handle, step: Handle, carried: Sequence[Handle],
        types: Sequence[Type], body: Region,
    ) -> Any:  # fmt: skip
        return self._op("scf.for", [begin, end, step, *carried], types, None, [body])

    def while_(
        self, carried: Sequence[Handle], types: Sequence[Type], before: Region, after: Region
    ) -> Any:
        return self._op("scf.while", carried, types, None, [before, after])

    def parallel_for(
        self, body: Region, lower: Sequence[Handle] = (), upper: Sequence[Handle] = (),
        field: str | None = None, level: int | None = None, is_serial: bool = False,
        block_dim: int = 0, halo: int | None = None,
    ) -> None:  # fmt: skip
        """Appends a parallel loop over a box of indices, over the elements of a field, or over the
        cells of a level.

        Args:
            body: takes an index for each dimension.
            lower, upper: bounds of a box.
            field: symbol of the field, in place of bounds.
            level: how many levels above the field the cells are.
            is_serial: whether iterations run one after the other, in order.
            block_dim: threads of a block on a GPU; 0 for any.
            halo: rows beyond those of a rank among which data may choose, -1 for all rows.
        """
        attributes = {"operandSegmentSizes": self._sizes(len(lower), len(upper))}
        if field is not None:
            attributes["field"] = self._symbol(field)
        if level is not None:
            attributes["level"] = self._number(level)
        if is_serial:
            attributes["serialize"] = self._attribute("unit")
        if block_dim:
            attributes["block_dim"] = self._number(block_dim)
        if halo is not None:
            attributes["tai_mesh.halo"] = self._number(halo)
        self._op("tai.parallel_for", [*lower, *upper], [], attributes, [body])

    def end_of_parallel_for(self) -> None:
        self._op("tai.yield", [], [])

    # Fields: a symbol, an index for each dimension, and for a component one for each of the element

    def load(
        self, field: str, indices: Sequence[Handle], component: Sequence[Handle], type_: Type
    ) -> Handle:
        """Emits a load of an element of a field, or of a component of it."""
        return self._op(
            "tai.load",
            [*indices, *component],
            [type_],
            {
                "field": self._symbol(field),
                "operandSegmentSizes": self._sizes(len(indices), len(component)),
            },
        )

    def store(
        self, field: str, value: Handle, indices: Sequence[Handle], component: Sequence[Handle]
    ) -> None:
        """Emits a store to an element of a field, or to a component of it."""
        self._op(
            "tai.store",
            [value, *indices, *component],
            [],
            {
                "field": self._symbol(field),
                "operandSegmentSizes": self._sizes(1, len(indices), len(component)),
            },
        )

    def atomic(
        self, kind: str, field: str, value: Handle, indices: Sequence[Handle],
        component: Sequence[Handle], type_: Type,
    ) -> Handle:  # fmt: skip
        """Combines an element of a field with a value (`add`, `min`, …); returns the former
        value.
        """
        return self._op(
            "tai.atomic",
            [value, *indices, *component],
            [type_],
            {
                "kind": self._attribute(f"#tai<atomic_kind {kind}>"),
                "field": self._symbol(field),
                "operandSegmentSizes": self._sizes(1, len(indices), len(component)),
            },
        )

    # Operations on sparse levels. A level is named by a field below it and by how many levels above
    # the field it is.

    def _cell(
        self, name: str, field: str, level: int, indices: Sequence[Handle], types: list[Type]
    ) -> Handle:
        attributes = {"field": self._symbol(field), "level": self._number(level)}
        return self._op(name, indices, types, attributes)

    def activate(self, field: str, level: int, indices: Sequence[Handle]) -> None:
        """Activates a cell; its values are zero if it was inactive."""
        self._cell("tai.activate", field, level, indices, [])

    def deactivate(self, field: str, level: int, indices: Sequence[Handle]) -> None:
        """Emits the deactivation of a cell, or of all cells of a list."""
        self._cell("tai.deactivate", field, level, indices, [])

    def is_active(self, field: str, level: int, indices: Sequence[Handle]) -> Handle:
        """Emits the test whether a cell is active, as an `i1`."""
        return self._cell("tai.is_active", field, level, indices, [self.type("i1")])

    def append(self, field: str, value: Handle, indices: Sequence[Handle]) -> Handle:
        """Appends a cell to the list of a field; returns its index."""
        attributes = {"field": self._symbol(field)}
        return self._op("tai.append", [value, *indices], [self.type("index")], attributes)

    def length(self, field: str, indices: Sequence[Handle]) -> Handle:
        """Emits the number of cells of a list, as an index."""
        attributes = {"field": self._symbol(field)}
        return self._op("tai.length", indices, [self.type("index")], attributes)

    # Arrays of the caller

    def extent(self, array: Handle, dimension: Handle) -> Handle:
        """Emits the length of an array along a dimension, as an index."""
        return self._op("memref.dim", [array, dimension], [self.type("index")])

    def load_from_array(self, array: Handle, indices: Sequence[Handle], type_: Type) -> Handle:
        return self._op("memref.load", [array, *indices], [type_])

    def store_to_array(self, value: Handle, array: Handle, indices: Sequence[Handle]) -> None:
        self._op("memref.store", [value, array, *indices], [])

    def atomic_in_array(
        self, kind: str, value: Handle, array: Handle, indices: Sequence[Handle], type_: Type
    ) -> Handle:
        """Combines an element of an array with a value (`addf`, `maxs`, …); returns the former
        value.
        """
        attributes = {"kind": self._number(_ARRAY_ATOMICS[kind])}
        return self._op("memref.atomic_rmw", [value, array, *indices], [type_], attributes)

    # Messages of kernels

    def assert_(
        self, condition: Handle, message: str, values: Iterable[Handle] = (),
        failure: int | None = None,
    ) -> None:  # fmt: skip
        """Appends an assertion that ends the program if the condition does not hold; `{}` in the
        message stand for the values.

        Args:
            failure: its kind, such as `FAIL_INDEX`. Others are for debug mode.
        """
        attributes = {"message": self._string(message)}
        if failure is not None:
            attributes["failure"] = self._attribute(f"{failure} : i32")
        self._op("tai.assert", [condition, *values], [], attributes)

    def print(self, format: str, values: Sequence[Handle], ends_line: bool = True) -> None:
        """Emits the printing of a text, in which `{}` stands for the values."""
        attributes = {"format": self._string(format)}
        if not ends_line:
            attributes["no_newline"] = self._attribute("unit")
        self._op("tai.print", values, [], attributes)

    # The kernel

    def return_(self, values: Sequence[Handle] = ()) -> None:
        """Ends the kernel."""
        self._op("tai.return", values, [])

    def kernel(
        self, symbol: str, arguments: Sequence[str], result: str | None, body: Region,
        gradients: Sequence[int] = (), conventions: dict[str, str] | None = None,
        modes: str = "", checks_updates: bool = False,
    ) -> None:  # fmt: skip
        """Makes the op of a kernel from a body that was built.

        Args:
            symbol: the name of the kernel in the module.
            arguments, result: types, as texts.
            gradients: the numbers of arguments by which it is differentiated besides fields; that
                of the result, if it is, comes after the last argument.
            conventions: the choices of gradients at kinks that differ from the default.
            modes: how it rounds, sums and approximates, where that is not the usual.
            checks_updates: whether it checks that iterations do not update one element in turn.
        """
        results = "()" if result is None else result
        attributes = {
            "sym_name": self._string(symbol),
            "function_type": self._attribute(f"({', '.join(arguments)}) -> {results}"),
        }
        if gradients:
            listed = ", ".join(map(str, gradients))
            attributes["gradients"] = self._attribute(f"array<i64: {listed}>")
        if conventions:
            chosen = ", ".join(f"{name} = {value}" for name, value in conventions.items())
            attributes["conventions"] = self._attribute("{" + chosen + "}")
        if modes:
            attributes["modes"] = self._attribute(modes)
        if checks_updates:
            attributes["tai.check_updates"] = self._attribute("unit")
        self._op("tai.kernel", [], [], attributes, [body])
