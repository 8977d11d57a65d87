"""Nested `for` loops: an `scf.for`, or an `scf.while` if they can be left early."""

from __future__ import annotations

import ast
import math
from typing import Any

from ...errors import TaiSyntaxError
from ..base.dtypes import u1
from ..values.builder import SIGNED
from ..values.value import Value
from .context import Context, Part
from .loop_domains import Bounds, LoopDomains
from .refs import Variable
from .regions import Regions
from .returns import Returns
from .scope import Loop
from .serial_work import SerialWork, count_trips
from .source import own_exits


class SerialLoops(Part):
    """The part of the compiler that makes `for` loops whose iterations run one after another.

    Args:
        context, serial_work, returns, regions, domains: other parts of the compiler, which it uses.
    """

    def __init__(
        self, context: Context, serial_work: SerialWork, returns: Returns, regions: Regions,
        domains: LoopDomains,
    ):  # fmt: skip
        super().__init__(context)
        self.serial_work, self.returns = serial_work, returns
        self.regions, self.domains = regions, domains

    def make(self, node: ast.For, bounds: Bounds, grouped: bool) -> None:
        names = self.domains.targets(node, len(bounds.lower), grouped)
        if len(bounds.lower) > 1 and own_exits(node.body) and _has_break(node.body):
            raise TaiSyntaxError(
                "'break' would leave only the last dimension of the loop",
                "write one loop for each dimension",
            )
        self.frame.push()
        self._nest(node, bounds, names, grouped, [])
        self.frame.pop(node.lineno)

    def _nest(
        self, node: ast.For, bounds: Bounds, names: list[str], grouped: bool, outer: list[Value]
    ) -> None:
        """Emits the loop of one dimension of a serial loop nest, and the loops of the inner
        dimensions.
        """
        dimension = len(outer)
        if dimension == len(bounds.lower):
            self.domains.define_indices(names, outer, grouped)
            self.frame.push()
            self.body(node.body)
            self.frame.pop(node.lineno)
            return
        emitter = self.emitter
        low, high = bounds.lower[dimension], bounds.upper[dimension]
        dt = self.domains.index_type_of([low, high, bounds.step])
        last = dimension + 1 == len(bounds.lower)
        loop = Loop("for", self.context.depth + 1)
        returns = bool(self.returns.exit_flags(None, node.body))
        if last and _has_break(node.body):
            loop.broken = Variable("break", emitter.constant(False, u1))
        self.frame.loops.append(loop)
        variables = self.regions.changed_by(node.body)
        self.frame.loops.pop()
        loop.trips = count_trips(low, high, bounds.step, unknown=math.inf)
        loop.names, loop.carried = names, variables
        begin, end = emitter.to_index(low), emitter.to_index(high)
        work = self.serial_work.work
        has_step = isinstance(bounds.step, Value) or bounds.step != 1
        if has_step:
            begin, end = emitter.index(0), self.domains.trip_count(low, high, bounds.step)

        def inside(handle: Any) -> None:
            index = emitter.from_index(handle, dt)
            if has_step:
                index = emitter.cast(self.domains.at_step(low, index, bounds.step), dt)
            if last and own_exits(node.body):
                loop.skipped = Variable("continue", emitter.constant(False, u1))
            self.frame.loops.append(loop)
            self._nest(node, bounds, names, grouped, [*outer, index])
            self.frame.loops.pop()
            self.context.is_dead = False

        if loop.broken is not None or returns:
            self._counted_while(loop, variables, begin, end, inside, node)
        else:
            self._carried_for(variables, begin, end, inside, node)
        self.serial_work.end_serial(work, low, high, bounds.step, node)

    def _carried_for(
        self, variables: list[Variable], begin: Any, end: Any, inside: Any, node: ast.For
    ) -> None:
        """Emits an `scf.for` that carries the variables which its body changes."""
        emitter, builder = self.emitter, self.builder
        initial = [v.value.handle for v in variables]
        types = [emitter.type_of(v.value.dt, v.value.shape) for v in variables]
        outer = builder.get_block()
        region = builder.region()
        names = [v.name for v in variables]
        block = builder.block(region, [emitter.index_type, *types], names)
        self._fill(block, variables, inside, node)
        builder.yield_([v.value.handle for v in variables])
        builder.set_block(outer)
        results = builder.for_(begin, end, emitter.index(1), initial, types, region)
        self.regions.take_results(results, variables)

    def _fill(self, block: Any, variables: list[Variable], inside: Any, node: ast.For) -> None:
        """Puts the body of a loop into a block of its index and the variables."""
        self.builder.set_block(block)
        self.regions.take_arguments(block, variables, 1)
        self.context.depth += 1
        inside(block.argument(0))
        self.context.depth -= 1
        self.at(node)

    def _counted_while(
        self, loop: Loop, variables: list[Variable], begin: Any, end: Any, inside: Any,
        node: ast.For,
    ) -> None:  # fmt: skip
        """Emits a loop over a range that may be left early: an `scf.while` that also carries the
        index.
        """
        emitter, builder = self.emitter, self.builder
        flags = self.returns.exit_flags(loop.broken, node.body)
        variables = [*(f for f in flags if f not in variables), *variables]
        types = [emitter.type_of(v.value.dt, v.value.shape) for v in variables]
        all_types = [emitter.index_type, *types]
        initial = [begin, *(v.value.handle for v in variables)]
        outer = builder.get_block()
        before, after = builder.region(), builder.region()
        names = ["index", *(v.name for v in variables)]
        head = builder.block(before, all_types, names)
        builder.set_block(head)
        self.regions.take_arguments(head, variables, 1)
        index = head.argument(0)
        more = builder.compare_integers(SIGNED["<"], index, end, emitter.type_of(u1))
        go_on = emitter.binary("&", Value(emitter, more, u1), self.returns.running(flags))
        carried = [v.value.handle for v in variables]
        builder.condition_of_while(go_on.handle, [index, *carried])
        block = builder.block(after, all_types, names)
        self._fill(block, variables, inside, node)
        following = builder.apply(
            "arith.addi", [block.argument(0), emitter.index(1)], emitter.index_type
        )
        builder.yield_([following, *(v.value.handle for v in variables)])
        builder.set_block(outer)
        results = builder.while_(initial, all_types, before, after)
        self.regions.take_results(results[1:] if len(variables) > 1 else results[1], variables)


def _has_break(statements: list[ast.stmt]) -> bool:
    for statement in statements:
        if isinstance(statement, ast.Break):
            return True
        if isinstance(statement, ast.If) and (
            _has_break(statement.body) or _has_break(statement.orelse)
        ):
            return True
    return False
