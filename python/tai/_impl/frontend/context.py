"""State shared by the parts of the compiler: the kernel, its scopes, and the insertion point."""

from __future__ import annotations

import ast
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from ..base import state
from ..base.dtypes import DataType
from ..base.options import Options
from ..base.program import Program
from ..fields.scalar import ScalarField
from ..fields.structs import StructType
from ..values.builder import Builder
from ..values.emitter import Emitter
from .diagnostics import Diagnostics
from .scope import Frame
from .templates import Reads
from .worlds import Worlds


class ArgumentForm(Protocol):
    """The form of a parameter of the kernel; `launch.specs` makes and documents them."""

    kind: str
    dt: Any
    shape: tuple[int, ...]
    ndim: int
    element_shape: tuple[int, ...]
    constant: Any
    has_gradient: bool
    alias: int | None
    is_read: bool
    is_written: bool
    is_loaded: bool
    uses_gradient: bool

    @property
    def has_slot(self) -> bool: ...

    @property
    def mlir_types(self) -> list[str]: ...

    def names(self, name: str) -> list[str]: ...


class ResultForm(Protocol):
    """The form of the result of the kernel."""

    dt: DataType
    shape: tuple[int, ...]

    @property
    def mlir_type(self) -> str: ...

    @property
    def has_gradient(self) -> bool: ...

    def convert(self, emitter: Any, value: Any) -> Any: ...


@dataclass
class Kernel:
    """The specialisation of a kernel that is compiled.

    Attributes:
        symbol: the name of the kernel in IR.
        parameters: name and form of each parameter.
        result: the form of the result, or None.
        followed: the names of the parameters whose values forward mode keeps, each with the field
            that has them.
        result_field: where forward mode keeps the result, or None.
        structs: the names and types of parameters that are structs; their members are parameters,
            by names such as `a.x`.
        modes: how it rounds, sums and approximates, where that is not the usual.
        batch: the `ti.batch` whose worlds it is for, or None.
    """

    symbol: str
    parameters: Sequence[tuple[str, ArgumentForm]]
    result: ResultForm | None
    followed: list[tuple[str, ScalarField]]
    result_field: ScalarField | None
    structs: dict[str, StructType]
    modes: dict[str, Any]
    batch: Any = None


class Walker(Protocol):
    """The interface to the whole compiler, which its parts call for nested nodes of the syntax
    tree.
    """

    def visit(self, node: ast.AST) -> Any:
        """Compiles a node of the syntax tree; returns the value if the node is an expression."""

    def body(self, statements: list[ast.stmt]) -> None:
        """Compiles the statements of a block; statements behind an exit run only without it."""


class Context:
    """The function being compiled, and the position of the compiler in it.

    Attributes:
        program, kernel: the kernel that is compiled, and its program.
        builder, emitter: make operations, and arithmetic of them.
        frames: the functions that are compiled, each inlined into the one before it.
        depth: how many regions of IR enclose the operations that are made.
        top_depth: the depth at which loops run in parallel.
        is_dead: set while the statements that follow cannot be reached.
        diagnostics: gives errors their place.
        reads: attributes that the code depends on besides its arguments.
        functions: the `FunctionInfo` of each `ti.func` that is inlined.
        walker: compiles nested nodes.
    """

    def __init__(self, program: Program, kernel: Kernel, frame: Frame, walker: Walker):
        self.program, self.kernel = program, kernel
        self.frames = [frame]
        self.builder = Builder(program.context, frame.filename)
        rounding = state.rounding
        self.emitter = rounding.make_emitter(self.builder) if rounding else Emitter(self.builder)
        self.emitter.worlds = None if kernel.batch is None else Worlds(kernel.batch)
        self.depth = self.top_depth = 0
        self.is_dead = False
        self.diagnostics = Diagnostics(self.frames)
        constants = [spec.constant for _, spec in kernel.parameters if spec.kind == "template"]
        self.reads = Reads(constants)
        self.functions: set[Any] = set()
        self.walker = walker

    @property
    def options(self) -> Options:
        """The options of the program, as `ti.init` got them."""
        return self.program.options

    @property
    def kernel_name(self) -> str:
        """The name of the kernel in messages."""
        return self.frames[0].name

    @property
    def depth_below_top(self) -> int:
        """The number of regions around new operations, apart from those that returns make."""
        return self.depth - self.top_depth

    @property
    def frame(self) -> Frame:
        """The innermost function."""
        return self.frames[-1]

    def enter(self, frame: Frame) -> None:
        self.frames.append(frame)
        self.builder.set_file(frame.filename)

    def leave(self) -> None:
        self.frames.pop()
        self.builder.set_file(self.frame.filename)

    def at(self, node: Any) -> None:
        """Gives the operations that are made from now on the location of this node."""
        self.diagnostics.last_node = node
        self.builder.set_location(node.lineno, node.col_offset + 1)


class Part:
    """A part of the compiler: it handles some nodes of syntax trees, by `visit_<node>`.

    Args:
        context: the state that all parts share.
    """

    def __init__(self, context: Context):
        self.context, self._frames = context, context.frames
        self.builder, self.emitter = context.builder, context.emitter
        self.at, self.guarded = context.at, context.diagnostics.guarded
        self.visit, self.body = context.walker.visit, context.walker.body

    @property
    def frame(self) -> Frame:
        """The innermost function that is being compiled."""
        return self._frames[-1]
