"""The starts of reverse sweeps, and the messages about gradients that cannot be meant."""

import warnings

import numpy as np
import pytest
import tai as ti


@pytest.fixture(autouse=True)
def doubles():
    ti.init(arch=ti.cpu, default_fp=ti.f64)


def real_field(*shape, name=""):
    return ti.field(ti.f64, shape=shape, needs_grad=True, name=name)


class Model:
    def __init__(self):
        self.x, self.y = x, y = real_field(3, name="x"), real_field(3, name="y")
        self.total, self.other = total, other = real_field(name="total"), real_field(name="other")

        @ti.kernel
        def square():
            for i in x:
                y[i] = x[i] * x[i]

        @ti.kernel
        def add():
            for i in x:
                total[None] += y[i]
                other[None] += 10 * x[i]

        self.square, self.add = square, add
        x.from_numpy(np.array([1.0, 2.0, 3.0]))

    @property
    def gradient(self):
        return self.x.grad.to_numpy().tolist()


def test_a_loss_of_several_numbers():
    m = Model()
    with ti.ad.Tape(m.y) as tape:
        m.square()
    assert m.gradient == [0, 0, 0]
    tape.grad(seed=[1, 10, 100])
    assert m.gradient == [2, 40, 600]
    tape.grad(seed=np.array([0, 0, 1]))
    assert m.gradient == [0, 0, 6]
    tape.grad()
    assert m.gradient == [0, 0, 6]
    with ti.ad.Tape(m.y, seed=[1, 1, 1]):
        m.square()
    assert m.gradient == [2, 4, 6]


def test_vectors_as_losses():
    x = real_field(2)
    for layout in (ti.Layout.AOS, ti.Layout.SOA):
        u = ti.Vector.field(2, ti.f64, shape=2, needs_grad=True, layout=layout)

        @ti.kernel
        def spread(u: ti.template()):
            for i in x:
                u[i] = ti.Vector([x[i], x[i] * x[i]])

        x.from_numpy(np.array([3.0, 4.0]))
        with ti.ad.Tape(u) as tape:
            spread(u)
        tape.grad(seed=[[1, 10], [100, 1000]])
        assert x.grad.to_numpy().tolist() == [1 + 60, 100 + 8000]


def test_several_losses():
    m = Model()
    with ti.ad.Tape([m.total, m.other]) as tape:
        m.square()
        m.add()
    assert m.total[None] == 14 and m.other[None] == 60
    assert m.gradient == [12, 14, 16]
    tape.grad(seed=[2, 0])
    assert m.gradient == [4, 8, 12]
    with ti.ad.Tape([m.total, m.other], seed=[0, 1]):
        m.square()
        m.add()
    assert m.gradient == [10, 10, 10]
    tape.replay()
    assert m.total[None] == 14 and m.gradient == [4, 8, 12]


def test_no_loss():
    m = Model()
    with ti.ad.Tape() as tape:
        m.square()
        m.add()
    tape.backward({m.y: [1, 0, 0]})
    assert m.gradient == [2, 0, 0]
    tape.backward({m.total: 1.0, m.y: [0, 1, 0]})
    assert m.gradient == [2, 8, 6]
    ti.ad.clear_all_gradients()
    m.other.grad[None] = 3
    tape.grad()
    assert m.gradient == [30, 30, 30]
    with pytest.raises(ti.TaiRuntimeTypeError, match="has no loss that a seed"):
        tape.grad(seed=1)


def test_seeds_of_the_wrong_shape():
    m = Model()
    with ti.ad.Tape(m.y) as tape:
        m.square()
    with pytest.raises(
        ti.TaiRuntimeTypeError, match=r"seed of 'y' has shape \(2,\), but the field has \(3,\)"
    ):
        tape.grad(seed=[1, 2])
    with pytest.raises(ti.TaiRuntimeTypeError, match="must be numbers of shape"):
        tape.grad(seed="much")
    with pytest.raises(ti.TaiRuntimeTypeError, match="has shape"):
        tape.backward({m.y: 1.0})
    # The tape is as usable as before.
    tape.grad(seed=[1, 1, 1])
    assert m.gradient == [2, 4, 6]
    with pytest.raises(ti.TaiRuntimeTypeError, match="has shape"), ti.ad.Tape(m.y, seed=[1]):
        pass
    with pytest.raises(ti.TaiRuntimeTypeError, match="takes a list of 2 seeds"):
        with ti.ad.Tape([m.total, m.other], seed=1.0):
            pass
    with ti.ad.Tape(m.total):
        m.square()
        m.add()


def test_a_seed_that_is_never_given():
    m = Model()
    with ti.ad.Tape(m.y) as tape:
        m.square()
    with pytest.warns(ti.ad.TaiGradientWarning, match="gradient of 'y' was never computed"):
        del tape


UNUSED = "a tape without a loss has recorded launches, and no gradient was computed"


def test_a_tape_whose_loss_was_forgotten():
    m = Model()
    with pytest.warns(ti.ad.TaiGradientWarning, match=UNUSED):
        with ti.ad.Tape():
            m.square()
    with pytest.warns(ti.ad.TaiGradientWarning, match=UNUSED):
        with ti.ad.Tape() as tape:
            m.square()
            m.add()
        del tape


@pytest.mark.parametrize(
    "use",
    [
        lambda tape, m: tape.backward({m.y: [1, 1, 1]}),
        lambda tape, m: tape.replay(backward=False),
        lambda tape, m: tape.explain(),
        lambda tape, m: tape.stats(),
        lambda tape, m: tape.memory,
        lambda tape, m: tape.num_records,
        lambda tape, m: tape.num_skipped,
    ],
    ids=["backward", "replay", "explain", "stats", "memory", "records", "skipped"],
)
def test_a_tape_without_a_loss_that_is_used(use):
    m = Model()
    with warnings.catch_warnings(record=True) as seen:
        with ti.ad.Tape() as tape:
            m.square()
        use(tape, m)
        del tape
    assert not seen


def test_no_word_about_tapes_that_an_error_ended_or_that_are_empty():
    m = Model()
    with warnings.catch_warnings(record=True) as seen:
        with pytest.raises(KeyError), ti.ad.Tape():
            m.square()
            raise KeyError
        with ti.ad.Tape():
            pass
    assert not seen


def test_a_tape_without_launches():
    m = Model()
    with pytest.warns(ti.ad.TaiGradientWarning, match="recorded no launch"):
        with ti.ad.Tape(m.total) as tape:
            pass
    assert tape.num_records == 0
    with pytest.warns(ti.ad.TaiGradientWarning, match="recorded no launch"):
        tape.grad()


def test_a_loss_that_depends_on_nothing():
    m = Model()
    with pytest.warns(ti.ad.TaiGradientWarning, match="'total' does not depend on any field"):
        with ti.ad.Tape(m.total):
            m.square()
    assert m.gradient == [0, 0, 0]


def test_fields_that_change_afterwards():
    m = Model()
    with ti.ad.Tape(m.total) as tape:
        m.square()
        m.add()
    m.x[1] = 7
    with pytest.raises(ti.TaiRuntimeError, match="field 'x' was changed by the host after"):
        tape.grad()
    tape.replay()
    assert m.gradient == [2, 14, 6]
    m.x.from_numpy(m.x.to_numpy())  # no change
    tape.grad()
    assert m.gradient == [2, 14, 6]
    m.y.fill(0)
    with pytest.warns(ti.ad.TaiGradientWarning, match="field 'y' was changed by the host"):
        tape.grad()
    assert m.gradient == [2, 14, 6]


def test_no_warnings_without_reason():
    m = Model()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with ti.ad.Tape(m.total) as tape:
            m.square()
            m.add()
        tape.grad()
        tape.replay()


def test_backward_of_a_loss_names_the_tape():
    m = Model()
    array = ti.ndarray(ti.f32, 3, needs_grad=True)
    vectors = ti.Vector.field(2, ti.f32, 3, needs_grad=True)
    number, vector = ti.ad.variable(2.0), ti.Vector([1.0, 2.0])
    for value in (m.total, array, vectors, number, vector):
        assert not hasattr(value, "backward")
        with pytest.raises(AttributeError, match="no attribute 'backward'") as raised:
            value.backward()
        assert "with ti.ad.Tape(loss):" in str(raised.value)
        assert "tape.backward(loss)" in str(raised.value)
