"""Names that programs written for Taichi's automatic differentiation use."""

import operator
import os
import subprocess
import sys
import textwrap

import pytest
import tai as ti

NAMES = """
kernel func field ndarray Vector Matrix Vector.field Matrix.field Matrix.diag root.dense root.place
root.lazy_grad root.lazy_dual ad.Tape ad.FwdMode ad.grad_for ad.grad_replaced ad.no_grad
ad.clear_all_gradients clear_all_gradients stop_grad data_oriented template grouped ndrange static
select cast random loop_config block_local f32 f64 i32 i j ij ijk cpu cuda gpu vulkan opengl gles
metal dx11 abs acos asin atan2 atomic_add ceil cos exp floor log max min rsqrt sin sqrt tan tanh
polar_decompose svd sym_eig eig solve types.ndarray types.vector types.matrix math.vec2 math.mat3
TaichiAssertionError TaichiCompilationError extension.adstack extension.assertion extension.bls
extension.data64 extension.sparse lang.impl.current_cfg lang.impl.get_runtime
lang.misc.get_host_arch_list lang.util.has_pytorch lang.enums.AutodiffMode.REVERSE
lang.enums.AutodiffMode.FORWARD lang.enums.AutodiffMode.VALIDATION lang.enums.AutodiffMode.NONE
lang.enums.SNodeGradType.ADJOINT lang.enums.SNodeGradType.DUAL lang.enums.SNodeGradType.PRIMAL
lang.exception.TaichiRuntimeError is_extension_supported
""".split()


def test_names_are_there():
    """One test for all: it only sees that they exist."""
    missing = []
    for name in NAMES:
        try:
            operator.attrgetter(name)(ti)
        except AttributeError:
            missing.append(name)
    assert not missing


def test_field_attributes():
    x = ti.field(ti.f32, shape=4, needs_grad=True, needs_dual=True)
    v = ti.Vector.field(3, ti.f32, shape=(2, 2), needs_grad=True)
    for name in "grad dual snode fill to_numpy from_numpy shape dtype".split():
        assert hasattr(x, name)
        assert hasattr(v, name)
    assert x.grad.snode is not None
    assert v.n == 3


def run_as_taichi(program):
    """Runs a program that imports `taichi` and gets this package."""
    source = "import sys, tai\nsys.modules['taichi'] = tai\n" + textwrap.dedent(program)
    done = subprocess.run([sys.executable, "-"], input=source, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_inner_modules_are_the_same_under_the_other_name():
    run_as_taichi(
        """
        import taichi as ti
        import taichi.math as tm
        from taichi.lang import impl
        from taichi.lang.misc import get_host_arch_list, is_extension_supported
        from taichi.lang.enums import AutodiffMode, SNodeGradType
        from taichi.lang.exception import TaichiRuntimeError
        from taichi.lang.util import has_pytorch
        from taichi.lang.matrix import Matrix
        from taichi.lang.snode import SNode
        import tai.lang.impl, tai.math

        assert tm is tai.math and tm is ti.math
        assert impl is tai.lang.impl and impl.__spec__.name == "tai.lang.impl"
        assert Matrix is ti.Matrix
        assert TaichiRuntimeError is ti.TaichiRuntimeError
        assert isinstance(has_pytorch(), bool)
        assert AutodiffMode.REVERSE is not AutodiffMode.FORWARD
        for arch in get_host_arch_list():
            ti.init(arch=arch)
            assert is_extension_supported(arch, ti.extension.adstack)
        """
    )


def test_no_alias_without_being_asked():
    with pytest.raises(ModuleNotFoundError):
        __import__("some_other_name.lang")


def target():
    """Where the tests run."""
    return ti.cuda if os.environ.get("TI_ARCH") == "cuda" else ti.cpu


def test_options_of_a_test_harness():
    ti.init(
        arch=ti.cpu, require=ti.extension.adstack, exclude=[ti.vulkan, ti.opengl],
        ad_stack_size=64, debug=True, fast_math=False,
    )  # fmt: skip
    ti.init(require=[ti.extension.data64, ti.extension.assertion], offline_cache=False)
    arch = target()
    with pytest.raises(ti.TaiRuntimeError, match=rf"arch=ti.{arch} has no .*quant$"):
        ti.init(arch=arch, require=ti.extension.quant)
    with pytest.raises(ti.TaiRuntimeError, match="excluded"):
        ti.init(arch=arch, exclude=[ti.x64 if arch == ti.cpu else ti.cuda])


def test_current_configuration():
    ti.init(arch=ti.cpu, default_fp=ti.f64, ad_stack_size=32, flatten_if=True)
    config = ti.lang.impl.current_cfg()
    assert config.arch == target()
    assert config.default_fp == ti.f64
    assert config.ad_stack_size == 32
    assert config.flatten_if is True
    assert config.device_memory_GB is None
    with pytest.raises(AttributeError, match="no option 'colour'"):
        _ = config.colour


# Programs as the documentation of differentiable programming describes them.


def test_gradient_by_kernel_grad():
    x = ti.field(dtype=ti.f32, shape=(), needs_grad=True)
    y = ti.field(dtype=ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def compute_y():
        y[None] = ti.sin(x[None]) ** 2

    x[None] = 1.0
    compute_y()
    y.grad[None] = 1.0
    compute_y.grad()
    import math

    assert x.grad[None] == pytest.approx(2 * math.sin(1) * math.cos(1), rel=1e-6)


def test_lazy_grad_and_loop_hints():
    x, y = ti.field(ti.f32), ti.field(ti.f32)
    loss = ti.field(ti.f32)
    ti.root.dense(ti.i, 16).place(x, y)
    ti.root.place(loss)
    ti.root.lazy_grad()

    @ti.kernel
    def double():
        ti.loop_config(block_dim=8)
        ti.block_local(x)
        for i in ti.grouped(x):
            y[i] = 2.0 * x[i] if x[i] > 3.0 else x[i]

    @ti.kernel
    def reduce():
        ti.loop_config(parallelize=4)
        for i in range(16):
            loss[None] += y[i]

    for i in range(16):
        x[i] = i
    with ti.ad.Tape(loss=loss):
        double()
        reduce()
    assert loss[None] == 0 + 1 + 2 + 3 + 2 * sum(range(4, 16))
    assert x.grad.to_numpy().tolist() == [1.0] * 4 + [2.0] * 12


def test_diagonal_matrices():
    F = ti.Matrix.field(2, 2, dtype=ti.f32, shape=3, needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def energy():
        for p in F:
            stress = ti.Matrix.diag(dim=2, val=F[p].determinant())
            loss[None] += (stress @ F[p]).sum()

    for p in range(3):
        F[p] = [[1.0, 2.0], [0.5, 3.0]]
    with ti.ad.Tape(loss):
        energy()
    # d (det F sum F) = sum F cof F + det F
    cofactors = [[3.0, -0.5], [-2.0, 1.0]]
    expected = [[6.5 * c + 2.0 for c in row] for row in cofactors]
    for p in range(3):
        assert F.grad[p].to_list() == expected


@pytest.mark.parametrize("name", ["vulkan", "metal", "opengl"])
def test_targets_that_a_gpu_stands_in_for(name, monkeypatch):
    monkeypatch.delenv("TI_ARCH", raising=False)
    with pytest.warns(UserWarning, match=f"arch=ti.{name} is not there"):
        ti.init(arch=getattr(ti, name))
    x = ti.field(ti.f32, shape=2)
    x.fill(3.0)
    assert x.to_numpy().tolist() == [3.0, 3.0]


def test_the_cpu_has_one_name():
    ti.init(arch=ti.x64)
    assert ti.cpu == ti.x64
    assert ti.lang.impl.current_cfg().arch in (ti.x64, ti.cuda, "python")


def test_modules_are_the_same_whoever_looks_first():
    """A finder of the program may stand in front, which would load a second copy of the file."""
    run_as_taichi(
        """
        import importlib.machinery
        import sys

        sys.meta_path.insert(0, importlib.machinery.PathFinder)
        for name in [n for n in sys.modules if n.split(".")[0] in ("tai", "taichi")]:
            del sys.modules[name]
        import tai

        sys.modules["taichi"] = tai
        import taichi.lang
        import taichi.math

        assert taichi.lang is tai.lang and taichi.math is tai.math
        """
    )
