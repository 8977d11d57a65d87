"""The options of `ti.init`: those that change what happens, and those that are accepted."""

from __future__ import annotations

import dataclasses
import warnings
from dataclasses import dataclass, fields
from typing import Any

from . import dtypes
from .targets import Arch, cpu

TRACE, DEBUG, INFO, WARN, ERROR, CRITICAL = "trace", "debug", "info", "warn", "error", "critical"


@dataclass
class Options:
    """The options of `ti.init` that change what happens."""

    arch: Arch = cpu
    default_fp: dtypes.DataType = dtypes.f32
    default_ip: dtypes.DataType = dtypes.i32
    debug: bool = False
    check_out_of_bound: bool = False
    bounds: str = "off"
    fast_math: bool = False
    sanitize: str = ""
    ad_ties: str = "second"
    ad_arcs: str = "exact"
    ad_guards: bool = True
    random_seed: int = 0
    print_ir: Any = False
    kernel_profiler: bool = False
    cpu_max_num_threads: int = 0
    deterministic: bool = False
    offline_cache: bool = True
    offline_cache_file_path: str = ""
    opt_level: int = 3
    log_level: str = WARN
    ad_history_bytes: int = 256 * 1024
    skip: Any = "all"
    memory_limit: int = 0
    device_memory_limit: int = 0
    device_heap_memory: int = 0
    default_gpu_block_dim: int = 0
    max_block_dim: int = 0
    fuse_launches: bool = True
    unrolling_limit: int = 65536
    # What was given for options that are accepted and change nothing.
    accepted: dict[str, Any] = dataclasses.field(default_factory=dict)

    def __getattr__(self, name: str) -> Any:
        if name in ACCEPTED:
            return self.__dict__.get("accepted", {}).get(name)
        raise AttributeError(f"ti.init has no option '{name}'")


KNOWN = {f.name for f in fields(Options)} - {"accepted"}

# Options that take one of a few words.
CHOICES = {
    "ad_ties": ("second", "split"),
    "ad_arcs": ("exact", "clamp"),
    "bounds": ("off", "clamp", "check"),
    "sanitize": ("", "address"),
}

# Options of Taichi that ask for what is always so here, or tune its own passes.
ACCEPTED = {
    "advanced_optimization", "flatten_if", "device_memory_GB", "device_memory_fraction",
    "ad_stack_size", "default_ad_stack_size", "demote_dense_struct_fors", "verbose",
    "kernel_profile", "print_preprocessed_ir", "print_kernel_llvm_ir", "print_struct_llvm_ir",
    "print_kernel_llvm_ir_optimized", "print_accessor_ir", "print_evaluator_ir", "gdb_trigger",
    "excepthook", "simplify_before_lower_access", "lower_access", "simplify_after_lower_access",
    "saturating_grid_dim", "default_cpu_block_dim",
    "cpu_block_dim_adaptive", "move_loop_invariant_outside_if", "cache_loop_invariant_global_vars",
    "make_thread_local", "make_block_local", "make_mesh_block_local", "detect_read_only",
    "real_matrix_scalarize", "force_scalarize_matrix", "half2_vectorization",
    "short_circuit_operators", "use_llvm", "experimental_auto_mesh_local",
    "quant_opt_store_fusion", "quant_opt_atomic_demotion", "ndarray_use_cached_allocator",
    "check_autodiff_valid", "validate_autodiff", "auto_mesh_local", "external_optimization_level",
    "timeline", "print_benchmark_stat", "constant_folding", "cuda_stack_limit",
    "block_dim_adaptive",
    "offline_cache_cleaning_policy", "offline_cache_max_size_of_files",
    "offline_cache_cleaning_factor", "enable_fallback", "require_version", "vk_api_version",
    "num_compile_threads", "packed", "lazy_compilation", "use_unified_memory",
    "ndrange_order", "random_seed_is_time",
}  # fmt: skip


_PRINT = "print_ir=True, or the names of stages, prints the IR of kernels"
# Those of them that ask for something which does not happen: the value that asks for nothing, and
# what to do instead.
_WITHOUT_EFFECT = {
    **dict.fromkeys(
        ("print_preprocessed_ir", "print_kernel_llvm_ir", "print_struct_llvm_ir",
         "print_kernel_llvm_ir_optimized", "print_accessor_ir", "print_evaluator_ir"),
        (False, _PRINT),
    ),
    "check_autodiff_valid": (False, "ti.ad.Tape(loss, validation=True) checks a tape"),
    "validate_autodiff": (False, "ti.ad.Tape(loss, validation=True) checks a tape"),
    "kernel_profile": (False, "the option is called kernel_profiler"),
    "print_benchmark_stat": (False, "kernel_profiler=True times kernels"),
    "timeline": (False, "kernel_profiler=True times kernels"),
    "gdb_trigger": (False, "start the program in the debugger"),
    "short_circuit_operators": (True, "'and' and 'or' never evaluate what does not matter; use "
                                "ti.logical_and, ti.logical_or where both must be"),
    "random_seed_is_time": (False, "random_seed=time.time_ns() % 2**31"),
    "require_version": (None, "compare ti.__version__ in the program"),
    "use_unified_memory": (False, "fields on the GPU are in its memory"),
}  # fmt: skip


def warn_of_options(accepted: dict[str, Any]) -> None:
    """Says which options ask for what does not happen."""
    for name, value in accepted.items():
        nothing, hint = _WITHOUT_EFFECT.get(name, (value, ""))
        if value != nothing:
            warnings.warn(f"ti.init({name}={value!r}) has no effect\n  hint: {hint}", stacklevel=3)


def skip_text(value: Any) -> str:
    """The option `skip` of `ti.init` as text: a string, or a list or tuple of names."""
    if value is True or value is None:
        return "all"
    if value is False:
        return "none"
    if isinstance(value, str):
        return value
    return ",".join(str(name) for name in value) or "none"
