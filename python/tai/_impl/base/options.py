"""The options of `ti.init`: those of tai, and those of Taichi that are accepted and ignored."""

from __future__ import annotations

import inspect
import re
import textwrap
import warnings
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

from . import dtypes
from .callers import calling_level
from .option_rows import ROWS, Row
from .targets import Arch, cpu, cuda, python

TRACE, DEBUG, INFO, WARN, ERROR, CRITICAL = "trace", "debug", "info", "warn", "error", "critical"


class Keyword(NamedTuple):
    """A keyword of `ti.init`."""

    name: str
    type: Any
    default: Any
    about: str


# The keywords of `ti.init` that may be given by position.
_POSITIONAL = ("arch", "default_fp", "default_ip")

# Taichi's names of options of the table, whose own name is no keyword then.
_NAMES = {
    "threads": "cpu_max_num_threads",
    "seed": "random_seed",
    "profiler": "kernel_profiler",
    "history_bytes": "ad_history_bytes",
    "device_heap": "device_heap_memory",
    "block_dim": "default_gpu_block_dim",
}
# Options that the package or tools set while a program runs; `cache_dir` follows from two keywords
# of `ti.init`.
_NOT_OF_INIT = {"cache_dir", "compile_profile", "forward_mode", "order_seed"}

# Options that are not set on the context, but passed on with each kernel, after the kernel's own
# words; see `base.modes`.
_ON_KERNELS = {"precision", "sums", "math", "ftz", "adjoints"}

# The kinds of values of the option table, in Python: the type, and a function that reads the text
# of the default value.
_KINDS: dict[str, tuple[Any, Callable[[str], Any]]] = {
    "Switch": (bool, lambda text: text == "true"),
    **dict.fromkeys(("BlockThreads", "Bytes", "Count", "Level", "Seed"), (int, int)),
}
_TYPES = {"arch": Arch, "print_ir": bool | str, "skip": bool | str | Sequence[str]}

# The sentence of the C API documentation about its order of calls, which has no meaning in Python.
_ORDER = re.compile(r"; to be set before [^.;]+")

# Remarks for Python users on keywords of `ti.init`, in addition to the text of the option table.
_NOTES = {
    "arch": "ti.cpu (or ti.x64), ti.cuda, or ti.gpu: CUDA, or the CPU where there is no GPU; or "
    "ti.python: no code is made, kernels and their gradients run operation by operation, slowly, "
    "and every index is checked, so that what a compiled kernel does can be compared with what it "
    "says. The environment variable TI_ARCH takes precedence",
    "debug": "The domains of functions such as log and sqrt are checked, too",
    "bounds": "'clamp' holds in gradients, too; 'check' is an error that names the line, the field "
    "and the index, and nothing is stored there. Indices that follow from arguments, constants and "
    "the bounds of loops are checked always, before the kernel runs. `debug` and "
    "`check_out_of_bound` imply 'check'. The environment variable TI_BOUNDS says it where the "
    "program does not",
    "fast_math": "Norms are taken without care for squares that over- or underflow",
    "sanitize": "It ends the process where a kernel on the CPU leaves an array of the caller, or "
    "memory that is no field: docs/guides/bounds.md. Elements of other fields are no such memory; "
    "`bounds` finds these. The environment variable TI_SANITIZE says it where the program does not "
    "and runs on the CPU",
    "target_cpu": "An error where this one cannot run its code. Results of one processor can be "
    "had on another, and with `strict` and `deterministic` all have the same bits. The "
    "environment variable TI_TARGET_CPU says it where the program does not",
    "print_ir": "True for all",
    "kernel_profiler": "See `ti.profiler`",
    "ad_history_bytes": "For each thread. `ad_stack_size` is accepted and not needed: loops may be "
    "of any length",
    "skip": "Or True, False, or a list of strings; see `ti.profiler.skips`",
    "memory_limit": "Those of sparse levels count by their active cells. More is a "
    "`TaiMemoryError`, and the program can go on",
    "device_heap_memory": "Gradients of loops do so. 0 is a 32nd of its memory, 4 GiB at most",
    "default_gpu_block_dim": "ti.loop_config(block_dim=…) names that of a loop",
    "max_block_dim": "Whatever a loop says",
    "fuse_launches": "Such as those of a tape; see `Tape.explain`. Without it, each is queued by "
    "itself",
}

# The keywords of `ti.init` for options that Python itself handles.
_OWN = (
    Keyword("default_fp", dtypes.DataType, dtypes.f32, "the type of `float` in kernels"),
    Keyword("default_ip", dtypes.DataType, dtypes.i32, "the type of `int` in kernels"),
    Keyword("precision", str, "default", "what `float` means and what kernels compute in: 'f64' or "
            "'f32'; with 'f16' or 'bf16' the fields of `float` are stored so, and kernels compute "
            "in f32. Types that the program names stay, but arithmetic on them is as wide. See "
            "docs/guides/precision.md for this and the next four"),
    Keyword("sums", str, "default", "how sums over iterations and scatters are kept: "
            "'compensated', with twice the digits of their type; 'deterministic', as by the option "
            "of that name"),
    Keyword("math", str, "default", "'fast' and 'strict' are as by the options fast_math and "
            "strict; 'accurate': elementary functions are within one unit in the last place"),
    Keyword("ftz", bool, False, "denormal numbers are zero, as operands and as results"),
    Keyword("adjoints", str, "default", "what gradients of fields are kept and summed in: 'f64'; "
            "by default the type of the field, and f32 for one of 16 bits"),
    Keyword("mesh", Any, None, "the processes that share the fields below `ti.root.shard`, made by "
            "`ti.mesh`; see docs/guides/many.md"),
    Keyword("check_out_of_bound", bool, False, "the same as bounds='check'"),
    Keyword("validation", bool, False, "each launch checks that no two iterations of a parallel "
            "loop read and write one element where the result depends on their order, which data "
            "decide; `debug` implies it. See docs/guides/parallel-updates.md"),
    Keyword("ad_ties", str, "second", "what `max` and `min` of equal numbers do in gradients: "
            "'second': the second one gets all; 'split': half each"),
    Keyword("ad_arcs", str, "exact", "the derivatives of asin and acos at ±1: 'exact': infinite; "
            "'clamp': as at the next number inside"),
    Keyword("ad_guards", bool, True, "a zero adjoint contributes zero whatever the partial "
            "derivative is; False leaves the test for it out, to measure what it costs"),
    Keyword("offline_cache", bool, True, "keep compiled kernels on disk"),
    Keyword("offline_cache_file_path", str, "", "where; if it is empty, $TAI_CACHE_DIR, else the "
            "folder `tai` in the user's cache folder"),
    Keyword("compile_progress", bool, True, "name the kernel that is compiled on the terminal, if "
            "there is one, once that takes over a second"),
    Keyword("log_level", str, WARN, "accepted, as are others that no result depends on; "
            "docs/reference/taichi-options.md lists them. Those that ask for what does not happen "
            "warn"),
    Keyword("unrolling_limit", int, 65536, "the most iterations that a `ti.static` loop may "
            "have; 0 for no limit. Less than the default, 65,536, is taken as that"),
)  # fmt: skip


def keywords_of(rows: Iterable[Row]) -> dict[str, Keyword]:
    """The keywords of `ti.init`: options of the table, and Python's own options."""
    found = {}
    for name, kind, initial, _, about in rows:
        if name in _NOT_OF_INIT:
            continue
        keyword = _NAMES.get(name, name)
        type_, read = _KINDS.get(kind, (str, str))
        type_ = _TYPES.get(keyword, type_)
        note = _NOTES.get(keyword)
        about = _ORDER.sub("", about)
        text = f"{about}. {note}" if note else about
        found[keyword] = Keyword(keyword, type_, cpu if name == "arch" else read(initial), text)
    found |= {own.name: own for own in _OWN}
    first = {name: found.pop(name) for name in _POSITIONAL if name in found}
    return first | found


KEYWORDS = keywords_of(ROWS)


class Options:
    """The options of `ti.init` that have an effect, by the names of the keywords.

    Attributes:
        accepted: values of options that are accepted and change nothing.
    """

    def __init__(self, accepted: dict[str, Any] | None = None, **chosen: Any):
        for keyword in KEYWORDS.values():
            setattr(self, keyword.name, chosen.get(keyword.name, keyword.default))
        self.accepted = accepted or {}

    def __getattr__(self, name: str) -> Any:
        if name in ACCEPTED:
            return self.__dict__.get("accepted", {}).get(name)
        raise AttributeError(f"ti.init has no option '{name}'")


def texts_of(options: Options, rows: Iterable[Row] = ROWS) -> dict[str, str]:
    """The texts of the options of the table, in the order in which they have to be set."""
    texts = {}
    for name, *_ in rows:
        make = _TEXTS.get(name)
        if make is None and name in _NOT_OF_INIT | _ON_KERNELS:
            continue
        value = getattr(options, _NAMES.get(name, name)) if make is None else make(options)
        if value is None:
            continue
        texts[name] = str(value).lower() if isinstance(value, bool) else str(value)
    # The options in `_BEFORE_ARCH` define the target, so they are set before it.
    first = {name: texts.pop(name) for name in _BEFORE_ARCH if name in texts}
    return first | texts


def bounds_of(options: Options) -> str:
    """The treatment of indices out of bounds, whichever option asks for it."""
    return "check" if options.debug or options.check_out_of_bound else options.bounds


# Options whose text differs from the text of their Python value; None means that the option keeps
# its default.
_TEXTS: dict[str, Callable[[Options], Any]] = {
    "arch": lambda o: "interpreter" if o.arch == python else o.arch,
    "bounds": bounds_of,
    "cache_dir": lambda o: (o.offline_cache_file_path or None) if o.offline_cache else "",
    "max_block_dim": lambda o: o.max_block_dim if o.arch == cuda else 0,
    "print_ir": lambda o: "all" if o.print_ir is True else o.print_ir or "",
    "skip": lambda o: skip_text(o.skip),
}
_BEFORE_ARCH = ("device_memory_limit", "device_heap", "arch")

# The options of `ti.init` that take one of a few words, with these words.
CHOICES = {
    "ad_ties": ("second", "split"),
    "ad_arcs": ("exact", "clamp"),
    "bounds": ("off", "clamp", "check"),
    "precision": ("default", "f64", "f32", "f16", "bf16"),
    "sums": ("default", "compensated", "deterministic"),
    "math": ("default", "fast", "strict", "accurate"),
    "ftz": (False, True),
    "adjoints": ("default", "f64"),
    "sanitize": ("", "address"),
}

# Taichi options that request what tai always does, or that tune Taichi's own passes; they are in
# docs/reference/taichi-options.md.
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
# Taichi options that are accepted but request what tai does not do: the value that requests
# nothing, and the advice for other values.
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
    "external_optimization_level": (3, "opt_level=0 to 3 says it for all passes"),
    "offline_cache_cleaning_policy": ("lru", "the cache keeps 1 GiB, and drops what was not used "
                                      "for longest; offline_cache=False does without"),
    "offline_cache_max_size_of_files": (100 << 20, "the cache keeps 1 GiB at most; "
                                        "offline_cache_file_path says where"),
}  # fmt: skip


def warn_of_options(accepted: dict[str, Any]) -> None:
    """Warns of each option that asks for something tai does not do."""
    for name, value in accepted.items():
        nothing, hint = _WITHOUT_EFFECT.get(name, (value, ""))
        if value != nothing:
            warnings.warn(
                f"ti.init({name}={value!r}) has no effect\n  hint: {hint}",
                stacklevel=calling_level(),
            )


def skip_text(value: Any) -> str:
    """The option `skip` of `ti.init` as text: a string, or a list or tuple of names."""
    if value is True or value is None:
        return "all"
    if value is False:
        return "none"
    if isinstance(value, str):
        return value
    return ",".join(str(name) for name in value) or "none"


def signature_of(keywords: dict[str, Keyword]) -> inspect.Signature:
    """Makes the signature of `ti.init`, as `help` and editors show it."""
    kind = inspect.Parameter
    parameters = [
        kind(
            k.name,
            kind.POSITIONAL_OR_KEYWORD if k.name in _POSITIONAL else kind.KEYWORD_ONLY,
            default=k.default,
            annotation=k.type,
        )
        for k in keywords.values()
    ]
    others = kind("accepted", kind.VAR_KEYWORD)
    return inspect.Signature([*parameters, others], return_annotation=None)


def described(keywords: dict[str, Keyword]) -> str:
    """Describes the keywords of `ti.init` as the section `Args` of a docstring."""
    return "\n".join(
        textwrap.fill(
            f"{k.name}: {k.about}.", 95, initial_indent=" " * 8, subsequent_indent=" " * 12
        )
        for k in keywords.values()
    )
