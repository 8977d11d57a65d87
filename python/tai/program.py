"""`ti.init` and what it sets up: options, the C++ context and the trees of fields."""

from __future__ import annotations

import atexit
import dataclasses
import sys
import threading
import warnings
import weakref
from dataclasses import dataclass, fields
from typing import Any

from . import _ad_origins, _state, dtypes
from ._skips import option_text
from ._symbols import Symbols
from .errors import TaiError, TaiRuntimeError, TaiRuntimeTypeError, did_you_mean


class Arch(str):
    """A target: `ti.cpu`, `ti.cuda`, …"""

    __slots__ = ()


cpu, x64, arm64 = Arch("cpu"), Arch("x64"), Arch("arm64")
python = Arch("python")
cuda, gpu, vulkan, metal = Arch("cuda"), Arch("gpu"), Arch("vulkan"), Arch("metal")
opengl, gles, dx11, amdgpu = Arch("opengl"), Arch("gles"), Arch("dx11"), Arch("amdgpu")

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
        if name in _ACCEPTED:
            return self.__dict__.get("accepted", {}).get(name)
        raise AttributeError(f"ti.init has no option '{name}'")


_KNOWN = {f.name for f in fields(Options)} - {"accepted"}

# Options that take one of a few words.
_CHOICES = {
    "ad_ties": ("second", "split"),
    "ad_arcs": ("exact", "clamp"),
    "bounds": ("off", "clamp", "check"),
    "sanitize": ("", "address"),
}

# Options of Taichi that ask for what is always so here, or tune its own passes.
_ACCEPTED = {
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


def _warn_of_options(accepted: dict[str, Any]) -> None:
    """Says which options ask for what does not happen."""
    for name, value in accepted.items():
        nothing, hint = _WITHOUT_EFFECT.get(name, (value, ""))
        if value != nothing:
            warnings.warn(f"ti.init({name}={value!r}) has no effect\n  hint: {hint}", stacklevel=3)


class Program:
    """What lives from one `ti.init` to the next."""

    def __init__(self, options: Options):
        from . import _core
        from .snode import Root

        self.options = options
        self.context = _core.Context()
        self.root = Root()
        # Held while fields are placed under `ti.root`, so that no other thread allocates half of
        # them.
        self.layout = threading.RLock()
        # Functions of kernels by symbol, for reports that name a line.
        functions: dict[str, Any] = {}
        self.kernel_functions = functions
        self.symbols = Symbols(self.context.has_kernel, lambda name: functions.pop(name, None))
        self.num_trees = 0
        # The roots of the trees that are allocated, by symbol.
        self.trees: dict[str, Any] = {}
        # Fields by symbol, for diagnostics and for clearing gradients.
        self.fields: dict[str, Any] = {}
        self.kernels: weakref.WeakSet = weakref.WeakSet()
        # Where forward mode keeps what kernels return; see `_ad_cells`.
        self.pools: list[Any] = []
        self.count_kernels_from_here()
        # Lists that sparse levels had made and reused at the last `clear_skips`.
        self.lists_before: dict[Any, tuple[int, int]] = {}
        self._set_options()

    def close(self) -> None:
        """Lets go of all memory, although the program's fields and kernels may live on."""
        for field in self.fields.values():
            field.release()
        for kernel in self.kernels:
            kernel.release()
        self.fields.clear()
        self.trees.clear()
        self.pools.clear()
        _ad_origins.forget()

    def count_kernels_from_here(self) -> None:
        """Forgets the kernels that were defined so far."""
        self.first_kernel = _state.kernels_made

    def kernels_defined(self) -> int:
        """How many kernels were defined since, and those before that are in use."""
        earlier = sum(kernel.number < self.first_kernel for kernel in self.kernels)
        return _state.kernels_made - self.first_kernel + earlier

    def _set_options(self) -> None:
        o = self.options

        def flag(value: bool) -> str:
            return "true" if value else "false"

        values = {
            "device_memory_limit": str(o.device_memory_limit),
            "device_heap": str(o.device_heap_memory),
            "arch": "interpreter" if o.arch == python else str(o.arch),
            "threads": str(o.cpu_max_num_threads),
            "deterministic": flag(o.deterministic),
            "debug": flag(o.debug),
            "bounds": "check" if o.debug or o.check_out_of_bound else o.bounds,
            "fast_math": flag(o.fast_math),
            "sanitize": o.sanitize,
            "opt_level": str(o.opt_level),
            "seed": str(o.random_seed),
            "print_ir": "all" if o.print_ir is True else str(o.print_ir or ""),
            "profiler": flag(o.kernel_profiler),
            "history_bytes": str(o.ad_history_bytes),
            "skip": option_text(o.skip),
            "memory_limit": str(o.memory_limit),
            "block_dim": str(o.default_gpu_block_dim),
            "max_block_dim": str(o.max_block_dim if o.arch == cuda else 0),
            "fuse_launches": flag(o.fuse_launches),
        }
        if not o.offline_cache:
            values["cache_dir"] = ""
        elif o.offline_cache_file_path:
            values["cache_dir"] = o.offline_cache_file_path
        for name, value in values.items():
            self.context.set_option(name, value)

    def unique_symbol(self, wanted: str) -> str:
        """A symbol that no tree, place or field of this program has."""
        return self.symbols.take(wanted)

    def materialize(self, namespace: dict[str, Any] | None = None) -> None:
        """Allocates the tree of what was placed under `ti.root` since the last time.

        Args:
            namespace: variables of the caller, to name fields after, so that the IR and
                diagnostics say `@x` for the field that the program calls `x`.
        """
        from .snode import Root

        with self.layout:
            root = self.root
            if not root.children:
                return
            if namespace is not None:
                name_fields(namespace)
            self.root, root.allocator = Root(), _state.thread
        try:
            root.allocate(self)
        finally:
            root.ready.set()


def name_fields(namespace: dict[str, Any]) -> None:
    """Names the fields that variables of `namespace` hold, where they have no name yet."""
    from .fields import Field

    for name, value in list(namespace.items()):
        if isinstance(value, Field):
            value.suggest_name(name)
        elif isinstance(value, (list, tuple)):
            for index, item in enumerate(value):
                if isinstance(item, Field):
                    item.suggest_name(f"{name}_{index}")


def get_program() -> Program:
    """The program, made with default options if `ti.init` was not called."""
    if _state.program is None:
        _state.program = Program(_state.options)
    return _state.program


_state.options = Options()


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

    Raises:
        TaiRuntimeError: an option that does not exist, or a target that is not there, and why.
        TaiRuntimeTypeError: a type that cannot be the default.
    """
    import os

    reset()
    chosen: dict[str, Any] = {"accepted": {}}
    needs, unwanted = options.pop("require", ()), options.pop("exclude", ())
    for name, value in options.items():
        if name in _KNOWN:
            chosen[name] = value
        elif name in _ACCEPTED:
            chosen["accepted"][name] = value
        else:
            raise TaiRuntimeError(
                f"ti.init has no option '{name}'",
                did_you_mean(name, [*_KNOWN, *_ACCEPTED]) or "see help(ti.init)",
            )
    _warn_of_options(chosen["accepted"])
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
    for name, known in _CHOICES.items():
        if chosen.get(name, known[0]) not in known:
            words = " or ".join(repr(word) for word in known)
            raise TaiRuntimeError(f"{name} is {words}, but got {chosen[name]!r}")
    chosen["arch"], may_fall_back = _choose_arch(arch)
    if os.environ.get("TI_ARCH"):
        chosen["arch"], may_fall_back = _choose_arch(os.environ["TI_ARCH"])
    if os.environ.get("TI_SANITIZE") and chosen["arch"] == cpu:
        chosen.setdefault("sanitize", os.environ["TI_SANITIZE"])
    _check_target(chosen["arch"], needs, unwanted)
    if chosen.get("sanitize") and chosen["arch"] != cpu:
        raise TaiRuntimeError(
            "sanitize='address' is for kernels on the CPU",
            "choose arch=ti.cpu, or run the program under compute-sanitizer",
        )
    may_fall_back |= bool(chosen["accepted"].get("enable_fallback"))
    if chosen["arch"] == cuda and may_fall_back and (why := why_no_cuda()):
        print(f"[tai] falling back to arch=cpu: {why}", file=sys.stderr)
        chosen["arch"] = cpu
    _state.options = Options(**chosen)
    _state.program = Program(_state.options)


def why_no_cuda() -> str:
    """Why there is no arch=ti.cuda on this machine; empty where there is."""
    from . import _core

    try:
        _core.Context().set_option("arch", "cuda")
    except TaiRuntimeError as error:
        return error.message
    return ""


def _check_target(arch: Arch, needs: Any, unwanted: Any) -> None:
    """Refuses a target that lacks an extension in `needs`, or is one of `unwanted`."""

    def each(what: Any) -> Any:
        return what if isinstance(what, (list, tuple, set)) else (what,)

    if needs:
        from .lang.misc import is_extension_supported

        for extension in each(needs):
            if not is_extension_supported(arch, extension):
                raise TaiRuntimeError(f"arch=ti.{arch} has no {extension}")
    if arch in each(unwanted) or (arch == cpu and x64 in each(unwanted)):
        raise TaiRuntimeError(f"arch=ti.{arch} is excluded by this program")


def _choose_arch(arch: Any) -> tuple[Arch, bool]:
    """The target to use, and whether the CPU will do where it is not there."""
    if isinstance(arch, (list, tuple)):
        arch = next((a for a in arch if a in (cpu, x64, arm64)), arch[0] if arch else None)
    if arch is None or arch in (cpu, x64, arm64):
        return cpu, False
    if arch in (gpu, cuda):
        return cuda, arch == gpu
    if arch == python:
        return python, False
    known = ["cpu", "x64", "cuda", "gpu", "python"]
    raise TaiRuntimeError(f"there is no target '{arch}'", did_you_mean(str(arch), known))


def reset() -> None:
    """Forgets all fields and compiled kernels."""
    if _state.tape is not None:
        raise TaiRuntimeError("the program cannot be reset inside a ti.ad.Tape")
    if _state.forward:
        raise TaiRuntimeError("the program cannot be reset in forward mode")
    if _state.program is None:
        return
    from . import _core

    _wait()
    _core.next_generation()
    _state.program.close()
    _state.program = None


@atexit.register
def _wait() -> None:
    """Before the program goes, what kernels on a GPU have printed appears, and why they failed."""
    if _state.program is None or _state.program.options.arch == cpu:
        return
    try:
        _state.program.context.synchronize()
    except TaiError as error:
        print(f"[tai] a kernel has failed: {error}", file=sys.stderr)


@atexit.register
def _stop_background_work() -> None:
    """What is compiled ahead of need must not outlive the libraries that it uses.

    Programs are not always freed at the end: one whose tape is open is not.
    """
    core = sys.modules.get(f"{__package__}._core")
    if core is not None:
        core.stop_background_work()


def sync() -> None:
    """Waits until everything that was launched has run."""
    if _state.program is not None:
        _state.program.context.synchronize()


class _Root:
    """`ti.root`: the root of the tree that is being laid out."""

    is_root = True

    def __getattr__(self, name: str) -> Any:
        return getattr(get_program().root, name)

    def deactivate_all(self) -> None:
        """Makes all cells of all sparse levels inactive, in all trees."""
        program = get_program()
        program.materialize(sys._getframe(1).f_globals)
        for tree in list(program.trees.values()):
            tree.deactivate_all()

    def __eq__(self, other: Any) -> bool:
        return other is self or getattr(other, "kind", None) == "root"

    __hash__ = object.__hash__

    def __repr__(self) -> str:
        return "ti.root"


root = _Root()
__all__ = ["Arch", "Options", "Program", "get_program", "init", "reset", "root", "sync"]
