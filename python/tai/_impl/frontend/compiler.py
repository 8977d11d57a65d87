"""From a Python function and the kinds of its arguments to the module of a kernel."""

from __future__ import annotations

import ast
import contextlib
import functools
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

from ...errors import (
    SHOW_TRACEBACK,
    TaiCompilationError,
    TaiError,
    TaiIndexError,
    TaiSyntaxError,
    TaiTypeError,
    shorten,
)
from ..base import dtypes, state
from ..values.builder import Builder
from ..values.emitter import Emitter
from .calls import Calls
from .checks import Checks
from .expressions import Expressions
from .hints import hint_for
from .loops import Loops
from .printing import Printing
from .refs import ArrayArgument, FieldElement, Variable
from .returns import Returns
from .scope import Bound, Frame
from .serial_work import SerialWork
from .source import function_ast
from .sparse import Sparse
from .statements import Statements, StaticBreak, StaticContinue
from .structs import make_value
from .templates import Reads

# Calls of Python that the compiler may need: some thirty for each statement inside of another.
_RECURSION = 20000
# The limit is one for all threads: how many of them need it, and what it was before.
_deep_lock = threading.Lock()
_deep_threads = 0
_limit_before = 0


@contextlib.contextmanager
def _deep_recursion() -> Iterator[None]:
    global _deep_threads, _limit_before
    with _deep_lock:
        if _deep_threads == 0:
            _limit_before = sys.getrecursionlimit()
            sys.setrecursionlimit(max(_limit_before, _RECURSION))
        _deep_threads += 1
    try:
        yield
    finally:
        with _deep_lock:
            _deep_threads -= 1
            if _deep_threads == 0:
                sys.setrecursionlimit(_limit_before)


class Compiler(
    Expressions, Statements, Returns, Loops, Calls, Sparse, Checks, Printing, SerialWork
):
    """Compiles one specialisation of one kernel.

    Args:
        program: the `Program` whose fields it uses.
        function: the Python function.
        symbol: the name of the kernel in IR.
        parameters: for each parameter, its name and `ArgumentSpec`.
        result: the `ResultSpec`, or None.
        cells: where forward mode keeps numbers that kernels return and take: the names of
            the parameters that are there with their fields, and the field for the result, or
            None. There is a parameter more for each, the number of its first element.
    """

    def __init__(
        self,
        program: Any,
        function: Callable[..., Any],
        symbol: str,
        parameters: list[tuple[str, Any]],
        result: Any,
        cells: tuple[list[tuple[str, Any]], Any] = ([], None),
    ):
        self.cells = cells
        self.program, self.kernel_name = program, symbol
        self.parameters, self.result = parameters, result
        node = function_ast(function)
        self.frame = Frame(function, node, "kernel")
        self.frames = [self.frame]
        self.builder = Builder(program.context, self.frame.filename)
        self.emitter = Emitter(self.builder)
        self.emitter.call = self.call_from_python
        self.emitter.make_struct = functools.partial(make_value, self.emitter)
        self.emitter.warn_of_fraction = self.warn_of_fraction
        self.depth = 0
        self.is_dead = False
        # The depth at which loops run in parallel, and what is known of inlined functions.
        self.top_depth = 0
        self.return_forms: dict[tuple, Any] = {}
        self.loop_options: dict[str, Any] = {}
        self.reads = Reads([s.constant for _, s in parameters if s.kind == "template"])
        self.prepare_checks()
        self.prepare_work()
        # Whether of the attribute that is evaluated next no more than its form is wanted.
        self.form_only = False
        self._methods: dict[type, Callable[[Any], Any]] = {}
        self._lines: dict[tuple[str, int], str] = {}
        self.last_node: Any = node
        # The exception of Python code that ended the compilation, as an error of ours.
        self.from_python: TaiError | None = None

    def compile(self) -> Any:
        """Builds and verifies the module.

        Returns:
            The `_core.Kernel`.

        Raises:
            TaiError: with the place in the program.
        """
        outer, state.emitter = state.emitter, self.emitter
        try:
            with _deep_recursion():
                self.build()
        except TaiError as error:
            error.trail = error.trail or self.trail()
            error.hint = error.hint or hint_for(error, error is self.from_python)
            raise
        finally:
            state.emitter = outer
        return self.builder.finish(self.kernel_name)

    def build(self) -> None:
        builder, frame = self.builder, self.frame
        node = frame.node
        self.at(node)
        followed, result_field = self.cells
        types = [t for _, spec in self.parameters for t in spec.mlir_types]
        types += ["i32"] * (len(followed) + (result_field is not None))
        region = builder.region()
        names = [n for name, spec in self.parameters for n in spec.names(name)]
        names += ["cell"] * (len(types) - len(names))
        block = builder.block(region, [builder.type(t) for t in types], names)
        self.emitter.entry = block
        builder.set_block(block)
        position, gradients, handles = 0, [], []
        for name, spec in self.parameters:
            handles.append([block.argument(position + i) for i in range(len(spec.mlir_types))])
            if spec.has_gradient and spec.has_slot:
                gradients.append(position)
            position += len(spec.mlir_types)
            given = handles[-1] if spec.alias is None else handles[spec.alias]
            frame.define(name, self.argument(name, spec, given))
        for number, (name, field) in enumerate(followed):
            first = block.argument(position + number)
            self.load_cells(frame.scopes[-1][name], field, first)
        self.result_cell = None
        if result_field is not None:
            self.result_cell = block.argument(position + len(followed))
        self.prepare_returns()
        self.body(node.body)
        results = frame.results
        if not frame.has_returned and results is not None and results.may_have_run:
            self.refuse_open_end()
            self.at(node)
            for variable in results.parts:
                self.store_cells(variable.value)
            builder.return_([variable.value.handle for variable in results.parts])
        elif not frame.has_returned:
            if self.result is not None:
                raise TaiSyntaxError(
                    f"kernel '{frame.name}' has a return type, but no return"
                ).locate(frame.filename, node.lineno, node.col_offset + 1)
            builder.return_()
        result = None if self.result is None else self.result.mlir_type
        if self.result is not None and self.result.has_gradient:
            gradients.append(len(types))
        builder.enter_module()
        self.at(node)
        builder.kernel(self.kernel_name, types, result, region, gradients, conventions())

    @property
    def has_gradients(self) -> bool:
        """Whether something that the kernel uses has a gradient."""
        fields = (f for f in self.emitter.fields if f.dtype.is_float)
        placed = (f._companions.get("grad") for f in fields)
        return any(spec.has_gradient for _, spec in self.parameters) or any(
            grad is not None and grad.level is not None for grad in placed
        )

    def argument(self, name: str, spec: Any, handles: list) -> Variable | Bound:
        """What a parameter of the kernel stands for in its body."""
        if spec.kind == "template":
            return Bound(spec.constant)
        if spec.kind == "array":
            return Bound(ArrayArgument(self.emitter, name, handles, spec))
        value = self.emitter.value(handles[0], spec.dt, spec.shape)
        if not spec.shape and spec.dt.kind == "i":
            value.index = "cast"
        return Variable(name, value, "kernel argument")

    def cell(self, field: Any, first: Any, number: int) -> FieldElement:
        """An element of the field that forward mode keeps numbers in."""
        emitter = self.emitter
        at = emitter.binary("+", emitter.value(first, dtypes.i32), number)
        return FieldElement(emitter, field, [emitter.to_index(at)])

    def load_cells(self, variable: Variable, field: Any, first: Any) -> None:
        """A parameter whose value forward mode follows is what it has kept."""
        emitter, given = self.emitter, variable.value
        count = 1
        for extent in given.shape:
            count *= extent
        parts = [emitter.cast(self.cell(field, first, i).load(), given.dt) for i in range(count)]
        variable.value = emitter.matrix(parts, given.dt, given.shape) if given.shape else parts[0]

    def store_cells(self, value: Any) -> None:
        """Keeps the result for forward mode, if that follows it."""
        if self.result_cell is None:
            return
        for number, part in enumerate(value.scalars() if value.shape else [value]):
            place = self.cell(self.cells[1], self.result_cell, number)
            place.store(self.emitter.cast(part, dtypes.f64))

    def check_kernel_result(self, value: Any) -> None:
        if value is None and self.result is not None:
            raise TaiSyntaxError("the kernel has a return type: return a value")
        if value is not None and self.result is None:
            raise TaiSyntaxError(
                "a kernel that returns a value needs a return type",
                f"def {self.frame.name}(…) -> ti.f32",
            )

    def return_from_kernel(self, value: Any, node: ast.Return) -> None:
        self.check_kernel_result(value)
        if value is None:
            self.builder.return_()
            return
        value = self.result.convert(self.emitter, value)
        self.at(node)
        self.store_cells(value)
        self.builder.return_([value.handle])

    def call_from_python(self, function: Any, args: tuple, kwargs: dict) -> Any:
        """Inlines a `ti.func` that a plain Python function calls while it is traced."""
        node = ast.Call(ast.Name(function.__name__, ast.Load()), [], [])
        ast.copy_location(node, self.last_node)
        return self.call(function, list(args), kwargs, node)

    # Walking

    def visit(self, node: ast.AST) -> Any:
        """Compiles a node; an error that has no place yet gets that of the node."""
        self.work += 1
        method = self._methods.get(type(node))
        if method is None:
            name = "visit_" + type(node).__name__
            fallback = self.generic_statement if isinstance(node, ast.stmt) else self.refuse
            method = self._methods[type(node)] = getattr(self, name, fallback)
        return self.guarded(method, node)

    def refuse(self, node: ast.AST) -> Any:
        raise TaiSyntaxError(f"kernels have no '{type(node).__name__}'")

    def guarded(self, method: Callable[[Any], Any], node: Any) -> Any:
        """Runs a method on a node and gives errors without a place that of the node."""
        try:
            return method(node)
        except TaiError as error:
            self.place(error, node)
            raise
        except (StaticBreak, StaticContinue):
            raise
        except Exception as error:
            if _is_of_a_handler(error):
                raise
            raise self.translated(error, node) from (error if SHOW_TRACEBACK else None)

    def translated(self, error: Exception, node: ast.AST) -> TaiError:
        """An exception of Python code that ran at compile time, as one of ours."""
        kinds = {IndexError: TaiIndexError, KeyError: TaiIndexError, TypeError: TaiTypeError}
        kind = next((k for e, k in kinds.items() if isinstance(error, e)), TaiCompilationError)
        text = str(error) or type(error).__name__
        if isinstance(error, KeyError):
            text = f"no item {text}"
        elif isinstance(error, RecursionError):
            text = "the program nests too deeply"
        made = kind(text)
        if isinstance(error, RecursionError):
            made.hint = "divide it into functions, or long sums into several statements"
        if isinstance(error, (AssertionError, AttributeError, RuntimeError)):
            made.hint = "TAI_TRACEBACK=1 in the environment shows where in Python this arose"
        self.place(made, node)
        self.from_python = made
        return made

    def place(self, error: TaiError, node: Any) -> None:
        if error.lineno is not None or not hasattr(node, "lineno"):
            return
        same_line = node.end_lineno == node.lineno
        error.locate(
            self.frame.filename,
            node.lineno,
            self.column(node.lineno, node.col_offset) + 1,
            self.column(node.lineno, node.end_col_offset) + 1 if same_line else None,
        )
        error.trail = self.trail()

    def column(self, line: int, offset: int) -> int:
        """A column in characters; `ast` counts bytes."""
        key = (self.frame.filename, line)
        text = self._lines.get(key)
        if text is None:
            import linecache

            text = self._lines[key] = linecache.getline(*key)
        return offset if text.isascii() else len(text.encode()[:offset].decode(errors="ignore"))

    def trail(self) -> list[str]:
        """Where the code being compiled stands: functions, innermost first."""
        lines = []
        for frame in reversed(self.frames):
            if frame.kind == "kernel":
                lines.append(f"in kernel '{frame.name}'")
            else:
                filename, line = frame.call
                lines.append(f"in function '{frame.name}', called at {shorten(filename)}:{line}")
        return lines[:6]

    def at(self, node: Any) -> None:
        """Operations made from now on stand at this node."""
        self.last_node = node
        self.builder.set_location(node.lineno, node.col_offset + 1)

    # Frames

    def enter(self, frame: Frame) -> None:
        self.frames.append(frame)
        self.frame = frame
        self.builder.set_file(frame.filename)

    def leave(self) -> None:
        self.frames.pop()
        self.frame = self.frames[-1]
        self.builder.set_file(self.frame.filename)


def conventions() -> dict[str, str]:
    """What `ti.init` chose for gradients at kinks, where that is not the usual."""
    options, chosen = state.options, {}
    if options.ad_ties == "split":
        chosen["ties"] = '"split"'
    if options.ad_arcs == "clamp":
        chosen["arcs"] = '"clamp"'
    if not options.ad_guards:
        chosen["guards"] = "false"
    return chosen


def _is_of_a_handler(error: BaseException) -> bool:
    """Whether the handler of a signal has raised the error: it may come at any statement."""
    handlers = {
        handler.__code__
        for handler in map(signal.getsignal, signal.valid_signals())
        if hasattr(handler, "__code__")
    }
    trace = error.__traceback__
    while trace is not None:
        if trace.tb_frame.f_code in handlers:
            return True
        trace = trace.tb_next
    return False
