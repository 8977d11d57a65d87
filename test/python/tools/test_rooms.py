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
