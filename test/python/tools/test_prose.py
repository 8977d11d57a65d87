"""`scripts/prose.py` counts sentences that begin without a noun, and keeps rooms below a bar."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "scripts"))

import prose


def offenders(name, text):
    room = prose.read_room(name, text)
    return [s for _, s in room.openings], [s for _, s in room.clauses]


@pytest.mark.parametrize(
    "sentence",
    [
        "Those of the loop are kept.",
        "Of the steps only one is exact.",
        "None of them is read again.",
        "As many threads run at a time.",
    ],
)
def test_an_opening_without_a_noun_is_counted(sentence):
    assert offenders("lib/A/B/C.cpp", f"// {sentence}\n") == ([sentence], [])
    assert offenders("python/a.py", f'"""{sentence}"""\n') == ([sentence], [])
    assert offenders("docs/a.md", f"{sentence}\n") == ([sentence], [])


@pytest.mark.parametrize(
    "sentence",
    [
        "Returns what is stored there.",
        "The tape saves what it overwrites.",
        "See what the user did.",
    ],
)
def test_a_clause_in_place_of_a_noun_is_counted(sentence):
    assert offenders("lib/A/B/C.cpp", f"/// {sentence}\n") == ([], [sentence])
    assert offenders("python/a.py", f"x = 1  # {sentence}\n") == ([], [sentence])
    assert offenders("docs/a.md", f"- {sentence}\n") == ([], [sentence])


@pytest.mark.parametrize(
    "name, text",
    [
        ("a.cpp", "// The tape saves the overwritten elements.\n"),
        ("a.cpp", "// See below, and see whatever is there.\n"),
        ("a.cpp", 'call("// Those are not read here.");\n'),
        ("a.cpp", "// RUN: tai-opt %s | What is it that reads here\n"),
        ("a.cpp", "// What remains.\n"),
        ("a.py", '"""Runs it.\n\n    --all   Those of all rooms are printed.\n"""\n'),
        ("a.md", "# What is in the box\n\n| Those of a table | what is |\n"),
        ("a.md", "```\nThose of the code are not read.\n```\n"),
    ],
)
def test_other_text_is_not_counted(name, text):
    assert offenders(name, text) == ([], [])


def test_a_sentence_may_go_over_several_lines():
    text = "// The first. Those of the\n// second line are kept.\nint x;\n"
    assert offenders("a.cpp", text) == (["Those of the second line are kept."], [])


@pytest.mark.parametrize(
    "name, room",
    [
        ("lib/Runtime/Tape/Tape.cpp", "lib/Runtime/Tape"),
        ("lib/CAPI/Tai.cpp", "lib/CAPI"),
        ("include/tai/Runtime/Tape/Tape.h", "include/tai/Runtime/Tape"),
        ("include/tai-c/Tai.h", "include/tai-c"),
        ("python/tai/_impl/ad/tape.py", "python/tai/_impl/ad"),
        ("python/tai/api.py", "python/tai"),
        ("test/python/ad/test_tape.py", "test/python"),
        ("docs/guides/tape.md", "pages"),
        ("setup.py", "."),
    ],
)
def test_rooms_are_folders(name, room):
    assert prose.room_of(name) == room


def room_with(openings, sentences=100):
    bad = [("a.cpp", "Those of the loop are kept.")] * openings
    return prose.Room(sentences, openings=bad)


def test_a_room_above_the_bar_is_a_problem():
    (line,) = prose.problems({"lib/A": room_with(1)})
    assert line == (
        "lib/A: 10.0 openings and 0.0 clauses per 1,000 sentences, at most 8 and 6: "
        "rewrite some that `scripts/prose.py --list lib/A` prints"
    )
    assert prose.problems({"lib/A": room_with(0)}) == []
    assert prose.problems({"lib/A": room_with(1, sentences=125)}) == []


def test_small_rooms_are_counted_together():
    text = "// The tape is kept.\n\n" * 3
    rooms = prose.read_tree({"lib/A/B.cpp": text, "lib/C/D.cpp": text})
    assert {name: room.sentences for name, room in rooms.items()} == {prose.SMALL_ROOMS: 6}


@pytest.mark.parametrize(
    "name, text, has",
    [
        ("a.cpp", "//===- a.cpp - Saves the tape ---===//\n\nint x;\n", True),
        ("a.h", "//===- a.h - Tape --*- C++ -*-===//\n", True),
        ("a.cpp", "//===- a.cpp -------===//\n// Saves the tape.\n\nint x;\n", True),
        ("a.cpp", "//===- a.cpp ------------===//\n\nint x;\n", False),
        ("a.cpp", "#include <a>\n// Saves the tape.\n", False),
        ("a.py", '#!/usr/bin/env python3\n"""Saves the tape."""\n', True),
        ("a.py", "# Saves the tape.\n", True),
        ("a.py", "import a\n", False),
        ("__init__.py", "", True),
    ],
)
def test_headers(name, text, has):
    assert prose.has_header(name, text) == has
