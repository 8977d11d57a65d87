"""The check of the examples itself: errors that it must find."""

import os
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "scripts"))
doc_examples = pytest.importorskip("doc_examples")
OPT = Path(os.environ.get("TAI_BUILD_DIR", ROOT / "build")) / "bin/tai-opt"
pytestmark = pytest.mark.skipif(not OPT.exists(), reason="this machine has no tai-opt")


def check(text):
    return doc_examples.check(str(OPT), doc_examples.Example(Path("x.td"), 1, "Op", text))


def test_values_that_an_example_is_given_get_their_types():
    assert check("%y = arith.addf %a, %b : f32\n") == ""
    assert check("%y = tai.matmul %a, %a : (vector<2x2xf64>, vector<2x2xf64>)\n") != ""


def test_an_unknown_op_is_found():
    assert "nosuchop" in check("%y = tai.nosuchop %a : f32\n")


def test_two_types_of_one_value_are_found():
    assert check("%y = arith.addf %a, %a : f32\n%z = arith.addi %a, %a : i32\n") != ""


def test_what_defines_all_that_it_names_is_verified():
    assert "a square matrix" in check(
        "%v = arith.constant dense<1.0> : vector<2x3xf32>\n"
        "%d = tai.determinant %v : vector<2x3xf32>\n"
    )
