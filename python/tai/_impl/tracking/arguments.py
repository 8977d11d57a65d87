"""Passes arguments of a launch and their adjoints to the core."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import TaiAutodiffError
from ..base import fitting
from ..base.elements import Elements
from ..interop import device_arrays
from . import tracked
from .tape_arrays import overlap


def as_array(value: Any) -> Any:
    """The NumPy array that shares the memory of `value`, a `DeviceArray`, or None."""
    if isinstance(value, np.ndarray):
        # A subclass of np.ndarray may report any shape, so a plain view is used.
        if type(value) is np.ndarray:
            return value
        fitting.unmasked(value)
        return np.ndarray.view(value, np.ndarray)
    if isinstance(getattr(value, "array", None), (np.ndarray, device_arrays.DeviceArray)):
        return value.array
    if isinstance(value, Elements):  # a field
        return None
    found = device_arrays.as_device_array(value)
    if found is not None:
        return found
    if hasattr(value, "detach") and hasattr(value, "numpy"):  # a torch tensor
        device_arrays.numpy_type(value.dtype)
        return device_arrays.host_view(value)
    if hasattr(value, "__dlpack__") and hasattr(value, "dtype") and hasattr(value, "ndim"):
        return device_arrays.from_exporter(value)  # of jax, on the CPU
    return None


def find_alias(spec: Any, value: Any, values: list[Any], specs: list[Any]) -> int | None:
    """The number of an earlier array argument that is the same object, if the argument has a
    gradient; otherwise None.
    """
    if not spec.has_gradient:
        return None
    for number, other in enumerate(specs[:-1]):
        if other.kind == "array" and other.alias is None and values[number] is value:
            same = (other.ndim, other.element_shape) == (spec.ndim, spec.element_shape)
            return number if same else None
    return None


def adjoint_slots(found: Any, values: list, tape: Any) -> tuple[list, Any]:
    """Returns the memory for the adjoints of arguments and of the result, and the gradient of the
    result.
    """
    slots: list[int] = []

    def add(buffer: np.ndarray) -> None:
        slots.extend([buffer.ctypes.data, *buffer.shape])

    for spec, value in zip(found.specs, values, strict=True):
        if not spec.has_gradient or spec.alias is not None:
            continue
        if spec.kind == "array":
            buffer = tracked.gradient_array(value)
            if tape is not None:
                tape.arrays.use_gradient(value, buffer)
            add(buffer)
            continue
        gradient = tracked.gradient_of(value)
        assert gradient is not None
        add(gradient.buffer(spec.dt) if tape is None else tape.argument(gradient, spec.dt))
    result = found.result_spec
    if result is None or not result.has_gradient:
        return slots, None
    if tape is None:  # the gradient is run by hand, and nothing depends on the result
        buffer = np.zeros(result.shape, result.dt.numpy)
        found.zero = buffer
        add(buffer)
        return slots, None
    gradient, buffer = tape.result(result.shape, result.dt)
    add(buffer)
    return slots, gradient


def check_arrays(kernel: str, parameters: list, found: Any, values: list) -> None:
    """Refuses array arguments that cannot be differentiated correctly."""
    names = [parameter.name for parameter in parameters]
    arrays = []
    for name, spec, value in zip(names, found.specs, values, strict=True):
        if spec.uses_gradient:
            raise TaiAutodiffError(
                f"kernel '{kernel}' uses the gradient of array '{name}' and cannot be "
                "differentiated",
                "call it outside of the tape, or under ti.ad.no_grad",
            )
        if spec.is_constant and spec.is_written:
            raise TaiAutodiffError(
                f"kernel '{kernel}' writes array '{name}', whose annotation has needs_grad=False: "
                "the gradient of the numbers that it overwrites would be wrong",
                "leave needs_grad out, or call the kernel under ti.ad.no_grad",
            )
        if spec.kind == "array" and spec.alias is None:
            arrays.append((name, spec, as_array(value)))
    for number, (name, spec, array) in enumerate(arrays):
        for other, other_spec, other_array in arrays[:number]:
            differentiated = spec.has_gradient or other_spec.has_gradient
            if differentiated and overlap(array, other_array):
                raise TaiAutodiffError(
                    f"arrays '{other}' and '{name}' of kernel '{kernel}' overlap, and "
                    "one has a gradient",
                    "pass the same array for both, or a copy",
                )
