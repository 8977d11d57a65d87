"""`ti.lang.misc`."""

from ..ops import ndrange
from ..program import Arch, cpu, cuda, gpu, x64


def get_host_arch_list() -> list[Arch]:
    """The targets of this machine's processor."""
    return [x64]


__all__ = ["cpu", "cuda", "get_host_arch_list", "gpu", "ndrange", "x64"]
