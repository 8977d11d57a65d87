"""An error in a program is reported at its line, with a caret and a hint."""

import inspect
import traceback

import numpy as np
import pytest
import tai as ti

import bad_algebra  # noqa: F401
import bad_calls  # noqa: F401
import bad_expressions  # noqa: F401
import bad_loops  # noqa: F401
import bad_register
import bad_statements


def bad_line(function):
    """The line that ends with the mark, its text, and the columns of its code."""
    if function.__name__ == "recursion":
        lines, start = inspect.getsourcelines(bad_statements)
        mark = "# BAD-RECURSION"
    else:
        lines, start = inspect.getsourcelines(function)
        mark = "# BAD"
    for number, line in enumerate(lines):
        if mark in line:
            return max(start, 1) + number, line.rstrip("\n"), line.index(mark)
    raise AssertionError(f"{function.__name__} has no line marked {mark}")


@pytest.mark.parametrize("case", bad_register.CASES, ids=lambda case: case[0].__name__)
def test_bad_kernel(case):
    function, kind, message, hint = case
    with pytest.raises(kind) as caught:
        function()
    error = caught.value
    text = str(error)
    assert message in error.message
    if hint is not None:
        assert hint in error.hint
        assert f"hint: {error.hint}" in text
    lineno, line, end = bad_line(function)
    assert error.filename == function.__code__.co_filename
    assert error.lineno == lineno
    begin = len(line) - len(line.lstrip()) + 1
    assert begin <= error.column <= end
    # The text shows the line and carets under the part that is wrong.
    shown = text.splitlines()
    at = next(i for i, s in enumerate(shown) if s.strip().startswith(f"{lineno} |"))
    assert line.strip() in shown[at]
    carets = shown[at + 1]
    offset = shown[at].index("| ") + 2
    assert carets.strip("| ^") == "" and "^" in carets
    assert carets.index("^") - offset == error.column - 1
    assert isinstance(error, ti.TaiError)


def test_there_are_many():
    assert len(bad_register.CASES) >= 150


def test_carets_point_at_the_part_that_is_wrong():
    v = ti.Vector.field(2, ti.i32, shape=3)

    @ti.kernel
    def condition():
        for i in v:
            if v[i] > 1:
                v[i] = 0

    @ti.kernel
    def variables():
        for i, j in v:
            v[i] = j

    @ti.kernel
    def bound(n: ti.f32):
        for i in range(n):
            v[i] = 0

    @ti.kernel
    def wait():
        while v[0]:
            v[0] = 0

    calls = {"v[i] > 1": condition, "i, j": variables, "range(n)": lambda: bound(2.0), "v[0]": wait}
    for code, call in calls.items():
        with pytest.raises(ti.TaiTypeError) as caught:
            call()
        line, carets = str(caught.value).splitlines()[2:4]
        assert line[carets.index("^") : carets.rindex("^") + 1] == code


def test_no_warning_of_digits_before_an_error_of_shapes(recwarn):
    @ti.kernel
    def kernel():
        a = 1
        a = ti.Vector([1.5, 2.0])
        print(a)

    with pytest.raises(ti.TaiTypeError, match="one number of type i32"):
        kernel()
    assert not recwarn.list


def test_the_compiler_speaks_of_what_the_program_has():
    x = ti.field(ti.f32, shape=4, needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def repeat():
        v = x[0]
        for _ in range(9):
            v = v * 1.5 + ti.sin(v)
        loss[None] = v

    @ti.kernel
    def neighbours():
        for i in range(3):
            x[i] = x[i + 1] * 2
        loss[None] = x[0]

    found = {}
    for kernel in (repeat, neighbours):
        with pytest.raises(ti.TaiTypeError) as caught, ti.ad.Tape(loss):
            kernel()
        found[kernel] = str(caught.value)
    assert "variable 'v', which all iterations share, is read and written" in found[repeat]
    for text in found.values():
        assert "ti.loop_config(serialize=True)" in text and "tai." not in text


def test_functions_are_named_on_the_way():
    @ti.func
    def inner(a):
        return a + missing_name  # noqa: F821

    @ti.func
    def outer(a):
        return inner(a)

    @ti.kernel
    def kernel(a: ti.f32) -> ti.f32:
        return outer(a)

    with pytest.raises(ti.TaiNameError) as caught:
        kernel(1.0)
    text = str(caught.value)
    assert text.index("in function 'inner'") < text.index("in function 'outer'")
    assert "in kernel 'kernel'" in text


def test_the_program_goes_on_after_an_error():
    x = ti.field(ti.i32, shape=3)

    @ti.kernel
    def wrong():
        for i in x:
            x[i] = undefined  # noqa: F821

    @ti.kernel
    def right():
        for i in x:
            x[i] = i

    for _ in range(2):
        with pytest.raises(ti.TaiNameError):
            wrong()
    right()
    assert x.to_numpy().tolist() == [0, 1, 2]


def test_access_rule_that_need_not_be_kept():
    x = ti.field(ti.f32, shape=4, needs_grad=True)
    y = ti.field(ti.f32, shape=4, needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def kernel():
        for i in x:
            y[i] += x[i]
            loss[None] += y[i] * y[i]
            y[i] = x[i] * 2

    for i in range(4):
        x[i] = i + 1
    with ti.ad.Tape(loss):
        kernel()
    assert x.grad.to_numpy().tolist() == [2, 4, 6, 8]


# Calls from Python


def test_wrong_arguments_of_a_kernel():
    @ti.kernel
    def kernel(n: ti.i32, a: ti.f32 = 1.0):
        pass

    with pytest.raises(ti.TaiRuntimeTypeError, match="needs an argument 'n'"):
        kernel()
    with pytest.raises(ti.TaiRuntimeTypeError, match="takes 2 arguments, but got 3"):
        kernel(1, 2, 3)
    with pytest.raises(ti.TaiRuntimeTypeError, match="'n'.*whole number"):
        kernel(1.5)
    with pytest.raises(ti.TaiRuntimeTypeError, match="'a'.*number"):
        kernel(1, "x")
    with pytest.raises(ti.TaiRuntimeTypeError, match="no parameter 'b'"):
        kernel(1, b=2)
    with pytest.raises(ti.TaiRuntimeTypeError, match="does not fit i32"):
        kernel(2**40)
    kernel(np.int64(3), np.float32(2))
    kernel(True, 2)


def test_wrong_arrays():
    @ti.kernel
    def kernel(a: ti.types.ndarray(dtype=ti.f32, ndim=2)):
        pass

    with pytest.raises(ti.TaiRuntimeTypeError, match="expects an array of f32, but got f64"):
        kernel(np.zeros((2, 2)))
    with pytest.raises(ti.TaiRuntimeTypeError, match="expects 2 dimensions, but got 1"):
        kernel(np.zeros(2, np.float32))
    with pytest.raises(ti.TaiRuntimeTypeError, match="got field 'field'\n.*template"):
        kernel(ti.field(ti.f32, shape=(2, 2)))
    with pytest.raises(ti.TaiRuntimeTypeError, match="expects an array, but got list"):
        kernel([[1.0]])
    with pytest.raises(ti.TaiRuntimeTypeError, match="expects numbers"):
        kernel(np.array([["a"]]))


def test_function_outside_of_a_kernel():
    @ti.func
    def function(a):
        return a

    with pytest.raises(ti.TaiSyntaxError, match="in kernels only"):
        function(1)
    with pytest.raises(ti.TaiSyntaxError, match="kernels"):
        ti.random()


def test_source_that_is_not_at_hand():
    space = {"ti": ti}
    exec("def f():\n    pass\nk = ti.kernel(f)", space)
    with pytest.raises(ti.TaiSyntaxError, match="(?s)cannot be read.*register it in linecache"):
        space["k"]()


def test_tracebacks_suggest_a_name_once():
    v = ti.Vector.field(2, ti.f32, shape=())

    @ti.kernel
    def kernel() -> ti.f32:
        return v[None].norm_sq()

    with pytest.raises(ti.TaiTypeError) as caught:
        kernel()
    shown = "".join(traceback.format_exception(caught.value))
    assert shown.lower().count("did you mean") == 1


# Fields and layouts


def test_element_access():
    x = ti.field(ti.f32, shape=(2, 3), name="x")
    for bad in [(2, 0), (-1, 0), (0, 3)]:
        with pytest.raises(ti.TaiIndexError, match="'x'.*out of range"):
            x[bad]
        with pytest.raises(IndexError):
            x[bad] = 1
    with pytest.raises(ti.TaiIndexError, match="expects 2 indices, but got 1"):
        _ = x[0]
    with pytest.raises(TypeError):
        x[0, 0.5] = 1
    with pytest.raises(ti.TaiRuntimeTypeError, match="not 'a'"):
        x[0, 0] = "a"
    v = ti.Vector.field(2, ti.f32, shape=2, name="v")
    with pytest.raises(ti.TaiRuntimeTypeError, match=r"shape \(2,\), but got \(3,\)"):
        v[0] = [1, 2, 3]


def test_placement():
    x = ti.field(ti.f32, name="x")
    with pytest.raises(ti.TaiRuntimeError, match="'x' is not placed"):
        _ = x[0]
    with pytest.raises(ti.TaiRuntimeError, match="'x' is not placed"):
        _ = x.shape
    ti.root.dense(ti.i, 4).place(x)
    with pytest.raises(ti.TaiRuntimeError, match="placed already"):
        ti.root.dense(ti.i, 4).place(x)
    with pytest.raises(ti.TaiAutodiffError, match="'x' has no gradient"):
        _ = x.grad[0]
    block = ti.root.dense(ti.i, 4)
    x[0] = 1
    with pytest.raises(ti.TaiRuntimeError, match="in use already"):
        block.place(ti.field(ti.f32))


def test_layouts():
    with pytest.raises(ti.TaiRuntimeTypeError, match="must be positive, but got 0"):
        ti.root.dense(ti.i, 0)
    with pytest.raises(ti.TaiRuntimeTypeError, match="whole number"):
        ti.root.dense(ti.i, 2.5)
    with pytest.raises(ti.TaiRuntimeTypeError, match="2 axes need 2 extents, but got 3"):
        ti.root.dense(ti.ij, (1, 2, 3))
    with pytest.raises(ti.TaiRuntimeTypeError, match="twice"):
        ti.root.dense(ti.axes(0, 0), 4)
    with pytest.raises(ti.TaiRuntimeTypeError, match="place expects fields"):
        ti.root.dense(ti.i, 4).place(3)
    with pytest.raises(ti.TaiRuntimeTypeError, match="holds numbers"):
        ti.field("f32", shape=3)
    with pytest.raises(ti.TaiAutodiffError, match="can have no gradient"):
        ti.field(ti.i32, shape=3, needs_grad=True)


# Options and tapes


def test_options():
    with pytest.raises(ti.TaiRuntimeError, match="no option 'defualt_fp'") as caught:
        ti.init(defualt_fp=ti.f64)
    assert "default_fp" in str(caught.value)
    with pytest.raises(ti.TaiRuntimeTypeError, match="default_fp must be a float type"):
        ti.init(default_fp=ti.i32)
    with pytest.raises(ti.TaiRuntimeError, match="no target 'vulcan'"):
        ti.init(arch="vulcan")
    ti.init(arch=ti.cpu, flatten_if=True, advanced_optimization=True, device_memory_GB=2)


@pytest.fixture
def no_driver(monkeypatch):
    """A machine without a CUDA driver."""
    for name in ("TI_ARCH", "TAI_CUDA_EMULATION"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TAI_CUDA_DRIVER", "libno-such-driver.so.1")


def test_gpu_falls_back(no_driver, capfd):
    ti.init(arch=ti.gpu)
    err = capfd.readouterr().err
    assert err.startswith("[tai] falling back to arch=cpu: no CUDA driver: the library 'libno-such")
    assert err.count("\n") == 1
    assert ti.lang.impl.current_cfg().arch == ti.cpu


def test_cuda_says_why_it_is_not_there(no_driver):
    with pytest.raises(ti.TaiRuntimeError, match="no CUDA driver: .* cannot be loaded"):
        ti.init(arch=ti.cuda)
    assert not ti.lang.misc.is_arch_supported(ti.cuda)


def test_cuda_can_be_emulated(no_driver, monkeypatch):
    monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    ti.init(arch=ti.cuda, device_memory_limit=1 << 20)
    assert ti.lang.impl.current_cfg().arch == ti.cuda
    x = ti.field(ti.f32, shape=4)
    x.fill(3)
    ti.sync()
    assert x[1] == 3
    ti.init(arch=ti.gpu)
    block = ti.root.pointer(ti.i, 4)
    y = ti.field(ti.f32)
    block.place(y)
    y[1] = 3
    assert block.active_cells().tolist() == [[1]]


def test_tapes():
    x = ti.field(ti.f32, shape=3, needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)
    plain = ti.field(ti.f32, shape=(), name="plain")
    whole = ti.field(ti.i32, shape=())
    with pytest.raises(ti.TaiRuntimeTypeError, match="takes the field of the loss, but got 3"):
        ti.ad.Tape(3)
    with pytest.raises(ti.TaiRuntimeTypeError, match="given twice"):
        ti.ad.Tape([x, x])
    with pytest.raises(ti.TaiAutodiffError, match="not a float"):
        ti.ad.Tape(whole)
    with pytest.raises(ti.TaiAutodiffError, match="'plain' has no gradient"), ti.ad.Tape(plain):
        pass
    with pytest.raises(ti.TaiRuntimeError, match="do not nest"), ti.ad.Tape(loss), ti.ad.Tape(loss):
        pass
    with pytest.raises(ti.TaiRuntimeError, match="inside a ti.ad.Tape"), ti.ad.Tape(loss):
        ti.init()
    tape = ti.ad.Tape(loss)
    with pytest.raises(ti.TaiRuntimeError, match="holds nothing"):
        tape.replay()
    with pytest.raises(ti.TaiAutodiffError, match="takes no gradient of its own"):
        ti.ad.grad_for(test_options)


def test_unknown_name_of_the_package():
    with pytest.raises(AttributeError, match="no attribute 'fild'") as caught:
        _ = ti.fild
    assert "field" in caught.value.__notes__[0]


def test_fields_are_called_by_their_variables():
    mass, kept = ti.field(ti.i32, 3), {"speed": ti.field(ti.i32, 3)}

    class Body:
        def __init__(self):
            self.pressure = ti.field(ti.i32, 3)

    body = Body()
    with pytest.raises(ti.TaiAutodiffError, match="field 'mass' is of type i32"):
        ti.optim.Adam([mass])
    with pytest.raises(ti.TaiAutodiffError, match="field 'pressure' is of type i32"):
        ti.optim.Adam([body.pressure])
    with pytest.raises(ti.TaiAutodiffError, match="field 'kept_speed' is of type i32"):
        ti.optim.Adam([kept["speed"]])
