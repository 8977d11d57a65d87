"""The counts that `scripts/house.py` keeps below their bars."""

import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]
sys.path.insert(0, str(ROOT / "scripts"))

import house  # noqa: E402


def counted(monkeypatch, rule, **texts):
    """The places that a rule finds in sources with these names and texts."""
    named = {name.replace("__", "/").replace("_dot_", "."): text for name, text in texts.items()}
    monkeypatch.setattr(house, "sources", lambda: named)
    return rule()


def test_the_tree_passes():
    assert house.check() == []
    assert len(house.sources()) > 800


def test_a_count_above_its_bar_lists_its_places_and_one_below_asks_for_a_lower_bar():
    rules = [
        house.Rule("sources", lambda: ["a.cpp", "b.cpp"], bar=bar, goal=0) for bar in (1, 2, 3)
    ]
    above, here, below = (house.check([rule]) for rule in rules)
    assert above == ["2 sources, at most 1:", "  a.cpp", "  b.cpp"]
    assert here == []
    assert "a bar of 3" in below[0]


def test_products_of_indices_are_found_and_comments_are_not(monkeypatch):
    found = counted(
        monkeypatch,
        house.index_arithmetic,
        lib__AD__A_dot_cpp="auto op = value.getDefiningOp<arith::MulIOp>();",
        lib__AD__B_dot_cpp="// not value.getDefiningOp<arith::MulIOp>()",
        lib__AD__C_dot_cpp="auto op = arith::MulIOp::create(builder, loc, a, b);",
        lib__Analysis__Index__D_dot_cpp="if (isa<arith::AddIOp, arith::MulIOp>(op)) {}",
        lib__Analysis__E_dot_cpp="TypeSwitch(op).Case<arith::MulIOp>(f);",
    )
    assert found == ["lib/AD/A.cpp", "lib/Analysis/E.cpp"]


def test_modes_of_sums_are_found_outside_of_the_rooms_of_reductions(monkeypatch):
    found = counted(
        monkeypatch,
        house.modes_of_sums,
        lib__AD__A_dot_cpp="if (modes.deterministic) {}",
        lib__AD__B_dot_cpp="return nondeterministic;",
        lib__Dialect__C_dot_cpp="bool isWide();",
        lib__Conversion__Reductions__D_dot_cpp="bool compensated = false;",
    )
    assert found == ["lib/AD/A.cpp"]


STRUCTS = """
/// Four in Inner, one beside it.
class Outer : public Base {
public:
  bool isEmpty() const { bool a = true; bool b = a; bool c; bool d; return b; }
  void set(bool a, bool b, bool c, bool d);
  struct Inner {
    bool a = false, b = false;
    std::atomic<bool> c{false};
    mutable bool d;
  };

private:
  bool e : 1;
};
struct Three { bool a; bool b = true; bool c{false}; };
"""


def test_booleans_are_counted_for_each_struct_without_those_of_its_functions(monkeypatch):
    assert {name: house.booleans(body) for name, body in house.bodies(STRUCTS)} == {
        "Outer": 1, "Inner": 4, "Three": 3,
    }  # fmt: skip
    found = counted(monkeypatch, house.flag_structs, lib__A_dot_h=STRUCTS)
    assert found == ["lib/A.h: Inner: 4 booleans"]


PASS = 'def Fold : Pass<"tai-fold"> {'
SOURCE = "struct Fold : tai::impl::FoldBase<Fold> {"


def test_getters_of_the_runtime_have_plain_names(monkeypatch):
    found = counted(
        monkeypatch,
        house.runtime_getters,
        lib__Runtime__A_dot_h="Tree &getTree() const { return tree; } // getMore() {",
        lib__Runtime__B_dot_h="size_t size() const; int getRow(int row) const;",
        include__tai__AD__C_dot_h="Type getType() const;",
    )
    assert found == ["lib/Runtime/A.h: getTree() const"]


def test_a_pass_wants_a_test_in_the_folder_of_its_source(monkeypatch):
    def missing(**tests):
        return counted(
            monkeypatch,
            house.passes_without_test,
            include__tai__Transforms__Passes_dot_td=PASS,
            lib__Transforms__Simplify__Fold_dot_cpp=SOURCE,
            test__Transforms__Simplify__others_dot_mlir="// RUN: tai-opt %s --tai-others",
            **tests,
        )

    place = "include/tai/Transforms/Passes.td: no test in test/Transforms/Simplify runs tai-fold"
    run = "// RUN: tai-opt %s --tai-fold | FileCheck %s"
    assert missing() == [place]
    assert missing(test__Dialect__fold_dot_mlir=run) == [place]
    assert missing(test__Transforms__Simplify__fold_dot_mlir="// about --tai-fold") == [place]
    assert missing(test__Transforms__Simplify__fold_dot_mlir=run.replace("fold", "fold-all"))
    assert missing(test__Transforms__Simplify__fold_dot_mlir=run) == []
    pipeline = '// RUN: tai-opt %s --pass-pipeline="builtin.module(tai-fold{most=3})"'
    assert missing(test__Transforms__Simplify__fold_dot_mlir=pipeline) == []
