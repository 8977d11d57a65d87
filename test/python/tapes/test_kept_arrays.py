"""Arrays that the program keeps and fills with numbers of a field between two kernels of a tape."""

import warnings

import numpy as np
import pytest
import tai as ti

N = 6


class Scene:
    """x -> y -> an array that is kept -> loss"""

    def __init__(self):
        ti.init(default_fp=ti.f32, offline_cache=False)
        x = self.x = ti.field(ti.f32, N, needs_grad=True, name="x")
        y = self.y = ti.field(ti.f32, N, needs_grad=True, name="y")
        loss = self.loss = ti.field(ti.f32, (), needs_grad=True, name="loss")
        self.kept = np.zeros(N, np.float32)
        self.other = np.zeros(N, np.float32)
        self.order = np.zeros(N, np.int32)
        self.box = {"kept": self.kept}
        x.fill(1.0)

        @ti.kernel
        def first():
            for i in x:
                y[i] = 2 * x[i]

        @ti.kernel
        def second(a: ti.types.ndarray()):
            for i in range(a.shape[0]):
                loss[None] += a[i] * x[i]

        @ti.kernel
        def gather(a: ti.types.ndarray()):
            for i in range(a.shape[0]):
                loss[None] += x[a[i]]

        self.first, self.second, self.gather = first, second, gather

    def update(self):
        self.kept[:] = 2 * self.y.to_numpy()

    def replace(self):
        self.kept = np.sin(self.y.to_numpy())


def said(scene, run):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for _ in range(3):
            with ti.ad.Tape(scene.loss):
                scene.first()
                run(scene)
    found = [w for w in caught if "does not depend on any field" not in str(w.message)]
    assert all(w.filename == __file__ for w in found)
    return [str(w.message) for w in found]


def fill(array, numbers):
    array[:] = numbers


def fill_by_copyto(array, numbers):
    np.copyto(array, numbers + 1)


def fill_by_out(array, numbers):
    np.multiply(numbers, 3, out=array)


def fill_by_augmented(array, numbers):
    array += numbers


def fill_elements(array, field):
    for i in range(N):
        array[i] = field[i] ** 2


def launch(s):
    s.second(s.kept)


# Each loses a gradient.


def lost_in_the_same_function(s):
    kept = s.kept
    kept[:] = 2 * s.y.to_numpy()
    s.second(kept)


def lost_in_a_method(s):
    s.update()
    s.second(s.kept)


def lost_by_a_new_array_in_an_attribute(s):
    s.replace()
    s.second(s.kept)


def lost_in_an_argument(s):
    fill(s.kept, s.y.to_numpy())
    s.second(s.kept)


def lost_by_copyto(s):
    fill_by_copyto(s.kept, s.y.to_numpy())
    s.second(s.kept)


def lost_by_out(s):
    fill_by_out(s.kept, s.y.to_numpy())
    s.second(s.kept)


def lost_by_an_augmented_assignment(s):
    fill_by_augmented(s.kept, s.y.to_numpy())
    s.second(s.kept)


def lost_by_elements(s):
    fill_elements(s.kept, s.y)
    s.second(s.kept)


def lost_in_a_closure(s):
    kept = s.kept

    def put():
        kept[1:] = s.y.to_numpy()[1:]

    put()
    s.second(kept)


def lost_in_a_dictionary(s):
    s.box["kept"][:] = s.y.to_numpy()
    s.second(s.box["kept"])


def lost_in_a_view(s):
    view = s.kept[2:]
    s.update()
    s.second(view)


def lost_before_a_function_that_launches(s):
    s.update()
    launch(s)


def lost_on_the_way_to_a_field(s):
    s.update()
    s.y.from_numpy(s.kept)


LOST = [f for name, f in list(globals().items()) if name.startswith("lost_")]


@pytest.mark.parametrize("run", LOST, ids=lambda f: f.__name__)
def test_it_is_said_once(run):
    (message,) = said(Scene(), run)
    assert "was computed by Python from a value that has a gradient" in message


# These lose none.


def kept_constants(s):
    s.kept[:] = 3.0
    s.second(s.kept)


def kept_after_a_look(s):
    assert s.y.to_numpy().sum() < 1e9
    s.kept[:] = np.arange(N)
    s.second(s.kept)


def kept_in_another_array(s):
    fill(s.other, s.y.to_numpy())
    s.second(s.kept)


def kept_integers(s):
    s.order[:] = np.argsort(s.y.to_numpy())
    s.gather(s.order)


def kept_new_integers(s):
    s.gather(np.argsort(s.y.to_numpy()).astype(np.int32))


def kept_by_a_function_that_is_not_called(s):
    def put():
        s.kept[:] = s.y.to_numpy()

    assert put is not None
    s.second(s.kept)


KEPT = [f for name, f in list(globals().items()) if name.startswith("kept_")]


@pytest.mark.parametrize("run", KEPT, ids=lambda f: f.__name__)
def test_nothing_is_said(run):
    assert said(Scene(), run) == []


def test_the_check_finds_arrays_that_are_not_followed():
    s = Scene()

    def run():
        s.loss.fill(0)
        s.first()
        # No text shows it.
        vars(s)["kept"].__setitem__(slice(None), s.y.to_numpy())
        s.second(s.kept)

    assert not ti.ad.check(run, loss=s.loss, wrt=[s.x])
