"""The rule about rooms itself: violations that it must find, in made-up tables and includes."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "scripts"))
rooms = pytest.importorskip("rooms")

TABLE = {"Low": "", "Middle": "Low", "High": "Low Middle"}


def graph(*arrows):
    made = rooms.Graph()
    for a, b in arrows:
        made.arrows[a, b].append(f"lib/{a}/X.cpp includes lib/{b}/Y.h")
    return made


ALL = [("Middle", "Low"), ("High", "Low"), ("High", "Middle")]


def test_arrows_of_the_table_pass():
    assert rooms.check_arrows(TABLE, graph(*ALL), set()) == []


def test_an_upward_include_is_named():
    (problem,) = rooms.check_arrows(TABLE, graph(*ALL, ("Low", "High")), set())
    assert problem == "lib/Low/X.cpp includes lib/High/Y.h: 'Low' may not include 'High'"


def test_a_known_upward_include_passes_until_it_is_gone():
    known = {("Low", "High")}
    assert rooms.check_arrows(TABLE, graph(*ALL, ("Low", "High")), known) == []
    (problem,) = rooms.check_arrows(TABLE, graph(*ALL), known)
    assert "'Low' does not need 'High' any more" in problem


def test_an_arrow_that_nobody_needs_is_named():
    (problem,) = rooms.check_arrows(TABLE, graph(*ALL[:2]), set())
    assert "'High' does not need 'Middle'" in problem


def test_a_room_without_an_entry_is_named():
    problems = rooms.check_arrows(TABLE, graph(*ALL, ("Cellar", "Low")), set())
    assert problems == [
        "lib/Cellar/X.cpp includes lib/Low/Y.h: "
        "the room 'Cellar' is in no table of scripts/rooms.py"
    ]


def test_a_circle_in_the_table_has_no_order():
    assert rooms.order(TABLE) == ["Low", "Middle", "High"]
    assert rooms.order({"A": "B", "B": "A"}) is None


def test_a_file_that_the_page_names_must_be_there():
    assert rooms.check_paths("`lib/AD/Rules/ScalarRules.cpp`, `Sparse.cpp`, `loops.py`") == []
    (problem,) = rooms.check_paths("how: `lib/AD/Rules/NoRules.cpp`")
    assert "no file 'lib/AD/Rules/NoRules.cpp'" in problem


@pytest.fixture
def tree(tmp_path, monkeypatch):
    """An empty project, and a function that writes a file of it."""
    monkeypatch.setattr(rooms, "ROOT", tmp_path)

    def write(name, text=""):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        return rooms.check_private(name, text)

    return write


def test_a_private_header_serves_its_folder(tree):
    for name in ("lib/AD/Own.h", "lib/AD/Rules/A.h", "lib/AD/Rules/Below/B.h"):
        tree(name)
    assert tree("lib/AD/Rules/A.cpp", '#include "A.h"\n#include "Below/B.h"\n') == []
    assert tree("lib/AD/Rules/Below/B.cpp", '#include "B.h"\n#include "../A.h"\n') == []
    assert tree("lib/AD/All.cpp", '#include "Own.h"\n#include "Rules/A.h"\n') == []
    assert tree("lib/AD/Reverse/C.cpp", '#include "../Own.h"\n') == []


def test_a_private_header_of_another_folder_is_named(tree):
    tree("lib/AD/Rules/A.h")
    (problem,) = tree("lib/AD/Reverse/C.cpp", '#include "../Rules/A.h"\n')
    assert "lib/AD/Reverse/C.cpp includes lib/AD/Rules/A.h, which is private" in problem
    (problem,) = tree("lib/CodeGen/D.cpp", '#include "../AD/Rules/A.h"\n')
    assert "which is private to its folder" in problem


def test_a_public_header_includes_no_private_one(tree):
    tree("lib/AD/Rules/A.h")
    (problem,) = tree("include/tai/AD/P.h", '#include "../../../lib/AD/Rules/A.h"\n')
    assert problem == "include/tai/AD/P.h is public and includes the private lib/AD/Rules/A.h"


def test_a_header_stands_in_the_folder_of_its_source():
    source = "lib/AD/Rules/A.cpp"
    assert (
        rooms.check_mirrors([source, "include/tai/AD/Rules/A.h", "include/tai/AD/Passes.h"]) == []
    )
    (problem,) = rooms.check_mirrors([source, "include/tai/AD/A.h"])
    assert problem == "include/tai/AD/A.h: its source is in lib/AD/Rules"
    assert rooms.check_mirrors([source, "include/tai/CodeGen/A.h"]) == []


def test_unit_tests_have_the_folder_and_the_name_of_their_subject():
    assert rooms.check_unit_tests(["test/unit/AD/Rules/ATest.cpp", "test/unit/Utils/B.h"]) == []
    (problem,) = rooms.check_unit_tests(["test/unit/Cellar/ATest.cpp"])
    assert problem == "test/unit/Cellar/ATest.cpp: there is no folder lib/Cellar"
    (problem,) = rooms.check_unit_tests(["test/unit/AD/Rules/RulesA.cpp"])
    assert "does not end with Test.cpp" in problem


def test_lit_tests_have_the_folder_of_their_subject():
    names = ["test/AD/Rules/a.mlir", "test/AD/Foreign/Inputs/b.mlir", "test/Tools/c.test"]
    assert rooms.check_lit_tests(names) == []
    (problem,) = rooms.check_lit_tests(["test/AD/Cellar/a.mlir"])
    assert problem == "test/AD/Cellar: there is no folder lib/AD/Cellar"
