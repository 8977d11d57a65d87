# ruff: noqa: F401
"""tai: differentiable simulation, compiled.

```python
import tai as ti

ti.init()
x = ti.field(ti.f32, shape=8, needs_grad=True)
loss = ti.field(ti.f32, shape=(), needs_grad=True)

@ti.kernel
def energy():
    for i in x:
        loss[None] += x[i] ** 2

with ti.ad.Tape(loss):
    energy()
print(x.grad)
```
"""

from __future__ import annotations

import importlib as _importlib
from typing import Any

from . import types
from ._impl import alias
from ._impl.base import dtypes, native
from ._impl.base.dtypes import (
    bf16,
    f16,
    f32,
    f64,
    float16,
    float32,
    float64,
    i8,
    i16,
    i32,
    i64,
    int8,
    int16,
    int32,
    int64,
    u1,
    u8,
    u16,
    u32,
    u64,
    uint1,
    uint8,
    uint16,
    uint32,
    uint64,
)
from ._impl.base.mesh import mesh
from ._impl.base.options import CRITICAL, DEBUG, ERROR, INFO, TRACE, WARN
from ._impl.base.program import reset, sync
from ._impl.base.start import init
from ._impl.base.targets import (
    amdgpu,
    arm64,
    cpu,
    cuda,
    dx11,
    gles,
    gpu,
    metal,
    opengl,
    python,
    vulkan,
    x64,
    x86_64,
)
from ._impl.fields.arrays import Ndarray, ndarray
from ._impl.fields.field import Field
from ._impl.fields.make import field
from ._impl.fields.matrix_field import MatrixField
from ._impl.fields.root import root
from ._impl.fields.scalar import ScalarField
from ._impl.fields.snode import (
    FieldsBuilder,
    Layout,
    SNode,
    axes,
    i,
    ij,
    ijk,
    ijkl,
    ijl,
    ik,
    ikl,
    il,
    j,
    jk,
    jkl,
    jl,
    k,
    kl,
    l,
)
from ._impl.values.eigen import eig
from ._impl.values.matrix import Matrix, Vector
from ._impl.values.ops import (
    abs,
    acos,
    acosh,
    activate,
    append,
    asin,
    asinh,
    assume_in_range,
    atan,
    atan2,
    atanh,
    atomic_add,
    atomic_and,
    atomic_max,
    atomic_min,
    atomic_mul,
    atomic_or,
    atomic_sub,
    atomic_xor,
    bit_cast,
    bit_shr,
    block_local,
    cache_read_only,
    cast,
    cbrt,
    ceil,
    copysign,
    cos,
    cosh,
    deactivate,
    erf,
    erfc,
    exp,
    floor,
    get_addr,
    grouped,
    hypot,
    is_active,
    length,
    log,
    log10,
    logical_and,
    logical_not,
    logical_or,
    loop_config,
    max,
    min,
    ndrange,
    no_activate,
    one,
    polar_decompose,
    pow,
    randn,
    random,
    raw_div,
    raw_mod,
    rescale_index,
    round,
    rsqrt,
    select,
    sin,
    sinh,
    solve,
    sqrt,
    static,
    static_assert,
    static_print,
    stop_grad,
    svd,
    sym_eig,
    tan,
    tanh,
    trunc,
    zero,
)
from ._impl.values.types import template
from ._version import __version__
from .errors import (
    TaiAssertionError,
    TaiAutodiffError,
    TaichiAssertionError,
    TaichiAutodiffError,
    TaichiCompilationError,
    TaichiIndexError,
    TaichiNameError,
    TaichiRuntimeError,
    TaichiRuntimeTypeError,
    TaichiSyntaxError,
    TaichiTypeError,
    TaiCompilationError,
    TaiError,
    TaiIndexError,
    TaiMemoryError,
    TaiNameError,
    TaiRuntimeError,
    TaiRuntimeTypeError,
    TaiSyntaxError,
    TaiTypeError,
)
from .errors import did_you_mean as _did_you_mean

alias.install()

# Loaded when they are first used: the extension module with libtai behind it, and modules that draw
# and write pictures.
_LAZY = {
    name: module
    for module, names in {
        "_impl.launch.kernels": "kernel func pyfunc real_func data_oriented Kernel",
        "_impl.ad.batch": "batch",
        "_impl.ad.saved": "export",
        "_impl.ad.ensemble": "ensemble",
        "_impl.ad.solve": "solve_to",
        "_impl.solvers.particles": "Particles",
        "ad": "Tape clear_all_gradients no_grad grad_replaced complex_kernel complex_kernel_grad",
        "lang.misc": "extension is_extension_supported",
        "_impl.fields.root": "deactivate_all_snodes",
        "_impl.fields.structs": "Struct StructField dataclass",
        "types": "BitpackedFields",
        "_impl.fields.array_kinds": "ScalarNdarray VectorNdarray MatrixNdarray",
        "_impl.base.log_level": "set_logging_level is_logging_effective",
        "about": "info",
        "_impl.values.ops": "loop_unique",
        "_impl.values.exponents": "frexp",
        "_impl.interop.device_arrays": "from_dlpack",
        "_impl.interop.streams": "wait_for_stream let_stream_wait",
        "gui": "GUI rgb_to_hex hex_to_rgb",
    }.items()
    for name in names.split()
}
# Names of Taichi that are known and missing: the error says so, and names a replacement.
_NOT_YET = {
    name: instead
    for names, instead in {
        "Texture": "read and write a field or array",
        "Mesh MeshInstance mesh_local mesh_patch_idx": "keep a field of indices for each relation",
        "simt": "loops of kernels are made parallel by the compiler",
        "aot graph": "compiled kernels are cached, and tapes replay launches as one",
        "volatile_load global_thread_idx experimental DeviceCapability Format": "",
        "ref": "return what a function changes, or pass the field as ti.template()",
        "argpack ArgPack": "ti.types.argpack(…) makes the type, and that the pack",
        "sparse_matrix_builder": "ti.linalg solves with a kernel in the place of a matrix",
    }.items()
    for name in names.split()
}
_MODULES = {"ad", "algorithms", "checkpoint", "errors", "gui", "jax", "lang", "linalg", "math",
            "optim", "profiler", "sparse", "testing", "tools", "torch", "ui", "volumes",
            "_lib"}  # fmt: skip


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        value = getattr(_importlib.import_module(f".{_LAZY[name]}", __name__), name)
    elif name in _MODULES:
        value = _importlib.import_module(f".{name}", __name__)
    else:
        if name in _NOT_YET:
            error = AttributeError(f"ti.{name} is not built in yet")
            if _NOT_YET[name]:
                error.add_note(f"hint: {_NOT_YET[name]}")
            raise error
        # With a name, Python adds no suggestion of its own.
        error = AttributeError(f"module 'tai' has no attribute '{name}'", name=name)
        hint = _did_you_mean(name, __dir__())
        if hint:
            error.add_note(hint)
        raise error
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_LAZY, *_MODULES})
