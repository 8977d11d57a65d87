"""`ti.ensemble`: a loss over many scenes, shared among the ranks of a mesh."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from ...errors import TaiRuntimeError, TaiRuntimeTypeError
from ..base.callers import calling_frame
from ..base.program import get_program
from ..fields.field import Field
from .seeds import require_grad

# Up to this number of numbers, the gradient of each chunk is kept, and the chunks are added up in
# their order.
_MOST_KEPT = 1 << 23


class Ensemble(NamedTuple):
    """The result of `ti.ensemble`: the loss of all scenes, their gradients with respect to each
    field, and the number of scenes that each rank ran.
    """

    loss: float
    gradients: list[np.ndarray]
    scenes: list[int]


def ensemble(
    run: Callable[[int, int], Any], scenes: int, wrt: Sequence[Any], chunk: int | None = None
) -> Ensemble:
    """Adds up losses and gradients of many scenes over the ranks of the program's mesh.

    Each rank takes the next chunk of scenes when it has done one, so that a slow rank gets fewer of
    them. All ranks call this function together, with fields that are not sharded, and get the same
    result; the gradients are also left in `x.grad` of the fields. Without a mesh one process runs
    all scenes. Sums are in double precision; up to 8 million numbers they are added up in the order
    of the chunks, and the bits do not depend on ranks and their speeds.

    Args:
        run: `run(first, last)` computes the loss of scenes `first` to `last` - 1 and returns it,
            with its gradients in `x.grad` of the fields: it usually records a `ti.ad.Tape`.
        scenes: the number of scenes.
        wrt: the fields with respect to which gradients are added up.
        chunk: the scenes of a call of `run`; by default each rank gets about eight chunks. A rank
            waits for the last chunks of the others for as long as the timeout of the mesh.

    Raises:
        TaiRuntimeError: on all ranks, if `run` fails on one of them.
    """
    mesh = get_program().options.mesh
    ranks = 1 if mesh is None else mesh.ranks
    for name, value in (("scenes", scenes), ("chunk", chunk or 1)):
        if isinstance(value, bool) or not isinstance(value, int) or value < 1:
            raise TaiRuntimeTypeError(f"{name} is a number of scenes, but got {value!r}")
    fields = list(wrt)
    frame = calling_frame()
    for each in fields:
        if not isinstance(each, Field):
            raise TaiRuntimeTypeError(f"wrt is a list of fields, but has {each!r}")
        require_grad(each, frame)
    chunk = chunk or max(1, -(-scenes // (8 * ranks)))
    chunks = -(-scenes // chunk)
    sums = _Sums(chunks, fields)
    problem, failure = "", None
    own = 0
    for number in _numbers(mesh, chunks):
        first, last = number * chunk, min((number + 1) * chunk, scenes)
        try:
            loss = float(run(first, last))
            sums.add(number, loss, fields)
        except Exception as error:
            problem, failure = f"scenes {first} to {last - 1}: {error}", error
            break
        own += last - first
    if mesh is None:
        if failure is not None:
            raise failure
        shares = [own]
    else:
        try:
            mesh.agree("an ensemble", problem)
        except TaiRuntimeError as error:
            raise error from failure
        shares = [int(text) for text in mesh.texts("an ensemble", str(own))]
        mesh.add_up(sums.numbers, "an ensemble")
    loss, gradients = sums.results(fields)
    for each, gradient in zip(fields, gradients, strict=True):
        each.grad.from_numpy(gradient.astype(each.dtype.numpy))
    return Ensemble(loss, gradients, shares)


def _numbers(mesh: Any, chunks: int) -> Any:
    """The chunks that this rank runs, one after the other."""
    if mesh is None:
        yield from range(chunks)
        return
    take = mesh.counter()
    while (number := take()) < chunks:
        yield number


class _Sums:
    """Losses and gradients of chunks, as one array of numbers for each chunk or for all."""

    def __init__(self, chunks: int, fields: list[Any]):
        sizes = [int(np.prod(each.shape + each.element_shape)) for each in fields]
        self._ends = np.cumsum([1, *sizes])
        total = int(self._ends[-1])
        self._is_kept = chunks * total <= _MOST_KEPT
        self.numbers = np.zeros((chunks if self._is_kept else 1, total))

    def add(self, number: int, loss: float, fields: list[Any]) -> None:
        """Adds the results of a chunk."""
        row = self.numbers[number if self._is_kept else 0]
        row[0] += loss
        for low, high, each in zip(self._ends, self._ends[1:], fields, strict=False):
            row[low:high] += each.grad.to_numpy().reshape(-1)

    def results(self, fields: list[Any]) -> tuple[float, list[np.ndarray]]:
        """The sums over all chunks, in their order."""
        total = np.zeros(self.numbers.shape[1])
        for row in self.numbers:
            total += row
        gradients = [
            total[low:high].reshape(each.shape + each.element_shape)
            for low, high, each in zip(self._ends, self._ends[1:], fields, strict=False)
        ]
        return float(total[0]), gradients
