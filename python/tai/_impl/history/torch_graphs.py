"""Borders between the gradients of torch and those of kernels.

Torch differentiates the results of its own functions. A launch is none of them: a tape adds to
`grad` of a leaf, which torch leaves alone, and a launch without a tape is a constant to torch.
"""

from __future__ import annotations

import sys
from typing import Any

from ...errors import TaiAutodiffError
from ..base import native
from ..base.callers import calling_frame
from . import origins

_RECIPE = "tai.torch.wrap, or torch.autograd.Function: see docs/guides/torch.md"


def check_leaf(value: Any, what: str) -> None:
    """Raises an error if a launch is differentiated by a tensor that torch has computed.

    Its gradient would be added to a `grad` that torch does not pass on.

    Args:
        value: an argument of a launch.
        what: says which one.

    Raises:
        TaiAutodiffError: the tensor requires a gradient and is no leaf of torch's graph.
    """
    if getattr(value, "requires_grad", False) is True and getattr(value, "is_leaf", True) is False:
        raise TaiAutodiffError(
            f"{what} is a tensor that torch computed from others, which its gradient would not "
            "reach",
            f"make the kernel a function of torch ({_RECIPE}); or pass the leaf that it was "
            "computed from, and compute the rest in a kernel",
        )


def cuts_graph(specs: list[Any], result: Any) -> bool:
    """Whether a launch loses a gradient: it reads a tensor that requires one, and leaves values
    that depend on it where torch does not know of the dependence.
    """
    if not any(spec.has_gradient and spec.kind == "array" and spec.is_read for spec in specs):
        return False
    if result is not None and result.dt.is_float:
        return True
    return any(
        spec.kind == "array" and spec.is_written and spec.dt.is_float and not spec.has_gradient
        for spec in specs
    )


def is_grad_enabled() -> bool:
    """Whether torch records the current computations."""
    torch = sys.modules.get("torch")
    return torch is not None and torch.is_grad_enabled()


def warn_of_a_cut(launcher: Any, kernel: str, parameters: list, values: list, specs: list) -> None:
    """Warns, once for each line, that a launch without a tape interrupts a graph of torch's
    autograd.

    Args:
        launcher: the kernel, which need not come here again from this line.
        kernel: its name.
        parameters, values, specs: of the launch; see `cuts_graph`.
    """
    if not is_grad_enabled():
        return
    frame = calling_frame()
    if frame is None:
        return
    native.note_graph_site(frame.f_code, frame.f_lineno, launcher)
    if not origins.is_new_place(frame, launcher):
        return
    torch = sys.modules["torch"]
    names = [
        parameter.name
        for parameter, value, spec in zip(parameters, values, specs, strict=True)
        if spec.has_gradient and spec.is_read and isinstance(value, torch.Tensor)
    ]
    if names:
        origins.warn_at(
            frame,
            f"kernel '{kernel}' reads '{names[0]}', a tensor that requires a gradient, and no tape "
            "records: to torch, what the kernel computes is a constant. For its gradient, make the "
            f"kernel a function of torch ({_RECIPE}) or launch it in a ti.ad.Tape; if a constant "
            f"is meant, launch it under torch.no_grad() or pass {names[0]}.detach()",
        )


def warn_of_a_copy(field: Any, tensor: Any) -> None:
    """Warns, once for each line, that a field takes numbers from a graph of torch's autograd."""
    if getattr(tensor, "requires_grad", False) is not True or not is_grad_enabled():
        return
    frame = calling_frame()
    if frame is not None and origins.is_new_place(frame, warn_of_a_copy):
        origins.warn_at(
            frame,
            f"field '{field.name}' takes the numbers of a tensor that requires a gradient, and the "
            f"gradient ends there. For it, make the kernels a function of torch ({_RECIPE}); if "
            "a constant is meant, pass tensor.detach()",
        )
