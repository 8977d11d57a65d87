"""A launch: packs arguments into slots, passes arrays and gradients to the tape, and calls."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import TaiRuntimeTypeError
from ..base import native
from ..history import origins, torch_graphs
from ..interop import device_arrays
from ..tracking import tangents, tracked
from ..tracking.arguments import adjoint_slots, as_array, check_arrays
from ..tracking.tape_arrays import HeldArray, check_overlaps, check_written_view, is_same_array
from .signature import Signature
from .slots import number_slot
from .specialization import Specialization
from .struct_results import StructResult


def pack(
    signature: Signature, found: Specialization, values: list[Any], tracks: bool
) -> tuple[list[int], list[HeldArray]]:
    """Packs the arguments of a launch into slots; returns also all arrays."""
    slots: list[int] = []
    kept: list[HeldArray] = []
    pairs = zip(signature.parameters, found.specs, values, strict=True)
    for parameter, spec, value in pairs:
        if spec.kind == "scalar":
            slots.append(number_slot(signature.kernel, parameter.name, spec.dt, value))
        elif spec.kind == "matrix":
            array = np.asarray(value)
            if array.shape != spec.shape:
                raise TaiRuntimeTypeError(
                    f"argument '{parameter.name}' of kernel '{signature.kernel}' expects "
                    f"{parameter.type!r}, but got shape {array.shape}"
                )
            slots += [
                number_slot(signature.kernel, parameter.name, spec.dt, x.item())
                for x in array.ravel()
            ]
        elif spec.kind == "array" and spec.alias is None:
            array = as_array(value)
            is_read, is_written = found.uses_of(spec)
            if is_written and not array.flags.writeable:
                raise TaiRuntimeTypeError(
                    f"argument '{parameter.name}' of kernel '{signature.kernel}' is written, "
                    "but the array is read-only",
                    "arrays of JAX do not change: pass np.array(x), or wrap the kernel by "
                    "ti.jax.wrap, which returns new ones"
                    if device_arrays.is_of_jax(value)
                    else "pass a copy: array.copy()",
                )
            if isinstance(array, device_arrays.DeviceArray):
                array.check(f"argument '{parameter.name}' of kernel '{signature.kernel}'")
            if is_written:
                check_written_view(signature.kernel, parameter.name, value, array)
            launched = array
            if not array.flags.c_contiguous:
                same = (h.launched for h in kept if is_same_array(h.array, array))
                launched = next(same, None)
                if launched is None:
                    launched = np.array(array, order="C")
            kept.append(
                HeldArray(parameter.name, signature.kernel, value, array, launched, len(slots),
                          is_read, is_written, spec.has_gradient)
            )  # fmt: skip
            slots += [launched.ctypes.data, *array.shape]
            if spec.has_gradient:
                # A gradient of a torch tensor is only made if it is needed: a kernel that does not
                # use the gradient gets the array itself in its place.
                looks = tracks or spec.uses_gradient
                grad = tracked.gradient_array(value) if looks else launched
                slots += [grad.ctypes.data, *grad.shape]
    return slots, kept


def _register(
    launcher: Any, signature: Signature, found: Specialization, grad: bool, cuts_graph: bool
) -> None:
    """Makes a launcher know a specialisation, if it can launch it without Python."""
    descriptions = [spec.description(cuts_graph) for spec in found.specs]
    wants_gradients = any(s.has_gradient and s.kind != "array" for s in found.specs)
    result = found.result_spec
    if (
        None not in descriptions
        and not (found.followed or found.result_pool)
        and not wants_gradients
        and not signature.structs  # one argument, several slots
        and not isinstance(signature.result, StructResult)
        and not (grad and result is not None and result.has_gradient)
    ):
        native.add_specialization(
            launcher, found.core, grad, descriptions, found.result, found.tracking, found.reads
        )
        found.registered.add(grad)


def launch(
    launcher: Any, signature: Signature, found: Specialization, values: list[Any], grad: bool,
    tracks: bool,
) -> Any:  # fmt: skip
    """Launches a specialisation of a kernel.

    Args:
        launcher: the kernel, or its gradient; it caches specialisations that it can launch by
            itself.
        signature, found: of the kernel, and the code compiled for these arguments.
        values: one for each parameter.
        grad: whether to run the gradient.
        tracks: whether adjoints of arguments and of the result have a place.

    Returns:
        The result of the kernel.
    """
    slots, kept = pack(signature, found, values, tracks)
    if tracks:
        check_arrays(signature.kernel, signature.parameters, found, values)
    if len(kept) > 1:
        check_overlaps(kept, tracks)
    cuts_graph = torch_graphs.cuts_graph(found.specs, found.result_spec)
    if cuts_graph and not tracks:
        torch_graphs.warn_of_a_cut(
            launcher, signature.kernel, signature.parameters, values, found.specs
        )
    if grad not in found.registered:
        _register(launcher, signature, found, grad, cuts_graph)
    result = found.result_spec
    others = [held.array for held in kept if isinstance(held.array, device_arrays.DeviceArray)]
    streams = device_arrays.order_before(others) if others else None
    tape: Any = tracked.recording()
    slots += [tangents.cell_of(values[number]).first for number in found.followed]
    cell = None
    if found.result_pool is not None and result is not None:
        count = int(np.prod(result.shape, dtype=int))
        cell = tangents.Cell(found.result_pool, count)
        slots.append(cell.first)
    gradient = None
    if tape is not None:
        origins.check_views()
    if tape is not None and kept and not grad:
        # Integers have no derivative.
        arrays = {
            h.name: h.value for h in kept
            if h.is_read and not h.has_gradient and h.array.dtype.kind not in "iub"
        }  # fmt: skip
        origins.check_arrays(launcher, [p.name for p in signature.given], arrays)
    try:
        for held in kept if tape is not None else ():
            is_read = found.core.reads_in_reverse(held.slot)
            ends = held.is_written and found.core.ends_gradients(held.slot)
            held = held._replace(is_read_in_reverse=is_read, ends_gradients=ends)
            launched = tape.arrays.use(held)
            slots[held.slot] = launched.ctypes.data
            if ends:
                origins.note_stored(held.value)
        if tracks:
            adjoints, gradient = adjoint_slots(found, values, tape)
            slots += adjoints
        answer = native.launch_slots(found.core, grad, slots, found.result)
        if streams:
            device_arrays.order_after(streams)
        for held in kept:
            if held.launched is not held.array and held.is_written and not grad:
                held.array[...] = held.launched
        if tape is not None and kept:
            tape.arrays.after_launch()
    finally:
        if tape is not None and kept:
            tape.arrays.forget_launch()
    is_followed = gradient is not None or cell is not None
    if not grad and is_followed:
        origins.begin()
        answer = tracked.wrap_result(answer, gradient, cell)
    if not grad and isinstance(signature.result, StructResult):
        return signature.result.unpack(answer, is_followed)
    return answer
