"""`for` loops: parallel at the top of a kernel, serial inside, unrolled for `ti.static`."""

from __future__ import annotations

import ast
from functools import partial
from typing import Any

from ...errors import TaiSyntaxError
from .compile_time import CompileTime
from .context import Context, Part
from .loop_config import LoopConfig
from .loop_domains import Bounds, LoopDomains
from .parallel_loops import ParallelLoops
from .returns import find_return
from .scope import Loop, StaticBreak, StaticContinue
from .serial_loops import SerialLoops
from .sparse import Level
from .statements import Statements


class Loops(Part):
    """The part of the compiler that handles `for`.

    Args:
        context, compile_time, loop_config, domains, statements, serial, parallel: other parts
            of the compiler, which it uses.
    """

    def __init__(
        self, context: Context, compile_time: CompileTime, loop_config: LoopConfig,
        domains: LoopDomains, statements: Statements, serial: SerialLoops, parallel: ParallelLoops,
    ):  # fmt: skip
        super().__init__(context)
        self.compile_time, self.loop_config = compile_time, loop_config
        self.domains, self.statements = domains, statements
        self.serial, self.parallel = serial, parallel

    def visit_For(self, node: ast.For) -> None:
        options = self.loop_config.take()
        static = self.compile_time.static_argument(node.iter)
        if static is not None:
            self._static_for(node, self.compile_time.visit_static(static))
            return
        domain, grouped = self.guarded(self.domains.domain, node.iter)
        self.at(node)
        if self.emitter.worlds is not None and self.context.depth == self.context.top_depth and (
            options.get("serialize") or options.get("parallelize") == 1
        ):  # fmt: skip
            raise TaiSyntaxError(
                "a loop at the top of a kernel of a batch runs in parallel over the worlds",
                "for an order within a world, put it in a loop: for _ in range(1)",
            )
        in_order = options.get("serialize", False) or self._runs_in_order(node)
        top = self.context.depth == self.context.top_depth and not in_order
        if isinstance(domain, Bounds):
            if top and options.get("parallelize", 0) != 1:
                self.parallel.make(node, domain, None, grouped, options)
            else:
                self.serial.make(node, domain, grouped)
            return
        if self.context.depth > self.context.top_depth:
            raise TaiSyntaxError(
                f"a loop over {self._name_of(domain)} must stand at the top of a kernel",
                "inside, loop over its indices: for I in ti.grouped(ti.ndrange(*x.shape))",
            )
        options["serialize"] = not top
        self.parallel.make(node, None, domain, grouped, options)

    def _runs_in_order(self, node: ast.For) -> bool:
        """Whether a loop of a function runs in order although it stands at the top of a kernel."""
        if self.frame.kind != "func":
            return False
        return self.frame.in_order or find_return(node.body) is not None

    def visit_WorldLoop(self, node: ast.For) -> None:
        self.at(node)
        self.parallel.make(node, Bounds([], []), None, False, self.loop_config.take())

    def _name_of(self, domain: Any) -> str:
        """Returns the name of a field or a level for messages."""
        return "a level" if isinstance(domain, Level) else f"field '{domain.name}'"

    def _static_for(self, node: ast.For, thing: Any) -> None:
        loop = Loop("static", self.context.depth)
        self.frame.loops.append(loop)
        self._unrolled(node, loop, self.compile_time.static_items(thing))
        self.frame.loops.pop()

    def _unrolled(self, node: ast.For, loop: Loop, items: list) -> None:
        """Compiles the iterations of an unrolled loop; after an iteration that may return, the next
        ones run only if it has not.
        """
        loop.depth = self.context.depth
        for number, item in enumerate(items):
            self.frame.push()
            self.compile_time.bind_static(node.target, item)
            try:
                self.body(node.body)
            except StaticContinue:
                pass
            except StaticBreak:
                self.frame.pop(node.lineno)
                return
            self.frame.pop(node.lineno)
            if self.frame.has_returned or self.context.is_dead:
                return
            rest = items[number + 1 :]
            running = self.statements.still_running(node) if rest else None
            if running is not None:
                self.statements.rest_of_body(
                    running, partial(self._unrolled, node, loop, rest), node.body, node
                )
                return
