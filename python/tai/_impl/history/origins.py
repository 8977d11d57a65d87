"""Warnings for numbers whose derivatives a tape or forward mode cannot track.

A number that a kernel returns is tracked through arithmetic. The results of `math.sin(r)`,
`float(r)`, NumPy, and reads of fields are plain numbers, which are constants to kernels and fields.
That is right for numbers that are printed, but gradients miss a contribution if such a number is
passed to a kernel or stored in a field. So when that happens while tracked values are alive, the
source of the calling function is analysed, once for each place: is the number computed from one?
"""

from __future__ import annotations

import threading
import warnings
from typing import Any

import numpy as np

from ...errors import TaiGradientWarning
from ..base import native, state
from ..base.callers import calling_frame
from ..base.program import at_close
from . import marks, numbers
from .followed import carries_history, has_history, is_followed, is_marked
from .marks import Mark
from .texts import Reading, callers

# Program locations that have been checked, identified by the addresses of code objects and of the
# objects that the code uses; the objects are kept alive, so that their addresses are not reused.
_sites: set[tuple[Any, ...]] = set()
_kept: dict[int, Any] = {}
# Program locations for which the answer depends on the arguments that the callers have given.
_asking: set[tuple[int, int]] = set()
# The most locations that are remembered. Only programs that generate code all the time have more.
_MOST_SITES = 4096


class _OfThread(threading.local):
    def __init__(self) -> None:
        self.watches = False
        # The code object that has opened the tape, and the line where it did.
        self.recording: Any = None
        self.opened = 0
        # Fields of which other libraries have views, with the owners of their memory; the tape
        # object that watches these fields, and whether it compares all of them.
        self.views: list[tuple[Any, Any]] = []
        self.watching: tuple[Any, bool] | None = None


_of_thread = _OfThread()


def begin() -> None:
    """Begins to follow values: a value with a gradient has come to Python."""
    if not _of_thread.watches and (state.tape is not None or state.forward):
        _of_thread.watches = True
        native.watch_numbers(True)


def end() -> None:
    """Ends the following of values: nothing is recorded any more."""
    marks.clear()
    numbers.clear()
    _of_thread.watching, _of_thread.opened = None, 0
    if _of_thread.views:
        native.watch_views(None, [], False, None, False)
        _of_thread.views.clear()
    if _of_thread.watches:
        _of_thread.watches = False
        native.watch_numbers(False)


def forget() -> None:
    """Forgets the lines that were looked at, when the program is over."""
    end()
    _forget_sites()


at_close.append(forget)


def _forget_sites() -> None:
    _sites.clear()
    _kept.clear()
    _asking.clear()
    native.forget_sites()


def dual_of_written(field: Any) -> Any:
    """The dual of a place that Python writes to in forward mode, if its tangent ends there.

    A value that Python writes is a constant, but before the first launch it is the point at which
    one differentiates.
    """
    dual = field._companions.get("dual")
    ends = native.forward_launches() > 0 and getattr(dual, "_core", None) is not None
    return dual.core if ends else None


def end_tangent(field: Any) -> None:
    """Ends the tangent of a field, because Python has overwritten the whole field."""
    dual = dual_of_written(field) if state.forward else None
    if dual is not None:
        dual.fill(0.0)


def note_read(field: Any) -> None:
    """Called when Python reads a field under a tape or in forward mode."""
    if not _of_thread.watches and has_history(field):
        begin()


def note_number(field: Any, value: Any) -> Any:
    """Python reads a number of a field; to be called under a tape or in forward mode.

    Returns:
        The number.
    """
    if has_history(field):
        begin()
        numbers.note(value)
    return value


def note_tape(tape: Any, looks_at_all: bool) -> None:
    """Notes that a tape begins to record.

    Args:
        tape: the core.
        looks_at_all: whether all of a view is compared between launches, or a few pieces.
    """
    frame = calling_frame()
    _of_thread.recording = None if frame is None else frame.f_code
    _of_thread.opened = 0 if frame is None else frame.f_lineno
    _of_thread.watching = (tape, looks_at_all)
    if marks.has_views():
        begin()
        _watch_views()


def _watch_views() -> None:
    """Watches the memory of fields that other libraries may write to between launches."""
    watching, program = _of_thread.watching, state.program
    if watching is None or program is None:
        return
    tape, looks_at_all = watching
    # A view that no longer exists may have been written to before.
    former = {id(field): (field, owner) for field, owner in _of_thread.views}
    views, memory = [], []
    for field, extent in [*marks.viewed()]:
        if has_history(field):
            known = former.get(id(field))
            views.append(known or (field, field._lend_memory()))
            count = (extent.end - extent.begin - extent.size) // extent.step + 1
            memory.append((extent.begin, extent.size, extent.step, count))
    native.watch_views(tape, memory, looks_at_all, program.context, tape.records > 0)
    _of_thread.views = views


def check_views() -> None:
    """Looks for writes to fields through views since the last recorded launch."""
    changed = native.take_changed_views() if _of_thread.views else ()
    frame = calling_frame() if changed else None
    fields = [_of_thread.views[number][0] for number in changed]
    if frame is None or not is_new_place(frame, fields[0]):
        return
    # Elements of fields that share cells are interleaved in memory.
    names = " or ".join(f"'{field.name}'" for field in fields)
    warn_at(
        frame,
        f"field {names} was written through a view of it (DLPack) after a kernel had been "
        "recorded: the tape does not see such writes, and the gradient is wrong if that kernel "
        "has used these elements. Write to the field in a kernel or by from_numpy or from_torch, "
        "or before the tape begins",
    )


def note_view(field: Any, loan: Any, address: int, steps: tuple[int, ...]) -> None:
    """Notes that another library has got a view of the memory of a field.

    Args:
        field, loan: which, and an object that lives as long as the view.
        address, steps: of its first element, and the bytes from index to index.
    """
    extents = (*field.shape, *field.element_shape)
    if 0 in extents or not field.dtype.is_float or not field._companions:
        return
    pairs = zip(extents, steps, strict=True)
    marks.mark_view(field, marks.made_of(address, field.dtype.bits // 8, pairs), loan)
    if state.tape is not None or state.forward:
        note_read(field)
    if state.tape is not None:
        # Writes made before this view existed are reported first.
        check_views()
        _watch_views()


def note_stored(array: Any) -> None:
    """Notes that a recorded kernel stores numbers that depend on values with a gradient to an
    array.
    """
    marks.mark(array, Mark.KERNEL)
    begin()


def note_computed(result: Any, *operands: Any) -> Any:
    """Marks a result of the host if an operand depends on values with a gradient.

    Returns:
        The result.
    """
    if (state.tape is not None or state.forward) and any(map(carries_history, operands)):
        marks.mark(result)
        begin()
    return result


def is_new_place(frame: Any, what: Any) -> bool:
    """Whether the line of `frame` has not been examined for `what`, an object that is kept from now
    on.
    """
    code = frame.f_code
    place = (id(code), frame.f_lineno)
    codes = [code]
    site: tuple[Any, ...] = (*place, id(what))
    if place in _asking:
        for caller in callers(frame, _of_thread.recording):
            codes.append(caller.f_code)
            site += (id(caller.f_code), caller.f_lineno)
    if site in _sites:
        return False
    if len(_sites) >= _MOST_SITES:
        _forget_sites()
    _sites.add(site)
    _kept[id(what)] = what
    _kept.update((id(code), code) for code in codes)
    return True


def _read(frame: Any) -> Reading:
    return Reading(frame, _of_thread.recording, _of_thread.opened)


def _settle(frame: Any, what: Any, reading: Reading, has_warned: bool) -> None:
    """Checks a program location again for other callers, if the answer depends on the callers."""
    place = (id(frame.f_code), frame.f_lineno)
    if has_warned:  # once is enough
        _asking.discard(place)
        _sites.add((*place, id(what)))
    elif reading.asks_callers and place not in _asking:
        _asking.add(place)
        is_new_place(frame, what)


def check_call(kernel: Any, names: list[str], values: dict[str, Any]) -> None:
    """Examines the plain numbers with which a kernel is called for lost gradients.

    Args:
        kernel, names: of the call, and its parameters.
        values: the arguments by name. Members of structs have names of their own.
    """
    if not _of_thread.watches:
        return
    frame = calling_frame()
    if frame is None:
        return
    read = [name for name in names if _is_read(values.get(name))]
    if is_new_place(frame, kernel):
        reading, lost = _read(frame), read
        if any(name in values and _is_plain(values[name]) for name in names):
            scope = reading.scope
            found = scope.given_to(kernel, frame.f_lineno, names, scope.has_history)
            found = [name for name in found if name in values and _is_plain(values[name])]
            lost = [name for name in names if name in found or name in read]
        _settle(frame, kernel, reading, bool(lost))
    else:
        lost = read
    if lost and is_new_place(frame, kernel._function):
        for name in lost:
            _warn(frame, f"what parameter '{name}' of kernel '{kernel.__name__}' is given")
        native.note_reported_site(frame.f_code, frame.f_lineno, kernel)
    if (id(frame.f_code), frame.f_lineno) not in _asking:
        # The launcher is told that it need not call this function again for the line.
        native.note_site(frame.f_code, frame.f_lineno, kernel)


def check_arrays(kernel: Any, names: list[str], arrays: dict[str, Any]) -> None:
    """Examines arrays without a gradient that a recorded launch reads for lost gradients.

    The tape follows an array from a launch that stores to it to one that reads it. It sees neither
    an array that Python computes in between, nor that the memory is that of a field.

    Args:
        kernel: of the launch.
        names: its parameters.
        arrays: the arguments for such parameters, by name.
    """
    if not arrays or not _of_thread.watches and marks.is_empty():
        return
    frame = calling_frame()
    if frame is None:
        return
    # An array without elements has no memory by which it could be told apart, and loses nothing.
    arrays = {n: v for n, v in arrays.items() if 0 not in tuple(getattr(v, "shape", ()))}
    for name, value in arrays.items():
        field = marks.field_behind(value)
        if field is not None and has_history(field) and is_new_place(frame, field):
            warn_at(
                frame,
                f"array '{name}' of kernel '{kernel.__name__}' is a view of field '{field.name}', "
                "which has a gradient: to the tape it is a constant. Use the field in the kernel",
            )
        if marks.mark_of(value) is Mark.HOST and is_new_place(frame, _warn):
            _warn(frame, f"what array '{name}' of kernel '{kernel.__name__}' is given")
    # Arrays to which kernels have stored are followed by the tape itself.
    unknown = {
        n: v for n, v in arrays.items()
        if marks.mark_of(v) is None and marks.field_behind(v) is None
    }  # fmt: skip
    if unknown and _of_thread.watches and is_new_place(frame, kernel.grad):
        reading = _read(frame)
        scope = reading.scope
        found = scope.given_to(kernel, frame.f_lineno, names, scope.is_computed)
        stored = reading.stored_arrays()
        for name, value in unknown.items():
            if name in found or _shares_memory(value, stored):
                _warn(frame, f"what array '{name}' of kernel '{kernel.__name__}' is given")


def check_write(field: Any, value: Any) -> None:
    """Checks a write of Python to a field; to be called under a tape or in forward mode."""
    if not has_history(field):
        return
    is_field = hasattr(field, "_companions")
    what = f"what Python writes to field '{field.name}'" if is_field else "what an array is given"
    tracked = is_followed(value) or (not marks.is_empty() and is_marked(value)) or _is_read(value)
    if not tracked and (not _of_thread.watches or isinstance(value, int)):
        return
    frame = calling_frame()
    if frame is None or not is_new_place(frame, _warn if tracked else check_write):
        return
    reading = _read(frame)
    is_array = marks.extent_of(value) is not None
    if is_array and not tracked and _shares_memory(value, reading.stored_arrays()):
        tracked = True
    holds = reading.scope.is_computed if is_array else reading.scope.has_history
    if not tracked:
        tracked = any(map(holds, reading.scope.written_at(frame.f_lineno)))
    if tracked:
        _warn(frame, what)
    _settle(frame, check_write, reading, tracked)


def _is_read(value: Any) -> bool:
    """Whether the value is a number or an element that Python has read and not computed with."""
    field = getattr(value, "_field", None) if getattr(value, "is_matrix", False) else None
    return numbers.is_read(value) or (field is not None and has_history(field))


def _is_plain(value: Any) -> bool:
    if isinstance(value, (float, np.floating)):
        return not is_followed(value)
    return getattr(value, "is_matrix", False) and not is_followed(value)


def _warn(frame: Any, what: str) -> None:
    mode = "the tape" if state.tape is not None else "forward mode"
    warn_at(
        frame,
        f"{what} was computed by Python from a value that has a gradient: to {mode} it is a "
        "constant from here on. Compute it in a kernel and pass it on in a field; if that is "
        "meant, read the value in a function under ti.ad.no_grad or before",
    )


def warn_at(frame: Any, message: str) -> None:
    """Warns of a gradient that is lost in the line of a frame."""
    warnings.warn_explicit(
        message,
        TaiGradientWarning,
        frame.f_code.co_filename,
        frame.f_lineno,
        module=frame.f_globals.get("__name__"),
    )


def _shares_memory(value: Any, stored: list[marks.Extent]) -> bool:
    extent = marks.extent_of(value) if stored else None
    return extent is not None and any(extent.overlaps(other) for other in stored)
