"""The table of Taichi's names is up to date, and names that no other test uses do their work."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest
import tai as ti

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "scripts"))
import taichi_names  # noqa: E402

ROW = re.compile(r"^\| `(\w+)` \| (yes|no) \| .* \| (?:\[\w+\]\(\.\./\.\./([\w/.]+)\))? \|$", re.M)
TEXT = taichi_names.PAGE.read_text()


def test_the_page_is_up_to_date():
    """Or run scripts/taichi_names.py --write."""
    rows = [match.groups()[:2] for match in ROW.finditer(TEXT)]
    there = [(name, "yes" if taichi_names.found(owner, name) else "no")
             for owner, name in taichi_names.names()]  # fmt: skip
    assert rows == there
    assert sum(state == "yes" for _, state in rows) > 390


def test_each_name_has_a_test():
    for name, state, test in (match.groups() for match in ROW.finditer(TEXT)):
        if state == "yes":
            assert test, f"{name} has no test"
            assert name in (ROOT / test).read_text(), f"{test} does not use {name}"


def test_names_that_are_missing_have_a_remark():
    assert not re.findall(r"^\| `\w+` \| no \|  \|.*", TEXT, re.M)


SAME = """
ti.float16=ti.f16 ti.float32=ti.f32 ti.float64=ti.f64 ti.int8=ti.i8 ti.int16=ti.i16 ti.int32=ti.i32
ti.int64=ti.i64 ti.uint1=ti.u1 ti.uint8=ti.u8 ti.uint16=ti.u16 ti.uint32=ti.u32 ti.uint64=ti.u64
ti.types.f16=ti.f16 ti.types.f32=ti.f32 ti.types.f64=ti.f64 ti.types.i8=ti.i8 ti.types.i16=ti.i16
ti.types.i32=ti.i32 ti.types.i64=ti.i64 ti.types.u1=ti.u1 ti.types.u8=ti.u8 ti.types.u16=ti.u16
ti.types.u32=ti.u32 ti.types.u64=ti.u64 ti.types.template=ti.template ti.x86_64=ti.x64
ti.types.float16=ti.f16 ti.types.float32=ti.f32 ti.types.float64=ti.f64 ti.types.int8=ti.i8
ti.types.int16=ti.i16 ti.types.int32=ti.i32 ti.types.int64=ti.i64 ti.types.uint1=ti.u1
ti.types.uint8=ti.u8 ti.types.uint16=ti.u16 ti.types.uint32=ti.u32 ti.types.uint64=ti.u64
ti.TaichiNameError=ti.TaiNameError ti.TaichiRuntimeTypeError=ti.TaiRuntimeTypeError
ti.TaichiSyntaxError=ti.TaiSyntaxError ti.TaichiTypeError=ti.TaiTypeError
""".split()


@pytest.mark.parametrize("pair", SAME)
def test_two_names_of_one_thing(pair):
    one, other = (eval(name, {"ti": ti}) for name in pair.split("="))
    assert one is other


def test_axes():
    fields = [ti.field(ti.f32) for _ in range(6)]
    levels = (ti.ikl, ti.ijl, ti.jkl), (ti.il, ti.jl, ti.kl)
    for (rank, axes), field in zip(
        [(3, axes) for axes in levels[0]] + [(2, axes) for axes in levels[1]], fields, strict=True
    ):
        ti.root.dense(axes, (2, 3, 4)[:rank]).place(field)
        assert field.shape == (2, 3, 4)[:rank]


def test_levels_of_messages_are_in_order():
    levels = [ti.TRACE, ti.DEBUG, ti.INFO, ti.WARN, "error", ti.CRITICAL]
    for level in levels:
        ti.set_logging_level(level)
        assert ti.is_logging_effective(ti.CRITICAL)
    assert not ti.is_logging_effective(ti.DEBUG)
    ti.set_logging_level(ti.WARN)


OTHERS = [ti.amdgpu, ti.dx11, ti.gles, ti.metal, ti.opengl, ti.vulkan]


@pytest.mark.parametrize("target", OTHERS)
def test_targets_that_there_are_not(target, monkeypatch):
    monkeypatch.delenv("TI_ARCH", raising=False)
    monkeypatch.setenv("TAI_CUDA_DRIVER", "no-such-library")
    with pytest.warns(UserWarning, match="is not there: kernels run on an NVIDIA GPU, or on the"):
        ti.init(arch=target)


def test_other_names_of_the_cpu(monkeypatch):
    monkeypatch.delenv("TI_ARCH", raising=False)
    ti.init(arch=ti.arm64)
    assert ti.lang.impl.current_cfg().arch == ti.cpu


def test_classes_of_fields():
    x, v = ti.field(ti.f32, shape=2), ti.Vector.field(2, ti.f32, shape=2)
    s = ti.Struct.field({"a": ti.f32}, shape=2)
    assert isinstance(x, ti.ScalarField) and isinstance(x, ti.Field)
    assert isinstance(v, ti.MatrixField) and isinstance(v, ti.Field)
    assert isinstance(s, ti.StructField)
    assert ti.Struct(a=1).methods == {}
    assert isinstance(ti.root.dense(ti.i, 2), ti.SNode)
    assert ti.Matrix([[1.0, 2.0, 3.0]]).get_shape() == (1, 3)


def test_hints_and_compile_time(capsys):
    x = ti.field(ti.f32, shape=4)

    @ti.real_func
    def twice(a: ti.f32) -> ti.f32:
        return 2 * a

    @ti.kernel
    def run():
        ti.static_assert(x.shape[0] == 4, "four")
        ti.static_print("shape", x.shape)
        ti.cache_read_only(x)
        for i in x:
            x[i] = twice(i)

    run()
    assert x.to_numpy().tolist() == [0, 2, 4, 6]
    assert "shape (4,)" in capsys.readouterr().out


def test_all_cells_become_inactive():
    x = ti.field(ti.f32)
    block = ti.root.pointer(ti.i, 4)
    block.dense(ti.i, 4).place(x)
    x[5] = 1.0
    ti.deactivate_all_snodes()
    assert x[5] == 0.0

    @ti.kernel
    def count() -> ti.i32:
        n = 0
        for _i in x:
            n += 1
        return n

    assert count() == 0


def test_functions_of_vectors_as_in_shaders():
    tm = ti.math
    result = ti.field(ti.f64, shape=16)

    @ti.kernel
    def run():
        for _ in range(1):
            v, n = ti.Vector([1.0, -1.0]), ti.Vector([0.0, 1.0])
            result[0], result[1] = tm.degrees(tm.pi), tm.radians(180.0)
            result[2] = tm.fract(2.25)
            result[3] = tm.smoothstep(0.0, 1.0, 0.25)
            r = tm.reflect(v, n)
            result[4], result[5] = r.x, r.y
            t = tm.refract(n * -1.0, n, 0.7)
            result[6], result[7] = t.x, t.y
            m = tm.rotation2d(tm.pi / 2)
            q = m @ ti.Vector([1.0, 0.0])
            result[8], result[9] = q.x, q.y
            result[10] = tm.eye(3).trace()
            result[11] = tm.e

    run()
    want = [180, np.pi, 0.25, 0.15625, 1, 1, 0, -1, 0, 1, 3, np.e]
    np.testing.assert_allclose(result.to_numpy()[:12], want, atol=1e-6)
    assert tm.ivec4(1, 2, 3, 4).sum() == 10 and tm.vec4(1, 2, 3, 4).sum() == 10.0
    assert tm.uvec2(1, 2).sum() + tm.uvec3(1, 2, 3).sum() + tm.uvec4(1, 1, 1, 1).sum() == 13
    assert tm.mat4(np.eye(4).tolist()).trace() == 4


def test_kinds_of_types():
    types = ti.types
    assert ti.types.is_real(ti.f32) and not ti.types.is_real(ti.i32)
    assert ti.types.is_integral(ti.u8) and not types.is_integral(ti.f64)
    assert ti.types.is_signed(ti.i8) and not types.is_signed(ti.u8)


def test_profiler_of_scopes(capsys):
    ti.profiler.clear_scoped_profiler_info()
    ti.profiler.print_scoped_profiler_info()
    assert ti.profiler.set_kernel_profiler_toolkit("default")


def test_arrows_and_triangles(tmp_path):
    gui = ti.GUI("test", res=(32, 32), show_gui=False)
    gui.triangles(a=np.array([[0.1, 0.1]]), b=np.array([[0.9, 0.1]]), c=np.array([[0.5, 0.9]]))
    before = gui.get_image().copy()
    assert before.max() > 0
    gui.arrow(orig=[0.1, 0.9], direction=[0.5, 0.0], color=0xFF0000)
    assert (gui.get_image() != before).any()
