"""Calls of libtai that forget Python's lock are found."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "scripts"))

import lock_discipline


@pytest.mark.parametrize(
    "text",
    [
        "int f() { return taiKernelReadsInReverse(k, 1); }",
        "void f() { taiFieldRelease(handle); }",
        "void f() { taiFieldRelease(handle); a(); b(); settle(); }",
        "void f() { if (taiTapeNumRecords(t)) g(); }\n} afterCall();",
        "void f() { { Teardown teardown; } taiFieldRelease(handle); }",
        "// settled(\nvoid f() { taiTapeExplain(t); // settle();\n}",
        "void f() { other(taiTapeExplain(t)); }",
    ],
)
def test_what_is_found(text):
    (line,) = lock_discipline.problems("f.cpp", text)
    assert line.startswith("f.cpp:") and line.endswith("is not followed by afterCall()")


@pytest.mark.parametrize(
    "text",
    [
        "void f() { c.check(taiFieldFill(f, g(1), 2)); }",
        "auto f() { return std::string(settled(taiTapeExplain(t))); }",
        "void f() { Teardown teardown; if (handle) taiFieldRelease(handle); }",
        "void f() { TaiStatus status = taiKernelLaunch(k); if (!afterCall()) return; }",
        "int f() { return taiContextIsOnGpu(c); }",
    ],
)
def test_what_is_right(text):
    assert lock_discipline.problems("f.cpp", text) == []


def test_the_module_is_right():
    assert lock_discipline.check() == []
