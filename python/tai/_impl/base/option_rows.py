"""The options of a context, made of Options.def by scripts/options.py --fix.

A row holds the name, the kind, the initial text, the expected values and the purpose.
"""

# ruff: noqa: E501
# fmt: off
Row = tuple[str, str, str, str, str]
ROWS: tuple[Row, ...] = (
    ("threads", "Count", "0", "a number of threads, or 0 for all", "threads that parallel loops use; 0 for all that the process may"),
    ("deterministic", "Switch", "false", "true or false", "results are bit-identical from run to run and for all numbers of threads, or sizes of blocks on a GPU"),
    ("debug", "Switch", "false", "true or false", "assertions, and every index is checked"),
    ("bounds", "Bounds", "off", "off, clamp or check", "what happens to indices that depend on data and are out of range: nothing is defined, the nearest element is taken, or the launch fails"),
    ("fast_math", "Switch", "false", "true or false", "reassociation, reciprocals and approximate functions; NaN and infinities keep their meaning"),
    ("strict", "Switch", "false", "true or false", "every sum, product, quotient and root is rounded by itself: no fused operations; not with fast_math"),
    ("precision", "Text", "default", "default, f64 or f32", "the minimum precision of arithmetic, whatever the types of fields: narrower values are widened when they are loaded"),
    ("sums", "Text", "default", "default, compensated or deterministic", "how sums over iterations and scatters are kept: with twice the digits of their type, or as by the option deterministic"),
    ("math", "Text", "default", "default, fast, strict or accurate", "fast and strict are as by the options fast_math and strict; accurate: elementary functions are within one unit in the last place"),
    ("ftz", "Switch", "false", "true or false", "denormal numbers are zero, as operands and as results"),
    ("adjoints", "Text", "default", "default or f64", "the type of gradient fields: with f64, a field whose gradient has another type is an error"),
    ("shadow", "Switch", "false", "true or false", "kernels compute each float again in higher precision, and lines where digits are lost are reported; implies strict, excludes fast_math, CPU only"),
    ("sanitize", "Sanitizer", "", "\"address\" or nothing", "accesses of kernels are checked by AddressSanitizer, whose runtime the process must have loaded"),
    ("opt_level", "Level", "3", "a number from 0 to 3", "effort of optimisation, as in compiler drivers"),
    ("target_cpu", "Text", "native", "native, or the name that LLVM has for a processor", "the processor that code is made for: this one, or an older one such as x86-64-v3, with the vectors and so the rounding that it has"),
    ("seed", "Seed", "0", "a number from 0 to 2^64 - 1", "the seed of random numbers"),
    ("cache_dir", "Text", "", "a folder, or nothing", "where compiled code is kept; empty for no cache. Where it is not set: $TAI_CACHE_DIR, else the folder `tai` in the user's cache folder"),
    ("print_ir", "Text", "", "stages of the IR", "stages that are printed as kernels are compiled: \"all\" or a list with commas"),
    ("profiler", "Switch", "false", "true or false", "times of launches"),
    ("compile_profile", "Switch", "false", "true or false", "times of each compilation, on the standard error"),
    ("forward_mode", "Switch", "false", "true or false", "every kernel is launched in its forward-mode variant, with tangents; also kernels replayed by a tape, and adjoints"),
    ("history_bytes", "Bytes", "262144", "a number of bytes", "bytes of history that a loop of an adjoint may record at once; with a longer history, parts of the loop are run once more"),
    ("skip", "Skips", "all", "all, none, or names of skips", "kinds of work that are skipped where they are not needed, separated by commas; \"-name\" removes one. Results of strict and deterministic programs do not depend on it where fields hold finite numbers; others may differ by rounding"),
    ("memory_limit", "Bytes", "0", "a number of bytes, or 0", "bytes that fields may take; 0 for what the machine has"),
    ("device_memory_limit", "Bytes", "0", "a number of bytes, or 0", "the same for the memory of the GPU; to be set before arch"),
    ("device_heap", "Bytes", "0", "a number of bytes, or 0 for what suits the device", "bytes that kernels on the GPU may allocate while they run; to be set before arch"),
    ("arch", "Text", "cpu", "cpu, cuda or interpreter", "where kernels run; to be set before the first tree is added. With the interpreter no code is made"),
    ("block_dim", "BlockThreads", "0", "a multiple of 32, or 0", "threads in a block on a GPU; 0 to choose for each kernel. A loop's own block_dim takes precedence"),
    ("max_block_dim", "BlockThreads", "0", "a multiple of 32, or 0", "the maximum of threads in a block; 0 for the limit of the GPU"),
    ("fuse_launches", "Switch", "true", "true or false", "consecutive launches may be fused into one piece of work"),
    ("combine_scatters", "Switch", "true", "true or false", "on a GPU, float additions to elements that data choose are added up in a warp first where all of its threads mean one element; never in deterministic and strict kernels"),
    ("order_seed", "Seed", "0", "a number from 0 to 2^64 - 1", "with the interpreter, the iterations of parallel loops run in an order drawn from it; 0 for ascending"),
)
