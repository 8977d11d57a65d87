"""Warnings where a number with a history becomes a constant of a tape or of forward mode."""

import functools
import math
import warnings

import numpy as np
import pytest
import tai as ti

FLAGS = {"needs_grad": True, "needs_dual": True}


@pytest.fixture(autouse=True)
def scene():
    ti.init(default_fp=ti.f64, offline_cache=False)
    return Scene()


class Scene:
    def __init__(self):
        self.x, self.y, self.loss = (ti.field(ti.f64, shape=(), name=n, **FLAGS) for n in "xyl")
        self.v = ti.Vector.field(2, ti.f64, shape=2, name="v", **FLAGS)
        self.plain = ti.field(ti.f64, shape=3, name="plain")
        self.p = ti.types.struct(a=ti.f64, b=ti.f64).field(shape=2, needs_grad=True)
        self.x[None] = 2.0


@ti.kernel
def square(x: ti.template()) -> ti.f64:
    return x[None] ** 2


@ti.kernel
def add(loss: ti.template(), x: ti.template(), r: ti.f64):
    loss[None] += r * x[None]


@ti.kernel
def add_vector(loss: ti.template(), v: ti.types.vector(2, ti.f64)):
    loss[None] += v.norm_sqr()


@ti.data_oriented
class Program:
    def __init__(self, scene):
        self.scene = scene

    @ti.kernel
    def add(self, r: ti.f64):
        self.scene.loss[None] += r * self.scene.x[None]

    def run(self):
        r = square(self.scene.x)
        self.add(math.exp(r))


last_energy = 0.0


def measure(s):
    s.energy = math.sin(square(s.x))


def measure_globally(s):
    global last_energy
    last_energy = math.sin(square(s.x))


def helper(s):
    return 0.5 * s.x[None]


def forget(r):
    return float(r)


def energy(s):
    r = square(s.x)
    return r + 0.0


# Each function has a line that loses a history, keyed by the text of the warning.
def f_math(s):
    r = square(s.x)
    add(s.loss, s.x, math.sin(r))


def f_float(s):
    add(s.loss, s.x, float(square(s.x)))


def f_numpy(s):
    r = float(square(s.x))
    q = np.sqrt(r) * 2
    add(s.loss, s.x, q)


def f_item_by_item(s):
    rs = []
    total = 0.0
    for _ in range(2):
        rs = [*rs, forget(square(s.x))]
        total += rs[-1]
    add(s.loss, s.x, total)


def f_host_read(s):
    add(s.loss, s.x, s.x[None])


def f_host_read_of_a_vector(s):
    w = s.v[1]
    add(s.loss, s.x, w[0] / 2)


def f_host_read_of_a_struct(s):
    s.p[0].a = 1.0
    add(s.loss, s.x, s.p[0].a)


def f_function(s):
    add(s.loss, s.x, helper(s))


def f_function_of_a_result(s):
    add(s.loss, s.x, math.cos(energy(s)))


def f_named(s):
    add(s.loss, s.x, r=abs(s.x[None]))


def f_vector(s):
    add_vector(s.loss, 2 * s.v[0])


def f_method(s):
    Program(s).run()


def f_second_of_a_line(s):
    r = square(s.x)
    add(s.loss, s.x, 1.0), add(s.loss, s.x, math.sin(r))


def f_in_a_dictionary(s):
    kept = {"dt": 0.1}
    kept["energy"] = math.sin(square(s.x))
    add(s.loss, s.x, kept["energy"])


def f_in_a_list(s):
    kept = []
    kept.append(float(square(s.x)))
    add(s.loss, s.x, kept[-1])


def f_in_an_attribute(s):
    s.energy = math.exp(square(s.x))
    add(s.loss, s.x, 2 * s.energy)


def f_in_an_attribute_by_a_function(s):
    measure(s)
    add(s.loss, s.x, s.energy / 2)


def f_in_a_global_name(s):
    measure_globally(s)
    add(s.loss, s.x, last_energy)


def f_in_an_array(s):
    kept = np.zeros(3)
    kept[1] = square(s.x)
    add(s.loss, s.x, kept[1])


def f_by_unpacked_arguments(s):
    kept = {"r": math.sin(square(s.x))}
    add(s.loss, s.x, **kept)


def f_by_a_partial_function(s):
    functools.partial(add, s.loss, s.x)(math.sin(square(s.x)))


def f_by_map(s):
    list(map(functools.partial(add, s.loss, s.x), [math.sin(square(s.x))]))


def w_element(s):
    s.y[None] = square(s.x)


def w_changed_element(s):
    r = square(s.x)
    s.y[None] = math.sin(r)


def w_in_place(s):
    s.y[None] += s.x[None]


def w_fill(s):
    s.v.fill(math.sqrt(square(s.x)))


def w_fill_by_a_result(s):
    s.y.fill(square(s.x))


def w_vector(s):
    s.v[0] = s.v[1] * 2


def w_arrays(s):
    array = s.v.to_numpy()
    array[0] *= 2
    s.v.from_numpy(array)


def w_whole(s):
    s.y.from_numpy(s.x.to_numpy())


def w_array(s):
    ti.ndarray(ti.f64, shape=(), needs_grad=True).fill(square(s.x))


def f_array(s):
    a = ti.ndarray(ti.f64, shape=2, needs_grad=True)
    add(s.loss, s.x, a[0] + 1)


CASES = [f for name, f in list(globals().items()) if name[:2] in ("f_", "w_")]


def lost(record):
    return [w for w in record if "a constant from here on" in str(w.message)]


# The struct has no dual, and arrays never have.
PAIRS = [(f, "tape") for f in CASES]
PAIRS += [(f, "forward") for f in CASES if f not in (f_host_read_of_a_struct, f_array, w_array)]


@pytest.mark.parametrize(("case", "mode"), PAIRS, ids=lambda part: getattr(part, "__name__", part))
def test_a_place_that_loses_a_history(scene, case, mode):
    def run():
        if mode == "tape":
            with ti.ad.Tape(scene.loss):
                case(scene)
        else:
            with ti.ad.FwdMode(scene.loss, scene.x):
                case(scene)

    with warnings.catch_warnings(record=True) as record:
        warnings.simplefilter("always")
        for _ in range(3):
            run()
    found = lost(record)
    assert len(found) == 1
    assert found[0].category is ti.ad.TaiGradientWarning
    assert found[0].filename == __file__
    text = str(found[0].message)
    assert ("to the tape" if mode == "tape" else "to forward mode") in text
    if case.__name__.startswith("w_"):
        wanted = "what an array is given" if case is w_array else "what Python writes to field '"
        assert wanted in text
    else:
        name = "add_vector" if "v" == case.__name__[2:3] else "add"
        assert f"of kernel '{name}' is given" in text and "parameter '" in text
    first = case.__code__.co_firstlineno
    if case is not f_method:
        assert first < found[0].lineno < first + 10


def g_followed(s):
    r = square(s.x)
    add(s.loss, s.x, 2 * r - r / (r + 1) + r**2)
    add(s.loss, s.x, r)


def g_printed(s):
    r = square(s.x)
    text = f"{r:.3f} {float(r)} {math.sqrt(r)} {s.x[None]}"
    assert text
    log = [float(r), s.x.to_numpy()]
    for t in range(2):
        add(s.loss, s.x, 0.1 * t)
    return log


def g_compared(s):
    r = square(s.x)
    add(s.loss, s.x, 1.5 if r > 1 else 0.5)
    if s.x[None] > 1:
        add(s.loss, s.x, 0.25)


def g_whole_numbers(s):
    r = square(s.x)
    add(s.loss, s.x, float(int(r)) + r // 3 + round(s.x[None]))


def g_to_a_field_without_gradient(s):
    s.plain[0] = square(s.x)
    s.plain[1] = s.x[None]
    s.plain.fill(math.sin(square(s.x)))


def g_constants(s):
    square(s.x)
    s.y[None] = 0.5
    s.v.fill(1.5)
    s.v.from_numpy(np.ones((2, 2)))
    s.loss[None] = 0
    add(s.loss, s.x, float(s.plain[0]) + math.sin(0.5))


def g_beside_a_kept_number(s):
    kept, s.dt = {"dt": 0.1, "log": []}, 0.2
    kept["energy"] = float(square(s.x))
    kept["log"].append(kept["energy"])
    s.energy = kept["energy"]
    add(s.loss, s.x, kept["dt"] + s.dt + len(kept["log"]))
    step(s, 0.25)


def g_read_without_recording(s):
    r = square(s.x)
    with ti.ad.no_grad():
        q = square(s.x)
    add(s.loss, s.x, 2 * q)
    add(s.loss, s.x, unrecorded(s))
    add(s.loss, s.x, r)


@ti.ad.no_grad
def unrecorded(s):
    return float(square(s.x))


def g_unrecorded(s):
    square(s.x)
    r = ti.ad.no_grad(lambda: None)
    assert r() is None
    s.x.shape, len(s.v)
    add(s.loss, s.x, 1.0 * len(s.v))


def step(s, r):
    add(s.loss, s.x, r)


def step_of_all(s, *rs):
    add(s.loss, s.x, rs[0])


def step_twice_removed(s, q):
    step(s, r=q + 1)


def store(s, r):
    s.y[None] = r


def in_a_closure(s, r):
    kept = [math.sin(r)]

    def run():
        add(s.loss, s.x, kept[0])

    run()


@pytest.mark.parametrize("mode", ["tape", "forward"])
@pytest.mark.parametrize("function", [step, step_of_all, step_twice_removed, store, in_a_closure])
def test_a_parameter_of_a_function_that_launches(scene, function, mode):
    """The same line is right with a constant, and loses a gradient later."""

    def record(number):
        with warnings.catch_warnings(record=True) as record:
            warnings.simplefilter("always")
            is_tape = mode == "tape"
            with ti.ad.Tape(scene.loss) if is_tape else ti.ad.FwdMode(scene.loss, scene.x):
                r = square(scene.x)
                if number is None:
                    for _ in range(3):
                        function(scene, math.sin(r))
                else:
                    function(scene, number)
                add(scene.loss, scene.x, 1.0)
        return lost(record)

    if function is not in_a_closure:
        assert record(0.5) == record(1.5) == []
    (warning,) = record(None)
    launching = step if function is step_twice_removed else function
    first = launching.__code__.co_firstlineno
    assert first < warning.lineno < first + 8
    assert record(None) == []


@pytest.mark.parametrize(
    "case", [f for name, f in list(globals().items()) if name[:2] == "g_"], ids=lambda f: f.__name__
)
def test_no_warning_where_nothing_is_lost(scene, case):
    with warnings.catch_warnings(record=True) as record:
        warnings.simplefilter("always")
        with ti.ad.Tape(scene.loss):
            case(scene)
    assert not lost(record)


def test_outside_of_tapes_nothing_is_looked_at(scene):
    with warnings.catch_warnings(record=True) as record:
        warnings.simplefilter("always")
        with ti.ad.Tape(scene.loss):
            r = square(scene.x)
        add(scene.loss, scene.x, math.sin(r))
        scene.y[None] = r
        scene.v.from_numpy(2 * scene.v.to_numpy())
    assert not lost(record)
