"""`for` loops: parallel at the top of a kernel, serial inside, unrolled for `ti.static`."""

from __future__ import annotations

import ast
from functools import reduce
from typing import Any

from ...errors import TaiSyntaxError, TaiTypeError
from ..base.dtypes import DataType, i32, i64, promote, u1
from ..fields.field import Field
from ..fields.matrix_field import MatrixField
from ..fields.scalar import ComponentField, ScalarField
from ..fields.snode import Place, Root, SNode
from ..fields.structs import StructField
from ..values import ops
from ..values.builder import SIGNED
from ..values.value import MatrixValue, Value
from .block_sizes import block_dim_of
from .refs import ArrayArgument, FieldElement, Variable, use_field
from .scope import Bound, Loop
from .source import own_exits
from .sparse import Level
from .statements import StaticBreak, StaticContinue


class Bounds:
    """The ranges of a loop: lower and upper bounds, as numbers or values."""

    def __init__(self, lower: list[Any], upper: list[Any], step: int = 1):
        self.lower, self.upper, self.step = lower, upper, step


class Loops:
    """The part of the compiler that handles `for`."""

    emitter: Any
    builder: Any
    frame: Any
    depth: int
    top_depth: int
    loop_options: dict[str, Any]

    def visit_For(self, node: ast.For) -> None:
        options, self.loop_options = self.loop_options, {}
        if node.orelse:
            raise TaiSyntaxError("'else' of a for is not supported in kernels")
        static = self.static_argument(node.iter)
        if static is not None:
            self.static_for(node, self.visit_static(static))
            return
        domain, grouped = self.domain(node.iter)
        self.at(node)
        top = self.depth == self.top_depth and not options.get("serialize", False)
        if isinstance(domain, Bounds):
            if top and options.get("parallelize", 0) != 1:
                self.parallel_for(node, domain, None, grouped, options)
            else:
                self.serial_for(node, domain, grouped)
            return
        if self.depth > self.top_depth:
            raise TaiSyntaxError(
                f"a loop over {self._name_of(domain)} must stand at the top of a kernel",
                "inside, loop over its indices: for I in ti.grouped(ti.ndrange(*x.shape))",
            )
        options["serialize"] = not top
        self.parallel_for(node, None, domain, grouped, options)

    def domain(self, node: ast.expr) -> tuple[Any, bool]:
        """What a loop runs over: `Bounds` or a field; and whether indices come as a vector."""
        if isinstance(node, ast.Call):
            function = self.visit(node.func)
            if function is range:
                return self.range_bounds(node), False
            if function is ops.grouped:
                if len(node.args) != 1:
                    raise TaiTypeError("ti.grouped takes one argument")
                inner, _ = self.domain(node.args[0])
                if (
                    isinstance(inner, Bounds)
                    and isinstance(node.args[0], ast.Call)
                    and (self.visit(node.args[0].func) is range)
                ):
                    raise TaiTypeError("ti.grouped takes a field or a ti.ndrange")
                return inner, True
            if function is ops.ndrange:
                return self.ndrange_bounds(self.items(node.args)), False
            thing = self.visit(node)
        else:
            thing = self.visit(node)
        if isinstance(thing, ops.ndrange):
            return self.ndrange_bounds(thing.arguments), False
        if isinstance(thing, ops.Grouped):
            if isinstance(thing.inner, ops.ndrange):
                return self.ndrange_bounds(thing.inner.arguments), True
            return self.field_domain(thing.inner), True
        if isinstance(thing, range):
            return Bounds([thing.start], [thing.stop], thing.step), False
        if isinstance(thing, (Field, SNode)):
            return self.field_domain(thing), False
        if isinstance(thing, ArrayArgument):
            shape = list(thing.shape)
            return Bounds([0] * len(shape), shape), False
        self.refuse_domain(thing, node)

    def _name_of(self, domain: Any) -> str:
        """What a message calls a field or a level."""
        return "a level" if isinstance(domain, Level) else f"field '{domain.name}'"

    def refuse_domain(self, thing: Any, node: ast.expr) -> None:
        text = ast.unparse(node)
        if isinstance(thing, Value) and not isinstance(thing, MatrixValue):
            raise TaiTypeError(f"a number cannot be looped over: {text}", f"for i in range({text})")
        if isinstance(thing, (list, tuple, MatrixValue, zip, enumerate, dict)) or getattr(
            thing, "is_matrix", False
        ):
            raise TaiSyntaxError(
                f"a loop over '{text}' is unrolled by the compiler and must say so",
                f"for … in ti.static({text})",
            )
        raise TaiTypeError(
            f"'{text}' cannot be looped over", "use range, ti.ndrange, a field, or ti.static"
        )

    def field_domain(self, thing: Any) -> Any:
        if isinstance(thing, Place):
            thing = thing.field
        if isinstance(thing, SNode):
            if thing.kind == "root":
                raise TaiTypeError("ti.root cannot be looped over", "loop over a level or a field")
            return Level(thing, "a loop")
        if not isinstance(thing, Field):
            raise TaiTypeError("ti.grouped takes a field or a ti.ndrange")
        use_field(thing)
        return thing.first if isinstance(thing, StructField) else thing

    def range_bounds(self, node: ast.Call) -> Bounds:
        if node.keywords:
            raise TaiSyntaxError("range takes no keywords")
        parts = self.items(node.args)
        if not 1 <= len(parts) <= 3:
            raise TaiSyntaxError(f"range takes 1 to 3 arguments, but got {len(parts)}")
        step = 1
        if len(parts) == 3:
            step = parts.pop()
            if isinstance(step, Value):
                step = step.const
            if not isinstance(step, int) or step == 0:
                raise TaiSyntaxError(
                    "the step of a range must be a number known at compile time, and not 0",
                    "compute the index in the loop: i = start + k * step",
                )
        lower, upper = (0, parts[0]) if len(parts) == 1 else parts
        for part in (lower, upper):
            self.check_bound(part)
        return Bounds([lower], [upper], step)

    def check_bound(self, part: Any) -> None:
        whole = part.dt.is_int and not part.shape if isinstance(part, Value) else (
            isinstance(part, int) or hasattr(part, "__index__")
        )  # fmt: skip
        if not whole:
            what = part.kind_name if isinstance(part, Value) else repr(part)
            raise TaiTypeError(
                f"the bounds of a loop are whole numbers, but got {what}", "convert it: int(…)"
            )

    def ndrange_bounds(self, arguments: Any) -> Bounds:
        lower, upper = [], []
        for argument in arguments:
            if isinstance(argument, (tuple, list)):
                if len(argument) != 2:
                    raise TaiTypeError("a range of ti.ndrange is a number or a pair (begin, end)")
                low, high = argument
            elif isinstance(argument, MatrixValue) or getattr(argument, "is_matrix", False):
                for extent in argument:
                    self.check_bound(extent)
                    lower.append(0)
                    upper.append(extent)
                continue
            else:
                low, high = 0, argument
            self.check_bound(low)
            self.check_bound(high)
            lower.append(low)
            upper.append(high)
        if not lower:
            raise TaiTypeError("ti.ndrange takes at least one range")
        return Bounds(lower, upper)

    # Targets

    def targets(self, node: ast.For, rank: int, grouped: bool) -> list[str]:
        """The names that the indices go to; one name for all where they are grouped."""
        target = node.target
        if grouped:
            if not isinstance(target, ast.Name):
                raise TaiSyntaxError("a loop over ti.grouped(…) has one variable, a vector")
            return [target.id]
        items = target.elts if isinstance(target, (ast.Tuple, ast.List)) else [target]
        if not all(isinstance(item, ast.Name) for item in items):
            raise TaiSyntaxError("the variables of a loop are names")
        if len(items) != rank:
            variables = "1 variable" if len(items) == 1 else f"{len(items)} variables"
            raise TaiTypeError(
                f"the loop has {variables}, but runs over {rank} "
                f"dimension{'s' if rank != 1 else ''}",
                "use ti.grouped(…) to have all indices in one vector"
                if len(items) == 1
                else "give one variable for each dimension",
            )
        return [item.id for item in items]

    def define_indices(self, names: list[str], indices: list[Value], grouped: bool) -> None:
        if grouped:
            dt = reduce(promote, (index.dt for index in indices), i32)
            parts = [self.emitter.cast(index, dt) for index in indices]
            vector = MatrixValue(self.emitter, None, dt, (len(indices),), parts)
            self.frame.define(names[0], Variable(names[0], vector, "loop variable"))
            return
        for name, index in zip(names, indices, strict=True):
            if name != "_":
                self.frame.define(name, Variable(name, index, "loop variable"))

    def index_type_of(self, parts: list[Any]) -> DataType:
        """The type of a loop variable: that of its bounds, and of numbers that they are."""
        dt = i32
        for part in parts:
            if not isinstance(part, Value):
                # The upper bound itself is none of the indices.
                dt = dt if i32.min <= part <= i32.max + 1 else promote(dt, i64)
            elif part.dt.is_int:
                dt = promote(dt, part.dt)
        return dt

    # Unrolled loops

    def static_for(self, node: ast.For, thing: Any) -> None:
        loop = Loop("static", self.depth)
        self.frame.loops.append(loop)
        self.unrolled(node, loop, self.static_items(thing, node.iter))
        self.frame.loops.pop()

    def unrolled(self, node: ast.For, loop: Loop, items: list) -> None:
        """The iterations of an unrolled loop; after a possible return only without it."""
        loop.depth = self.depth
        for number, item in enumerate(items):
            self.frame.push()
            self.bind_static(node.target, item)
            try:
                self.body(node.body)
            except StaticContinue:
                pass
            except StaticBreak:
                self.frame.pop(node.lineno)
                return
            self.frame.pop(node.lineno)
            if self.frame.has_returned or self.is_dead:
                return
            rest = items[number + 1 :]
            running = self.still_running(node) if rest else None
            if running is not None:
                self.rest_of_body(
                    running, lambda rest=rest: self.unrolled(node, loop, rest), node.body, node
                )
                return

    def bind_static(self, target: ast.expr, item: Any) -> None:
        """Gives an item of an unrolled loop to its target."""
        if isinstance(target, ast.Name):
            if isinstance(item, Value):
                self.frame.define(target.id, Variable(target.id, item, "loop variable"))
            else:
                self.frame.define(target.id, Bound(item))
            return
        if not isinstance(target, (ast.Tuple, ast.List)):
            raise TaiSyntaxError("the variables of a loop are names")
        parts = self.take_apart(item)
        if len(parts) != len(target.elts):
            raise TaiTypeError(f"{len(target.elts)} variables cannot take {len(parts)} values")
        for one, part in zip(target.elts, parts, strict=True):
            self.bind_static(one, part)

    # Serial loops

    def serial_for(self, node: ast.For, bounds: Bounds, grouped: bool) -> None:
        names = self.targets(node, len(bounds.lower), grouped)
        if len(bounds.lower) > 1 and own_exits(node.body) and _has_break(node.body):
            raise TaiSyntaxError(
                "'break' would leave only the last dimension of the loop",
                "write one loop for each dimension",
            )
        self.frame.push()
        self.nest(node, bounds, names, grouped, [])
        self.frame.pop(node.lineno)

    def nest(
        self, node: ast.For, bounds: Bounds, names: list[str], grouped: bool, outer: list[Value]
    ) -> None:
        """One dimension of a serial loop, and the ones inside of it."""
        dimension = len(outer)
        if dimension == len(bounds.lower):
            self.define_indices(names, outer, grouped)
            self.frame.push()
            self.body(node.body)
            self.frame.pop(node.lineno)
            return
        emitter = self.emitter
        low, high = bounds.lower[dimension], bounds.upper[dimension]
        dt = self.index_type_of([low, high])
        last = dimension + 1 == len(bounds.lower)
        loop = Loop("for", self.depth + 1)
        returns = bool(self.exit_flags(None, node.body))
        if last and _has_break(node.body):
            loop.broken = Variable("break", emitter.constant(False, u1))
        self.frame.loops.append(loop)
        variables = self.changed_by(node.body)
        self.frame.loops.pop()
        begin, end = emitter.to_index(low), emitter.to_index(high)
        work = self.work
        if bounds.step != 1:
            begin, end = emitter.index(0), self.trip_count(low, high, bounds.step)

        def inside(handle: Any) -> None:
            index = emitter.from_index(handle, dt)
            if bounds.step != 1:
                index = emitter.binary("+", low, emitter.binary("*", index, bounds.step))
            if last and own_exits(node.body):
                loop.skipped = Variable("continue", emitter.constant(False, u1))
            self.frame.loops.append(loop)
            self.nest(node, bounds, names, grouped, [*outer, index])
            self.frame.loops.pop()
            self.is_dead = False

        if loop.broken is not None or returns:
            self.counted_while(loop, variables, begin, end, inside, node)
        else:
            self.carried_for(variables, begin, end, inside, node)
        self.end_serial(work, low, high, bounds.step, node)

    def trip_count(self, low: Any, high: Any, step: int) -> Any:
        """The number of iterations of a range with a step, as an index handle."""
        emitter = self.emitter
        size = abs(step)
        if not isinstance(low, Value) and not isinstance(high, Value):
            first, last = (low, high) if step > 0 else (high, low)
            return emitter.index(max(-((first - last) // size), 0))
        # From one end of a type to the other there is more than it can count.
        low, high = (
            emitter.cast(part if isinstance(part, Value) else emitter.constant(part, i64), dt)
            for dt in [promote(self.index_type_of([low, high]), i64)]
            for part in (low, high)
        )
        span = emitter.binary("-", high, low) if step > 0 else emitter.binary("-", low, high)
        count = emitter.binary("//", emitter.binary("+", span, size - 1), size)
        return emitter.to_index(count)

    def carried_for(
        self, variables: list[Variable], begin: Any, end: Any, inside: Any, node: ast.For
    ) -> None:
        """An `scf.for` that carries the variables which its body changes."""
        emitter, builder = self.emitter, self.builder
        initial = [v.value.handle for v in variables]
        types = [emitter.type_of(v.value.dt, v.value.shape) for v in variables]
        outer = builder.get_block()
        region = builder.region()
        names = [v.name for v in variables]
        block = builder.block(region, [emitter.index_type, *types], names)
        builder.set_block(block)
        self.take_arguments(block, variables, 1)
        self.depth += 1
        inside(block.argument(0))
        self.depth -= 1
        self.at(node)
        builder.yield_([v.value.handle for v in variables])
        builder.set_block(outer)
        results = builder.for_(begin, end, emitter.index(1), initial, types, region)
        self.take_results(results, variables)

    def counted_while(
        self, loop: Loop, variables: list[Variable], begin: Any, end: Any, inside: Any,
        node: ast.For,
    ) -> None:  # fmt: skip
        """A range that can be left: an `scf.while` that also carries the index."""
        emitter, builder = self.emitter, self.builder
        flags = self.exit_flags(loop.broken, node.body)
        variables = [*(f for f in flags if f not in variables), *variables]
        types = [emitter.type_of(v.value.dt, v.value.shape) for v in variables]
        all_types = [emitter.index_type, *types]
        initial = [begin, *(v.value.handle for v in variables)]
        outer = builder.get_block()
        before, after = builder.region(), builder.region()
        names = ["index", *(v.name for v in variables)]
        head = builder.block(before, all_types, names)
        builder.set_block(head)
        self.take_arguments(head, variables, 1)
        index = head.argument(0)
        more = builder.compare_integers(SIGNED["<"], index, end, emitter.type_of(u1))
        go_on = emitter.binary("&", Value(emitter, more, u1), self.running(flags))
        carried = [v.value.handle for v in variables]
        builder.condition_of_while(go_on.handle, [index, *carried])
        block = builder.block(after, all_types, names)
        builder.set_block(block)
        self.take_arguments(block, variables, 1)
        self.depth += 1
        inside(block.argument(0))
        self.depth -= 1
        self.at(node)
        following = builder.apply(
            "arith.addi", [block.argument(0), emitter.index(1)], emitter.index_type
        )
        builder.yield_([following, *(v.value.handle for v in variables)])
        builder.set_block(outer)
        results = builder.while_(initial, all_types, before, after)
        self.take_results(results[1:] if len(variables) > 1 else results[1], variables)

    # Parallel loops

    def parallel_for(
        self, node: ast.For, bounds: Bounds | None, field: Any, grouped: bool,
        options: dict[str, Any],
    ) -> None:  # fmt: skip
        """A `tai.parallel_for` over a box of indices or the elements of a field."""
        emitter, builder = self.emitter, self.builder
        level = field if isinstance(field, Level) else None
        storage = field = level.field if level is not None else field
        if isinstance(field, MatrixField):
            storage = field.single or field.components[0]
        elif isinstance(field, ComponentField) and field.is_window:
            storage = field._whole.single
        rank = len(field.shape) if bounds is None else len(bounds.lower)
        names = self.targets(node, rank if level is None else level.rank, grouped)
        lower: list[Any] = []
        upper: list[Any] = []
        if bounds is not None:
            for low, high in zip(bounds.lower, bounds.upper, strict=True):
                if bounds.step != 1:
                    lower.append(emitter.index(0))
                    upper.append(self.trip_count(low, high, bounds.step))
                else:
                    lower.append(emitter.to_index(low))
                    upper.append(emitter.to_index(high))
        is_serial = bool(options.get("serialize"))

        loop = Loop("parallel", self.depth + 1)
        shared = self.share(self.changed_by(node.body), node)
        outer = builder.get_block()
        region = builder.region()
        block = builder.block(region, [emitter.index_type] * rank)
        builder.set_block(block)
        self.depth += 1
        self.frame.push()
        indices = []
        for dimension in range(rank):
            if bounds is not None:
                parts = [bounds.lower[dimension], bounds.upper[dimension]]
            else:
                first = (field.offset or (0,) * rank)[dimension]
                parts = [first, first + field.shape[dimension]]
            index = emitter.from_index(block.argument(dimension), self.index_type_of(parts))
            if bounds is not None and bounds.step != 1:
                scaled = emitter.binary("*", index, bounds.step)
                index = emitter.binary("+", bounds.lower[dimension], scaled)
            indices.append(index)
        if level is not None:
            offset = field.offset or (0,) * rank
            indices = [
                emitter.binary("//", emitter.binary("-", indices[d], offset[d]), level.scale[d])
                for d in level.dimensions
            ]
        self.define_indices(names, indices, grouped)
        self.appends = False
        shape = None if bounds is not None else field.shape
        work = self.begin_parallel(bounds, shape, is_serial)
        self.loop_body(loop, node)
        self.end_parallel(work, bounds, shape, is_serial, node)
        if self.appends and self.program.options.deterministic:
            # On many threads, the order of a list would be that in which they come.
            is_serial = True
        self.frame.pop(node.lineno)
        self.depth -= 1
        self.at(node)
        builder.end_of_parallel_for()
        builder.set_block(outer)
        builder.parallel_for(
            region, lower, upper, None if bounds is not None else storage.symbol,
            None if level is None else level.up, is_serial,
            block_dim_of(options, self.program.options),
        )  # fmt: skip
        for variable in shared:
            variable.value = variable.hidden.convert(variable.hidden.load())
            variable.hidden = None

    def share(self, variables: list[Variable], node: ast.For) -> list[Variable]:
        """Moves variables that a parallel loop changes to memory that its iterations share."""
        for variable in variables:
            value = variable.value
            field = self.shared_memory(variable.name, value.dt, value.shape)
            place = FieldElement(self.emitter, field, [])
            place.store(value)
            variable.hidden = place
        return variables

    def shared_memory(self, name: str, dt: DataType, shape: tuple[int, ...]) -> ScalarField:
        """A field of one element, with a gradient and a dual, that belongs to this kernel."""
        field = ScalarField(dt, f"{self.kernel_name}_{name}", "primal", shape)
        field.needs_grad = field.needs_dual = dt.is_float
        root = Root()
        root.place(field)
        root.allocate(self.program)
        return field


def _has_break(statements: list[ast.stmt]) -> bool:
    for statement in statements:
        if isinstance(statement, ast.Break):
            return True
        if isinstance(statement, ast.If) and (
            _has_break(statement.body) or _has_break(statement.orelse)
        ):
            return True
    return False
