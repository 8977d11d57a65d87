"""Numbers that Python reads from fields reach kernels by ways that no text shows, and are still
found; the same ways with constants are silent."""

import dataclasses
import functools
import json
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
        self.x, self.loss, self.total = (ti.field(ti.f64, shape=(), **FLAGS) for _ in range(3))
        self.v = ti.Vector.field(2, ti.f64, shape=3, **FLAGS)
        self.constant = ti.field(ti.f64, shape=())
        self.a = ti.ndarray(ti.f64, shape=2, needs_grad=True)
        self.x[None], self.constant[None] = 3.0, 0.5


@ti.kernel
def measure(loss: ti.template(), v: ti.template(), x: ti.template()):
    loss[None] += x[None] ** 2
    v[0][1] += x[None] ** 2


@ti.kernel
def add(total: ti.template(), x: ti.template(), r: ti.f64):
    total[None] += r * x[None]


@ti.kernel
def add_vector(total: ti.template(), r: ti.types.vector(2, ti.f64)):
    total[None] += r[0] * r[1]


@dataclasses.dataclass
class Step:
    size: float


class Reader:
    def __init__(self, field):
        self.field = field

    def __call__(self):
        return self.field[None]

    def read(self):
        return self.field[None]

    @property
    def value(self):
        return self.field[None]


def launch(scene, r):
    add(scene.total, scene.x, r)


# Each function hands the number of a field to a kernel.
def by_a_data_class(scene, field):
    step = Step(field[None])
    launch(scene, step.size)


def by_a_default(scene, field):
    def run(r=field[None]):
        launch(scene, r)

    run()


def by_a_generator(scene, field):
    def numbers():
        yield field[None]

    for r in numbers():
        launch(scene, r)


def by_a_pattern(scene, field):
    match {"r": field[None]}:
        case {"r": r}:
            launch(scene, r)


def by_a_property(scene, field):
    launch(scene, Reader(field).value)


def by_a_method_of_a_new_object(scene, field):
    launch(scene, Reader(field).read())


def by_an_object_that_is_called(scene, field):
    launch(scene, Reader(field)())


def by_setattr(scene, field):
    step = Step(0.0)
    setattr(step, "size", field[None])  # noqa: B010
    launch(scene, step.size)


def by_a_special_method(scene, field):
    launch(scene, field.__getitem__(None))  # noqa: PLC2801


def by_a_text(scene, field):
    exec("launch(scene, field[None])", {"launch": launch, "scene": scene, "field": field})


def by_a_cache(scene, field):
    @functools.lru_cache
    def read():
        return field[None]

    launch(scene, read())


def by_a_vararg_of_a_partial_function(scene, field):
    functools.partial(launch, scene)(*[field[None]])


WAYS = [way for name, way in list(globals().items()) if name.startswith("by_")]


def lost(record):
    return [w for w in record if "a constant from here on" in str(w.message)]


def record(scene, mode, run):
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        is_tape = mode == "tape"
        with ti.ad.Tape(scene.total) if is_tape else ti.ad.FwdMode(scene.total, scene.x):
            measure(scene.loss, scene.v, scene.x)
            run()
    return lost(found)


@pytest.mark.parametrize("mode", ["tape", "forward"])
@pytest.mark.parametrize("way", WAYS, ids=lambda way: way.__name__)
def test_a_number_is_known_however_it_comes(scene, way, mode):
    assert record(scene, mode, lambda: way(scene, scene.constant)) == []
    (warning,) = record(scene, mode, lambda: way(scene, scene.loss))
    assert warning.category is ti.ad.TaiGradientWarning
    assert "parameter 'r' of kernel 'add'" in str(warning.message)
    assert record(scene, mode, lambda: way(scene, scene.loss)) == []  # once is enough


def test_a_line_that_was_right_with_constants(scene):
    """The launcher knows the place, and looks at each number nevertheless."""
    steps = [Step(0.5) for _ in range(4)]

    def run():
        steps[2].size = scene.loss[None]
        for step in steps:
            launch(scene, step.size)

    assert len(record(scene, "tape", run)) == 1


def test_a_property_that_computes(scene):
    class Half(Reader):
        @property
        def half(self):
            return 0.5 * self.field[None]

    half = Half(scene.loss)
    (warning,) = record(scene, "tape", lambda: launch(scene, half.half))
    assert "parameter 'r'" in str(warning.message)


def test_a_component_of_an_element(scene):
    (warning,) = record(scene, "tape", lambda: launch(scene, scene.v[0][1]))
    assert "parameter 'r'" in str(warning.message)
    assert record(scene, "tape", lambda: launch(scene, [[0.5]][0][0])) == []


def test_an_array_of_a_whole_field(scene):
    def run(field):
        launch(scene, float(np.asarray(field)) + 1)

    assert record(scene, "tape", lambda: run(scene.constant)) == []
    (warning,) = record(scene, "tape", lambda: run(scene.loss))
    assert "parameter 'r'" in str(warning.message)


def test_an_element_that_an_object_holds(scene):
    held = Step(0.0)

    def run():
        held.size = scene.v[0]
        add_vector(scene.total, held.size)

    (warning,) = record(scene, "tape", run)
    assert "parameter 'r' of kernel 'add_vector'" in str(warning.message)


def test_an_array_and_a_write(scene):
    step = Step(0.0)

    def run():
        step.__dict__.update(size=scene.a[1])
        launch(scene, getattr(step, "size"))  # noqa: B009
        vars(step)["size"] = scene.loss[None]
        scene.loss[None] = getattr(step, "size")  # noqa: B009

    first, second = record(scene, "tape", run)
    assert "parameter 'r'" in str(first.message)
    assert "Python writes to field" in str(second.message)


def test_numbers_read_elsewhere_are_constants(scene):
    before = Step(scene.loss[None])

    @ti.ad.no_grad
    def read():
        return Step(scene.loss[None])

    def run():
        launch(scene, before.size)
        launch(scene, read().size)
        assert json.dumps(scene.loss[None])

    assert record(scene, "tape", run) == []
    kept = []
    assert record(scene, "tape", lambda: kept.append(scene.loss[None])) == []
    # The numbers of an earlier tape belong to the point at which one differentiates.
    assert record(scene, "tape", lambda: launch(scene, Step(kept.pop()).size)) == []


def test_many_numbers_are_forgotten_together(scene, monkeypatch):
    from tai._impl.history import numbers

    monkeypatch.setattr(numbers, "_MOST", 8)
    step = Step(0.0)

    def run():
        for _ in range(20):
            vars(step)["size"] = scene.loss[None]
        launch(scene, getattr(step, "size"))  # noqa: B009

    assert len(record(scene, "tape", run)) == 1
    assert not numbers._of_thread.read
