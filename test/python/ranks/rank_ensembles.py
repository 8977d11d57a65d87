"""Ensembles that ranks run in tests, and that one process runs without a mesh."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import tai as ti

from rank_scenes import _failure, begin, mesh_of_program


def _scenes(transport: Any) -> tuple[Any, Any]:
    """Parameters, and a function that computes the loss of some scenes."""
    begin(transport, ti.f32)
    w = ti.field(ti.f32, shape=5, needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)
    w.from_numpy(np.linspace(-1, 1, 5, dtype=np.float32))

    @ti.kernel
    def simulate(first: ti.i32, last: ti.i32):
        for s, k in ti.ndrange((first, last), 5):
            loss[None] += ti.sin(w[k] * (s + 1)) / (k + 1)

    def run(first: int, last: int) -> float:
        with ti.ad.Tape(loss):
            simulate(first, last)
        return loss[None]

    return w, run


def spread(transport: Any, chunk: int) -> dict[str, Any]:
    """50 scenes, and their gradient."""
    w, run = _scenes(transport)
    found = ti.ensemble(run, 50, [w], chunk=chunk)
    return {"loss": found.loss, "gradient": found.gradients[0], "scenes": found.scenes,
            "left": w.grad.to_numpy()}  # fmt: skip


def slow(transport: Any) -> list[int]:
    """Rank 1 does not end its first scene before rank 0 has begun the last one."""
    w, run = _scenes(transport)
    ends = transport.folder / "ends"

    def slowly(first: int, last: int) -> float:
        if transport.rank == 1:
            while not ends.exists():
                threading.Event().wait(0.01)
        elif first == 9:
            ends.touch()
        return run(first, last)

    if transport.rank == 1:
        # This rank takes the first scene.
        take = transport.take

        def taken(name: str) -> int:
            number = take(name)
            (transport.folder / "taken").touch()
            return number

        transport.take = taken
    else:
        take_first = transport.take

        def wait(name: str) -> int:
            while not (transport.folder / "taken").exists():
                threading.Event().wait(0.01)
            return take_first(name)

        transport.take = wait
    return ti.ensemble(slowly, 10, [w], chunk=1).scenes


def turns(transport: Any) -> list[int]:
    """A transport without `take`."""
    w, run = _scenes(transport)
    mesh_of_program()._transport = _Plain(transport)
    return ti.ensemble(run, 10, [w], chunk=2).scenes


class _Plain:
    def __init__(self, transport: Any):
        self.rank, self.size = transport.rank, transport.size
        self.swap, self.all_reduce = transport.swap, transport.all_reduce
        self.all_gather = transport.all_gather


def failing(transport: Any) -> str:
    """A scene that does not exist."""
    w, run = _scenes(transport)

    def some(first: int, last: int) -> float:
        if first == 4:
            raise ValueError("no such scene")
        return run(first, last)

    return _failure(lambda: ti.ensemble(some, 10, [w], chunk=2))
