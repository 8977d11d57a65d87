"""Large and odd programs: long chains, deep calls, names that are not English, huge shapes."""

import importlib.util
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
import tai as ti


def load(folder, text):
    """A module with this text, which kernels need a file for."""
    path = folder / "written.py"
    path.write_text("import tai as ti\n" + text)
    spec = importlib.util.spec_from_file_location("written", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("count", [2, 65, 400])
def test_a_long_chain_of_branches(tmp_path, count):
    text = "@ti.kernel\ndef f(n: ti.i32) -> ti.i32:\n    r = -1\n    if n == 0:\n        r = 7\n"
    for i in range(1, count):
        text += f"    elif n == {i}:\n        r = {7 + i * i}\n"
    f = load(tmp_path, text + "    return r\n").f
    for n in (0, 1, count // 2, count - 1):
        assert f(n) == 7 + n * n
    assert f(count) == -1


def test_a_long_sum(tmp_path):
    terms = " + ".join(f"n * {i}.0" for i in range(400))
    f = load(tmp_path, f"@ti.kernel\ndef f(n: ti.f64) -> ti.f64:\n    return {terms}\n").f
    assert f(2.0) == 2 * sum(range(400))


def test_functions_that_call_one_another(tmp_path):
    text = "@ti.func\ndef g0(x):\n    return x\n"
    for i in range(1, 60):
        text += f"@ti.func\ndef g{i}(x):\n    return g{i - 1}(x) + 1\n"
    f = load(tmp_path, text + "@ti.kernel\ndef f(n: ti.i32) -> ti.i32:\n    return g59(n)\n").f
    assert f(1) == 60


def test_recursion_that_only_ends_when_it_runs():
    @ti.func
    def count(x):
        result = x
        if x > 0:
            result = count(x - 1)
        return result

    @ti.kernel
    def f(n: ti.i32) -> ti.i32:
        return count(n)

    with pytest.raises(
        ti.TaiSyntaxError, match="'count' calls itself more than 50 times"
    ) as caught:
        f(3)
    assert "ti.static" in caught.value.hint and caught.value.lineno


def test_recursion_that_ends_at_compile_time():
    @ti.func
    def count(n: ti.template(), x):
        result = x
        if ti.static(n > 0):
            result = count(n - 1, x) + 2
        return result

    @ti.kernel
    def f(x: ti.i32) -> ti.i32:
        return count(40, x)

    assert f(1) == 81


def test_loops_that_are_unrolled_without_end():
    x = ti.field(ti.i32, 4)

    @ti.kernel
    def many():
        for _ in ti.static(range(10**8)):
            x[0] += 1

    @ti.kernel
    def listed() -> ti.i32:
        return len([i + 1 for i in range(10**8)])

    for kernel in (many, listed):
        with pytest.raises(ti.TaiSyntaxError, match="more than 65,536 iterations") as caught:
            kernel()
        assert "unrolling_limit" in caught.value.hint and caught.value.lineno


@pytest.mark.parametrize("limit", [70000, 0])
def test_the_limit_can_be_raised(limit):
    ti.init(unrolling_limit=limit)

    @ti.kernel
    def listed() -> ti.i32:
        return len([i + 1 for i in range(66000)])

    assert listed() == 66000


def test_names_that_are_not_english():
    größe = ti.field(ti.f32, 3, needs_grad=True)
    質量 = ti.Vector.field(2, ti.f32, 3)
    verlust = ti.field(ti.f32, (), needs_grad=True)

    @ti.kernel
    def füllen(ß: ti.f32):
        for i in größe:
            größe[i] = ß * (i + 1)
            質量[i] = [größe[i], 1.0]

    @ti.kernel
    def summe():
        for é in größe:
            verlust[None] += größe[é] ** 2

    füllen(2.0)
    with ti.ad.Tape(verlust):
        summe()
    assert verlust[None] == 4 + 16 + 36 and 質量[2][0] == 6
    assert größe.grad.to_numpy().tolist() == [4, 8, 12]
    with pytest.raises(ti.TaiIndexError, match="field 'größe'"):
        größe[5]


def test_reports_have_names_that_are_not_english():
    """IR has ASCII names only; errors and the profiler use the names of the program."""
    ti.init(debug=True, kernel_profiler=True, offline_cache=False)
    größe = ti.field(ti.f32, 3, needs_grad=True)
    zweite = ti.field(ti.f32, 3, name="größe")
    verlust = ti.field(ti.f32, (), needs_grad=True)

    @ti.kernel
    def böse(i: ti.i32):
        größe[i] = 1.0

    @ti.kernel
    def übrig(i: ti.i32):
        zweite[i] = 1.0

    @ti.kernel
    def fläche():
        for i in größe:
            verlust[None] += größe[i]

    for kernel in (böse, übrig):
        with pytest.raises(ti.TaiAssertionError, match="out of range for field 'größe' of"):
            kernel(9)
    with ti.ad.Tape(verlust):
        fläche()
    names = {row.name for row in ti.profiler.get_stats()}
    assert {"böse", "fläche", "fläche_grad"} <= names
    assert ti.profiler.query_kernel_profiler_info("fläche").counter == 2


@pytest.mark.parametrize("shape", [2**64, 2**62, (2**40, 2**40), 10**30])
def test_shapes_that_no_machine_has(shape):
    with pytest.raises(ti.TaiRuntimeError) as caught:
        x = ti.field(ti.f32, shape=shape)
        x.to_numpy()
    text = str(caught.value)
    assert "!tai" not in text and "-->" not in text and "hint" in text


@pytest.mark.parametrize(
    ("key", "match"),
    [
        (slice(0, 2), "no slices"), ((slice(None),), "no slices"), ("a", "whole number, not 'a'"),
        (0.5, "whole number, not 0.5"),
    ],
    ids=str,
)  # fmt: skip
def test_indices_from_python_that_are_none(key, match):
    x, v = ti.field(ti.i32, 3), ti.Vector.field(2, ti.f32, 3)
    with pytest.raises(ti.TaiRuntimeTypeError, match=match):
        x[key]
    with pytest.raises(ti.TaiRuntimeTypeError, match=match):
        x[key] = 1
    with pytest.raises(ti.TaiRuntimeTypeError, match=match):
        v[key]
    with pytest.raises(ti.TaiRuntimeTypeError, match=match):
        v[key] = [1, 2]
    assert not x.to_numpy().any() and not np.any(v.to_numpy())


def test_gradients_of_whole_numbers():
    n = ti.field(ti.i32, 3)

    @ti.kernel
    def f():
        n.grad[0] = 1

    with pytest.raises(ti.TaiAutodiffError, match="'n' holds whole numbers") as caught:
        f()
    assert caught.value.lineno and "needs_grad" in caught.value.hint


@pytest.mark.parametrize(
    ("option", "hint"),
    [
        ({"print_kernel_llvm_ir": True}, "print_ir"),
        ({"validate_autodiff": True}, "validation=True"),
        ({"short_circuit_operators": False}, "logical_and"),
        ({"kernel_profile": True}, "kernel_profiler"),
    ],
    ids=str,
)
def test_options_without_effect_say_so(option, hint):
    with pytest.warns(UserWarning, match=rf"has no effect[\s\S]*{hint}"):
        ti.init(**option)


def test_options_that_ask_for_what_is_always_so_do_not():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ti.init(
            flatten_if=True, advanced_optimization=False, device_memory_GB=1.0, ad_stack_size=32,
            print_kernel_llvm_ir=False, short_circuit_operators=True, packed=True,
        )  # fmt: skip


def documented_options():
    page = (Path(__file__).parents[3] / "docs" / "reference" / "taichi-options.md").read_text()
    rows = [line.split("|")[1] for line in page.splitlines() if line.startswith("| `")]
    return {name for row in rows for name in re.findall(r"`(\w+)`", row)}


def test_every_option_does_something_or_says_that_it_does_not():
    from tai._impl.base import options

    silent = options.ACCEPTED - set(options._WITHOUT_EFFECT)
    assert silent | {"log_level"} == documented_options()
    for name in sorted(silent - {"enable_fallback"}):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            ti.init(**{name: 2})
    for name in sorted(options._WITHOUT_EFFECT):
        with pytest.warns(UserWarning, match=rf"{name}=2\) has no effect\n  hint: \S"):
            ti.init(**{name: 2})
    for name in sorted(options.KEYWORDS):
        assert re.search(rf"\b{name}\b", ti.init.__doc__), name


def test_memory_of_fields_is_printed(capsys):
    x = ti.field(ti.f64, (100, 10), name="big")
    v = ti.Vector.field(3, ti.f32, 5, name="small")
    cells = ti.field(ti.i32, name="cells")
    ti.root.pointer(ti.i, 4).dense(ti.i, 8).place(cells)
    x[0, 0], v[0], cells[0] = 1, [1, 2, 3], 1
    ti.profiler.print_memory_profiler_info()
    lines = capsys.readouterr().out.splitlines()
    assert "8,000" in lines[1] and "big: f64, shape (100, 10)" in lines[1]
    assert "128" in lines[2] and "if all active" in lines[2]
    assert "60" in lines[3] and "small: f32×3" in lines[3]
    assert "8,188" in lines[4]


def test_pictures_without_a_window_say_so(monkeypatch):
    monkeypatch.delenv("TAI_GUI_DIR", raising=False)
    with pytest.warns(UserWarning, match="no folder"):
        ti.tools.imshow(np.zeros((4, 4)))
