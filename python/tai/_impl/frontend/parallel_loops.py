"""Loops at the top of a kernel: `tai.parallel_for`."""

from __future__ import annotations

import ast
from typing import Any

from ...errors import SHARED_VARIABLES, TaiSyntaxError
from ..base.dtypes import DataType
from ..fields.matrix_field import MatrixField
from ..fields.scalar import ComponentField, ScalarField
from ..fields.snode import Root
from ..values.value import Value
from .block_sizes import block_dim_of
from .context import Context, Part
from .loop_domains import Bounds, LoopDomains
from .private_variables import is_private
from .refs import FieldElement, Variable, field_element
from .regions import Regions
from .scope import Loop
from .serial_work import SerialWork
from .sparse import Level, Levels
from .worlds import ACTIVE


class ParallelLoops(Part):
    """The part of the compiler that makes loops at the top of a kernel.

    Args:
        context, levels, serial_work, regions, domains: other parts of the compiler, which it uses.
    """

    def __init__(
        self, context: Context, levels: Levels, serial_work: SerialWork, regions: Regions,
        domains: LoopDomains,
    ):  # fmt: skip
        super().__init__(context)
        self.levels, self.serial_work = levels, serial_work
        self.regions, self.domains = regions, domains

    def make(
        self, node: ast.For, bounds: Bounds | None, field: Any, grouped: bool,
        options: dict[str, Any],
    ) -> None:  # fmt: skip
        """Emits a `tai.parallel_for` over a box of indices or over the elements of a field."""
        emitter, builder = self.emitter, self.builder
        level = field if isinstance(field, Level) else None
        storage = field = level.field if level is not None else field
        if isinstance(field, MatrixField):
            storage = field.components[0] if field.single is None else field.single
        elif isinstance(field, ComponentField) and field.is_window:
            storage = field._whole.single
        rank = len(field.shape) if bounds is None else len(bounds.lower)
        worlds = emitter.worlds
        if worlds is not None:
            bounds, rank = self._with_worlds(bounds, field, level, rank)
        count = rank if level is None else level.rank
        names = self.domains.targets(node, count - (worlds is not None), grouped, field)
        lower: list[Any] = []
        upper: list[Any] = []
        # A loop over an array without dimensions has one iteration and no index.
        is_single = bounds is not None and rank == 0
        if is_single:
            lower, upper = [emitter.index(0)], [emitter.index(1)]
        if bounds is not None:
            for low, high, step in zip(bounds.lower, bounds.upper, bounds.steps, strict=True):
                if _is_step(step):
                    lower.append(emitter.index(0))
                    upper.append(self.domains.trip_count(low, high, step))
                else:
                    lower.append(emitter.to_index(low))
                    upper.append(emitter.to_index(high))
        is_serial = bool(options.get("serialize"))

        loop = Loop("parallel", self.context.depth + 1)
        changed = self.regions.changed_by(node.body)
        own = {v: v.value for v in changed if self._is_private(v, node)}
        shared = self._share([v for v in changed if v not in own], node)
        outer = builder.get_block()
        region = builder.region()
        block = builder.block(region, [emitter.index_type] * (1 if is_single else rank))
        builder.set_block(block)
        self.context.depth += 1
        self.frame.push()
        indices = []
        for dimension in range(rank):
            if bounds is not None:
                parts = [bounds.lower[dimension], bounds.upper[dimension]]
                parts.append(bounds.steps[dimension])
            else:
                first = (field.offset or (0,) * rank)[dimension]
                parts = [first, first + field.shape[dimension]]
            dt = self.domains.index_type_of(parts)
            index = emitter.from_index(block.argument(dimension), dt)
            if bounds is not None and _is_step(bounds.steps[dimension]):
                first = bounds.lower[dimension]
                step = bounds.steps[dimension]
                index = emitter.cast(self.domains.at_step(first, index, step), dt)
            indices.append(index)
        if level is not None:
            offset = field.offset or (0,) * rank
            indices = [
                emitter.binary("//", emitter.binary("-", indices[d], offset[d]), level.scale[d])
                for d in level.dimensions
            ]
        if worlds is not None:
            if shared:
                self._refuse_shared(shared[0])
            worlds.index = indices.pop(0)
            if worlds.batch.is_masked:
                mask = field_element(emitter, worlds.batch.mask, None).load()
                active = emitter.compare("!=", mask, 0)
                self.frame.define(ACTIVE, Variable(ACTIVE, active, "loop variable"))
        self.domains.define_indices(names, indices, grouped)
        self.levels.appends = False
        shape = None if bounds is not None else field.shape
        work = self.serial_work.begin_parallel(bounds, shape, is_serial)
        self.regions.loop_body(loop, node)
        self.serial_work.end_parallel(work, bounds, shape, is_serial, node)
        if self.levels.appends and self.context.options.deterministic:
            # With several threads, the order of appended elements would depend on timing, so a
            # deterministic loop that appends is serial.
            is_serial = True
        if worlds is not None:
            worlds.index = None
        self.frame.pop(node.lineno)
        self.context.depth -= 1
        self.at(node)
        builder.end_of_parallel_for()
        builder.set_block(outer)
        builder.parallel_for(
            region, lower, upper, None if bounds is not None else storage.symbol,
            None if level is None else level.up, is_serial,
            block_dim_of(options, self.context.options), options.get("halo"),
        )  # fmt: skip
        for variable in shared:
            place = variable.hidden
            assert place is not None
            variable.value = place.convert(place.load())
            variable.hidden = None
        for variable, value in own.items():
            variable.value = value

    def _with_worlds(
        self, bounds: Bounds | None, field: Any, level: Level | None, rank: int
    ) -> tuple[Bounds | None, int]:
        """The domain of a loop of a batched kernel, with the worlds in front."""
        worlds = self.emitter.worlds
        if level is not None:
            raise TaiSyntaxError(
                "a kernel of a batch cannot loop over a level", "loop over a field of the batch"
            )
        if bounds is None:
            if worlds.has(field):
                return None, rank
            first = list(field.offset or (0,) * rank)
            last = [a + n for a, n in zip(first, field.shape, strict=True)]
            bounds = Bounds(first, last)
        size = worlds.size(self.emitter)
        made = Bounds([0, *bounds.lower], [size, *bounds.upper], bounds.step, [1, *bounds.steps])
        return made, len(made.lower)

    def _refuse_shared(self, variable: Variable) -> None:
        raise TaiSyntaxError(
            f"'{variable.name}' would be one variable for all worlds, and the loop changes it",
            "keep it in a field of the batch, of shape (): total[None] += …",
        )

    def _is_private(self, variable: Variable, node: ast.For) -> bool:
        """Whether the iterations of a loop that changes a variable need not share it."""
        name = variable.name
        return self.frame.find(name) is variable and is_private(name, node, self.frame.node)

    def _share(self, variables: list[Variable], node: ast.For) -> list[Variable]:
        """Moves variables that a parallel loop changes to memory that its iterations share."""
        for variable in variables:
            value = variable.value
            field = self._shared_memory(variable.name, value.dt, value.shape)
            assert field.symbol is not None
            SHARED_VARIABLES[field.symbol] = variable.name
            place = FieldElement(self.emitter, field, [])
            place.store(value)
            variable.hidden = place
        return variables

    def _shared_memory(self, name: str, dt: DataType, shape: tuple[int, ...]) -> ScalarField:
        """A field of one element, with a gradient and a dual, that belongs to this kernel."""
        field = ScalarField(dt, f"{self.context.kernel.symbol}_{name}", "primal", shape)
        field.needs_grad = field.needs_dual = dt.is_float
        root = Root()
        root.place(field)
        root.allocate(self.context.program)
        return field


def _is_step(step: Any) -> bool:
    """Whether a range has a step other than 1."""
    return isinstance(step, Value) or step != 1
