"""A loss as a function of parameters: a tape that is replayed, or a function of the program."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from ...errors import TaiAutodiffError, TaiRuntimeTypeError
from ..ad.tape import Tape
from ..launch.bound_kernel import BoundKernel
from ..launch.kernels import Kernel
from .parameters import Parameter, refuse_losses


class Result(NamedTuple):
    """The result of a minimisation.

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
        """Whether a tolerance was reached, and not another limit."""
        return self.reason in ("gradient", "loss")


class Objective:
    """Computes the loss and its gradient at the present values of the parameters.

    Args:
        function: a tape with a loss, or a function that runs one and returns the loss.
        user: the name of the calling function, for messages.
        parameters: whose gradient it computes.
    """

    def __init__(self, function: Any, user: str, parameters: list[Parameter]):
        self._parameters = parameters
        self._tape: Tape | None = None
        self._call: Callable[[], Any] | None = None
        self._user, self.evaluations = user, 0
        if isinstance(function, Tape):
            self._tape = function
            function._note_use()
            self._loss = function.loss if function.loss is not None else function._outer_loss
            if self._loss is None or isinstance(self._loss, (list, tuple)):
                raise TaiRuntimeTypeError(
                    f"{user} takes a tape with one loss", "with ti.ad.Tape(loss) as tape: …"
                )
            refuse_losses(parameters, [self._loss], user)
        elif isinstance(function, Kernel | BoundKernel):
            raise TaiRuntimeTypeError(
                f"{user} takes a tape or a function that runs one, but got kernel "
                f"'{function.__name__}'",
                f"with ti.ad.Tape(loss) as tape: {function.__name__}() ; and give it the tape",
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
        """Computes the loss and the gradient by running the kernels and their adjoints.

        Raises:
            TaiRuntimeTypeError: the loss is not one number.
            TaiAutodiffError: the function has computed no gradient.
        """
        self.evaluations += 1
        if self._tape is not None:
            self._tape.replay()
            return self._number(self._loss)
        assert self._call is not None
        if self.evaluations > 1:
            return self._number(self._call())
        # The gradients are cleared, because gradients of an earlier tape would be taken for those
        # of the function.
        for parameter in self._parameters:
            parameter.value.grad.fill(0)
        sweeps = Tape.sweeps
        loss = self._number(self._call())
        if Tape.sweeps != sweeps:
            refuse_losses(self._parameters, Tape._get_swept_losses(), self._user)
        if Tape.sweeps == sweeps and not any(
            parameter.value.grad.to_numpy().any() for parameter in self._parameters
        ):
            raise TaiAutodiffError(
                f"{self._user}: the function ran no tape, so its loss has no gradient",
                "launch the kernels in a tape: with ti.ad.Tape(loss): simulate()",
            )
        return loss

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
                "run a tape in the function, and return its loss: return loss[None]",
            ) from None


def refuse_start(user: str, loss: float, first: str) -> None:
    """Raises an error because no minimisation can begin at this loss.

    Raises:
        TaiAutodiffError: always.
    """
    raise TaiAutodiffError(
        f"{user}: the loss is {loss:g} at the start" + (f", and {first}" if first else ""),
        "begin where the loss and its gradient are finite; tape.health() says where NaN comes from",
    )
