"""Condition numbers of a loss and its gradient: how much they magnify rounded inputs."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...errors import TaiError
from .compare import Accesses
from .mode import derivatives_of_gradients
from .precision import own_fields, owner_of
from .seeds import number_of
from .snapshot import Snapshot

# The number of random directions by which the condition of the gradient is estimated.
_DIRECTIONS = 4


@dataclass
class Condition:
    """Relative condition numbers of a loss and its gradient.

    A relative change of each input by at most u changes the loss by at most `loss * u` of it, to
    first order. Inputs are the elements that the kernels read before anything is stored to them.

    Attributes:
        loss: Σ |x · ∂L/∂x| / |L| over all inputs; infinite if L is 0 and the sum is not.
        gradient: ‖H diag(x)‖ / ‖g‖ in the Frobenius norm, estimated by products with random
            signs (within a factor of 2 as a rule); None where second derivatives are not to be
            had: inputs without duals, overwritten inputs, kernels without a rule.
        fields: the share of each field in `loss`, by name, largest first.
        overwritten: names of inputs that the kernels overwrite. Their first values are gone, and
            they are left out: `loss` is then a lower bound.
    """

    loss: float
    gradient: float | None
    fields: dict[str, float] = field(default_factory=dict)
    overwritten: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        second = "unknown" if self.gradient is None else f"{self.gradient:.2g}"
        bound = "at least " if self.overwritten else ""
        lines = [f"condition: {bound}{self.loss:.2g} of the loss, {second} of the gradient"]
        lines += [f"  {value:9.2g}  {name}" for name, value in self.fields.items()]
        if self.overwritten:
            lines.append(f"  left out, overwritten: {', '.join(self.overwritten)}")
        return "\n".join(lines)

    __repr__ = __str__


def weigh_inputs(found: Accesses) -> tuple[dict[str, float], list[Any], list[str]]:
    """The fields whose initial values a tape reads, so that their gradients are those of its last
    sweep.

    Returns:
        Σ |x · ∂L/∂x| by the name of the field; the fields; and the names of those that are
        overwritten, which are in neither.
    """
    weights: dict[str, float] = {}
    fields, overwritten = [], []
    mine = {f.symbol for f in own_fields()}
    for symbol, first in found.first.items():
        if symbol not in mine:
            continue
        f = found.known[symbol]
        name = owner_of(f).name
        gradient = Snapshot._take(f._companions["grad"]).astype(np.float64)
        if symbol in found.changed:
            # An element that the host has filled within the tape is no input, and its gradient is
            # 0.
            if gradient[first].any():
                overwritten.append(name)
            continue
        values = Snapshot._take(f).astype(np.float64)
        weights[name] = weights.get(name, 0.0) + float(np.abs(values * gradient)[first].sum())
        fields.append(f)
    return weights, fields, sorted(set(overwritten))


def _ratio(weight: float, size: float) -> float:
    return weight / size if size else (math.inf if weight else 0.0)


def take_condition(core: Any, loss: Any, replay: Callable[[], Any]) -> Condition:
    """The condition numbers of a tape that has been left.

    Args:
        replay: runs it and its reverse sweep again.
    """
    with Snapshot():
        core.clear_gradients()
        core.backward()
        size = abs(float(number_of(loss)))
        weights, fields, overwritten = weigh_inputs(Accesses(core, loss))
        norm = math.hypot(*(np.linalg.norm(Snapshot._take(f._companions["grad"])) for f in fields))
        largest = sorted(weights.items(), key=lambda item: -item[1])
        return Condition(
            _ratio(sum(weights.values()), size),
            None if overwritten else _of_gradient(replay, loss, fields, norm),
            {name: _ratio(weight, size) for name, weight in largest},
            overwritten,
        )


def _of_gradient(
    replay: Callable[[], Any], loss: Any, fields: list[Any], norm: float
) -> float | None:
    owners = list({id(owner_of(f)): owner_of(f) for f in fields}.values())
    generator = np.random.default_rng(3)
    squares = []
    for _ in range(_DIRECTIONS):
        pairs = []
        for f in owners:
            values = f.to_numpy()
            pairs.append((f, values * generator.choice([-1.0, 1.0], values.shape)))
        try:
            products = derivatives_of_gradients(replay, loss, pairs)
        except TaiError:  # no dual, or no rule: `ti.ad.hvp` says which
            return None
        squares.append(sum(float(np.sum(np.square(p, dtype=np.float64))) for p in products))
    return _ratio(math.sqrt(np.mean(squares)), norm)
