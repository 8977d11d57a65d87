"""Compiles a Python function, for given kinds of arguments, to the MLIR module of a kernel."""

from __future__ import annotations

import ast
import functools
import sys
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

from ...errors import TaiError, TaiSyntaxError
from ..base import native, state
from ..base.locks import Lock
from ..base.modes import attribute_of
from ..base.options import Options
from ..base.program import Program
from ..fields.scalar import ScalarField
from ..fields.structs import StructType
from ..values.builder import Builder
from ..values.emitter import Emitter
from .assignments import Assignments
from .calls import Calls
from .checks import Checks
from .compile_time import CompileTime
from .context import ArgumentForm, Context, Kernel, Part, ResultForm
from .diagnostics import Diagnostics
from .expressions import Expressions
from .hints import hint_for
from .inlining import Inlining
from .loop_config import LoopConfig
from .loop_domains import LoopDomains
from .loops import Loops
from .operators import Operators
from .parallel_loops import ParallelLoops
from .parameters import Parameters
from .printing import Printing
from .regions import Regions
from .returns import Returns
from .scope import Frame
from .serial_loops import SerialLoops
from .serial_work import SerialWork
from .source import function_ast
from .sparse import Levels
from .statements import Statements, refuse_statement
from .structs import make_value
from .templates import Reads
from .while_loops import WhileLoops
from .worlds import statements_of

# The limit of Python's recursion while a kernel is compiled: a nested statement takes about thirty
# calls.
_RECURSION = 20000


# Objects of one compilation.
_OWN = (Part, Context, Diagnostics, Emitter, Builder, Frame)


class _DeepRecursion(native.WithBlock):
    """A context in which inlined functions may call one another to a greater depth."""

    # The recursion limit belongs to all threads, so these variables hold the instances that need
    # the greater limit, and the former limit.
    _change = Lock()
    _all: ClassVar[set[_DeepRecursion]] = set()
    _before: ClassVar[int | None] = None

    def _enter(self) -> None:
        kind = _DeepRecursion
        with kind._change:
            if kind._before is None:
                kind._before = sys.getrecursionlimit()
            kind._all.add(self)
            sys.setrecursionlimit(max(kind._before, _RECURSION))

    def _end(self) -> None:
        kind = _DeepRecursion
        with kind._change:
            kind._all.discard(self)
            if not kind._all and kind._before is not None:
                sys.setrecursionlimit(kind._before)
                kind._before = None


class Compiler:
    """Compiles one specialisation of one kernel: makes the parts, and walks the tree with them.

    Args:
        program: whose fields it uses.
        function: the Python function.
        symbol: the name of the kernel in IR.
        parameters: name and form of each parameter.
        result: the form of the result, or None.
        cells: where forward mode keeps numbers that kernels return and take: the names of
            the parameters that are there with their fields, and the field for the result, or
            None. There is a parameter more for each, the number of its first element.
        structs: the names and types of parameters that are structs; their members are among
            `parameters`, by names such as `a.x`.
        modes: how it rounds, sums and approximates; see `base.modes`.
        batch: the `ti.batch` whose worlds it is for, or None.
    """

    def __init__(
        self,
        program: Program,
        function: Callable[..., Any],
        symbol: str,
        parameters: Sequence[tuple[str, ArgumentForm]],
        result: ResultForm | None,
        cells: tuple[list[tuple[str, ScalarField]], ScalarField | None],
        structs: dict[str, StructType],
        modes: dict[str, Any],
        batch: Any = None,
    ):
        frame = Frame(function, function_ast(function), "kernel")
        followed, result_field = cells
        kernel = Kernel(symbol, parameters, result, followed, result_field, structs, modes, batch)
        self.context = context = Context(program, kernel, frame, self)

        compile_time = CompileTime(context)
        checks = Checks(context, compile_time)
        levels = Levels(context)
        self._work = work = SerialWork(context)
        loop_config = LoopConfig(context)
        expressions = Expressions(context, compile_time, checks, levels)
        printing = Printing(context, expressions)
        self._parameters = Parameters(context)
        self._returns = returns = Returns(context, self._parameters)
        regions = Regions(context, compile_time, returns)
        inlining = Inlining(context, returns, loop_config)
        calls = Calls(
            context, compile_time, checks, levels, expressions, printing, inlining, loop_config
        )
        self._statements = Statements(context, compile_time, printing, returns, regions)
        domains = LoopDomains(context, expressions)
        serial = SerialLoops(context, work, returns, regions, domains)
        parallel = ParallelLoops(context, levels, work, regions, domains)
        # The parts of the compiler that have methods for kinds of nodes.
        self._parts: list[Part] = [
            expressions,
            Operators(context, compile_time),
            printing,
            returns,
            calls,
            Assignments(context, compile_time, checks, expressions),
            self._statements,
            WhileLoops(context, returns, regions),
            Loops(context, compile_time, loop_config, domains, self._statements, serial, parallel),
        ]
        self._methods: dict[type[ast.AST], Callable[[Any], Any]] = {}
        self._guarded = context.diagnostics.guarded

        emitter = context.emitter
        math = kernel.modes.get("math")
        emitter.fast_norms = math == "fast" or (math is None and program.options.fast_math)
        emitter.call = calls.call_from_python
        emitter.make_struct = functools.partial(make_value, emitter)
        emitter.warn_of_fraction = checks.warn_of_fraction

    @property
    def reads(self) -> Reads:
        """Returns the attributes of template arguments on which the code depends."""
        return self.context.reads

    def compile(self) -> Any:
        """Builds and verifies the module of the kernel.

        Returns:
            The `_core.Kernel`.

        Raises:
            TaiError: with the place in the program.
        """
        context, diagnostics = self.context, self.context.diagnostics
        outer, state.of_thread.emitter = state.emitter, context.emitter
        try:
            with _DeepRecursion():
                self._build()
        except TaiError as error:
            error.trail = error.trail or diagnostics.trail()
            if error.hint is None or error.hint is error.general_hint:
                found = hint_for(error, error is diagnostics.from_python)
                error.hint = found or error.general_hint
            raise
        finally:
            state.of_thread.emitter = outer
        return context.builder.finish(context.kernel.symbol)

    def close(self) -> None:
        """Takes the compiler apart, after its results were taken, to break reference cycles.

        Its parts know each other in circles, which would keep the program, with its memory and
        threads, until the cyclic collector of Python runs.
        """
        pending: list[Any] = [self]
        while pending:
            held = vars(pending.pop())
            pending += [part for part in held.values() if isinstance(part, _OWN)]
            held.clear()

    def _build(self) -> None:
        context, parameters = self.context, self._parameters
        builder, frame, kernel = context.builder, context.frame, context.kernel
        node = frame.node
        context.at(node)
        region = builder.region()
        types = [builder.type(t) for t in parameters.types]
        block = builder.block(region, types, parameters.names)
        context.emitter.entry = block
        builder.set_block(block)
        parameters.define(block)
        self._returns.prepare_returns()
        batch = kernel.batch
        self.body(node.body if batch is None else statements_of(node.body, batch.is_masked))
        results = frame.results
        if not frame.has_returned and results is not None and results.may_have_run:
            self._returns.refuse_open_end()
            context.at(node)
            for variable in results.parts:
                parameters.store_cells(variable.value)
            builder.return_([variable.value.handle for variable in results.parts])
        elif not frame.has_returned:
            if kernel.result is not None:
                raise TaiSyntaxError(
                    f"kernel '{frame.name}' has a return type, but no return"
                ).locate(frame.filename, node.lineno, node.col_offset + 1)
            builder.return_()
        result = None if kernel.result is None else kernel.result.mlir_type
        builder.enter_module()
        context.at(node)
        builder.kernel(
            kernel.symbol, parameters.types, result, region, parameters.gradients,
            conventions(context.options), attribute_of(kernel.modes) if kernel.modes else "",
            context.options.validation,
        )  # fmt: skip

    @property
    def has_gradients(self) -> bool:
        """Whether any field or array that the kernel uses has a gradient."""
        fields = (f for f in self.context.emitter.fields if f.dtype.is_float)
        placed = (f._companions.get("grad") for f in fields)
        return any(spec.has_gradient for _, spec in self.context.kernel.parameters) or any(
            grad is not None and grad.level is not None for grad in placed
        )

    # Walking

    def visit(self, node: ast.AST) -> Any:
        """Compiles a node; an error that has no place yet gets that of the node."""
        self._work.work += 1
        kind = type(node)
        method = self._methods.get(kind)
        if method is None:
            method = self._methods[kind] = self._find_method(kind)
        return self._guarded(method, node)

    def body(self, statements: list[ast.stmt]) -> None:
        """Compiles the statements of a block; statements behind an exit run only without it."""
        self._statements.block(statements)

    def _find_method(self, kind: type[ast.AST]) -> Callable[[Any], Any]:
        """Returns the method, of one of the parts, that compiles nodes of a kind."""
        name = "visit_" + kind.__name__
        for part in self._parts:
            method = getattr(part, name, None)
            if method is not None:
                return method
        return refuse_statement if issubclass(kind, ast.stmt) else _refuse


def _refuse(node: ast.AST) -> Any:
    raise TaiSyntaxError(f"kernels have no '{type(node).__name__}'")


def conventions(options: Options) -> dict[str, str]:
    """The gradients at kinks that `ti.init` chose, if not the default ones."""
    chosen: dict[str, str] = {}
    if options.ad_ties == "split":
        chosen["ties"] = '"split"'
    if options.ad_arcs == "clamp":
        chosen["arcs"] = '"clamp"'
    if not options.ad_guards:
        chosen["guards"] = "false"
    return chosen
