"""`ti.lang.misc`: targets, and what they can do."""

from enum import Enum

from .._impl.base.program import Arch, arm64, cpu, cuda, gpu, init, python, reset, why_no_cuda, x64
from .._impl.values.ops import (
    block_local,
    cache_read_only,
    loop_config,
    loop_unique,
    ndrange,
    no_activate,
)


class Extension(Enum):
    """What a target may have, or not."""

    sparse = "sparse"
    quant = "quant"
    quant_basic = "quant_basic"
    data64 = "data64"
    adstack = "adstack"
    bls = "bls"
    assertion = "assertion"
    extfunc = "extfunc"
    mesh = "mesh"


extension = Extension

# Block-local storage is a hint without effect here; programs that ask for it run.
_SUPPORTED = {
    Extension.data64,
    Extension.adstack,
    Extension.assertion,
    Extension.bls,
    Extension.sparse,
}


def is_extension_supported(arch: Arch, ext: Extension) -> bool:
    """Whether a target has what `ext` names.

    Loops that carry values are differentiable without a limit, which is what `adstack`
    asks for.
    """
    return arch in (cpu, x64, arm64, cuda, python) and ext in _SUPPORTED


def is_arch_supported(arch: Arch, use_gles: bool = False) -> bool:
    """Whether kernels can run on a target, on this machine."""
    return arch in (cpu, x64, python) or (arch in (cuda, gpu) and not why_no_cuda())


def get_host_arch_list() -> list[Arch]:
    """The targets of this machine's processor."""
    return [x64]


__all__ = [
    "block_local", "cache_read_only", "cpu", "cuda", "extension", "get_host_arch_list", "gpu",
    "init", "is_arch_supported", "is_extension_supported", "loop_config", "loop_unique", "ndrange",
    "no_activate", "python", "reset", "x64",
]  # fmt: skip
