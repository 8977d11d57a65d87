"""The extension of Visual Studio Code: its manifest names files, its patterns match IR."""

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
FOLDER = ROOT / "editors/vscode"
TOOL = Path(os.environ.get("TAI_BUILD_DIR", ROOT / "build")) / "bin/tai-opt"
MANIFEST = json.loads((FOLDER / "package.json").read_text())
needs_node = pytest.mark.skipif(not shutil.which("node"), reason="Node.js is not installed")


def scopes(line):
    """The scope of each word of a line, by the first pattern that matches there."""
    grammar = json.loads((FOLDER / MANIFEST["contributes"]["grammars"][0]["path"]).read_text())
    patterns = [(re.compile(p.get("match") or p["begin"]), p["name"]) for p in grammar["patterns"]]
    found, at = {}, 0
    while at < len(line):
        hits = [
            (m.start(), i, m, n) for i, (p, n) in enumerate(patterns) if (m := p.search(line, at))
        ]
        if not hits:
            break
        _, _, match, name = min(hits, key=lambda hit: hit[:2])
        found[match[0]] = name
        at = max(match.end(), at + 1)
    return found


def test_manifest_names_files():
    contributes = MANIFEST["contributes"]
    named = [MANIFEST["main"], *(g["path"] for g in contributes["grammars"])]
    named += [language["configuration"] for language in contributes["languages"]]
    for name in named:
        assert (FOLDER / name).is_file(), name
    assert contributes["grammars"][0]["language"] == contributes["languages"][0]["id"]
    assert contributes["languages"][0]["extensions"] == [".mlir"]
    json.loads((FOLDER / "language-configuration.json").read_text())


def test_colours_of_an_access():
    found = scopes("%v = tai.load @x[%i] : f32 // of @y")
    assert found["tai.load"] == "keyword.other.tai.mlir"
    assert found["@x"] == "entity.name.function.mlir"
    assert found["%v"] == "variable.other.mlir"
    assert found["f32"] == "storage.type.mlir"
    assert found["// of @y"] == "comment.line.double-slash.mlir"


def test_colours_of_a_layout():
    found = scopes("tai.tree @s : !tai.root<pointer<[i: 64], dense<[i: 8], {x: f32}>>>")
    assert found["!tai.root"] == "entity.name.type.mlir"
    assert found["pointer"] == found["dense"] == "support.type.layout.tai.mlir"
    assert found["64"] == "constant.numeric.mlir"


PROGRAM = """
tai.tree @t : !tai.root<dense<[i: 8], {x: f32, y: f32, dx: f32, dy: f32}>>
tai.field @x = @t["x"] : f32, rank 1, adjoint @dx
tai.field @y = @t["y"] : f32, rank 1, adjoint @dy
tai.field @dx = @t["dx"] : f32, rank 1
tai.field @dy = @t["dy"] : f32, rank 1
tai.kernel @square() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = arith.mulf %0, %0 : f32
    tai.store %1, @y[%i] : f32
  }
  tai.return
}
func.func @plain() {
  return
}
func.func private @energy(%x: f64) -> f64
    attributes {tai.differentiate, tai.gradients = array<i64: 0, 1>} {
  %0 = arith.mulf %x, %x : f64
  return %0 : f64
}
"""


def ask(script):
    """The output of a script that uses adjoint.js as `adjoint`."""
    head = f"const adjoint = require({json.dumps(str(FOLDER / 'adjoint.js'))});\n"
    done = subprocess.run(
        ["node", "-e", head + script], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def show(name, program=PROGRAM, tool=TOOL):
    return ask(
        f"adjoint.makeAdjoint({json.dumps(str(tool))}, {json.dumps(program)}, {json.dumps(name)})"
        ".then((text) => console.log(text));"
    )


@needs_node
def test_lenses_stand_above_kernels_and_functions_to_differentiate():
    found = json.loads(
        ask(f"console.log(JSON.stringify(adjoint.findFunctions({json.dumps(PROGRAM)})))")
    )
    assert [f["name"] for f in found] == ["square", "energy"]
    lines = PROGRAM.split("\n")
    assert all(f"@{f['name']}(" in lines[f["line"]] for f in found)


@needs_node
@pytest.mark.skipif(not TOOL.exists(), reason="this machine has no tools of tai")
def test_lens_shows_the_adjoint_alone():
    shown = show("square")
    assert "tai.kernel @square_grad(" in shown and "@dx" in shown
    assert "@square(" not in shown and "@energy" not in shown and "tai.tree" not in shown
    assert "@energy_grad(" in show("energy")


@needs_node
@pytest.mark.skipif(not TOOL.exists(), reason="this machine has no tools of tai")
def test_lens_shows_the_error():
    shown = show("square", PROGRAM.replace("arith.mulf %0, %0", "arith.mulf %0, %9"))
    assert shown.startswith("//") and "use of undeclared SSA value" in shown
    assert all(line.startswith("//") for line in shown.strip().split("\n"))


@needs_node
def test_lens_says_that_the_tool_is_missing():
    assert show("square", tool="/nowhere/tai-opt").startswith("// ")
