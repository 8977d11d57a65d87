"""`ti.lang.misc`: targets and their capabilities."""

from .._impl.base.program import reset
from .._impl.base.start import init
from .._impl.base.targets import (
    Arch,
    Extension,
    cpu,
    cuda,
    gpu,
    is_extension_supported,
    python,
    why_no_cuda,
    x64,
)
from .._impl.values.ops import (
    block_local,
    cache_read_only,
    loop_config,
    loop_unique,
    ndrange,
    no_activate,
)

extension = Extension


def is_arch_supported(arch: Arch, use_gles: bool = False) -> bool:
    """Whether kernels can run on a target, on this machine."""
    return arch in (cpu, x64, python) or (arch in (cuda, gpu) and not why_no_cuda())


def get_host_arch_list() -> list[Arch]:
    """Returns the targets of this machine's processor."""
    return [x64]


__all__ = [
    "block_local", "cache_read_only", "cpu", "cuda", "extension", "get_host_arch_list", "gpu",
    "init", "is_arch_supported", "is_extension_supported", "loop_config", "loop_unique", "ndrange",
    "no_activate", "python", "reset", "x64",
]  # fmt: skip
