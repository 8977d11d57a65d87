"""Targets of kernels, such as `ti.cpu` and `ti.cuda`, and their capabilities."""

from __future__ import annotations

import warnings
from enum import Enum
from typing import Any

from ...errors import TaiRuntimeError, did_you_mean
from . import native
from .callers import calling_level


class Arch(str):
    """A target: `ti.cpu`, `ti.cuda`, …"""

    __slots__ = ()


cpu, arm64 = Arch("cpu"), Arch("arm64")
x64 = x86_64 = cpu  # programs compare them
python = Arch("python")
cuda, gpu, vulkan, metal = Arch("cuda"), Arch("gpu"), Arch("vulkan"), Arch("metal")
opengl, gles, dx11, amdgpu = Arch("opengl"), Arch("gles"), Arch("dx11"), Arch("amdgpu")

# The GPU targets of Taichi for which `gpu` is used here.
_OTHER_GPUS = {vulkan, metal, opengl, gles, dx11, amdgpu}
_CPU = {cpu, arm64, "x64", "x86_64"}


class Extension(Enum):
    """An optional capability of targets."""

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
    """Whether a target has the feature `ext`.

    Loops that carry values are differentiable without a limit, as `adstack` requires.
    """
    return arch in (cpu, arm64, cuda, python) and ext in _SUPPORTED


def why_no_cuda() -> str:
    """Why there is no arch=ti.cuda on this machine; empty where there is."""
    try:
        native.Context().set_option("arch", "cuda")
    except TaiRuntimeError as error:
        return error.message
    return ""


def check_target(arch: Arch, needs: Any, unwanted: Any) -> None:
    """Raises an error if a target lacks an extension of `needs`, or is one of the excluded targets
    `unwanted`.
    """

    def each(what: Any) -> Any:
        return what if isinstance(what, (list, tuple, set)) else (what,)

    if needs:
        for extension in each(needs):
            if not is_extension_supported(arch, extension):
                raise TaiRuntimeError(f"arch=ti.{arch} has no {extension}")
    if arch in each(unwanted):
        raise TaiRuntimeError(f"arch=ti.{arch} is excluded by this program")


def choose_arch(arch: Any) -> tuple[Arch, bool]:
    """Chooses the target of the program, given whether the CPU may replace a target that is not
    available.
    """
    if isinstance(arch, (list, tuple)):
        arch = next((a for a in arch if a in _CPU), arch[0] if arch else None)
    if arch is None or arch in _CPU:
        return cpu, False
    if arch in _OTHER_GPUS:
        warnings.warn(
            f"arch=ti.{arch} is not there: kernels run on an NVIDIA GPU, or on the CPU without one"
            "\n  hint: arch=ti.gpu says so",
            stacklevel=calling_level(),
        )
        arch = gpu
    if arch in (gpu, cuda):
        return cuda, arch == gpu
    if arch == python:
        return python, False
    known = ["cpu", "x64", "cuda", "gpu", "python"]
    raise TaiRuntimeError(f"there is no target '{arch}'", did_you_mean(str(arch), known))
