"""Errors of programs that use the gradient of a `ti.ndarray` without one, which is None."""

import numpy as np
import pytest
import tai as ti

HINT = "the grad of a ti.ndarray is None unless it is made with needs_grad=True"


@ti.kernel
def copy(x: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        y[i] = x[i]


@ti.kernel
def of_template(x: ti.template(), y: ti.types.ndarray()):
    for i in range(y.shape[0]):
        y[i] = x[i]


USES = {
    "argument": lambda x, y: copy(x.grad, y),
    "template": lambda x, y: of_template(x.grad, y),
    "fill": lambda x, y: y.fill(x.grad),
    "element": lambda x, y: y.__setitem__(0, x.grad),
    "from_numpy": lambda x, y: y.from_numpy(x.grad),
    "copy_from": lambda x, y: y.copy_from(x.grad),
}


@pytest.mark.parametrize("use", USES)
@pytest.mark.parametrize("dtype", ["f32", "f64", "i32"])
def test_use_of_a_missing_gradient(use, dtype):
    ti.init()
    x, y = (ti.ndarray(getattr(ti, dtype), 3) for _ in "xy")
    assert x.grad is None
    with pytest.raises(ti.TaiError, match=HINT):
        USES[use](x, y)
    assert y.to_numpy().tolist() == [0, 0, 0]


def test_missing_gradient_is_not_assigned():
    ti.init()
    x = ti.ndarray(ti.f32, 3)
    with pytest.raises(ti.TaiRuntimeTypeError, match="has no gradient"):
        x.grad = np.ones(3, np.float32)


@pytest.mark.parametrize("value", [[1.0, None, 2.0], ["1", "2", "3"], [b"1", b"2", b"3"]])
def test_arrays_of_other_things_than_numbers(value):
    ti.init()
    x, y = ti.ndarray(ti.f64, 3), ti.field(ti.f64, 3)
    for target in (x, y):
        with pytest.raises(ti.TaiRuntimeTypeError, match="numbers of type f64"):
            target.from_numpy(np.array(value))
    with pytest.raises(ti.TaiRuntimeTypeError, match="numbers of type f64"):
        x[0] = value[1]
    assert x.to_numpy().tolist() == y.to_numpy().tolist() == [0, 0, 0]


def test_arrays_of_python_numbers_are_taken():
    ti.init()
    x = ti.ndarray(ti.f64, 3)
    x.from_numpy(np.array([1, 2.5, True], object))
    assert x.to_numpy().tolist() == [1, 2.5, 1]


@pytest.mark.parametrize("value", [np.array([3]), np.array([3, 4]), np.array([3.5]), [3]])
def test_array_for_a_number_after_a_launch(value):
    ti.init()

    @ti.kernel
    def take(a: ti.i32) -> ti.i32:
        return a

    assert take(3) == 3
    with pytest.raises(ti.TaiRuntimeTypeError, match="expects a whole number"):
        take(value)
