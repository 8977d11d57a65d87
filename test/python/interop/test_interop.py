"""Fields and arrays shared with other libraries, by DLPack and as arguments of kernels.

Without a GPU, the emulated one stands in: its memory is not that of the host's side, so that
missing shares show.
"""

import gc
import os

import numpy as np
import pytest
import tai as ti

ON_GPU = os.environ.get("TI_ARCH") == "cuda" and os.environ.get("TAI_CUDA_EMULATION") != "1"


@pytest.fixture(params=["cpu", "device"])
def arch(request, monkeypatch):
    """The CPU, and a device whose memory NumPy can nevertheless read."""
    monkeypatch.setenv("TI_ARCH", "cpu" if request.param == "cpu" else "cuda")
    monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    ti.init(offline_cache=False)
    return request.param


def test_views_change_with_the_field(arch):
    x = ti.field(ti.f32, shape=(3, 4))

    @ti.kernel
    def add(by: ti.f32):
        for i, j in x:
            x[i, j] += by

    x[1, 2] = 5.0
    view = np.from_dlpack(x)
    assert view.shape == (3, 4) and view.dtype == np.float32 and view.flags.writeable
    assert view[1, 2] == 5.0
    add(1.0)
    ti.sync()
    assert view[1, 2] == 6.0 and view[0, 0] == 1.0
    # From here, and as the host sees it.
    view[2, 3] = 40.0
    assert x[2, 3] == 40.0
    add(1.0)
    assert x[2, 3] == 41.0
    assert x.to_numpy()[2, 3] == 41.0
    # From the host, one by one and all at once.
    x[0, 1] = 7.0
    ti.sync()
    assert view[0, 1] == 7.0
    x.fill(2.0)
    ti.sync()
    assert (view == 2).all()
    x.from_numpy(np.arange(12, dtype=np.float32).reshape(3, 4))
    ti.sync()
    np.testing.assert_array_equal(view.ravel(), np.arange(12))
    view[0, 0] = 9.0
    assert x.to_numpy()[0, 0] == 9.0


def test_the_host_reads_often_what_others_change(arch):
    x = ti.field(ti.i32, shape=5)

    @ti.kernel
    def twice():
        for i in x:
            x[i] *= 2

    view = np.from_dlpack(x)
    for n in range(20):
        view[n % 5] = n
        assert x[n % 5] == n
        twice()
        assert x[n % 5] == 2 * n


def test_no_kernel_uses_a_field_and_an_array_of_its_memory(arch):
    """Compiled code assumes that fields and arrays are apart, and keeps loaded values."""
    x, y = ti.field(ti.f32, shape=8), ti.field(ti.f32, shape=8)

    @ti.kernel
    def shift(a: ti.types.ndarray(ti.f32, 1)):
        for i in x:
            x[i] = a[i] + 1.0

    @ti.kernel
    def other(a: ti.types.ndarray(ti.f32, 1)):
        for i in y:
            y[i] = a[i] + 1.0

    data = np.ones(8, np.float32)
    shift(data)
    view = np.from_dlpack(x)
    for _ in range(2):
        with pytest.raises(ti.TaiError, match="'shift' uses field 'x' and is given an array that"):
            shift(view)
        other(view)
        shift(data)
    assert x.to_numpy().tolist() == [2.0] * 8
    assert y.to_numpy().tolist() == [3.0] * 8
    # A part of it, and memory beside it.
    z = ti.field(ti.f32, shape=(4, 8))

    @ti.kernel
    def first(a: ti.types.ndarray(ti.f32, 1)):
        for i in range(8):
            z[0, i] = a[i]

    with pytest.raises(ti.TaiError, match="'first' uses field"):
        first(np.from_dlpack(z)[3])
    first(view)
    assert z.to_numpy()[0].tolist() == [2.0] * 8


@pytest.mark.parametrize(
    "dt", [ti.i8, ti.u8, ti.i16, ti.i32, ti.i64, ti.f16, ti.f32, ti.f64, ti.u1]
)
def test_types(arch, dt):
    x = ti.field(dt, shape=3)
    x[1] = 1
    view = np.from_dlpack(x)
    assert view.dtype == np.dtype(dt.numpy)
    assert view.tolist() == [0, 1, 0]


def test_layouts(arch):
    v = ti.Vector.field(3, ti.f64, shape=(4, 2))
    m = ti.Matrix.field(2, 3, ti.f32, shape=5)
    a, b = ti.field(ti.f32), ti.field(ti.f32)
    ti.root.dense(ti.i, 6).place(a, b)
    turned = ti.field(ti.i32)
    ti.root.dense(ti.j, 3).dense(ti.i, 2).place(turned)
    one = ti.field(ti.f32, shape=())

    @ti.kernel
    def fill():
        for i, j in v:
            v[i, j] = ti.Vector([i * 1.0, j * 1.0, 7.0])
        for i in m:
            for r, c in ti.static(ti.ndrange(2, 3)):
                m[i][r, c] = 100 * i + 10 * r + c
        for i in a:
            a[i] = i
            b[i] = -i
        for i, j in turned:
            turned[i, j] = 10 * i + j
        one[None] = 3.5

    views = [np.from_dlpack(field) for field in (v, m, a, b, turned, one)]
    fill()
    ti.sync()
    for view, field in zip(views, (v, m, a, b, turned, one), strict=True):
        np.testing.assert_array_equal(view, field.to_numpy())
    assert views[0].shape == (4, 2, 3) and views[1][4, 1, 2] == 412
    assert not views[2].flags.c_contiguous  # b lies between its elements
    assert views[4][1, 2] == 12


def test_what_cannot_be_shared(arch):
    sparse = ti.field(ti.f32)
    ti.root.pointer(ti.i, 4).dense(ti.i, 4).place(sparse)
    blocked = ti.field(ti.f32)
    ti.root.dense(ti.ij, 4).dense(ti.ij, 2).place(blocked)
    apart = ti.Vector.field(2, ti.f32)
    for component in (0, 1):
        ti.root.dense(ti.i, 3).place(apart.get_scalar_field(component))
    for field, reason in ((sparse, "it is sparse"), (blocked, "blocks"), (apart, "lie apart")):
        with pytest.raises(BufferError, match=reason):
            field.__dlpack__()
    whole = ti.field(ti.f32, shape=2)
    with pytest.raises(BufferError, match="copy"):
        whole.__dlpack__(copy=True)
    with pytest.raises(BufferError, match="is on device"):
        whole.__dlpack__(dl_device=(2, 3))


def test_views_outlive_the_field(arch):
    x = ti.field(ti.f64, shape=1000)
    x.fill(3.0)
    view = np.from_dlpack(x)
    ti.init(offline_cache=False)
    del x
    gc.collect()
    other = ti.field(ti.f64, shape=1000)
    other.fill(5.0)
    assert (view == 3.0).all()
    view[:] = 4.0
    assert (other.to_numpy() == 5.0).all()


def test_capsules_that_nobody_takes(arch):
    x = ti.field(ti.f32, shape=4)
    for _ in range(3):
        x.__dlpack__()
        x.__dlpack__(max_version=(1, 0))
    gc.collect()
    assert x.__dlpack_device__() == (1, 0)


def test_gradients_that_others_write_are_cleared(arch):
    x = ti.field(ti.f64, shape=3, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def square():
        for i in x:
            loss[None] += x[i] ** 2

    x.fill(2.0)
    view = np.from_dlpack(x.grad)
    for _ in range(2):
        view[:] = 100.0
        loss[None] = 0
        with ti.ad.Tape(loss):
            square()
        ti.sync()
        np.testing.assert_array_equal(view, 4.0)


def test_arrays_of_others_are_taken_as_they_are(arch):
    class Wrapped:
        """An array with the two methods of DLPack and no others."""

        def __init__(self, array):
            self.array_, self.dtype, self.ndim = array, array.dtype, array.ndim

        def __dlpack__(self, **options):
            return self.array_.__dlpack__(**options)

        def __dlpack_device__(self):
            return self.array_.__dlpack_device__()

    @ti.kernel
    def double(a: ti.types.ndarray(dtype=ti.f32, ndim=1)):
        for i in range(4):
            a[i] *= 2

    data = np.arange(4, dtype=np.float32)
    double(Wrapped(data))
    np.testing.assert_array_equal(data, [0, 2, 4, 6])
    same = ti.from_dlpack(Wrapped(data))
    double(same)
    np.testing.assert_array_equal(data, [0, 4, 8, 12])
    nd = ti.ndarray(ti.f32, 4)
    np.from_dlpack(nd)[:] = 1
    double(nd)
    np.testing.assert_array_equal(nd.to_numpy(), 2)
    # The memory of a field, given to a kernel.
    x = ti.field(ti.f32, shape=4)
    x.fill(3.0)
    double(np.from_dlpack(x))
    np.testing.assert_array_equal(x.to_numpy(), 6)


class OnGpu:
    """The interface of an array on a GPU."""

    def __init__(self, shape=(4,), typestr="<f4", strides=None, number=0):
        self.__cuda_array_interface__ = {
            "version": 3, "shape": shape, "typestr": typestr, "data": (1 << 40, False),
            "strides": strides, "stream": 1,
        }  # fmt: skip


@pytest.mark.skipif(ON_GPU, reason="there is a GPU")
def test_arrays_on_a_gpu_need_kernels_there(arch):
    @ti.kernel
    def double(a: ti.types.ndarray(dtype=ti.f32, ndim=1)):
        for i in range(4):
            a[i] *= 2

    with pytest.raises(
        ti.TaiRuntimeTypeError, match=r"argument 'a' of kernel 'double' is on a GPU"
    ):
        double(OnGpu())
    with pytest.raises(ti.TaiRuntimeTypeError, match="expects an array of f32, but got f64"):
        double(OnGpu(typestr="<f8"))
    ti.wait_for_stream(0)
    ti.let_stream_wait(0)


def test_torch_on_the_cpu(arch):
    torch = pytest.importorskip("torch")
    x = ti.Vector.field(2, ti.f32, shape=3)
    x.fill(1.5)
    copy = x.to_torch()
    assert copy.shape == (3, 2) and copy.dtype == torch.float32
    copy[0, 0] = 9
    assert x[0][0] == 1.5
    shared = torch.from_dlpack(x)
    shared[1, 1] = 8.0
    assert x[1][1] == 8.0
    given = torch.arange(6, dtype=torch.float64).reshape(3, 2)
    x.from_torch(given)
    np.testing.assert_array_equal(x.to_numpy(), given.numpy())
    with pytest.raises(ti.TaiRuntimeTypeError, match="shape"):
        x.from_torch(torch.zeros(2, 3))
    leaf = torch.ones(3, 2, requires_grad=True)
    x.from_torch(leaf.detach())
    assert x[2][1] == 1


@pytest.mark.parametrize("dt", [ti.f16, ti.bf16, ti.f32, ti.f64, ti.i32], ids=str)
@pytest.mark.parametrize("given", ["bfloat16", "float16", "float32", "float64"])
def test_tensors_of_each_type_are_copied(arch, dt, given):
    torch = pytest.importorskip("torch")
    x = ti.field(dt, shape=3)
    x.from_torch(torch.tensor([1.0, -2.0, 3.0], dtype=getattr(torch, given)))
    assert x.to_numpy().tolist() == x.to_torch().tolist() == [1, -2, 3]


def test_tensors_are_copied_from_memory_to_memory(arch, monkeypatch):
    """On a GPU, the way through arrays of the host would be long."""
    torch = pytest.importorskip("torch")
    x = ti.field(ti.f32, shape=3)
    x.fill(2)

    def refuse(*args):
        raise AssertionError("the copy goes through NumPy")

    monkeypatch.setattr(type(x), "to_numpy", refuse)
    monkeypatch.setattr(type(x), "from_numpy", refuse)
    assert x.to_torch().tolist() == [2, 2, 2]
    x.from_torch(torch.tensor([1.0, 2.0, 3.0]))
    assert [x[i] for i in range(3)] == [1, 2, 3]


def test_torch_while_a_tape_records(arch):
    torch = pytest.importorskip("torch")
    x = ti.field(ti.f64, shape=2, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def add():
        for i in x:
            loss[None] += x[i] ** 3

    with ti.ad.Tape(loss) as tape:
        x.from_torch(torch.tensor([1.0, 2.0], dtype=torch.float64))
        add()
    assert loss[None] == 9
    loss[None] = 0
    tape.replay()
    assert loss[None] == 9
