"""The generated parts of the documentation site: its Python reference names all that is public."""

import importlib
import operator
import sys
from pathlib import Path

import pytest
import tai as ti

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "scripts" / "site"))
import api  # noqa: E402
from indentation import indented  # noqa: E402


def names_of(page):
    return [name for listed in page.sections.values() for name in listed.split()]


def test_every_public_name_is_on_a_page():
    listed = [name for page in api.PAGES for name in names_of(page)]
    assert len(listed) == len(set(listed))
    listed += [name for names in api.CONSTANTS.values() for name in names.split()]
    listed += api.ELSEWHERE
    public = {name for name in dir(ti) if not name.startswith("_")}
    modules = {name for name in public if (api.PACKAGE / f"{name}.py").is_file()}
    packages = {name for name in public if (api.PACKAGE / name).is_dir()}
    renamed = {name for name in public if name.startswith("Taichi")}
    typing = {"Any", "annotations", "TYPE_CHECKING"}
    known = {"alias", "native", "dtypes"}  # of the package itself
    assert public - modules - packages - renamed - typing - known - set(listed) == set()
    assert set(listed) - public == set()


def test_every_module_has_a_page():
    """But those that are programs, or whose names another page lists."""
    others = {"errors", "about", "binaries", "doctor", "view", "types"}
    found = {path.stem for path in api.PACKAGE.glob("*.py") if not path.stem.startswith("_")}
    assert found - others <= set(api.MODULES)


@pytest.mark.parametrize("module", ["", *api.MODULES])
def test_definitions_are_where_the_reference_looks(module):
    if module and not (api.PACKAGE / f"{module}.py").is_file():
        assert module in {"checkpoint", "jax", "optim"}
        return
    names = api.names_of_module(module) if module else api.names_of_package()
    assert len(names) > (100 if not module else 0)
    for name, full in names.items():
        if not full:
            continue
        assert api.is_visible(full) or not module, full
        parts = full.split(".")
        source = "/".join(parts[1:-1])
        files = [api.PACKAGE / f"{source}.py", api.PACKAGE / source / "__init__.py"]
        assert any(file.is_file() for file in files), (name, full)
        if module not in ("torch", "jax"):
            owner = importlib.import_module(".".join(parts[:-1]))
            public = operator.attrgetter(f"{module}.{name}" if module else name)(ti)
            assert getattr(owner, parts[-1]) is public, full


def test_names_that_griffe_does_not_see():
    assert api.is_visible("tai._impl.base.dtypes.cast")
    assert not api.is_visible("tai._impl.base.dtypes.float16")
    assert api.names_of_module("types")["float16"] == ""


def test_entries_of_the_pages_are_seen():
    names = api.names_of_package()
    listed = [name for page in api.PAGES for name in names_of(page)]
    assert not [name for name in listed if not api.is_visible(names[name])]


def test_lists_for_python_markdown():
    page = "- one\n  - two\n\n  more\n\n1. three\n   ```\n   x\n   ```\ntext\n  indented\n"
    assert indented(page) == (
        "- one\n    - two\n\n    more\n\n1. three\n    ```\n    x\n    ```\ntext\n  indented\n"
    )
    assert indented("```\n- one\n  two\n```\n") == "```\n- one\n  two\n```\n"
