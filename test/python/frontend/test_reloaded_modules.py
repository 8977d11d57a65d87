"""Modules that are loaded again, or whose files change: a kernel has the text of its code."""

import importlib
import importlib.util
import linecache
import os
import subprocess
import sys
import textwrap

import pytest
import tai as ti

HEAD = "import tai as ti\n"


class Modules:
    """Modules in a folder of their own, which a test writes and imports."""

    def __init__(self, folder):
        self.folder = folder

    def write(self, name, text):
        path = self.folder / f"{name}.py"
        path.write_text(HEAD + textwrap.dedent(text))
        # No file of the same size and time, which importlib takes for the same.
        os.utime(path, ns=(0, 10**9 * (10**6 + sum(path.read_bytes()))))
        return path

    def load(self, name, text):
        self.write(name, text)
        importlib.invalidate_caches()
        return importlib.import_module(name)

    def reload(self, module, text):
        self.write(module.__name__, text)
        return importlib.reload(module)


@pytest.fixture
def modules(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    known = set(sys.modules)
    ti.init(arch=ti.cpu)
    yield Modules(tmp_path)
    for name in set(sys.modules) - known:
        if (
            getattr(sys.modules[name], "__file__", None)
            and str(tmp_path) in sys.modules[name].__file__
        ):
            del sys.modules[name]


KERNEL = """
    {lines}
    @ti.kernel
    def answer() -> ti.i32:
        return {number}

    def plain():
        return {number}
"""


@pytest.mark.parametrize("lines", ["", "# one\n    # two"])
@pytest.mark.parametrize("launched", [True, False])
def test_reloaded_kernel_is_the_new_one(modules, lines, launched):
    module = modules.load("sim_kernel", KERNEL.format(lines="", number=1))
    old = module.answer
    if launched:
        assert old() == 1
    module = modules.reload(module, KERNEL.format(lines=lines, number=22))
    assert module.answer() == module.plain() == 22
    # As an old function of Python does.
    assert old() == 1


@pytest.mark.parametrize("lines", ["", "# one\n    # two"])
def test_edit_without_reload_changes_nothing(modules, lines):
    module = modules.load("sim_edit", KERNEL.format(lines="", number=1))
    modules.write("sim_edit", KERNEL.format(lines=lines, number=22))
    assert module.answer() == module.plain() == 1


def test_edit_that_python_overlooks_is_overlooked(modules):
    """A file of the same size and time: importlib runs its old code again."""
    module = modules.load("sim_stale", KERNEL.format(lines="", number=1))
    path = modules.folder / "sim_stale.py"
    stat = path.stat()
    path.write_text(path.read_text().replace("return 1", "return 2"))
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns + 1000))
    module = importlib.reload(module)
    assert module.answer() == module.plain()


FUNC = """
    @ti.func
    def twice(x):
        return {number} * x

    @ti.pyfunc
    def thrice(x):
        return {number} * x
"""


def test_kernels_follow_the_functions_of_a_reloaded_module(modules):
    helpers = modules.load("helpers_f", FUNC.format(number=1))

    @ti.kernel
    def by_module(x: ti.i32) -> ti.i32:
        return helpers.twice(x) + helpers.thrice(x)

    assert by_module(5) == 10
    modules.reload(helpers, FUNC.format(number=22))
    assert by_module(5) == 220
    assert helpers.thrice(5) == 110


def test_reloaded_function_and_an_open_gradient(modules):
    helpers = modules.load("helpers_g", FUNC.format(number=1))
    x = ti.field(ti.f32, shape=(), needs_grad=True)
    y = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def run():
        y[None] = helpers.twice(x[None])

    for number in (1, 22):
        modules.reload(helpers, FUNC.format(number=number))
        with ti.ad.Tape(y):
            run()
        assert x.grad[None] == number


METHODS = """
    @ti.data_oriented
    class Sim:
        scale = 1

        @ti.func
        def part(self, x):
            return {number} * x * self.scale

        @ti.kernel
        def step(self) -> ti.i32:
            return self.part(1)

    @ti.dataclass
    class Ball:
        mass: ti.i32

        @ti.func
        def weight(self):
            return {number} * self.mass

    @ti.kernel
    def weigh() -> ti.i32:
        ball = Ball(1)
        return ball.weight()
"""


def test_methods_of_classes_and_structs(modules):
    module = modules.load("sim_methods", METHODS.format(number=1))
    sim, weigh = module.Sim(), module.weigh
    assert sim.step() == weigh() == 1
    modules.reload(module, "\n# moved\n" + textwrap.dedent(METHODS.format(number=22)))
    assert module.Sim().step() == module.weigh() == 22
    assert sim.step() == 1


FACTORY = """
    {lines}
    def make(k):
        @ti.kernel
        def answer() -> ti.i32:
            return {number} + k

        return answer
"""


def test_factory_of_an_edited_file_is_refused_or_right(modules):
    module = modules.load("sim_factory", FACTORY.format(lines="", number=1))
    modules.write("sim_factory", FACTORY.format(lines="", number=22))
    answer = module.make(1)
    with pytest.raises(ti.TaiSyntaxError) as caught:
        answer()
    assert "the file has changed since" in str(caught.value)
    assert "importlib.reload" in str(caught.value)
    # Where another kernel of the file was made before, its text is at hand.
    both = FACTORY + KERNEL
    module = modules.load("sim_both", both.format(lines="", number=1))
    modules.write("sim_both", both.format(lines="# moved", number=22))
    assert module.make(1)() == 2


def test_class_in_a_function_is_no_other_text(modules):
    """Its qualified name is a constant, and depends on the functions around."""
    text = """
        def make():
            @ti.kernel
            def answer() -> ti.i32:
                class Inner:
                    pass
                return 1
            return answer
    """
    with pytest.raises(ti.TaiSyntaxError, match="kernels have no class definitions"):
        modules.load("sim_class", text).make()()


def test_two_modules_of_one_name(modules, tmp_path):
    loaded = []
    for number in (1, 22):
        path = tmp_path / str(number) / "sim.py"
        path.parent.mkdir()
        path.write_text(HEAD + textwrap.dedent(KERNEL.format(lines="", number=number)))
        spec = importlib.util.spec_from_file_location("sim", path)
        loaded.append(importlib.util.module_from_spec(spec))
        spec.loader.exec_module(loaded[-1])
    assert [module.answer() for module in loaded] == [1, 22]


@pytest.mark.parametrize("launched", [True, False])
def test_texts_of_exec_under_one_name(modules, launched):
    """As notebooks and generators of code do, which tell `linecache` of their texts."""
    kernels = []
    for number in (1, 22):
        text = HEAD + textwrap.dedent(KERNEL.format(lines="", number=number))
        linecache.cache["<made>"] = (len(text), None, text.splitlines(True), "<made>")
        names = {"__name__": "made"}
        exec(compile(text, "<made>", "exec"), names)
        kernels.append(names["answer"])
        if launched:
            assert kernels[-1]() == number
    assert [kernel() for kernel in kernels] == [1, 22]


def test_text_that_linecache_learns_late(modules):
    text = HEAD + textwrap.dedent(KERNEL.format(lines="", number=7))
    names = {"__name__": "made"}
    exec(compile(text, "<late>", "exec"), names)
    linecache.cache["<late>"] = (len(text), None, text.splitlines(True), "<late>")
    assert names["answer"]() == 7


def test_text_of_another_code_is_refused(modules):
    text = HEAD + textwrap.dedent(KERNEL.format(lines="", number=7))
    other = text.replace("return 7", "return 7 + 1")
    linecache.cache["<other>"] = (len(other), None, other.splitlines(True), "<other>")
    names = {"__name__": "made"}
    exec(compile(text, "<other>", "exec"), names)
    with pytest.raises(ti.TaiSyntaxError, match="the file has changed since"):
        names["answer"]()


def test_error_shows_the_line_that_was_loaded(modules):
    module = modules.load("sim_error", KERNEL.format(lines="", number="unknown"))
    modules.write("sim_error", KERNEL.format(lines="# moved\n    # again", number=5))
    with pytest.raises(ti.TaiNameError) as caught:
        module.answer()
    assert "|     return unknown" in str(caught.value)


@pytest.mark.parametrize(
    "body",
    [
        "total = 0.5\n    for i in range(3):\n        total += ti.f32(i) ** 2\n    return total",
        "a: ti.f32 = 1.0\n    assert a > 0, 'positive'\n    return a if a < 2 else -0.0",
        "v = ti.Vector([j * 1.0 for j in range(3)])\n    return v.sum()",
        "'Says it.'\n    w = ti.math.vec3(1)\n    return ti.static(sum(k for k in range(3))) * w.x",
    ],
)
@pytest.mark.parametrize("future", ["", "from __future__ import annotations\n"])
def test_code_and_text_of_many_forms_agree(modules, body, future):
    path = modules.folder / "forms.py"
    path.write_text(f"{future}{HEAD}@ti.kernel\ndef run(x: ti.f32 = 2.0) -> ti.f32:\n    {body}\n")
    importlib.invalidate_caches()
    module = importlib.import_module("forms")
    assert isinstance(module.run(), float)


NOTEBOOK = """
import os, pathlib, sys
from IPython.core.interactiveshell import InteractiveShell

folder = pathlib.Path(sys.argv[1])
sys.path.insert(0, str(folder))
texts = {texts!r}

def write(number):
    path = folder / "lab.py"
    path.write_text(texts.replace("NUMBER", str(number)))
    os.utime(path, (10**6 * number, 10**6 * number))

write(1)
shell = InteractiveShell.instance()
for cell in ("%load_ext autoreload", "%autoreload 2" + {options!r}, "import tai as ti, lab",
             "from lab import answer, weigh, plain, twice, Sim, Ball", "ti.init(arch=ti.cpu)",
             "@ti.kernel\\ndef own() -> ti.i32:\\n    return twice(1) + 0 * lab.twice(1)",
             "sim = Sim()"):
    shell.run_cell(cell, store_history=True).raise_error()
results = "answer(), lab.answer(), plain(), own(), sim.step(), sim.both(), weigh()"
for number in (1, 22, 333):
    write(number)
    shell.run_cell("seen = " + results, store_history=True).raise_error()
    print(shell.user_ns["seen"])
"""

LAB = """import tai as ti
@ti.kernel
def answer() -> ti.i32:
    return NUMBER

def plain():
    return NUMBER

@ti.func
def twice(x):
    return NUMBER * x

@ti.data_oriented
class Sim:
    @ti.func
    def part(self, x):
        return NUMBER * x

    @ti.kernel
    def step(self) -> ti.i32:
        return NUMBER

    @ti.kernel
    def both(self) -> ti.i32:
        return self.part(1)

@ti.dataclass
class Ball:
    mass: ti.i32

    @ti.func
    def weight(self):
        return NUMBER * self.mass

@ti.kernel
def weigh() -> ti.i32:
    ball = Ball(1)
    return ball.weight()
"""


def _only(*kept):
    """LAB with a number that changes in some lines only, so that IPython reloads these alone."""
    lines = LAB.split("\n")
    for n, line in enumerate(lines):
        if "NUMBER" in line and not any(k in line for k in kept):
            lines[n] = line.replace("NUMBER", "1")
    return "\n".join(lines)


@pytest.mark.parametrize("options", ["", " --full"])
@pytest.mark.parametrize(
    ("text", "changes"),
    [(LAB, [0, 1, 2, 3, 4, 5, 6]), (_only("NUMBER * x"), [3, 5]), (_only("NUMBER * self"), [6])],
    ids=["all", "functions", "struct"],
)
def test_autoreload_in_a_notebook(tmp_path, text, changes, options):
    pytest.importorskip("IPython", reason="IPython is not installed: pip install ipython")
    script = NOTEBOOK.replace("{texts!r}", repr(text)).replace("{options!r}", repr(options))
    done = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path)], capture_output=True, text=True, timeout=300,
        env={**os.environ, "IPYTHONDIR": str(tmp_path)},
    )  # fmt: skip
    expected = [
        str(tuple(number if n in changes else 1 for n in range(7))) for number in (1, 22, 333)
    ]
    seen = [line for line in done.stdout.splitlines() if line.startswith("(")]
    assert seen == expected, done.stdout + done.stderr
