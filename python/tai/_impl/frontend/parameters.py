"""Parameters and results of a kernel."""

from __future__ import annotations

import ast
from typing import Any

from ...errors import TaiSyntaxError
from ..base import dtypes
from ..fields.structs import StructType
from ..fields.triplets import TripletsType
from .context import Context, Part
from .refs import ArrayArgument, FieldElement, Variable
from .scope import Bound
from .structs import StructValue
from .triplets import TripletsValue


class Parameters(Part):
    """The part of the compiler that handles the parameters and the result of a kernel.

    Attributes:
        types, names: of the arguments in IR.
        gradients: the numbers of those by which the kernel is differentiated; that of the result
            comes after the last one.
    """

    def __init__(self, context: Context):
        super().__init__(context)
        kernel = context.kernel
        keeps_result = kernel.result_field is not None
        self.types = [t for _, spec in kernel.parameters for t in spec.mlir_types]
        self.names = [n for name, spec in kernel.parameters for n in spec.names(name)]
        cells = len(kernel.followed) + keeps_result
        self.types += ["i32"] * cells
        self.names += ["cell"] * cells
        self.gradients: list[int] = []
        # The number of the first element of the pool in which forward mode keeps the result.
        self._result_cell: Any = None

    def define(self, block: Any) -> None:
        """Defines the parameters as names in the body of the kernel; the entry block has an
        argument for each type.
        """
        kernel, frame = self.context.kernel, self.frame
        position = 0
        handles: list[list[Any]] = []
        for name, spec in kernel.parameters:
            handles.append([block.argument(position + i) for i in range(len(spec.mlir_types))])
            if spec.has_gradient and spec.has_slot:
                self.gradients.append(position)
            position += len(spec.mlir_types)
            given = handles[-1] if spec.alias is None else handles[spec.alias]
            frame.define(name, self._argument(name, spec, given))
        for number, (name, field) in enumerate(kernel.followed):
            variable = frame.scopes[-1][name]
            assert isinstance(variable, Variable)
            self._load_cells(variable, field, block.argument(position + number))
        for name, type_ in kernel.structs.items():
            made = self._triplets if isinstance(type_, TripletsType) else self._struct
            frame.define(name, Bound(made(name, type_)))
        if kernel.result_field is not None:
            self._result_cell = block.argument(position + len(kernel.followed))
        if kernel.result is not None and kernel.result.has_gradient:
            self.gradients.append(len(self.types))

    def _triplets(self, name: str, type_: StructType) -> TripletsValue:
        arrays: dict[str, Any] = {}
        for key in type_.members:
            array = self.frame.scopes[-1][f"{name}.{key}"]
            assert isinstance(array, Bound)
            arrays[key] = array.thing
        return TripletsValue(self.emitter, name, arrays)

    def _struct(self, name: str, type_: StructType) -> StructValue:
        """Makes a struct of those parameters that are its members."""
        members: dict[str, Any] = {}
        for key, kind in type_.members.items():
            inner = f"{name}.{key}"
            if isinstance(kind, StructType):
                members[key] = self._struct(inner, kind)
            else:
                variable = self.frame.scopes[-1][inner]
                members[key] = variable.thing if isinstance(variable, Bound) else variable.value
        return StructValue(type_, members)

    def _argument(self, name: str, spec: Any, handles: list) -> Variable | Bound:
        """Returns the meaning of a parameter in the body of the kernel."""
        if spec.kind == "template":
            return Bound(spec.constant)
        if spec.kind == "array":
            array = ArrayArgument(self.emitter, name, handles, spec)
            worlds = self.emitter.worlds
            if worlds is not None and worlds.is_stacked(name) and worlds.sized_by is None:
                worlds.sized_by = handles[0]
            return Bound(array)
        value = self.emitter.value(handles[0], spec.dt, spec.shape)
        if not spec.shape and spec.dt.kind == "i":
            value.index = "cast"
        return Variable(name, value, "kernel argument")

    def _cell(self, field: Any, first: Any, number: int) -> FieldElement:
        """Returns an element of the field in which forward mode keeps numbers."""
        emitter = self.emitter
        at = emitter.binary("+", emitter.value(first, dtypes.i32), number)
        return FieldElement(emitter, field, [emitter.to_index(at)])

    def _load_cells(self, variable: Variable, field: Any, first: Any) -> None:
        """Loads the value of a parameter that forward mode has kept in its field."""
        emitter, given = self.emitter, variable.value
        count = 1
        for extent in given.shape:
            count *= extent
        parts = [emitter.cast(self._cell(field, first, i).load(), given.dt) for i in range(count)]
        variable.value = emitter.matrix(parts, given.dt, given.shape) if given.shape else parts[0]

    def store_cells(self, value: Any) -> None:
        """Stores the result of the kernel for forward mode, if forward mode follows it."""
        if self._result_cell is None:
            return
        for number, part in enumerate(value.scalars() if value.shape else [value]):
            place = self._cell(self.context.kernel.result_field, self._result_cell, number)
            place.store(self.emitter.cast(part, dtypes.f64))

    def check_kernel_result(self, value: Any) -> None:
        if value is None and self.context.kernel.result is not None:
            raise TaiSyntaxError("the kernel has a return type: return a value")
        if value is not None and self.context.kernel.result is None:
            raise TaiSyntaxError(
                "a kernel that returns a value needs a return type",
                f"def {self.frame.name}(…) -> {_annotation(value)}",
            )

    def return_from_kernel(self, value: Any, node: ast.Return) -> None:
        self.check_kernel_result(value)
        if value is None:
            self.builder.return_()
            return
        assert self.context.kernel.result is not None
        value = self.context.kernel.result.convert(self.emitter, value)
        self.at(node)
        self.store_cells(value)
        self.builder.return_([value.handle])


def _annotation(value: Any) -> str:
    """The return type to write for a value of a kernel, or of Python."""
    if isinstance(value, tuple | list):
        return f"tuple[{', '.join(map(_annotation, value))}]"
    if isinstance(value, bool | int):
        return "ti.i32"
    number = getattr(value, "dt", None)
    if not isinstance(number, dtypes.DataType):
        return "ti.f32"
    shape = ", ".join(map(str, value.shape))
    kind = {0: "", 1: "vector", 2: "matrix"}[len(value.shape)]
    return f"ti.types.{kind}({shape}, ti.{number})" if kind else f"ti.{number}"
