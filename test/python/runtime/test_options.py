"""The table of options: each row is read, refused and reached from `ti.init`."""

import inspect
import subprocess
import sys
from pathlib import Path

import pytest
import tai as ti
from tai._impl.base import native, option_rows, options

TABLE = {name: (initial, expects) for name, initial, expects, _ in native.options()}
# Set while a program runs, or from the environment alone.
NOT_OF_INIT = {"forward_mode", "compile_profile", "order_seed"}
# Texts that no option of that kind takes.
WRONG = {"true or false": "perhaps", "off, clamp or check": "sometimes"}


@pytest.mark.parametrize("name", sorted(TABLE))
def test_the_initial_text_is_accepted(name):
    native.Context().set_option(name, TABLE[name][0])


# Any text is a folder.
@pytest.mark.parametrize("name", sorted(set(TABLE) - {"cache_dir"}))
def test_what_does_not_parse_names_the_option_and_what_it_expects(name):
    with pytest.raises(Exception, match=name if name != "arch" else "there is no arch") as info:
        native.Context().set_option(name, WRONG.get(TABLE[name][1], "-1x"))
    if "option '" in str(info.value) and name not in ("skip", "print_ir"):
        assert f"expects {TABLE[name][1]}, but got" in str(info.value)


def test_an_unknown_name_lists_all_options():
    with pytest.raises(Exception, match="unknown option 'speed'") as info:
        native.Context().set_option("speed", "9")
    assert f"the options are {', '.join(TABLE)}" in str(info.value)


def test_init_reaches_every_option(monkeypatch):
    reached = set()
    real = native.Context.set_option

    class Recording(native.Context):
        def set_option(self, name, value):
            reached.add(name)
            real(self, name, value)

    monkeypatch.setattr(native, "Context", Recording)
    ti.init(offline_cache=False)
    ti.field(ti.f32, shape=1).fill(1)
    # The words of numbers stand on each kernel: test_modes.
    assert options._ON_KERNELS <= set(TABLE)
    assert reached == set(TABLE) - NOT_OF_INIT - options._ON_KERNELS


def test_a_row_more_is_a_keyword_more():
    """With its type, its default, its line of help, and the text that the context gets."""
    row = ("tile_bytes", "Bytes", "4096", "a number of bytes", "what a tile may take")
    rows = [*option_rows.ROWS, row]
    keywords = options.keywords_of(rows)
    parameter = options.signature_of(keywords).parameters["tile_bytes"]
    assert (parameter.default, parameter.annotation) == (4096, int)
    assert "        tile_bytes: what a tile may take." in options.described(keywords).splitlines()
    chosen = options.Options()
    chosen.tile_bytes = 512
    assert options.texts_of(chosen, rows) == options.texts_of(chosen) | {"tile_bytes": "512"}


def test_the_rows_of_the_package_are_those_of_the_library():
    rows = [(name, *texts) for name, _, *texts in option_rows.ROWS]
    assert rows == native.options()


def test_the_page_says_what_taichi_calls_an_option():
    page = (Path(__file__).parents[3] / "docs/reference/options.md").read_text()
    for name, keyword in options._NAMES.items():
        assert f"| `{keyword}` | `{name}` |" in page


def test_help_needs_no_library():
    """The signature and the help are there before the extension module is loaded."""
    code = (
        "import inspect, sys, tai as ti\n"
        "found = inspect.signature(ti.init).parameters\n"
        "print(found['deterministic'], found['opt_level'], 'tai._core' in sys.modules)\n"
        "print('fast_math: reassociation' in ti.init.__doc__)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split("\n")[:2] == [
        "deterministic: bool = False opt_level: int = 3 False",
        "True",
    ]


def test_an_unknown_keyword_gets_the_nearest_name():
    with pytest.raises(ti.TaiRuntimeError, match="no option 'determinstic'") as info:
        ti.init(determinstic=True)
    assert "did you mean 'deterministic'?" in str(info.value)


def test_the_signature_says_what_holds_where_nothing_is_set():
    for name, parameter in inspect.signature(ti.init).parameters.items():
        if parameter.kind is not parameter.VAR_KEYWORD:
            assert getattr(options.Options(), name) == parameter.default, name
