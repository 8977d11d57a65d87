"""Writes to a field through a view of it, by DLPack, between two recorded launches."""

import warnings

import numpy as np
import pytest
import tai as ti
from tai._impl.history import origins


@pytest.fixture(params=["cpu", "emulated"])
def arch(request, monkeypatch):
    """Memory of the emulated device is compared by copies, as that of a GPU is."""
    if request.param == "emulated":
        monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    return ti.cpu if request.param == "cpu" else ti.cuda


class Scene:
    """x -> y -> loss"""

    def __init__(self, size=1000, dtype=ti.f32, shared=False, arch=ti.cpu):
        ti.init(arch=arch, default_fp=ti.f32, offline_cache=False)
        x = self.x = ti.field(dtype, needs_grad=True, name="x")
        y = self.y = ti.field(dtype, needs_grad=True, name="y")
        loss = self.loss = ti.field(dtype, shape=(), needs_grad=True, name="loss")
        if shared:
            ti.root.dense(ti.i, size).place(x, y)
        else:
            ti.root.dense(ti.i, size).place(x)
            ti.root.dense(ti.i, size).place(y)
        x.fill(1.0)

        @ti.kernel
        def square():
            for i in x:
                y[i] = x[i] * x[i]

        @ti.kernel
        def total():
            for i in y:
                loss[None] += y[i]

        self.square, self.total = square, total
        self.view_of_x, self.view_of_y = np.from_dlpack(x), np.from_dlpack(y)

    def said(self, between, **options):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            for _ in range(2):
                with ti.ad.Tape(self.loss, **options):
                    self.square()
                    between()
                    self.total()
        assert all(w.filename == __file__ for w in caught)
        return [str(w.message) for w in caught]


@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize("dtype", [ti.f32, ti.f64])
@pytest.mark.parametrize("size", [1, 30, 65_537])
def test_a_write_of_all_elements(size, dtype, shared, arch):
    s = Scene(size, dtype, shared, arch)

    def write():
        s.view_of_x[:] = 2 * s.view_of_x

    (message,) = s.said(write)
    # Also where the elements of both lie between each other.
    assert "field 'x' was written through a view of it (DLPack)" in message


def test_a_write_to_a_computed_field(arch):
    s = Scene(arch=arch)
    (message,) = s.said(lambda: np.multiply(s.view_of_y, 2, out=s.view_of_y))
    assert "field 'y' was written" in message


def test_a_write_before_the_sweep(arch):
    s = Scene(arch=arch)
    with pytest.warns(ti.ad.TaiGradientWarning, match="field 'x' was written"):  # noqa: SIM117
        with ti.ad.Tape(s.loss):
            s.square()
            s.total()
            s.view_of_x[3] = 7


def test_validation_sees_a_single_element(arch):
    s = Scene(100_003, arch=arch)
    count = iter(range(100))

    def write():
        s.view_of_x[50_001] = 3.0 + next(count)

    assert s.said(write) == []  # a few pieces do not show it
    (message,) = s.said(write, validation=True)
    assert "field 'x' was written" in message


@pytest.mark.parametrize("form", ["nothing", "fill", "element", "from_numpy", "before", "read"])
def test_nothing_is_said(form, arch):
    s = Scene(arch=arch)
    work = {
        "nothing": lambda: None,
        "fill": lambda: s.x.fill(3.0),
        "element": lambda: s.x.__setitem__(5, 2.0),
        "from_numpy": lambda: s.x.from_numpy(np.ones(1000, np.float32)),
        "before": lambda: None,
        "read": lambda: s.view_of_x.sum(),
    }[form]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for value in (1.0, 2.0):
            if form == "before":
                s.view_of_x[:] = value
            with ti.ad.Tape(s.loss):
                if form == "before":
                    s.view_of_x[:] = value + 1
                s.square()
                work()
                s.total()
    if form == "before":
        assert s.x.grad[7] == 6.0


def test_a_tree_that_is_destroyed_while_the_tape_is_open(arch):
    s = Scene(arch=arch)
    tree = ti.FieldsBuilder()
    z = ti.field(ti.f32, needs_grad=True)
    tree.dense(ti.i, 5000).place(z, z.grad)
    made = tree.finalize()
    view = np.from_dlpack(z)
    with ti.ad.Tape(s.loss):
        s.square()
        del view
        made.destroy()
        s.total()
    assert s.loss[None] == 1000.0


@pytest.mark.parametrize("form", ["numpy", "torch"])
def test_a_view_that_is_made_between_launches(form, arch):
    """It may be gone before the next launch."""
    s = Scene(arch=arch)
    s.view_of_x = s.view_of_y = None

    assert s.said(lambda: np.from_dlpack(s.x).sum()) == []
    (message,) = s.said(lambda: write_through_a_view(s.x, form))
    assert "field 'x' was written" in message


def write_through_a_view(field, form):
    if form == "numpy":
        view = np.from_dlpack(field)
        np.multiply(view, 3.0, out=view)
    else:
        pytest.importorskip("torch").from_dlpack(field).mul_(3.0)


def test_torch_writes_in_place(arch):
    torch = pytest.importorskip("torch")
    s = Scene(70_001, arch=arch)
    tensor = torch.from_dlpack(s.x)

    def write():
        tensor[:1000] += 1.0

    (message,) = s.said(write)
    assert "field 'x' was written" in message


def test_a_view_that_is_gone_costs_nothing(arch):
    s = Scene(arch=arch)
    with ti.ad.Tape(s.loss):
        s.square()
        assert len(watched()) == 2
        s.total()
    copied = np.array(s.view_of_x)
    s.view_of_x = None
    with ti.ad.Tape(s.loss):
        s.square()
        assert [field.name for field, _ in watched()] == ["y"]
        s.total()
    s.view_of_y = None
    with ti.ad.Tape(s.loss):
        s.square()
        assert not watched()
        s.total()
    assert copied[3] == 1.0 and s.x.grad[3] == 2.0


def watched():
    return origins._of_thread.views


@pytest.mark.parametrize("width", [1, 3])
@pytest.mark.parametrize("size", [40, 30_001])
@pytest.mark.parametrize("validation", [False, True])
def test_neighbours_in_the_same_cells(width, size, validation, arch):
    """Only the elements of a field are compared, wherever those of another one lie."""
    ti.init(arch=arch, default_fp=ti.f32, offline_cache=False)
    p = ti.Vector.field(width, ti.f32, needs_grad=True, name="p")
    q = ti.field(ti.f32, name="q")
    loss = ti.field(ti.f32, shape=(), needs_grad=True, name="loss")
    ti.root.dense(ti.i, size).place(p, q)
    p.fill(1.0)

    @ti.kernel
    def total():
        for i in p:
            loss[None] += p[i].norm_sqr()

    @ti.kernel
    def weigh(a: ti.types.ndarray(dtype=ti.f32, ndim=1)):
        for i in range(3):
            loss[None] += p[i][0] * a[i]

    view_of_p, view_of_q = np.from_dlpack(p), np.from_dlpack(q)
    options = {"validation": True} if validation else {}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with ti.ad.Tape(loss, **options):
            total()
            view_of_q[:] = 5.0
            total()
        with ti.ad.Tape(loss, **options):
            total()
            weigh(np.array(view_of_q))
    with pytest.warns(ti.ad.TaiGradientWarning, match="field 'p' was written"):  # noqa: SIM117
        with ti.ad.Tape(loss, **options):
            total()
            view_of_p[:] = 2.0
            total()


class Weights(Scene):
    def __init__(self, arch=ti.cpu):
        super().__init__(arch=arch)
        y, loss = self.y, self.loss

        @ti.kernel
        def weigh(a: ti.types.ndarray(dtype=ti.f32, ndim=1)):
            for i in y:
                loss[None] += y[i] * a[i]

        @ti.kernel
        def scale(f: ti.f32):
            for i in y:
                loss[None] += y[i] * f

        self.weigh, self.scale = weigh, scale


@pytest.mark.parametrize("form", ["copy", "computed", "to_numpy", "number", "loop", "stored"])
def test_numbers_from_before_the_tape(form, arch):
    """They are constants, whatever they were computed from."""
    s = Weights(arch)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if form in ("copy", "computed", "to_numpy"):
            weights = {"copy": s.view_of_x.copy(), "computed": 1 / (1 + s.view_of_x),
                       "to_numpy": s.x.to_numpy() * 2}[form]  # fmt: skip
            with ti.ad.Tape(s.loss):
                s.square()
                s.weigh(weights)
        elif form == "number":
            factor = float(s.view_of_x[3]) + s.x[4]
            with ti.ad.Tape(s.loss):
                s.square()
                s.scale(factor)
        else:
            weights = np.zeros(1000, np.float32)
            for _ in range(3):
                if form == "loop":
                    weights = s.view_of_x * 2
                with ti.ad.Tape(s.loss):
                    s.square()
                    s.weigh(weights)
                if form == "stored":
                    weights[:] = s.view_of_x
                np.subtract(s.view_of_x, 0.1, out=s.view_of_x)


@pytest.mark.parametrize("form", ["view", "copy", "computed", "number", "round"])
def test_numbers_from_within_the_tape(form, arch):
    s = Weights(arch)
    with pytest.warns(ti.ad.TaiGradientWarning) as caught, ti.ad.Tape(s.loss):
        s.square()
        if form == "view":
            s.weigh(s.view_of_x)
        elif form == "copy":
            copied = s.view_of_x.copy()
            s.weigh(copied)
        elif form == "computed":
            s.weigh(1 / (1 + s.view_of_x))
        elif form == "number":
            factor = float(s.view_of_x[3])
            s.scale(factor)
        else:
            weights = np.ones(1000, np.float32)
            for _ in range(2):
                s.weigh(weights)
                weights = s.view_of_x * 2
    assert len(caught) == 1


def test_a_view_of_a_field_without_a_gradient(arch):
    s = Weights(arch)
    z = ti.field(ti.f32, shape=1000)
    view = np.from_dlpack(z)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with ti.ad.Tape(s.loss):
            s.square()
            view[:] = 3.0
            s.scale(float(view[5]))
            s.weigh(np.array(view))
