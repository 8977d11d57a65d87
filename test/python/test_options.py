"""The table of options: each row is read, refused and reached from `ti.init`."""

import pytest
import tai as ti
from tai import _core as native

TABLE = {name: (initial, expects) for name, initial, expects, _ in native.options()}
# Set while a program runs, or from the environment alone.
NOT_OF_INIT = {"forward_mode", "compile_profile", "order_seed"}
# What no option of that kind takes.
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
    assert reached == set(TABLE) - NOT_OF_INIT
