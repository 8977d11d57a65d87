"""Values of other libraries, and of odd forms, where Python gives them to the package: each works,
or is an error of ours with a hint."""

import numpy as np
import pytest
import tai as ti
from tai._impl.frameworks.xla_buffers import DeviceBuffer
from tai._impl.interop import device_arrays

HUGE = 10**400


@ti.kernel
def passed(x: ti.f32) -> ti.f32:
    return x


@ti.kernel
def counted(n: ti.i32) -> ti.i32:
    return n


@ti.kernel
def set_to_one(a: ti.types.ndarray(dtype=ti.f32, ndim=1)):
    for i in a:
        a[i] = 1.0


@pytest.fixture(autouse=True)
def program():
    ti.init(arch=ti.cpu)


def refused(call, message, hint):
    with pytest.raises(ti.TaiError) as caught:
        call()
    assert message in caught.value.message and hint in caught.value.hint
    assert len(str(caught.value)) < 1000


# Whole numbers that no float is near to


@pytest.mark.parametrize("sign", [1, -1])
def test_huge_numbers(sign):
    x, v = ti.field(ti.f32, 2), ti.Vector.field(2, ti.f64, 2)
    a = ti.ndarray(ti.f32, 2)
    number = sign * HUGE
    bits = "a whole number of 1329 bits"
    S = ti.types.struct(a=ti.f32)
    for call in (
        lambda: passed(number), lambda: counted(number), lambda: x.fill(number),
        lambda: x.__setitem__(0, number), lambda: ti.f32(number), lambda: ti.cast(number, ti.f64),
        lambda: S(a=number), lambda: a.__setitem__(0, number), lambda: a.fill(number),
    ):  # fmt: skip
        refused(call, bits, "")
    refused(lambda: v.__setitem__(0, [number, 1]), "…", "store a number")
    assert passed(10**38) == np.float32(1e38) and passed(10**300) == np.inf


def test_huge_numbers_in_kernels():
    @ti.kernel
    def product() -> ti.f32:
        return 1.5 * HUGE

    @ti.kernel
    def quotient() -> ti.f64:
        return HUGE // 10**399 + ti.f64(0.5)

    @ti.kernel
    def loop() -> ti.i32:
        n = 0
        for _ in range(10**30):
            n += 1
        return n

    refused(product, "a whole number of 1329 bits is too large", "the largest float")
    assert quotient() == 10.5
    refused(loop, "one has 100 bits", "nest two loops")


# Shapes


class Sized:
    """As torch.Size and its tensors say a list."""

    def __init__(self, *values):
        self.values = values

    def __repr__(self):
        return "Sized"

    def tolist(self):
        return list(self.values)


@pytest.mark.parametrize(
    "shape",
    [np.array([4, 3]), np.array([4, 3], np.uint8), (np.int64(4), 3), [4, 3], Sized(4, 3),
     np.zeros((4, 3)).shape, range(4, 2, -1)],
    ids=repr,
)  # fmt: skip
def test_shapes_of_many_kinds(shape):
    assert ti.field(ti.f32, shape).shape == (4, 3)
    assert ti.Vector.field(2, ti.f32, shape).shape == (4, 3)
    assert ti.ndarray(ti.f32, shape).shape == (4, 3)
    x = ti.field(ti.f32)
    ti.root.dense(ti.ij, shape).place(x, offset=np.array([1, 2]))
    assert x.shape == (4, 3)
    x[2, 2] = 7
    assert x.to_numpy()[1, 0] == 7


@pytest.mark.parametrize("extent", [np.array(4), np.array([4]), np.int8(4)], ids=repr)
def test_one_extent(extent):
    assert ti.field(ti.f32, extent).shape == (4,)


@pytest.mark.parametrize(
    "shape", [np.array([4.5, 3]), np.array([[4, 3]]), "43", b"43", 4.0, {4}, (4, None), "4"]
)
def test_no_shapes(shape):
    for make in (ti.field, ti.ndarray):
        refused(lambda: make(ti.f32, shape), "a shape is made of whole numbers", "shape=(4, 3)")  # noqa: B023


# Arrays of other libraries


class Lying(np.ndarray):
    """Says that it is much larger."""

    shape = property(lambda self: (10**7,))
    strides = property(lambda self: (4,))
    size = property(lambda self: 10**7)


def test_subclass_of_an_array_with_a_false_shape():
    # Room on both sides, where a store out of range would be seen.
    memory = np.zeros(300, np.float32)
    given = memory[100:103].view(Lying)
    set_to_one(given)
    assert memory.sum() == 3 and memory[100:103].sum() == 3
    set_to_one(memory[200:203].view(Lying))
    assert memory.sum() == 6
    x = ti.field(ti.f32, 3)
    x.from_numpy(given)
    assert x.to_numpy().sum() == 3
    total = ti.field(ti.f32, (), needs_grad=True)

    @ti.kernel
    def add(a: ti.types.ndarray()):
        for i in a:
            total[None] += a[i]

    with ti.ad.Tape(total):
        add(given)
    assert total[None] == 3
    mapped = np.memmap  # another subclass, which is common
    assert issubclass(mapped, np.ndarray)


def test_array_on_a_disk(tmp_path):
    a = np.memmap(tmp_path / "a", np.float32, "w+", shape=(4,))
    set_to_one(a)
    assert a.sum() == 4


class Tensor:
    """As a tensor of torch that does not share its memory."""

    is_cuda = is_meta = is_quantized = is_nested = False
    requires_grad, is_leaf, grad, ndim, shape = False, True, None, 1, (3,)
    dtype, layout, device = "torch.float32", "torch.strided", "cpu"
    error = None

    def __init__(self, **attributes):
        self.__dict__.update(attributes)

    def is_conj(self):
        return self.__dict__.get("conj", False)

    def is_neg(self):
        return self.__dict__.get("neg", False)

    def detach(self):
        return self

    def make_error(self):
        """An exception of its own for each time: it keeps the frames in which it was raised."""
        kind, text = self.error or (BufferError, "cannot export")
        return kind(text)

    def numpy(self):
        raise self.make_error() if self.error else TypeError("can't convert")

    def __dlpack_device__(self):
        return (1, 0)

    def __dlpack__(self, **options):
        raise self.make_error()


@pytest.mark.parametrize(
    ("attributes", "message", "hint"),
    [
        ({"is_meta": True}, "has no memory", "torch.empty_like"),
        ({"layout": "torch.sparse_coo"}, "is sparse", "x.to_dense()"),
        ({"layout": "torch.sparse_csr"}, "is sparse", "x.to_dense()"),
        ({"layout": "torch._mkldnn"}, "is sparse", "x.to_dense()"),
        ({"is_quantized": True}, "is quantized", "x.dequantize()"),
        ({"is_nested": True}, "is nested", "to_padded_tensor"),
        ({"conj": True}, "is a conjugate", "x.resolve_conj()"),
        ({"neg": True}, "is a negative", "x.resolve_neg()"),
        (
            {"error": (RuntimeError, "no storage\nmore")},
            "cannot be shared: no storage",
            "dense copy",
        ),
        ({"error": (TypeError, "can't convert")}, "cannot be shared: can't convert", "dense copy"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_tensors_without_dense_memory(attributes, message, hint):
    refused(lambda: set_to_one(Tensor(**attributes)), message, hint)
    if "neg" not in attributes:
        refused(lambda: ti.from_dlpack(Tensor(**attributes)), message, hint)


def test_from_dlpack_of_something_else():
    for value in (3, None, "a", [1.0]):
        refused(lambda: ti.from_dlpack(value), "takes an array of another library", "__dlpack__")  # noqa: B023
    refused(lambda: ti.from_dlpack(np.zeros(3, "S3")), "cannot be shared", "dense copy")
    a = np.zeros(3, np.float32)
    set_to_one(ti.from_dlpack(a))
    assert a.sum() == 3


# Pictures


@pytest.mark.parametrize("shape", [(), (3,), (3, 3, 5), (3, 3, 0), (0, 3), (3, 3, 3, 3)], ids=repr)
def test_pictures_of_odd_shapes(tmp_path, shape):
    picture = np.zeros(shape, np.float32)
    for call in (
        lambda: ti.tools.imwrite(picture, str(tmp_path / "a.png")),
        lambda: ti.tools.imresize(picture, 4, 4), lambda: ti.tools.imshow(picture),
    ):  # fmt: skip
        refused(call, "a picture has shape (width, height)", "reshape")
    assert not list(tmp_path.iterdir())


def test_pictures_of_odd_kinds(tmp_path):
    path = str(tmp_path / "a.png")
    for value in ("abc", None, np.zeros((3, 3), complex), {"a": 1}):
        refused(lambda: ti.tools.imwrite(value, path), "made of whole numbers or floats", "ti.f32")  # noqa: B023
    refused(lambda: ti.tools.imwrite([[1, 2], [3]], path), "array of numbers", "one length")
    refused(lambda: ti.tools.imread(path), "there is no picture", "paths")
    refused(lambda: ti.tools.imresize(np.zeros((3, 3)), 0), "at least one pixel", "larger")
    refused(lambda: ti.tools.imwrite(np.zeros((3, 3)), path[:-3] + "xyz"), "written", ".png")
    ti.tools.imwrite(np.zeros((3, 5), bool), path)
    assert ti.tools.imread(path).shape == (3, 5)


# Indices and bounds in kernels


def test_struct_as_an_index():
    S = ti.types.struct(k=ti.i32)
    x, s = ti.field(ti.f32, 3), S.field(shape=2)
    numbers = [1, 2]

    @ti.kernel
    def store():
        x[S(k=1)] = 1.0

    @ti.kernel
    def read():
        x[0] = x[s[0]]

    @ti.kernel
    def component():
        v = ti.Vector([1.0, 2.0])
        v[S(k=1)] = 1.0

    @ti.kernel
    def bound():
        for _ in range(S(k=3)):
            x[0] += 1.0

    @ti.kernel
    def item():
        x[0] = numbers[S(k=1)]

    for kernel in (store, read, component, bound, item):
        with pytest.raises(ti.TaiError) as caught:
            kernel()
        assert "struct" in str(caught.value) and "member" in caught.value.hint
        assert "StructValue" not in str(caught.value) and "is_matrix" not in str(caught.value)


def test_bounds_that_are_no_whole_numbers():
    x = ti.field(ti.i32, 3)

    @ti.kernel
    def plain():
        for i in range(3.0):
            x[i] = 1

    @ti.kernel
    def static():
        for i in ti.static(range(3.0)):
            x[i] = 1

    @ti.kernel
    def whole_field():
        for i in range(x):
            x[i] = 1

    for kernel in (plain, static):
        refused(kernel, "", "convert it: int(…)")
    refused(whole_field, "field 'x'", "for i in x")


def test_shape_of_an_array_in_a_kernel():
    values = [1.0, 2.0, 3.0]

    @ti.kernel
    def extent() -> ti.i32:
        n = np.array(values).shape[0]
        total = 0
        for _ in range(np.array([4, 5]).shape[0]):
            total += n
        return total

    assert extent() == 6


def test_halves_are_rounded_otherwise():
    """`np.rint(0.5)` is 0 and `ti.round(0.5)` is 1, and the error says so."""
    x = ti.field(ti.f32, 3)

    @ti.kernel
    def nearest():
        for i in x:
            x[i] = np.rint(x[i])

    hint = "write ti.round(x[i]), which rounds halves away from zero"
    refused(nearest, "np.rint cannot take values of a kernel", hint)


# Arrays and functions of JAX and torch in kernels


@pytest.mark.parametrize("library", ["jax.numpy", "torch"])
def test_functions_of_other_libraries_in_kernels(library):
    np_like = pytest.importorskip(library, reason=f"{library} is not installed")
    x = ti.field(ti.f32, 3)

    @ti.kernel
    def sine():
        for i in x:
            x[i] = np_like.sin(x[i])

    @ti.kernel
    def larger():
        for i in x:
            x[i] = np_like.maximum(x[i], 1.0)

    @ti.kernel
    def unknown():
        for i in x:
            x[i] = np_like.diag(x[i])

    refused(sine, "np_like.sin cannot take values of a kernel", "write ti.sin(x[i])")
    refused(larger, "np_like.maximum cannot take", "write ti.max(x[i], 1.0)")
    refused(unknown, "np_like.diag cannot take", "functions of ti")


@pytest.mark.parametrize("library", ["numpy", "jax.numpy", "torch"])
def test_arrays_as_templates(library):
    np_like = pytest.importorskip(library, reason=f"{library} is not installed")

    @ti.kernel
    def total(x: ti.template()) -> ti.f32:
        result = 0.0
        for i in range(3):
            result += x[i]
        return result

    @ti.kernel
    def first(x: ti.template()) -> ti.f32:
        return float(x[0])

    array = np_like.ones(3)
    refused(lambda: total(array), "known at compile time", "x: ti.types.ndarray()")
    assert first(array) == 1.0


def test_arrays_of_jax_where_they_cannot_be_used():
    jax = pytest.importorskip("jax", reason="JAX is not installed")
    refused(lambda: set_to_one(jax.numpy.zeros(3)), "is written, but", "pass np.array(x)")
    read_only = np.zeros(3, np.float32)
    read_only.flags.writeable = False
    refused(lambda: set_to_one(read_only), "is written, but", "array.copy()")

    @jax.jit
    def traced(x):
        set_to_one(x)
        return x

    refused(lambda: traced(jax.numpy.zeros(3)), "that JAX traces has no memory", "ti.jax.wrap")


def test_traced_arrays_with_a_layout_of_their_own():
    """Newer versions of JAX give tracers a `layout`, as torch gives its tensors."""
    kind = type("DynamicJaxprTracer", (), {"__module__": "jax._src.core", "layout": "Layout((0,))"})
    error = device_arrays._not_shared(kind(), TypeError("no"))
    assert "that JAX traces has no memory" in error.message


def test_parts_of_buffers_of_a_gpu():
    whole = DeviceBuffer(4096, (3, 5, 2), np.float32, 0)
    part = whole[(2, 1, ...)]
    assert (part.shape, part.ndim, part.nbytes) == ((2,), 1, 8)
    assert part.ctypes.data == 4096 + 4 * (2 * 10 + 1 * 2) and part.flags.writeable
    whole.flags.writeable = False
    assert not whole[(0, ...)].flags.writeable


def test_masked_elements_are_refused():
    ti.init(arch=ti.cpu)
    x = ti.field(ti.f32, 4)
    v = ti.Vector.field(2, ti.f32, 4)
    held = ti.ndarray(ti.f32, 4)
    one = np.ma.masked_array(np.arange(4, dtype=np.float32), mask=[0, 1, 0, 0])
    two = np.ma.masked_array(np.ones((4, 2), np.float32), mask=np.eye(4, 2))

    @ti.kernel
    def take(a: ti.types.ndarray()):
        for i in x:
            x[i] = a[i]

    uses = [
        lambda: x.from_numpy(one),
        lambda: x.fill(one),
        lambda: x.__setitem__(0, np.ma.masked),
        lambda: v.from_numpy(two),
        lambda: v.__setitem__(0, two[0]),
        lambda: held.from_numpy(one),
        lambda: take(one),
        lambda: take(one),
    ]
    take(one.data)
    for use in uses:
        with pytest.raises(ti.TaiRuntimeTypeError, match=r"masked(.|\n)*array.filled\(0\)"):
            use()
    # A masked array without masked elements is as good as its data.
    whole = np.ma.masked_array(np.full(4, 2, np.float32))
    take(whole)
    x.from_numpy(whole)
    assert x.to_numpy().tolist() == [2, 2, 2, 2]
