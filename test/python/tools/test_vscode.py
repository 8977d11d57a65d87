"""The extension of Visual Studio Code: its manifest names files, its patterns match IR."""

import json
import re
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[3] / "editors/vscode"
MANIFEST = json.loads((FOLDER / "package.json").read_text())


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
