"""What docs/developing.md says one more of each takes, as changes that apply to the tree."""

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
sys.path.insert(0, str(ROOT / "scripts"))

import options  # noqa: E402

PAGE = (ROOT / "docs/developing.md").read_text()
SECTION = re.compile(r"^### ([^\n]+): (\d+) files?\n(.*?)(?=^##)", re.M | re.S)
EXAMPLES = {
    title: (int(count), re.search(r"^```diff\n(.*?)^```$", text, re.M | re.S)[1])
    for title, count, text in SECTION.findall(PAGE)
}


def test_there_is_an_example_of_each():
    assert list(EXAMPLES) == [
        "The derivative of a scalar op",
        "A kind of layout level",
        "An option of a context",
        "An entry point of the runtime",
        "A pass",
    ]


@pytest.mark.parametrize("title", EXAMPLES)
def test_the_change_applies_and_touches_as_many_files_as_it_says(title):
    count, change = EXAMPLES[title]
    assert len(re.findall(r"^\+\+\+ b/", change, re.M)) == count
    done = subprocess.run(
        ["git", "apply", "--check", "-C1", "-"], cwd=ROOT, input=change, text=True,
        capture_output=True,
    )  # fmt: skip
    assert done.returncode == 0, f"docs/developing.md, {title}: {done.stderr}"


def test_no_list_of_sources_and_tests_names_a_pass():
    """As the example of a pass says: they are found by their folders."""
    for name in ("lib/Transforms/CMakeLists.txt", "test/CMakeLists.txt", "test/lit.cfg.py"):
        assert "latten" not in (ROOT / name).read_text()


def changed_options() -> str:
    """The table of options with the row of the example."""
    change = EXAMPLES["An option of a context"][1]
    before, after = (
        "\n".join(line[1:] for line in change.splitlines()[3:] if line[0] in " " + sign)
        for sign in "-+"
    )
    source = options.TABLE.read_text()
    assert source.count(before) == 1
    return source.replace(before, after)


def test_the_row_of_an_option_becomes_a_row_of_the_page_and_of_python():
    table = changed_options()
    assert "| `contract` | `true` | true or false |" in options.page(
        table, options.PAGE.read_text()
    )
    scope = {}
    exec(options.module(table), scope)
    assert [row[:3] for row in scope["ROWS"] if row[0] == "contract"] == [
        ("contract", "Switch", "true")
    ]


def compiler_of(source: Path) -> tuple[list[str], Path]:
    """How the build compiles a source, up to what it makes, and where."""
    database = ROOT / "build/compile_commands.json"
    entries = json.loads(database.read_text()) if database.exists() else []
    for entry in entries:
        if Path(entry["file"]) == source:
            words = shlex.split(entry["command"])
            return words[: words.index("-o")], Path(entry["directory"])
    pytest.skip("the sources of this folder are not built here")


def test_the_row_of_an_option_is_all_that_the_sources_need(tmp_path):
    """The session compiles with it, sets what it names, and lists it in its errors."""
    changed = tmp_path / "tai/Support/Options.def"
    changed.parent.mkdir(parents=True)
    changed.write_text(changed_options())
    source = ROOT / "lib/ExecutionEngine/SessionOptions.cpp"
    words, folder = compiler_of(source)

    def compiles(*how: str) -> str:
        command = [*words, *how, str(source)]
        at = next(at for at, word in enumerate(command) if word.startswith("-I"))
        command.insert(at, f"-I{tmp_path}")
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    compiles("-fsyntax-only")
    session = compiles("-E", "-P")
    handled = re.search(r'if \(name == "contract"\) \{(.*?)if \(name ==', session, re.S)[1]
    assert "options::Switch::parse(value)" in handled
    assert "compileOptions.codegen.contract = *parsed" in handled
    assert 'names.empty() ? "contract" : ", " "contract"' in session
