"""`ti.batch`: one program for many worlds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...errors import TaiRuntimeError, TaiRuntimeTypeError, TaiSyntaxError
from ..base import dtypes
from ..base.dtypes import cast, f32, u32
from ..base.keywords import check_keywords
from ..fields.field import Field
from ..fields.make import field as make
from ..fields.make import make_field
from ..fields.structs import StructType
from ..launch.kernels import Kernel, func, kernel
from ..values.ops import grouped
from ..values.types import template
from .tape import Tape


class Batch:
    """A program that runs many independent worlds at once; see `ti.batch`.

    Attributes:
        size: how many worlds there are.
        is_masked: whether worlds can be left out.
    """

    def __init__(self, size: int, masked: bool = False):
        if isinstance(size, bool) or not isinstance(size, (int, np.integer)) or size < 1:
            raise TaiRuntimeTypeError(
                f"ti.batch takes the number of worlds, but got {size!r}", "ti.batch(4096)"
            )
        self.size, self.is_masked = int(size), bool(masked)
        self._fields: list[Any] = []
        self._starts: list[tuple[Any, Any]] = []
        self._mask: Any = None
        self._states: Any = None
        self._chosen: Any = None
        if self.is_masked:
            self._mask = make(dtypes.i32, self.size, name="mask")
            self._mask.batch = self
            self._mask.fill(1)

    def __len__(self) -> int:
        return self.size

    def __repr__(self) -> str:
        return f"<ti.batch of {self.size} worlds>"

    # Fields

    def field(
        self, dtype: Any, shape: Any = (), name: str | None = "", needs_grad: bool = False,
        needs_dual: bool = False,
    ) -> Any:  # fmt: skip
        """Makes a field that has separate values for each world.

        In Python its first index is that of the world; kernels of the batch leave it away.

        Args:
            dtype: a type of numbers, vectors, matrices or structs.
            shape: the shape of the field in one world.
            name, needs_grad, needs_dual: as for `ti.field`.
        """
        shape = (shape,) if isinstance(shape, (int, np.integer)) else tuple(shape)
        whole = (self.size, *shape)
        if isinstance(dtype, StructType):
            return self.adopt(dtype.field(whole, needs_grad=needs_grad, needs_dual=needs_dual))
        return self.adopt(
            make(dtype, whole, name=name, needs_grad=needs_grad, needs_dual=needs_dual)
        )

    def adopt(self, field: Any) -> Any:
        """Takes a field whose first dimension is that of the worlds, in any layout.

        Raises:
            TaiRuntimeTypeError: it has another extent there, or an offset.
        """
        if not isinstance(field, Field):
            raise TaiRuntimeTypeError(f"a batch has fields, but got {field!r}")
        if not field.shape or field.shape[0] != self.size or any(field.offset or ()):
            raise TaiRuntimeTypeError(
                f"field '{field.name}' has shape {field.shape}, but its first dimension is that of "
                f"{self.size} worlds, from 0 on",
                f"shape=({self.size}, …)",
            )
        members = getattr(field, "members", None)
        if members is not None:
            for member in members.values():
                self.adopt(member)
            return field
        field.batch = self
        self._fields.append(field)
        return field

    # Kernels

    def kernel(self, function: Callable[..., Any] | None = None, **modes: Any) -> Any:
        """A kernel that is written for one world and runs for all of them.

        Its fields of this batch are those of the world. Loops at the top run in parallel over the
        worlds and their own range; statements between them, in parallel over the worlds. Other
        fields, arrays and numbers are the same for all worlds.

        Raises:
            TaiSyntaxError: a result; or as the kernel is compiled, a variable that all worlds
                would share.
        """
        if function is None:
            return lambda given: self.kernel(given, **modes)
        made: Kernel = kernel(**modes)(function) if modes else kernel(function)
        if function.__annotations__.get("return") is not None:
            raise TaiSyntaxError(
                f"kernel '{function.__name__}' of a batch returns one value, and there are "
                f"{self.size} worlds",
                "store it to a field of the batch",
            )
        made.batch = self
        return made

    @property
    def mask(self) -> Any:
        """A field with 1 for each world that takes part, and 0 for others.

        Raises:
            TaiRuntimeError: the batch was made without `masked=True`.
        """
        if self._mask is None:
            raise TaiRuntimeError(
                "this batch has no mask: all worlds take part", "ti.batch(n, masked=True)"
            )
        return self._mask

    # Episodes

    def save(self) -> None:
        """Keeps the contents of all fields of the batch, for `reset`."""
        known = {id(field) for field, _ in self._starts}
        for field in self._fields:
            if id(field) not in known:
                start = make_field(
                    field.element_shape, field.dtype, field.shape, None, "batch_start", None,
                    False, False,
                )  # fmt: skip
                self._starts.append((field, start))
        for field, start in self._starts:
            start.copy_from(field)

    def reset(self, which: Any = None) -> None:
        """Brings the fields of worlds back to the contents that `save` has kept.

        Args:
            which: a field or an array with a number for each world: those with another one than 0
                are reset. All of them, without it.

        Raises:
            TaiRuntimeError: nothing was saved.
            TaiRuntimeTypeError: not a number for each world.
        """
        if not self._starts:
            raise TaiRuntimeError(
                "nothing was saved that worlds could be reset to", "batch.save() after the set-up"
            )
        if isinstance(which, Field):
            shape: Any = which.shape
        else:
            which = np.ones(self.size, np.int32) if which is None else np.asarray(which)
            which = which.astype(np.int32)
            shape = which.shape
        if shape != (self.size,):
            raise TaiRuntimeTypeError(
                f"reset takes a number for each of {self.size} worlds, but got shape {shape}"
            )
        if not isinstance(which, Field):
            chosen: Any = self._choice()
            chosen.from_numpy(which)
            which = chosen
        for field, start in self._starts:
            _restore(field, start, which)

    def _choice(self) -> Any:
        if self._chosen is None:
            self._chosen = make(dtypes.i32, self.size, name="batch_choice")
        return self._chosen

    def seed(self, seeds: Any) -> None:
        """Seeds the random number generator of each world, which `random` uses.

        Args:
            seeds: a whole number, from which those of the worlds are derived; or one for each.
                Before the first call they are derived from 0.
        """
        if np.ndim(seeds) == 0:
            seeds = _spread(int(seeds), self.size)
        seeds = np.asarray(seeds)
        if seeds.shape != (self.size,) or not np.issubdtype(seeds.dtype, np.integer):
            raise TaiRuntimeTypeError(
                f"seed takes one whole number, or one for each of {self.size} worlds"
            )
        self._state().from_numpy(seeds.astype(np.uint32))

    def _state(self) -> Any:
        if self._states is None:
            self._states = make(dtypes.u32, self.size, name="batch_random")
            self._states.batch = self
            self._states.from_numpy(_spread(0, self.size))
        return self._states

    @property
    def random(self) -> Any:
        """A function of kernels of the batch: the next random number of the world, in [0, 1).

        A world draws the same numbers whatever the other worlds do. Call it in statements between
        loops, or in inner loops: the numbers of a world have an order.
        """
        states = self._state()

        @func
        def draw():  # type: ignore[no-untyped-def]
            state = states[None] * cast(747796405, u32) + cast(2891336453, u32)
            states[None] = state
            word = ((state >> ((state >> 28) + 4)) ^ state) * cast(277803737, u32)
            word = (word >> 22) ^ word
            return cast(word >> 8, f32) * 5.9604644775390625e-08

        return draw

    # Gradients

    def tape(self, loss: Any, weights: Any = None, **options: Any) -> Tape:
        """Opens a tape whose loss is one number in each world.

        The gradient of a field holds, in the part of each world, the derivative of the loss of that
        world. The loss is set to zero as the block is entered, and as it is replayed.

        Args:
            loss: a field of the batch of shape ().
            weights: a number for each world, from which its sweep starts: 1 without it.
            options: as for `ti.ad.Tape`.

        Raises:
            TaiRuntimeTypeError: the loss is no such field.
        """
        if not isinstance(loss, Field) or loss.batch is not self or loss.shape != (self.size,):
            raise TaiRuntimeTypeError(
                "the loss of a batch is a field with a number for each world",
                "loss = batch.field(ti.f32, needs_grad=True)",
            )
        weights = np.ones(self.size) if weights is None else weights
        return _BatchTape(loss, seed=weights, **options)


class _BatchTape(Tape):
    """A tape of a batch, which sets the losses to zero when it begins."""

    def _enter(self) -> Tape:
        super()._enter()
        self.loss.fill(0)
        return self


def _spread(seed: int, size: int) -> np.ndarray:
    """Derives a seed for each of `size` worlds from one number."""
    return np.random.SeedSequence(seed).generate_state(size, np.uint32)


@kernel
def _restore(target: template(), source: template(), which: template()) -> None:  # type: ignore
    for at in grouped(target):
        if which[at[0]] != 0:
            target[at] = source[at]


def batch(size: int, masked: bool = False) -> Batch:
    """Many worlds with one program: fields, kernels, losses, seeds, resets and masks of each.

    ```python
    worlds = ti.batch(4096)
    x, v = worlds.field(ti.f32, needs_grad=True), worlds.field(ti.f32, needs_grad=True)

    @worlds.kernel
    def step():
        v[None] -= 0.01 * ti.sin(x[None])
        x[None] += 0.01 * v[None]
    ```

    Args:
        size: how many worlds there are.
        masked: whether worlds can be left out by `mask`, which costs a read for each loop.
    """
    return Batch(size, masked)


__all__ = ["Batch", "batch"]


check_keywords(globals(), ["batch"])
