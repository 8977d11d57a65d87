"""Kernels that are methods of a class."""

from __future__ import annotations

from typing import Any


class BoundKernel:
    """A kernel of a class, bound to an instance."""

    __slots__ = ("_instance", "_kernel")
    _tai_kernel = True

    def __init__(self, kernel: Any, instance: Any):
        self._kernel, self._instance = kernel, instance

    def __repr__(self) -> str:
        return f"<{self._kernel!r} of {self._instance!r}>"

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        return self._kernel(self._instance, *args, **kwargs)

    @property
    def grad(self) -> BoundKernel:
        return BoundKernel(self._kernel.grad, self._instance)

    @property
    def __self__(self) -> Any:
        return self._instance

    def mlir(self, *args: Any, stage: str = "tai") -> str:
        """The IR; see `Kernel.mlir`."""
        return self._kernel.mlir(self._instance, *args, stage=stage)

    def explain(self, *args: Any) -> str:
        """Describes the gradient in words; see `Kernel.explain`."""
        return self._kernel.explain(self._instance, *args)

    def compile(self, *args: Any, grad: bool = False) -> None:
        """Compiles the kernel; see `Kernel.compile`."""
        self._kernel.compile(self._instance, *args, grad=grad)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._kernel, name)
