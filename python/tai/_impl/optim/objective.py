"""A loss as a function of parameters: a tape that is replayed, or a function of the program."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from ...errors import TaiAutodiffError, TaiRuntimeTypeError
from ..ad.tape import Tape


class Result(NamedTuple):
    """The end of a minimisation.

    Attributes:
        loss: at the parameters that are left.
        gradient: its largest component, by size.
        iterations: steps that were taken.
        evaluations: how often the loss and its gradient were computed.
        reason: why it stopped: `gradient`, `loss`, `iterations`, `line search`, `damping`.
    """

    loss: float
    gradient: float
    iterations: int
    evaluations: int
    reason: str

    @property
    def converged(self) -> bool:
        """Whether a tolerance was reached."""
        return self.reason in ("gradient", "loss")


class Objective:
    """Computes the loss and its gradient at the present parameters.

    Args:
        function: a tape with a loss, or a function that runs one and returns the loss.
        user: for messages.
    """

    def __init__(self, function: Any, user: str):
        self._tape: Tape | None = None
        self._call: Callable[[], Any] | None = None
        self._user, self.evaluations = user, 0
        if isinstance(function, Tape):
            self._tape = function
            self._loss = function.loss if function.loss is not None else function._outer_loss
            if self._loss is None or isinstance(self._loss, (list, tuple)):
                raise TaiRuntimeTypeError(
                    f"{user} takes a tape with one loss", "with ti.ad.Tape(loss) as tape: …"
                )
        elif callable(function):
            self._call = function
        else:
            raise TaiRuntimeTypeError(
                f"{user} takes a tape or a function, but got {function!r}",
                "with ti.ad.Tape(loss) as tape: … ; or a function that runs a tape and returns "
                "the loss",
            )

    def evaluate(self) -> float:
        """Runs the kernels and their gradients.

        Raises:
            TaiRuntimeTypeError: the loss is not one number.
        """
        self.evaluations += 1
        if self._tape is not None:
            self._tape.replay()
            return self._number(self._loss)
        assert self._call is not None
        return self._number(self._call())

    def _number(self, loss: Any) -> float:
        if hasattr(loss, "to_numpy"):
            loss = loss.to_numpy()
        if getattr(loss, "size", 1) == 1 and hasattr(loss, "item"):
            loss = loss.item()
        try:
            return float(loss)
        except (TypeError, ValueError):
            raise TaiRuntimeTypeError(
                f"{self._user}: the loss must be one number, but got {loss!r}",
                "return it from the function: return loss[None]",
            ) from None


def refuse_start(user: str, loss: float, first: str) -> None:
    """Says that nothing can be minimised from here.

    Raises:
        TaiAutodiffError: always.
    """
    raise TaiAutodiffError(
        f"{user}: the loss is {loss:g} at the start" + (f", and {first}" if first else ""),
        "begin where the loss and its gradient are finite; tape.health() says where NaN comes from",
    )
