"""Wrong keywords of public functions and methods: the error names the nearest one."""

import importlib
import inspect
import re
import subprocess
import sys
import traceback

import numpy as np
import pytest
import tai as ti
from tai.errors import did_you_mean

MODULES = ["ad", "algorithms", "checkpoint", "gui", "linalg", "math", "optim", "profiler", "sparse",
           "testing", "tools", "types", "ui", "volumes"]  # fmt: skip
_BY_NAME = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
# They take any keyword.
EXEMPT = {"types.struct", "types.argpack", "types.template"}


def of_class(prefix, cls):
    yield f"{prefix}()", cls.__init__, True
    for name in dir(cls):
        value = inspect.getattr_static(cls, name)
        if name.startswith("_") or not isinstance(
            value, (staticmethod, classmethod, type(of_class))
        ):
            continue
        plain = getattr(value, "__func__", value)
        if plain.__module__.split(".")[0] == "tai":
            yield f"{prefix}.{name}", plain, not isinstance(value, staticmethod)


def public():
    """Each public function with its name, and whether its first argument is given."""
    found = [(f"ti.{name}", getattr(ti, name)) for name in
             ("field", "ndarray", "batch", "export", "solve_to", "GUI", "Ndarray", "ScalarField",
              "MatrixField", "SNode", "FieldsBuilder", "StructField")]  # fmt: skip
    found += [("ti.Vector.field", ti.Vector.field), ("ti.Matrix.ndarray", ti.Matrix.ndarray)]
    for name in MODULES:
        module = importlib.import_module(f"tai.{name}")
        names = name != "math" and getattr(module, "__all__", None) or [
            n for n, v in vars(module).items()
            if not n.startswith("_") and getattr(v, "__module__", None) == module.__name__
        ]  # fmt: skip
        found += [(f"{name}.{n}", getattr(module, n)) for n in names if f"{name}.{n}" not in EXEMPT]
    for name, value in found:
        if isinstance(value, type):
            if value.__init__ is not object.__init__ and not issubclass(value, Exception):
                yield from of_class(name, value)
        elif inspect.isfunction(value):
            yield name, value, False


def keywords_of(function, is_method):
    parameters = list(inspect.signature(function).parameters.values())[is_method:]
    if any(p.kind is p.VAR_KEYWORD for p in parameters):
        return []
    return [p.name for p in parameters if p.kind in _BY_NAME and p.name[0] != "_"]


CASES = {
    name: (function, is_method, keywords)
    for name, function, is_method in public()
    if (keywords := keywords_of(function, is_method))
}


@pytest.mark.parametrize("name", CASES)
def test_a_misspelt_keyword_gets_the_nearest_one(name):
    function, is_method, keywords = CASES[name]
    right = keywords[-1]
    wrong = right + "zz"
    with pytest.raises(TypeError, match=re.escape(f"keyword argument '{wrong}'")) as caught:
        function(*([None] if is_method else []), **{wrong: 1})
    assert f"did you mean '{right}'?" in str(caught.value)


@pytest.mark.parametrize(
    ("wrong", "right"), [("dt", "DT"), ("coutn", "count"), ("Loss", "loss"), ("lost", "loss")]
)
def test_capitals_and_letters_in_another_order_come_first(wrong, right):
    assert did_you_mean(wrong, ["t", "td", "DT", "count", "loss"]) == f"did you mean '{right}'?"


def test_the_case_of_every_module_is_there():
    assert len(CASES) > 150
    assert {name.split(".")[0] for name in CASES} >= {*MODULES, "ti"} - {"checkpoint"}


def test_a_keyword_that_is_near_none_gets_the_list():
    x = ti.field(ti.f32, shape=3, needs_grad=True)
    with pytest.raises(TypeError, match="its keywords: parameters, lr, betas, eps"):
        ti.optim.Adam([x], momentum=0.9)
    with pytest.raises(TypeError, match="did you mean 'lr'"):
        ti.optim.Adam([x], lrate=0.1)
    gui = ti.GUI("test", res=(8, 8), show_gui=False)
    with pytest.raises(TypeError, match="did you mean 'radius'"):
        gui.circle((0.5, 0.5), radus=3)


def test_functions_stay_what_they_are():
    assert str(inspect.signature(ti.field)).startswith("(dtype: 'Any', shape: 'Any' = None")
    assert ti.field.__doc__ and ti.optim.Adam.step.__qualname__.endswith(".step")
    x = ti.field(dtype=ti.f32, shape=2, name="x")
    x.from_numpy(np.ones(2, np.float32))
    assert x.to_numpy(dtype=np.float64).tolist() == [1, 1]


class Mine(ti.optim.SGD):
    def __init__(self, parameters, speed):
        super().__init__(parameters, lr=speed)


def test_a_class_of_the_program_has_keywords_of_its_own():
    x = ti.field(ti.f32, shape=3, needs_grad=True)
    assert Mine([x], speed=0.5).lr == 0.5
    with pytest.raises(TypeError, match="'sped'"):
        Mine([x], sped=0.5)


@ti.func
def weighed(a, weight=2.0):
    return a * weight


@ti.kernel
def by_method() -> ti.f32:
    return ti.Vector([3.0, 4.0]).norm(epsilon=0.0)


@ti.kernel
def by_function() -> ti.f32:
    return weighed(1.0, wieght=3.0)


@ti.kernel
def scaled(x: ti.f32, count: ti.i32) -> ti.f32:
    return x * count


@pytest.mark.parametrize(
    "call, right",
    [
        (by_method, "eps"),
        (by_function, "weight"),
        # Not that `count` is missing.
        (lambda: scaled(1.0, coutn=2), "count"),
    ],
    ids=["method", "function", "kernel"],
)
def test_wrong_keywords_in_kernels_and_of_kernels(call, right):
    with pytest.raises(ti.TaiError) as caught:
        call()
    assert caught.value.hint == f"did you mean '{right}'?"


_Ball = ti.types.struct(position=ti.math.vec3, mass=ti.f32)
WRONG_NAMES = {
    "a vector": (lambda: ti.Vector([1.0, 2.0]), "normalised", "normalized"),
    "an element": (lambda: ti.Vector.field(3, ti.f32, shape=1)[0], "norn", "norm"),
    "a matrix": (lambda: ti.Matrix([[1.0, 2.0], [3.0, 4.0]]), "transpos", "transpose"),
    "a struct": (lambda: _Ball(mass=1.0), "mas", "mass"),
    "a struct type": (lambda: _Ball, "feld", "field"),
    "a field of structs": (lambda: _Ball.field(shape=1), "postion", "position"),
    "its method": (lambda: _Ball.field(shape=1), "to_nump", "to_numpy"),
    "its element": (lambda: _Ball.field(shape=1)[0], "mas", "mass"),
    "a picture": (lambda: ti.GUI("test", res=8, show_gui=False), "circel", "circle"),
    "an optimiser": (
        lambda: ti.optim.Adam([ti.field(ti.f32, shape=1, needs_grad=True)]), "stpe", "step"),
    **{f"ti.{name}": (lambda name=name: importlib.import_module(f"tai.{name}"), wrong, right)
       for name, wrong, right in [("ad", "Tap", "Tape"), ("math", "clampp", "clamp"),
                                  ("linalg", "cgg", "cg"), ("lang", "matri", "matrix"),
                                  ("types", "vectr", "vector"), ("optim", "Adamm", "Adam")]},
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG_NAMES)
def test_a_misspelt_attribute_gets_the_nearest_one(name):
    make, wrong, right = WRONG_NAMES[name]
    with pytest.raises(AttributeError) as caught:
        getattr(make(), wrong)
    assert str(caught.value).endswith(f"\n  did you mean '{right}'?")
    assert not hasattr(make(), "_of_another_library")


@pytest.mark.parametrize(
    "make, wrong, right",
    [
        ("x", "gradd", "grad"),
        ("x.grad", "fil", "fill"),
        ("ti.ndarray(ti.f32, 3)", "shap", "shape"),
        ("ti.ad.Tape(x)", "stat", "stats"),
        ("ti.root", "dens", "dense"),
        ("run", "explan", "explain"),
        ("run", "gradd", "grad"),
        ("ti.Vector", "fiel", "field"),
        ("ti.GUI('a', show_gui=False)", "circel", "circle"),
    ],
)
def test_one_suggestion_is_printed(make, wrong, right, tmp_path):
    program = tmp_path / "program.py"
    program.write_text(
        "import tai as ti\nti.init()\nx = ti.field(ti.f32, shape=3, needs_grad=True)\n"
        f"@ti.kernel\ndef run():\n    pass\n{make}.{wrong}\n"
    )
    found = subprocess.run([sys.executable, program], capture_output=True, text=True, timeout=120)
    error = found.stderr.lower()
    assert error.count("did you mean") == error.count(f"did you mean: '{right}'") + error.count(
        f"did you mean '{right}'"
    ) == 1, found.stderr  # fmt: skip
    assert f"{make}.{wrong}".lower() in error


def test_a_property_that_fails_keeps_its_error():
    class Broken(ti.optim.SGD):
        @property
        def rate(self):
            raise AttributeError("there is none yet")

    with pytest.raises(AttributeError, match="^there is none yet$"):
        Broken([ti.field(ti.f32, shape=1, needs_grad=True)]).rate  # noqa: B018


def test_keywords_that_are_given_are_not_suggested():
    with pytest.raises(TypeError, match="did you mean 'edge0'"):
        ti.math.smoothstep(edge=0.0, edge1=1.0, x=0.5)


@pytest.mark.parametrize(
    ("program", "hint"),
    [
        ("ti.feild(ti.f32, shape=3)", "did you mean 'field'?"),
        ("ti.init(default_pf=ti.f64)", "did you mean 'default_fp'?"),
        ("ti.cpuu", "did you mean 'cpu'?"),
    ],
)
def test_one_suggestion_alone(program, hint):
    """As a terminal shows it: Python adds no other name. Letters in another order come first."""
    with pytest.raises((AttributeError, ti.TaiRuntimeError)) as caught:
        eval(program, {"ti": ti})
    text = "".join(traceback.format_exception(caught.value))
    assert text.lower().count("did you mean") == 1
    assert hint in text


def test_a_kernel_names_the_public_class_of_an_error():
    @ti.kernel
    def long() -> ti.f32:
        return ti.Vector([1.0, 2.0]).nrom()

    with pytest.raises(ti.TaiTypeError) as caught:
        long()
    text = "".join(traceback.format_exception(caught.value))
    assert "\ntai.errors.TaiTypeError: a vector of 2 f32 has no attribute 'nrom'" in text
