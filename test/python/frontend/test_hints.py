"""Every error of a kernel has its place, and says what to do."""

import pytest
import tai as ti
from tai.errors import TaiCompilationWarning

# One statement each, which is wrong; `x` is a field of numbers, `v` of vectors, `m` of matrices,
# `s` of structs.
WRONG = [
    "x[0] = [1, 2]", "x.append(1)", "x[0] = v[0]", "a = v[0] + m[0]", "a = v[0][5]",
    "a = v[0][-1]", "a = v[0].w", "s[0].c = 1", "a = S(1.0, 2.0)", "x[0].foo()",
    "x[0] = x[1] if x[2] > 0 else None", "x[0] = 'abc'", "x[0] = 'abc' + x[1]",
    "x[0] = len(x[1])", "x[0] = sum(x)", "x[0] = ti.sqrt()", "x[0] = ti.sin(1, 2)",
    "x[0] = ti.max(x[1])", "x[0] = ti.select(x[0])", "x[0] = m[0].inverse()", "a = ti.svd(v[0])",
    "a = v[0].cross(ti.Vector([1, 2]))", "a = ti.Matrix([[1, 2], [3]])", "del x",
    "ti.loop_config(foo=1)", "x[0, 1] = 2", "x['a'] = 2", "x[0:2] = 2", "x[1.5] = 2",
    "x[None] = 2", "x[0] = yy", "x[0] = 1 & 1.5 + x[0]", "x[0] &= 1", "x[0] = ~x[1]",
    "ti.atomic_add(3, 1)", "a, b = 1, 2, 3", "a, *b = 1, 2, 3", "x[0] = (lambda y: y)(1)",
    "x[0] = int('5a')", "x[0] = [1, 2][x[0]]", "x[0] = [1, 2][5]", "x[0] = {'a': 1}['b']",
    "x[0] = 1 // 0", "x[0] = v[0].norm(1, 2, 3)", "x[0] = ti.foo(1)", "x[0] = one(1, 2)",
    "x[0] = none(1)", "x[0] = v[0] > v[1]", "assert x[0] > 0, x[0]", "y = ti.field(ti.f32, 3)",
    "x.copy_from(x)", "a = x.to_numpy()", "x[0] = x.shape", "ti.sync()", "ti.init()",
    "x[0] = math.gamma(x[1])", "raise ValueError", "import math", "a = {1, 2}", "a: int",
    "x[0] = 1j", "global x", "x[0] = x", "x[0] = math.sin", "for i in 5: pass",
    "for i, j in x: pass", "for i in range(1.5): pass", "return 1",
    "x[0] = 1 if x else 2", "print(f'{x[0]:d}')", "print(x[0], file=3)",
]  # fmt: skip

HEAD = """
import math
import tai as ti

x = ti.field(ti.f32, 8)
v = ti.Vector.field(3, ti.f32, 4)
m = ti.Matrix.field(2, 2, ti.f32, 4)
S = ti.types.struct(a=ti.f32)
s = S.field(shape=3)

@ti.func
def one(a):
    return a

@ti.func
def none(a):
    pass

@ti.kernel
def f():
    {}
"""


@pytest.mark.parametrize("statement", WRONG)
def test_what_is_wrong_has_a_place_and_a_hint(statement, tmp_path):
    path = tmp_path / "wrong.py"
    path.write_text(HEAD.format(statement))
    line = HEAD.split("{}")[0].count("\n") + 1
    space = {"__name__": "wrong"}
    with pytest.raises(ti.TaiError) as caught:
        exec(compile(path.read_text(), str(path), "exec"), space)
        space["f"]()
    error = caught.value
    assert (error.lineno, error.filename) == (line, str(path))
    assert error.column and error.hint
    text = str(error)
    assert "^" in text and "Traceback" not in text and "mlir" not in text.lower()


def test_calls_with_wrong_arguments():
    @ti.kernel
    def f(a: int, b: float):
        pass

    for args, kwargs in (((1,), {}), ((1, 2.0, 3), {}), ((1,), {"c": 2})):
        with pytest.raises(ti.TaiRuntimeTypeError) as caught:
            f(*args, **kwargs)
        assert "a, b" in caught.value.hint
    with pytest.raises(ti.TaiSyntaxError) as caught:

        @ti.kernel
        def g(*args):
            pass

    assert caught.value.hint


@pytest.mark.parametrize(
    ("result", "annotation"),
    [
        ("n", "ti.i32"), ("3", "ti.i32"), ("2.5", "ti.f32"), ("x[0]", "ti.f64"), ("n > 1", "ti.u1"),
        ("v[0]", "ti.types.vector(3, ti.f32)"), ("m[0]", "ti.types.matrix(2, 2, ti.f32)"),
        ("(n, v[0])", "tuple[ti.i32, ti.types.vector(3, ti.f32)]"),
    ],
)  # fmt: skip
def test_the_hint_for_a_missing_return_type_can_be_pasted(result, annotation, tmp_path):
    text = HEAD.replace("ti.f32, 8", "ti.f64, 8").replace("def f():", "def f(n: ti.i32){}:")
    path = tmp_path / "returns.py"

    def run(arrow):
        path.write_text(text.format(arrow, f"return {result}"))
        space = {"__name__": "returns"}
        exec(compile(path.read_text(), str(path), "exec"), space)
        return space["f"](2)

    with pytest.raises(ti.TaiSyntaxError, match="needs a return type") as caught:
        run("")
    assert caught.value.hint == f"def f(…) -> {annotation}"
    assert run(f" -> {annotation}") is not None


@pytest.mark.parametrize("statement", ["x[None] = 4.0", "x[None] += 1.0", "a = x[0]"])
def test_a_number_in_the_place_of_a_field(statement, tmp_path):
    path = tmp_path / "replaced.py"
    path.write_text(HEAD.replace("@ti.func", "x = 3.0\n\n@ti.func", 1).format(statement))
    space = {"__name__": "replaced"}
    with pytest.raises(ti.TaiError, match="float") as caught:
        exec(compile(path.read_text(), str(path), "exec"), space)
        space["f"]()
    assert "x[None] = 3.0" in caught.value.hint


hidden = None


def test_a_variable_that_hides_a_field():
    global hidden
    hidden = ti.field(ti.f32, 4)

    @ti.kernel
    def f():
        hidden = 3  # noqa: F841

    with pytest.warns(TaiCompilationWarning, match=r"'hidden' hides the field[\s\S]*hidden\[i\]"):
        f()
    assert not hidden.to_numpy().any()


@pytest.mark.parametrize("name", ["random", "atomic_add", "rescale_index", "svd", "get_addr"])
def test_an_operation_of_kernels_in_python(name):
    with pytest.raises(ti.TaiSyntaxError, match=f"ti.{name} stands in kernels") as caught:
        getattr(ti, name)(*([1.0, 2.0] if name != "random" else []))
    assert caught.value.hint == f"call ti.{name} in a function with @ti.kernel or @ti.func"


def test_loop_config_in_python():
    with pytest.raises(ti.TaiSyntaxError, match="before a loop") as caught:
        ti.loop_config(serialize=True)
    assert "on the line above the for" in caught.value.hint
