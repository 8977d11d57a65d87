"""`ti.init`."""

from __future__ import annotations

import os
import sys
from typing import Any

from ...errors import TaiRuntimeError, TaiRuntimeTypeError, did_you_mean
from . import dtypes, modes, native, state
from .mesh import Mesh
from .options import (
    ACCEPTED,
    CHOICES,
    KEYWORDS,
    Options,
    described,
    signature_of,
    warn_of_options,
)
from .program import Program, check_reset, reset
from .targets import Arch, check_target, choose_arch, cpu, cuda, why_no_cuda


def init(
    arch: Arch | None = None, default_fp: Any = None, default_ip: Any = None, **options: Any
) -> None:
    """Resets the program: discards all fields and kernels, and sets the options.

    Options of Taichi that request tai's fixed behaviour, or tune Taichi's passes, are accepted and
    ignored: docs/reference/taichi-options.md lists them.

    Args:
        enable_fallback: use the CPU if `ti.cuda` is not available.
        require: extensions that the target must have (`ti.extension.data64`, …).
        exclude: targets that the program does not run on.

    Raises:
        TaiRuntimeError: an option that does not exist, or a target that is not available, and why.
        TaiRuntimeTypeError: a type that cannot be the default.
    """
    check_reset()
    chosen: dict[str, Any] = {"accepted": {}}
    needs, unwanted = options.pop("require", ()), options.pop("exclude", ())
    for name, value in options.items():
        if name in KEYWORDS:
            chosen[name] = value
        elif name in ACCEPTED:
            chosen["accepted"][name] = value
        else:
            raise TaiRuntimeError(
                f"ti.init has no option '{name}'",
                did_you_mean(name, [*KEYWORDS, *ACCEPTED]) or "see help(ti.init)",
            )
    warn_of_options(chosen["accepted"])
    for name, given, kind in (("default_fp", default_fp, "f"), ("default_ip", default_ip, "iu")):
        if given is None:
            continue
        dtype = dtypes.to_dtype(given)
        if dtype is None or dtype.kind not in kind:
            what = "a float type" if kind == "f" else "an integer type"
            raise TaiRuntimeTypeError(f"{name} must be {what}, but got {given!r}")
        chosen[name] = dtype
    for name in ("bounds", "target_cpu"):
        if os.environ.get(f"TI_{name.upper()}"):
            chosen.setdefault(name, os.environ[f"TI_{name.upper()}"])
    for name, known in CHOICES.items():
        if chosen.get(name, known[0]) not in known:
            words = " or ".join(repr(word) for word in known)
            raise TaiRuntimeError(f"{name} is {words}, but got {chosen[name]!r}")
    modes.check_together(chosen)
    modes.choose(chosen)
    chosen["arch"], may_fall_back = choose_arch(arch)
    if os.environ.get("TI_ARCH"):
        chosen["arch"], may_fall_back = choose_arch(os.environ["TI_ARCH"])
    if os.environ.get("TI_SANITIZE") and chosen["arch"] == cpu:
        chosen.setdefault("sanitize", os.environ["TI_SANITIZE"])
    check_target(chosen["arch"], needs, unwanted)
    modes.check_target(chosen, chosen["arch"])
    if chosen.get("sanitize") and chosen["arch"] != cpu:
        raise TaiRuntimeError(
            "sanitize='address' is for kernels on the CPU",
            "choose arch=ti.cpu, or run the program under compute-sanitizer",
        )
    may_fall_back |= bool(chosen["accepted"].get("enable_fallback"))
    if chosen["arch"] == cuda and may_fall_back and (why := why_no_cuda()):
        print(f"[tai] falling back to arch=cpu: {why}", file=sys.stderr)
        chosen["arch"] = cpu
    mesh = chosen.get("mesh")
    if mesh is not None:
        _check_mesh(mesh, chosen["arch"])
        if chosen["arch"] == cuda:
            mesh.choose_gpu()
        mesh.connect(on_gpus=chosen["arch"] == cuda)
    taken = Options(**chosen)
    program = Program(taken)
    # The fields are dropped only now, when nothing can be refused any more.
    reset()
    if mesh is not None:
        native.set_mesh(mesh.rank, mesh.ranks, mesh.exchange)
    elif state.options.mesh is not None:
        native.set_mesh(0, 0, None)
    state.options, state.program = taken, program


def _check_mesh(mesh: Any, arch: Arch) -> None:
    if not isinstance(mesh, Mesh):
        raise TaiRuntimeTypeError(
            f"mesh is made by ti.mesh, but got {mesh!r}", 'write mesh=ti.mesh("x", 4)'
        )
    if arch not in (cpu, cuda):
        raise TaiRuntimeError(
            f"a mesh runs on the CPU or on GPUs, but arch is {arch}", "choose arch=ti.cpu"
        )


# The keywords of `ti.init` are those in the table of options.
init.__signature__ = signature_of(KEYWORDS)  # type: ignore[attr-defined]
if init.__doc__:  # python -OO has none
    init.__doc__ = init.__doc__.replace("    Args:\n", f"    Args:\n{described(KEYWORDS)}\n", 1)
