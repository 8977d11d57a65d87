"""The names, methods and keyword arguments that differentiable simulators use exist."""

import operator
import subprocess
import sys

import numpy as np
import pytest
import tai as ti

NAMES = """
f32 f64 i8 i16 i32 i64 u8 u16 u32 u64 float32 float64 int32 int64 uint8
field Vector Matrix init kernel func pyfunc template static static_print static_assert ndrange
grouped cast bit_cast root i j k l ij ik jk ijk ijkl axes
cpu x64 cuda gpu vulkan metal
Vector.field Matrix.field Matrix.diag Matrix.identity Matrix.zero Matrix.one Matrix.rows Matrix.cols
Vector.zero Vector.one Vector.unit Vector.normalized ScalarField MatrixField
ad.Tape ad.no_grad ad.grad_for ad.grad_replaced ad.clear_all_gradients ad.FwdMode
clear_all_gradients Tape no_grad complex_kernel complex_kernel_grad
atomic_add atomic_sub atomic_mul atomic_min atomic_max atomic_and atomic_or atomic_xor
sin cos tan asin acos atan2 tanh exp log sqrt rsqrt floor ceil round abs min max pow select
random randn polar_decompose svd sym_eig solve
types.ndarray types.vector types.matrix types.template ndarray data_oriented
GUI rgb_to_hex tools.imwrite tools.imread tools.imshow tools.VideoManager
sync reset loop_config block_local
profiler.print_kernel_profiler_info profiler.clear_kernel_profiler_info
profiler.query_kernel_profiler_info
lang.impl.get_runtime lang.impl.current_cfg lang.misc.get_host_arch_list
lang.exception.TaichiRuntimeError lang.util.has_pytorch
math.vec2 math.vec3 math.vec4 math.mat2 math.mat3 math.pi math.e math.clamp math.mix math.dot
math.cross math.normalize math.length math.sign math.fract math.step math.smoothstep math.reflect
math.isnan math.isinf math.inf math.nan
TaichiCompilationError TaichiSyntaxError TaichiNameError TaichiTypeError TaichiRuntimeError
TaichiAssertionError TaiAutodiffError
Layout.AOS Layout.SOA FieldsBuilder SNode
DEBUG INFO WARN ERROR
""".split()


def test_names_are_there():
    """Every name of the list exists and is not None."""
    missing = []
    for name in NAMES:
        try:
            assert operator.attrgetter(name)(ti) is not None
        except (AttributeError, AssertionError):
            missing.append(name)
    assert not missing


def test_docstrings():
    for name in NAMES:
        thing = ti
        for part in name.split("."):
            thing = getattr(thing, part)
        if callable(thing) and name.split(".")[0] not in ("math", "lang"):
            assert thing.__doc__, name


def test_every_method_of_the_api_surface():
    s = ti.field(ti.f32, shape=2)
    v = ti.Vector.field(2, ti.f32, shape=2)
    for method in "grad dual fill to_numpy from_numpy shape dtype copy_from parent snode".split():
        assert hasattr(s, method) and hasattr(v, method)
    for method in "n m get_scalar_field".split():
        assert hasattr(v, method)
    matrix = ti.Matrix([[1.0, 2.0], [3.0, 4.0]])
    for method in """transpose determinant inverse trace norm norm_sqr normalized dot cross
                     outer_product sum max min any all cast fill n m to_numpy""".split():
        assert hasattr(matrix, method)
    for method in """circle circles line lines triangle triangles rect text clear show set_image
                     get_image get_event running is_pressed get_cursor_pos""".split():
        assert hasattr(ti.GUI("g", res=8), method)
    for method in "dense pointer bitmasked dynamic place lazy_grad lazy_dual parent".split():
        assert callable(getattr(ti.root, method))


def test_missing_names_say_so():
    with pytest.raises(AttributeError, match="ti.simt is not built in yet"):
        _ = ti.simt
    assert not hasattr(ti, "__path_of_nothing__")


def test_import_loads_neither_the_compiler_nor_plotting():
    program = """
import sys, tai
loaded = {"tai._core", "matplotlib", "PIL", "imageio", "rich", "inspect"} & set(sys.modules)
assert not loaded - {"inspect"}, loaded
"""
    subprocess.run([sys.executable, "-c", program], check=True)


def test_profiler(capsys):
    ti.init(kernel_profiler=True, offline_cache=False)
    x = ti.field(ti.f32, shape=100)

    @ti.kernel
    def work():
        for i in x:
            x[i] += 1

    for _ in range(5):
        work()
    stats = ti.profiler.query_kernel_profiler_info("work")
    assert stats.counter == 5 and stats.total >= stats.max >= stats.min >= 0
    ti.profiler.print_kernel_profiler_info()
    assert "work" in capsys.readouterr().out
    ti.profiler.clear_kernel_profiler_info()
    assert ti.profiler.query_kernel_profiler_info("work").counter == 0


def test_profiler_is_off_by_default():
    ti.init(offline_cache=False)
    with pytest.raises(ti.TaiRuntimeError, match="kernel_profiler=True"):
        ti.profiler.print_kernel_profiler_info()


def test_runtime_shim():
    x = ti.field(ti.f32, shape=3)
    runtime = ti.lang.impl.get_runtime()
    runtime.materialize()
    assert runtime.materialized
    with pytest.raises(ti.TaiRuntimeError):
        x.parent().place(ti.field(ti.f32))
    ti.sync()


def test_deterministic_sums():
    def total(threads):
        ti.init(deterministic=True, cpu_max_num_threads=threads, offline_cache=False)
        x = ti.field(ti.f32, shape=100_000)
        s = ti.field(ti.f32, shape=())
        x.from_numpy(np.random.default_rng(0).standard_normal(100_000).astype(np.float32))

        @ti.kernel
        def kernel():
            for i in x:
                s[None] += x[i]

        kernel()
        return s[None]

    assert len({total(threads) for threads in (1, 2, 2, 2)}) == 1


def test_cache_on_disk(tmp_path):
    def run():
        ti.init(offline_cache=True, offline_cache_file_path=str(tmp_path))
        x = ti.field(ti.f32, shape=4)

        @ti.kernel
        def kernel():
            for i in x:
                x[i] = 3 * i

        kernel()
        return x.to_numpy().tolist()

    assert run() == [0, 3, 6, 9]
    ti.reset()
    entries = [p for p in tmp_path.rglob("*") if p.is_file()]
    assert entries
    for entry in entries:
        entry.write_bytes(b"not an object file" * 10)
    assert run() == [0, 3, 6, 9]


def test_functions_are_called_as_they_are_reached():
    """So that tracebacks and Python's help name them."""
    names = "sin cos sqrt floor ceil round abs min max pow atan2 exp log cbrt erf bit_cast".split()
    names += "atomic_add activate is_active length append".split()
    for name in names:
        function = getattr(ti, name)
        assert (function.__name__, function.__qualname__.split(".")[-1]) == (name, name)
        assert function.__doc__
