"""MLIR regions, and the variables that they change."""

from __future__ import annotations

import ast
from collections.abc import Callable
from typing import Any

from ..base.dtypes import u1
from ..values.value import Value
from .compile_time import CompileTime
from .context import Context, Part
from .refs import Variable
from .returns import Returns, find_return
from .scope import Loop
from .source import AssignedNames, own_exits
from .structs import variables_of


class Regions(Part):
    """The part of the compiler that makes branches, and hands variables into regions and out.

    Args:
        context, compile_time, returns: other parts of the compiler, which it uses.
    """

    def __init__(self, context: Context, compile_time: CompileTime, returns: Returns):
        super().__init__(context)
        self.compile_time, self.returns = compile_time, returns

    def changed_by(self, *lists: list[ast.stmt]) -> list[Variable]:
        """Returns the variables of this function that the statements may change."""
        known, now = self.frame.assigned, self.compile_time
        collector = AssignedNames(now.takes_reference, now.changes_receiver, now.is_settled, known)
        found: list[Variable] = []
        for statements in lists:
            for name in collector.collect(statements):
                found += [v for v in variables_of(self.frame.find(name)) if v not in found]
            loop = self.frame.loops[-1] if self.frame.loops else None
            if loop is not None and own_exits(statements):
                for flag in (loop.broken, loop.skipped):
                    if flag is not None and flag not in found:
                        found.append(flag)
            if self.frame.results is not None and find_return(statements) is not None:
                found += [v for v in self.frame.results.variables if v not in found]
        return [v for v in found if v.hidden is None and v.fixed is None]

    def branch(
        self,
        condition: Value,
        then: Callable[[], None],
        orelse: Callable[[], None] | None,
        statements: list[ast.stmt],
        node: ast.stmt,
    ) -> list[bool]:
        """Emits an `scf.if` that yields the variables that its branches change.

        Returns:
            For each branch, whether it ends by an exit.
        """
        emitter, builder = self.emitter, self.builder
        variables = self.changed_by(statements)
        before = [v.value for v in variables]
        outer = builder.get_block()
        after, blocks, regions, ends = [], [], [], []
        for action in (then, orelse):
            region = builder.region()
            regions.append(region)
            if action is None and not variables:
                continue
            block = builder.block(region, [])
            builder.set_block(block)
            if action is not None:
                self.context.depth += 1
                self.frame.push()
                action()
                self.frame.pop(node.lineno)
                self.context.depth -= 1
            ends.append(self.context.is_dead)
            self.context.is_dead = False
            blocks.append(block)
            after.append([v.value for v in variables])
            for variable, value in zip(variables, before, strict=True):
                variable.value = value
        merged = [
            number
            for number in range(len(variables))
            if any(values[number] is not before[number] for values in after)
        ]
        self.at(node)
        for block, values in zip(blocks, after, strict=True):
            builder.set_block(block)
            builder.yield_([values[number].handle for number in merged])
        builder.set_block(outer)
        types = [emitter.type_of(before[n].dt, before[n].shape) for n in merged]
        results = builder.if_(condition.handle, types, *regions)
        self.take_results(results, [variables[n] for n in merged])
        self.context.is_dead = len(ends) == 2 and all(ends)
        return ends or [False]

    def take_results(self, results: Any, variables: list[Variable]) -> None:
        """Assigns the results of a structured operation to the variables that it carries."""
        if len(variables) == 1:
            results = (results,)
        for variable, handle in zip(variables, results or (), strict=True):
            variable.value = self.emitter.value(handle, variable.value.dt, variable.value.shape)

    def take_arguments(self, block: Any, variables: list[Variable], first: int = 0) -> None:
        """Assigns the arguments of a loop's block to the variables that the loop carries."""
        for number, variable in enumerate(variables):
            old = variable.value
            variable.value = self.emitter.value(block.argument(first + number), old.dt, old.shape)

    def loop_body(self, loop: Loop, node: ast.For | ast.While) -> None:
        """Compiles the statements in the body of a loop, once."""
        if own_exits(node.body):
            loop.skipped = Variable("continue", self.emitter.constant(False, u1))
        self.frame.loops.append(loop)
        self.frame.push()
        self.body(node.body)
        self.frame.pop(node.lineno)
        self.frame.loops.pop()
        self.context.is_dead = False
