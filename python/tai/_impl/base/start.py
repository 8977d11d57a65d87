"""`ti.init`."""

from __future__ import annotations

import os
import sys
from typing import Any

from ...errors import TaiRuntimeError, TaiRuntimeTypeError, did_you_mean
from . import dtypes, state
from .options import ACCEPTED, CHOICES, KNOWN, Options, warn_of_options
from .program import Program, reset
from .targets import Arch, check_target, choose_arch, cpu, cuda, why_no_cuda


def init(arch: Arch | None = None, default_fp: Any = None, default_ip: Any = None, **options: Any):
    """Starts anew: forgets all fields and kernels, and sets the options.

    Args:
        arch: `ti.cpu` (or `ti.x64`), `ti.cuda`, or `ti.gpu`: CUDA, or the CPU where there is no
            GPU; or `ti.python`: no code is made, kernels and their gradients run operation by
            operation, slowly, and every index is checked, so that what a compiled kernel does
            can be compared with what it says. The environment variable TI_ARCH takes
            precedence.
        default_fp, default_ip: the types of `float` and `int` in kernels.
        debug: check assertions, indices and the domains of functions such as log and sqrt.
        bounds: what happens where an index that depends on data is out of range: `off`:
            anything (the default); `clamp`: the nearest element is taken, in gradients too;
            `check`: an error that names the line, the field and the index, and nothing is
            stored there. Indices that follow from arguments, constants and the bounds of loops
            are checked always, before the kernel runs. `debug` and `check_out_of_bound` imply
            `check`. The environment variable TI_BOUNDS says it where the program does not.
        fast_math: let the compiler reorder floating-point arithmetic, and take norms without
            care for squares that over- or underflow.
        sanitize: `address`: kernels on the CPU are compiled with AddressSanitizer, which ends the
            process where they leave an array of the caller, or memory that is no field. The
            process needs its run time: docs/bounds.md. Elements of other fields are no such
            memory; `bounds` finds these. The environment variable TI_SANITIZE says it where the
            program does not and runs on the CPU.
        ad_ties: what `max` and `min` of equal numbers do in gradients: `second`: the second
            one gets all; `split`: half each.
        ad_arcs: the derivatives of asin and acos at ±1: `exact`: infinite; `clamp`: as at the
            next number inside.
        ad_guards: a zero adjoint contributes zero whatever the partial derivative is; False
            leaves the test for it out, to measure what it costs.
        random_seed: seed of `ti.random`.
        print_ir: True, or a comma list of stages: print the IR of kernels.
        kernel_profiler: time kernels; see `ti.profiler`.
        cpu_max_num_threads: 0 for all cores.
        deterministic: the same bits from run to run, whatever the number of threads.
        offline_cache, offline_cache_file_path: keep compiled kernels on disk, and where.
        ad_history_bytes: what the gradient of a loop may keep in memory for each thread; a
            loop that would need more is run again in parts. `ad_stack_size` is accepted
            and not needed: loops may be of any length.
        skip: what is left out where it is not needed: `all`, `none`, or names, as a comma list
            or a list of strings; `-name` takes one away. Results do not depend on it; see
            `ti.profiler.skips`.
        memory_limit: bytes that fields may take, those of sparse levels by their active cells;
            0 for what the machine has. More is a `TaiMemoryError`, and the program can go on.
        device_memory_limit: the same for the memory of the GPU.
        device_heap_memory: bytes that kernels may ask for while they run on the GPU, which
            gradients of loops do; 0 for a 32nd of its memory, 4 GiB at most. It can be said
            until the first kernel that asks.
        default_gpu_block_dim: threads of a block on the GPU, a multiple of 32; 0 for what suits
            each kernel. A loop after `ti.loop_config(block_dim=…)` has what that says.
        max_block_dim: the most of them, a multiple of 32, whatever a loop says; 0 for what the
            GPU has room for.
        fuse_launches: make one piece of work of launches that come again and again in the same
            sequence, such as those of a tape; see `Tape.explain`. Without it, each is queued
            by itself.
        unrolling_limit: the most iterations that a `ti.static` loop may have; 0 for no limit. Less
            than the default, 65,536, is taken as that.
        enable_fallback: take the CPU where `ti.cuda` is not there.
        require: extensions that the target must have (`ti.extension.data64`, …).
        exclude: targets that the program does not run on.
        opt_level: 0 to 3, how much the compiler does for speed; 3 where nothing is said.
        log_level: accepted, as are others that no result depends on; docs/taichi-options.md
            lists them. Those that ask for what does not happen warn.

    Raises:
        TaiRuntimeError: an option that does not exist, or a target that is not there, and why.
        TaiRuntimeTypeError: a type that cannot be the default.
    """
    reset()
    chosen: dict[str, Any] = {"accepted": {}}
    needs, unwanted = options.pop("require", ()), options.pop("exclude", ())
    for name, value in options.items():
        if name in KNOWN:
            chosen[name] = value
        elif name in ACCEPTED:
            chosen["accepted"][name] = value
        else:
            raise TaiRuntimeError(
                f"ti.init has no option '{name}'",
                did_you_mean(name, [*KNOWN, *ACCEPTED]) or "see help(ti.init)",
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
    if os.environ.get("TI_BOUNDS"):
        chosen.setdefault("bounds", os.environ["TI_BOUNDS"])
    for name, known in CHOICES.items():
        if chosen.get(name, known[0]) not in known:
            words = " or ".join(repr(word) for word in known)
            raise TaiRuntimeError(f"{name} is {words}, but got {chosen[name]!r}")
    chosen["arch"], may_fall_back = choose_arch(arch)
    if os.environ.get("TI_ARCH"):
        chosen["arch"], may_fall_back = choose_arch(os.environ["TI_ARCH"])
    if os.environ.get("TI_SANITIZE") and chosen["arch"] == cpu:
        chosen.setdefault("sanitize", os.environ["TI_SANITIZE"])
    check_target(chosen["arch"], needs, unwanted)
    if chosen.get("sanitize") and chosen["arch"] != cpu:
        raise TaiRuntimeError(
            "sanitize='address' is for kernels on the CPU",
            "choose arch=ti.cpu, or run the program under compute-sanitizer",
        )
    may_fall_back |= bool(chosen["accepted"].get("enable_fallback"))
    if chosen["arch"] == cuda and may_fall_back and (why := why_no_cuda()):
        print(f"[tai] falling back to arch=cpu: {why}", file=sys.stderr)
        chosen["arch"] = cpu
    state.options = Options(**chosen)
    state.program = Program(state.options)
