"""Computations of torch within functions whose operators are differentiated by kernels alone."""

from __future__ import annotations

import warnings
from typing import Any

import torch
from torch.utils._python_dispatch import TorchDispatchMode

from ...errors import TaiGradientWarning
from ..base.callers import calling_frame

# Operations that use no elements of the tensors that they take.
_PREFIXES = ("new_", "empty", "zeros", "ones", "full", "rand")
_NAMES = {"zero_", "fill_", "detach", "detach_", "alias"}


class ComputationWatch(TorchDispatchMode):
    """Warns where a function computes with torch what depends on its inputs or on its kernels.

    A launch detaches the tensors that it takes, which tells tensors that kernels write from
    constants that the function makes.
    """

    def __init__(self, name: str, inputs: list[torch.Tensor]):
        super().__init__()
        self._name = name
        self._storages = {_storage_of(tensor) for tensor in inputs}

    def __torch_dispatch__(
        self, function: Any, types: Any, args: Any = (), kwargs: Any = None
    ) -> Any:
        answer = function(*args, **(kwargs or {}))
        name = function._schema.name.split("::")[-1]
        tensors = [a for a in args if isinstance(a, torch.Tensor) and a.is_floating_point()]
        if name.startswith("detach"):
            self._storages.update(map(_storage_of, tensors))
        elif not self._is_free(function, name, answer) and any(
            _storage_of(tensor) in self._storages for tensor in tensors
        ):
            self._warn(name)
        return answer

    @staticmethod
    def _is_free(function: Any, name: str, answer: Any) -> bool:
        """Whether an operation has no gradient that could be lost: it makes a tensor from the form
        of another one, a view, or a number."""
        if name in _NAMES or name.startswith(_PREFIXES) or name.endswith("_like"):
            return True
        aliases = [r.alias_info for r in function._schema.returns]
        is_view = any(alias is not None and not alias.is_write for alias in aliases)
        return is_view or not (isinstance(answer, torch.Tensor) and answer.is_floating_point())

    def _warn(self, name: str) -> None:
        frame = calling_frame()
        while frame is not None and frame.f_globals.get("__name__", "").startswith("torch."):
            frame = frame.f_back
        if frame is not None:
            warnings.warn_explicit(
                f"'{self._name}' computes with torch ({name}), and the gradient of its operator "
                "is by its kernels alone: compute it in a kernel, or outside of the function",
                TaiGradientWarning,
                frame.f_code.co_filename,
                frame.f_lineno,
            )


def _storage_of(tensor: torch.Tensor) -> int:
    return tensor.untyped_storage().data_ptr()
