"""The rule on imports between the packages of tai: what `scripts/rooms_python.py` finds."""

import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).resolve().parents[3] / "scripts"
sys.path.insert(0, str(SCRIPTS))
import rooms_python  # noqa: E402

ALLOWED = {"errors": set(), "_impl.low": set(), "_impl.high": {"_impl.low"}, "_impl": set(),
           "public": {"_impl.high"}}  # fmt: skip

RIGHT = {
    "__init__.py": "from ._impl.high.top import f\nimport tai.errors\n",
    "errors.py": "",
    "_impl/__init__.py": "",
    "_impl/low/__init__.py": "",
    "_impl/low/base.py": "import math\nfrom ...errors import E\n",
    "_impl/high/__init__.py": "",
    "_impl/high/top.py": "from ..low import base\nfrom ..low.base import g\n",
}


def find(tmp_path, **changed) -> list[str]:
    for name, text in {**RIGHT, **changed}.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return rooms_python.problems(tmp_path, ALLOWED)


def test_the_package_keeps_the_rules():
    package = SCRIPTS.parent / "python" / "tai"
    assert rooms_python.problems(package) == []
    assert len(rooms_python.find_imports(package)) > 300


def test_what_is_allowed(tmp_path):
    assert find(tmp_path) == []


@pytest.mark.parametrize(
    "name, text, said",
    [
        ("_impl/low/base.py", "from ..high.top import f\n", "_impl.low may not import from _impl"),
        ("_impl/low/base.py", "import tai._impl.high.top\n", "_impl.low may not import from _impl"),
        ("_impl/low/base.py", "from ... import x\n", "_impl.low may not import from public"),
        ("errors.py", "from ._impl.low import base\n", "errors may not import from _impl.low"),
        ("__init__.py", "from ._impl.low import base\n", "public may not import from _impl.low"),
        ("_impl/new/a.py", "from ..low import base\n", "_impl.new is not in the table"),
        ("_impl/high/top.py", "def f():\n    from ..low import base\n", "inside of a function"),
        ("_impl/high/top.py", "class A:\n  async def f(s):\n    import tai.errors\n", "inside of"),
        ("_impl/high/top.py", "from ... import _core\n", "take it from _impl.base.native"),
        ("_impl/high/top.py", "from tai._core import Context\n", "take it from _impl.base.native"),
    ],
)  # fmt: skip
def test_what_is_not(tmp_path, name, text, said):
    found = find(tmp_path, **{name: text})
    assert any(said in line for line in found), found


def test_circles_within_a_package(tmp_path):
    found = find(tmp_path, **{
        "_impl/low/base.py": "from . import other\n", "_impl/low/other.py": "from .base import x\n",
    })  # fmt: skip
    assert found == ["modules in a circle: _impl.low.base, _impl.low.other"]
    types = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from .base import x\n"
    assert find(tmp_path, **{"_impl/low/other.py": types}) == []


def test_a_table_with_a_circle(tmp_path):
    find(tmp_path)
    allowed = {**ALLOWED, "_impl.low": {"_impl.high"}}
    found = rooms_python.problems(tmp_path, allowed)
    assert "packages in a circle: _impl.high, _impl.low" in found


def test_no_folder_is_crowded(tmp_path):
    root = SCRIPTS.parent
    assert rooms_python.crowds(root / "python/tai", root / "test/python") == []
    for number in range(41):
        (tmp_path / f"test_{number}.py").touch()
    assert "41 files side by side, at most 40" in rooms_python.crowds(tmp_path)[0]
    (tmp_path / "room").mkdir()
    (tmp_path / "test_0.py").rename(tmp_path / "room" / "test_0.py")
    assert rooms_python.crowds(tmp_path) == []
