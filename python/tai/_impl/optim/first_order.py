"""Optimisers that follow the gradient: SGD and Adam."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from ...errors import TaiAutodiffError, TaiRuntimeError, TaiRuntimeTypeError
from ..ad.tape import Tape
from ..base import dtypes
from ..fields.active import active_elements, write_elements
from ..fields.make import make_field
from .kernels import COUNTS, IS_BAD, KEPT, SKIPPED, STEPS, get_kernels
from .parameters import check_number, check_outside, check_parameters, refuse_losses

_LARGEST = {"f64": sys.float_info.max, "f32": 3.4028234663852886e38, "bf16": 3.3895313892515355e38,
            "f16": 65504.0}  # fmt: skip


class Optimizer:
    """Base of methods that change parameters after their gradient is known.

    Attributes:
        lr: the learning rate; may be changed between steps.
        nonfinite: `raise` or `skip`.
    """

    # The names of the values that the method keeps for each element of a parameter.
    _memories: tuple[str, ...] = ()

    def __init__(self, parameters: Any, lr: float, nonfinite: str):
        self._user = f"ti.optim.{type(self).__name__}"
        self.lr = lr
        if nonfinite not in ("raise", "skip"):
            raise TaiRuntimeTypeError(
                f"{self._user}: nonfinite must be 'raise' or 'skip', but got {nonfinite!r}"
            )
        self.nonfinite = nonfinite
        self._parameters = check_parameters(parameters, self._user)
        self._memory = [
            {what: p.memory(f"{what}_{number}") for what in self._memories}
            for number, p in enumerate(self._parameters)
        ]
        self._counts: Any = make_field((), dtypes.i32, COUNTS, None, "optim_counts", None,
                                       False, False)  # fmt: skip
        self._factors: Any = make_field((), dtypes.f64, 2, None, "optim_factors", None,
                                        False, False)  # fmt: skip
        self._counts.materialize()
        self._factors.materialize()
        self._kept = 0

    def __repr__(self) -> str:
        names = ", ".join(getattr(value, "name", "an array") for value in self.parameters)
        return f"<{self._user} of {names}, lr {self.lr:g}>"

    @property
    def lr(self) -> float:
        return self._rate

    @lr.setter
    def lr(self, value: float) -> None:
        self._rate = check_number(f"ti.optim.{type(self).__name__}", "lr", value, 0.0)

    @property
    def parameters(self) -> list[Any]:
        """The fields and arrays that the method changes."""
        return [p.value for p in self._parameters]

    @property
    def steps(self) -> int:
        """How many steps were taken, without skipped ones; waits for the device."""
        return int(self._counts[STEPS])

    @property
    def skipped(self) -> int:
        """How many steps were left out as a gradient was not finite; waits for the device."""
        return int(self._counts[SKIPPED])

    def zero_grad(self) -> None:
        """Sets the gradients of the parameters to zero."""
        for p in self._parameters:
            p.value.grad.fill(0)

    def step(self) -> None:
        """Changes the parameters by their gradients, as the last reverse sweep left them.

        Raises:
            TaiAutodiffError: a gradient is NaN or infinite (with `nonfinite="raise"`), a tape
                records, or the loss of the last sweep is a parameter. Then neither the parameters
                nor the state have changed.
            TaiRuntimeError: an element would leave the range of its type; it keeps its value.
        """
        check_outside(f"{self._user}.step()")
        refuse_losses(self._parameters, Tape._get_swept_losses(), f"{self._user}.step()")
        k = get_kernels()
        for p in self._parameters:
            largest = _LARGEST[p.dtype.name]
            if p.is_array:
                k.of_arrays.count(p.flat("grad"), self._counts, largest)
            else:
                k.of_fields.count(p.value.grad, self._counts, largest)
        self._update()
        if self.nonfinite == "raise":
            self._check()

    def _update(self) -> None:
        raise NotImplementedError

    def _check(self) -> None:
        counts = self._counts.to_numpy()
        if counts[IS_BAD]:
            found = filter(None, (p.first_not_finite() for p in self._parameters))
            raise TaiAutodiffError(
                f"{self._user}: {next(found, 'a gradient is not finite')}; the step is left out, "
                "and nothing has changed",
                "tape.health() says where it comes from; nonfinite='skip' leaves such steps out "
                "silently",
            )
        if counts[KEPT] != self._kept:
            number, self._kept = int(counts[KEPT]) - self._kept, int(counts[KEPT])
            raise TaiRuntimeError(
                f"{self._user}: the step with lr={self.lr:g} leaves the range of the type at "
                f"{number} element{'s' * (number > 1)}, which kept their values",
                "choose a smaller lr",
            )

    # State

    def __reduce_ex__(self, protocol: Any) -> Any:
        raise TaiRuntimeTypeError(
            f"{self._user} cannot be copied or pickled: its memory belongs to the program",
            "pickle its state_dict(), and load_state_dict(…) into a new one",
        )

    def _numbers(self) -> dict[str, Any]:
        return {"lr": self.lr}

    def state_dict(self) -> dict[str, Any]:
        """All that it has learned: numbers and NumPy arrays, which can be pickled."""
        return {
            "kind": type(self).__name__, **self._numbers(), "steps": self.steps,
            "skipped": self.skipped,
            "memory": [{n: f.to_numpy() for n, f in m.items()} for m in self._memory],
        }  # fmt: skip

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Goes on from the state of another optimiser of this kind, with parameters alike.

        Raises:
            TaiRuntimeTypeError: the state is that of another kind, or of other shapes.
        """
        check_kind(self, state)
        memory = state["memory"]
        if [{n: a.shape for n, a in m.items()} for m in memory] != [
            {n: tuple(f.shape) + tuple(f.element_shape) for n, f in m.items()} for m in self._memory
        ]:
            raise TaiRuntimeTypeError(
                f"{self._user}: the state belongs to parameters of other shapes",
                "make the optimiser with the same parameters, in the same order",
            )
        for own, given, p in zip(self._memory, memory, self._parameters, strict=True):
            for name, field in own.items():
                if p.is_sparse:
                    _store_active(p.value, field, given[name])
                else:
                    field.from_numpy(given[name])
        for name in self._numbers():
            setattr(self, name, state[name])
        counts = np.zeros(COUNTS, np.int32)
        counts[STEPS], counts[SKIPPED] = state["steps"], state["skipped"]
        self._counts.from_numpy(counts)
        self._kept = 0


def check_kind(optimizer: Any, state: Any) -> None:
    """Refuses a state that another kind of optimiser has saved."""
    kind = type(optimizer).__name__
    if not isinstance(state, dict) or state.get("kind") != kind:
        got = state.get("kind") if isinstance(state, dict) else type(state).__name__
        raise TaiRuntimeTypeError(
            f"ti.optim.{kind} loads the state of a ti.optim.{kind}, but got {got!r}",
            "optimizer.load_state_dict(other.state_dict())",
        )


def _store_active(like: Any, field: Any, values: np.ndarray) -> None:
    """Stores the numbers of the elements that are active in the parameter."""
    parts = getattr(like, "parts", None) or [like]
    where = active_elements(parts[0])
    assert where is not None
    at = tuple((where - np.array(like.offset or (0,) * where.shape[1])).T)
    targets = getattr(field, "parts", None) or [field]
    if len(targets) == 1:
        write_elements(targets[0], where, np.ascontiguousarray(values[at]))
        return
    for target, index in zip(targets, np.ndindex(*field.element_shape), strict=True):
        write_elements(target, where, np.ascontiguousarray(values[(*at, *index)]))


class SGD(Optimizer):
    """Gradient descent, with momentum if wanted: m = momentum m + g, x -= lr m.

    ```python
    optimizer = ti.optim.SGD([x], lr=0.1, momentum=0.9)
    with ti.ad.Tape(loss) as tape:
        simulate()
    optimizer.step()
    for _ in range(100):
        tape.replay()
        optimizer.step()
    ```

    Args:
        parameters: a field or `ti.ndarray` with a gradient, or a list of them.
        lr: the learning rate.
        momentum: the weight of earlier gradients, from 0 to below 1.
        nesterov: look ahead: x -= lr (g + momentum m).
        nonfinite: for a gradient that is NaN or infinite, `raise` or `skip` the step. Either
            way nothing changes; `skip` does not wait for the device.
    """

    def __init__(
        self, parameters: Any, lr: float = 1e-2, momentum: float = 0.0, nesterov: bool = False,
        nonfinite: str = "raise",
    ):  # fmt: skip
        self.momentum = check_number("ti.optim.SGD", "momentum", momentum, 0.0, 1.0)
        self.nesterov = bool(nesterov)
        if self.nesterov and not self.momentum:
            raise TaiRuntimeTypeError(
                "ti.optim.SGD: nesterov=True needs a momentum", "ti.optim.SGD(x, momentum=0.9)"
            )
        self._memories = ("mean",) if self.momentum else ()
        super().__init__(parameters, lr, nonfinite)

    def _numbers(self) -> dict[str, Any]:
        return {"lr": self.lr, "momentum": self.momentum, "nesterov": self.nesterov}

    def _update(self) -> None:
        k = get_kernels()
        k.advance(self._counts, self._factors, 0.0, 0.0)
        for p, memory in zip(self._parameters, self._memory, strict=True):
            limit = _LARGEST[p.value.dtype.name]
            rest = (self._counts, self.momentum, self.lr, self.nesterov, bool(memory), limit)
            if p.is_array:
                # Without momentum, the kernel does not access the memory of momentum.
                mean = memory["mean"].array.reshape(-1) if memory else p.flat("grad")
                k.of_arrays.sgd(p.flat(), p.flat("grad"), mean, *rest)
            else:
                k.of_fields.sgd(p.value, p.value.grad, memory.get("mean", p.value.grad), *rest)


class Adam(Optimizer):
    """Adam: steps of about `lr`, whatever the size of the gradients.

    ```python
    optimizer = ti.optim.Adam([x, v], lr=0.01)
    ```

    It keeps the root of the second moment, and scales gradients before it squares them: so
    gradients of 1e30 or 1e-30 in f32 are as good as others.

    Args:
        parameters: a field or `ti.ndarray` with a gradient, or a list of them.
        lr: the learning rate.
        betas: the weights of earlier gradients, and of their squares.
        eps: added to the root of the second moment.
        nonfinite: for a gradient that is NaN or infinite, `raise` or `skip` the step. Either
            way nothing changes; `skip` does not wait for the device.
    """

    _memories = ("mean", "root")

    def __init__(
        self, parameters: Any, lr: float = 1e-3, betas: tuple[float, float] = (0.9, 0.999),
        eps: float = 1e-8, nonfinite: str = "raise",
    ):  # fmt: skip
        if not isinstance(betas, (list, tuple)) or len(betas) != 2:
            raise TaiRuntimeTypeError(
                f"ti.optim.Adam: betas must be two numbers, but got {betas!r}", "betas=(0.9, 0.999)"
            )
        self.betas = (
            check_number("ti.optim.Adam", "betas[0]", betas[0], 0.0, 1.0),
            check_number("ti.optim.Adam", "betas[1]", betas[1], 0.0, 1.0),
        )
        self.eps = check_number("ti.optim.Adam", "eps", eps, 1e-30)
        super().__init__(parameters, lr, nonfinite)

    def _numbers(self) -> dict[str, Any]:
        return {"lr": self.lr, "betas": self.betas, "eps": self.eps}

    def _update(self) -> None:
        k = get_kernels()
        k.advance(self._counts, self._factors, *self.betas)
        for p, memory in zip(self._parameters, self._memory, strict=True):
            limit = _LARGEST[p.value.dtype.name]
            rest = (self._counts, self._factors, *self.betas, self.lr, self.eps, limit)
            if p.is_array:
                mean, root = (memory[what].array.reshape(-1) for what in self._memories)
                k.of_arrays.adam(p.flat(), p.flat("grad"), mean, root, *rest)
            else:
                k.of_fields.adam(p.value, p.value.grad, memory["mean"], memory["root"], *rest)
