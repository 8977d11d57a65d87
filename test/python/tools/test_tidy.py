"""`scripts/tidy.py` finds the sources that a changed header is looked at in."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "scripts"))

import tidy


def sources(*patterns):
    return {name for name in tidy.git("ls-files", *patterns) if name}


def test_a_header_is_looked_at_in_its_own_source():
    known = sources("lib/*.cpp")
    header = "include/tai/Analysis/Index/IndexForms.h"
    assert tidy.includer(header, known) == "lib/Analysis/Index/IndexForms.cpp"


def test_headers_of_one_name_are_told_apart():
    """lib/AD/Reverse/StoredOutputs.cpp includes another file of that name."""
    source = tidy.includer("lib/Runtime/Tape/Memory/StoredSlabs.h", sources("lib/*.cpp"))
    assert source.startswith("lib/Runtime/Tape/")


def test_a_header_may_be_included_by_headers_alone():
    """Given the sources that include none of it themselves, one is found by way of a header."""
    header = "python/src/Slots.h"
    known = {name for name in sources("python/src/*.cpp") if header not in tidy.includes(name)}
    assert tidy.includer(header, known) in known


def test_what_no_source_includes_is_said(capsys):
    assert (
        tidy.to_look_at({"lib/None.cpp", "benchmarks/floor/Floor.h"}, sources("lib/*.cpp")) == set()
    )
    assert "benchmarks/floor/Floor.h is not compiled" in capsys.readouterr().out
