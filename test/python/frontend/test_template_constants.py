"""Template arguments: the compiled constants are the values at the launch."""

import copy
import dataclasses
import enum
import gc
import linecache
import math
import types
import weakref
from collections import namedtuple

import numpy as np
import pytest
import tai as ti
from tai.errors import TaiCompilationWarning

# Python takes neighbours for equal, or finds some unequal to itself.
LIKE_NUMBERS = [
    0, 0.0, -0.0, False, 1, 1.0, True, np.float32(1), np.float64(1), np.int8(1), np.int64(1),
    np.bool_(True), math.nan, 100000, 100000.0, 2**31 - 1, np.float32(-0.0),
]  # fmt: skip

Pair = namedtuple("Pair", "value other")


class Level(enum.IntEnum):
    ONE = 1


@dataclasses.dataclass(frozen=True)
class Fixed:
    value: object


CONTAINERS = {
    "bare": lambda x: x,
    "tuple": lambda x: (x,),
    "list": lambda x: [x],
    "nested": lambda x: ((0, [x]), "a"),
    "dict": lambda x: {"a": x},
    "named": lambda x: Pair(x, 0),
    "dataclass": Fixed,
}


def kind_of(x):
    """The visible properties of a compiled number: its type, and its sign even at zero."""
    if isinstance(x, np.generic):
        return str(x.dtype)
    return type(x).__name__


@pytest.mark.parametrize("form", CONTAINERS)
def test_numbers_that_python_takes_for_equal_are_apart(form):
    seen = []

    @ti.func
    def look(x: ti.template()):
        ti.static(seen.append(x))

    @ti.kernel
    def f(box: ti.template()):
        if ti.static(form == "bare"):
            look(box)
        elif ti.static(form == "dict"):
            look(box["a"])
        elif ti.static(form == "nested"):
            look(box[0][1][0])
        elif ti.static(form in ("named", "dataclass")):
            look(box.value)
        else:
            look(box[0])

    for _ in range(2):
        for x in LIKE_NUMBERS:
            seen.clear()
            f(CONTAINERS[form](x))
            # The code that ran was compiled for this very number, now or the first time.
            assert not seen or repr(seen) == repr([x])
    assert len(f._specializations) >= len(LIKE_NUMBERS)


@pytest.mark.parametrize("form", ["tuple", "list", "dict"])
def test_whole_numbers_and_floats_have_their_own_arithmetic(form):
    out = ti.field(ti.f64, ())
    make = CONTAINERS[form]

    @ti.kernel
    def square(box: ti.template()):
        x = box["a"] if ti.static(form == "dict") else box[0]
        out[None] = x * x

    square(make(100000))
    assert out[None] == 1410065408  # 1e10 as an i32
    square(make(100000.0))
    assert out[None] == pytest.approx(1e10, rel=1e-6)
    square(make(100000))
    assert out[None] == 1410065408


def test_signs_of_zero_are_apart():
    out = ti.field(ti.f64, ())

    @ti.kernel
    def f(x: ti.template(), box: ti.template()):
        out[None] = ti.atan2(x, -1.0) + 10 * ti.atan2(box[0], -1.0)

    for x in (0.0, -0.0, 0.0):
        for y in (-0.0, 0.0):
            f(x, (y,))
            wanted = math.atan2(x, -1) + 10 * math.atan2(y, -1)
            assert out[None] == pytest.approx(wanted, rel=1e-6)


def test_nan_is_itself():
    @ti.kernel
    def f(x: ti.template()) -> ti.f32:
        return x

    for _ in range(5):
        assert math.isnan(f(float("nan")))
    assert len(f._specializations) == 1


def test_defaults_are_templates_too():
    @ti.kernel
    def f(x: ti.template() = 1) -> ti.f64:
        return x / 3 * 3 + ti.static(isinstance(x, float))

    assert f(1.0) == pytest.approx(2)
    assert f() == pytest.approx(1)
    assert f(1.0) == pytest.approx(2)
    assert f(True) == pytest.approx(1)


def test_enumerations_are_not_their_numbers():
    @ti.kernel
    def f(x: ti.template()) -> ti.i32:
        return ti.static(isinstance(x, Level))

    assert [f(1), f(Level.ONE), f(1), f(Level.ONE)] == [0, 1, 0, 1]


def test_numpy_numbers_that_are_equal_share_code():
    @ti.kernel
    def f(x: ti.template()) -> ti.f32:
        return x

    for _ in range(3):
        assert f(np.float32(0.5)) == 0.5
    assert len(f._specializations) == 1


CHANGES = {
    "list": ([1.0], lambda x: x.__setitem__(0, 7.0), lambda x: x[0]),
    "nested list": ([[1.0]], lambda x: x[0].__setitem__(0, 7.0), lambda x: x[0][0]),
    "list in a tuple": (([1.0],), lambda x: x[0].__setitem__(0, 7.0), lambda x: x[0][0]),
    "dict": ({"a": 1.0}, lambda x: x.update(a=7.0), lambda x: x["a"]),
    "array": (np.ones(3), lambda x: x.fill(7), lambda x: x[0]),
    "part of an array": (np.ones((4, 4))[::2, ::2], lambda x: x.fill(7), lambda x: x[1, 1]),
    "vector": (ti.Vector([1.0, 2.0]), lambda x: x.fill(7), lambda x: x[0]),
    "vector in a list": ([ti.Vector([1.0])], lambda x: x[0].fill(7), lambda x: x[0][0]),
    "struct": (ti.Struct(a=1.0), lambda x: setattr(x, "a", 7.0), lambda x: x.a),
    "sign": ([0.0], lambda x: x.__setitem__(0, -0.0), lambda x: x[0]),
    "type": ([1], lambda x: x.__setitem__(0, True), lambda x: x[0]),
}


@pytest.mark.parametrize("case", CHANGES)
def test_templates_that_change_in_place_are_noticed(case):
    box, change, read = CHANGES[case]
    box = copy.deepcopy(box)
    seen = []

    @ti.kernel
    def f(x: ti.template()):
        ti.static(seen.append(repr(read(x))))

    f(box)
    f(box)
    assert len(seen) == 1
    change(box)
    f(box)
    f(box)
    assert len(seen) == 2 and seen[0] != seen[1]


def test_a_list_that_changes_gives_the_new_result_and_the_old_again():
    @ti.kernel
    def f(cfg: ti.template()) -> ti.f32:
        return cfg[0]

    cfg = [1.0]
    assert f(cfg) == 1
    cfg[0] = 7.0
    assert f(cfg) == 7
    cfg.insert(0, 3)
    assert f(cfg) == 3
    del cfg[0]
    cfg[0] = 1.0
    assert f(cfg) == 1
    assert len(f._specializations) == 3


def test_gradients_notice_it_too():
    x = ti.field(ti.f32, (), needs_grad=True)
    y = ti.field(ti.f32, (), needs_grad=True)

    @ti.kernel
    def f(cfg: ti.template()):
        y[None] = cfg[0] * x[None]

    cfg = [2.0]
    for factor in (2.0, 5.0):
        cfg[0] = factor
        for grad in (f.grad, f.grad):
            f(cfg)
            x.grad[None], y.grad[None] = 0, 1
            grad(cfg)
            assert x.grad[None] == factor


@ti.data_oriented
class Solver:
    scale = 1.0

    def __init__(self):
        self.n = 2
        self.settings = {"gain": 1.0}
        self.table = np.ones(4)
        self.inner = Fixed([1.0])
        self.x = ti.field(ti.f32, ())
        self.y = ti.field(ti.f32, ())
        self.calls = 0

    @property
    def doubled(self):
        return 2 * self.n

    def computed(self):
        return self.n + 100

    @ti.kernel
    def run(self) -> ti.f32:
        self.x[None] = self.n
        return (
            self.n * 1000 + self.settings["gain"] * 100 + self.table[3] * 10 + self.inner.value[0]
        )

    @ti.kernel
    def run_property(self) -> ti.i32:
        return self.doubled

    @ti.kernel
    def run_python(self) -> ti.i32:
        return self.computed()

    @ti.kernel
    def run_class(self) -> ti.f32:
        return self.scale

    @ti.kernel
    def run_form(self) -> ti.i32:
        return self.table.shape[0]


def test_attributes_of_objects_that_change_are_noticed():
    solver = Solver()
    assert solver.run() == 2111
    assert solver.run() == 2111
    solver.n = 3
    assert solver.run() == 3111
    solver.settings["gain"] = 2.0
    assert solver.run() == 3211
    solver.table[3] = 5
    assert solver.run() == 3251
    solver.inner.value[0] = 4.0
    assert solver.run() == 3254
    solver.x[None], solver.y[None] = 0, 0
    solver.x, solver.y = solver.y, solver.x
    solver.run()
    assert solver.x[None] == 3 and solver.y[None] == 0
    solver.calls += 1  # nothing that the kernel reads
    before = len(Solver.__dict__["run"]._specializations)
    solver.run()
    assert len(Solver.__dict__["run"]._specializations) == before


def test_what_python_code_reads_of_an_object_is_noticed():
    solver = Solver()
    for n in (2, 5, 2):
        solver.n = n
        assert solver.run_property() == 2 * n
        assert solver.run_python() == n + 100


def test_attributes_of_a_class_are_noticed():
    solver = Solver()
    assert solver.run_class() == 1
    solver.scale = 2.0
    assert solver.run_class() == 2
    del solver.scale
    assert solver.run_class() == 1


def test_elements_of_an_array_of_which_only_the_shape_is_read_do_not_matter():
    solver = Solver()
    assert solver.run_form() == 4
    solver.table[0] = 9
    assert solver.run_form() == 4
    kernel = Solver.__dict__["run_form"]
    assert len(kernel._specializations) == 1
    solver.table = np.ones(6)
    assert solver.run_form() == 6


def test_a_kernel_that_is_compiled_again_and_again_says_so():
    solver = Solver()
    with pytest.warns(TaiCompilationWarning, match="16 times, as 'doubled' changes") as said:
        for n in range(17):
            solver.n = n
            assert solver.run_property() == 2 * n
    # At the launch.
    assert len(said) == 1 and said[0].filename == __file__
    assert "solver.run_property()" in linecache.getline(__file__, said[0].lineno)


def test_an_object_that_nothing_can_refer_to_weakly():
    @ti.data_oriented
    class Slots:
        __slots__ = ("n",)

        def __init__(self, n):
            self.n = n

        @ti.kernel
        def run(self) -> ti.i32:
            return self.n

    assert [Slots(n).run() for n in (4, 5, 4)] == [4, 5, 4]


def test_a_list_that_contains_itself_is_refused():
    @ti.kernel
    def f(x: ti.template()):
        pass

    box = []
    box.append(box)
    with pytest.raises(ti.TaiRuntimeTypeError, match="contains itself"):
        f(box)


def test_objects_that_are_gone_are_no_others():
    @ti.func
    def pick(box: ti.template(), n: ti.i32):
        if n > 0:
            return box[0]
        return box[1]

    @ti.kernel
    def f(n: ti.i32) -> ti.f32:
        # Each list is gone when the next one is made.
        a = pick([1, 2], n)
        b = pick([1.5, 2.5], n)
        return a + b

    assert f(1) == 2.5 and f(-1) == 4.5


def test_kernels_let_go_of_their_constants():
    class Thing:
        pass

    def make():
        @ti.kernel
        def f(x: ti.template()) -> ti.i32:
            return x.n

        thing = Thing()
        thing.n, thing.kernel, thing.box = 3, f, [f]
        assert f(thing) == 3
        return weakref.ref(thing)

    kept = make()
    gc.collect()
    assert kept() is None


class Slotted:
    __slots__ = ("n", "rest")


@pytest.mark.parametrize("make", [Slotted, types.SimpleNamespace, lambda: types.ModuleType("m")])
def test_any_object_with_attributes(make):
    @ti.kernel
    def f(x: ti.template()) -> ti.i32:
        return x.n * 10 + x.rest[0]

    thing = make()
    thing.n, thing.rest = 1, (2,)
    assert [f(thing), f(thing)] == [12, 12]
    thing.n = 3
    assert [f(thing), f(thing)] == [32, 32]
    thing.rest = (True,)
    assert [f(thing), f(thing)] == [31, 31]


def test_an_object_whose_attributes_are_exchanged_as_a_whole():
    @ti.kernel
    def f(x: ti.template()) -> ti.i32:
        return x.n

    thing = types.SimpleNamespace(n=1)
    assert [f(thing), f(thing)] == [1, 1]
    thing.__dict__.clear()
    thing.__dict__["n"] = 2
    assert [f(thing), f(thing)] == [2, 2]


def test_matrices_and_structs_can_be_copied():
    vector, struct = ti.Vector([1.0, 2.0]), ti.Struct(a=1.0)
    copies = copy.deepcopy([vector, struct])
    vector[0], struct.a = 5.0, 6.0
    assert copies[0][0] == 1 and copies[1].a == 1
