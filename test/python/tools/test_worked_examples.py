"""The recipes of docs/developing.md for one more of each, as changes that apply to the tree."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import needed

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
        "A form of an index",
        "A form of a reduction",
        "A pass",
    ]


@pytest.mark.parametrize("title", EXAMPLES)
def test_the_change_applies_and_touches_as_many_files_as_it_says(title):
    count, change = EXAMPLES[title]
    assert len(re.findall(r"^\+\+\+ b/", change, re.M)) == count
    done = subprocess.run(
        [needed.program("git"), "apply", "--check", "-C1", "-"], cwd=ROOT, input=change, text=True,
        capture_output=True,
    )  # fmt: skip
    assert done.returncode == 0, f"docs/developing.md, {title}: {done.stderr}"


def test_no_list_of_sources_and_tests_names_a_pass():
    """As the example of a pass says: they are found by their folders."""
    for name in ("lib/Transforms/CMakeLists.txt", "test/CMakeLists.txt", "test/lit.cfg.py"):
        assert "latten" not in (ROOT / name).read_text()


def changed_files(title: str, folder: Path) -> list[Path]:
    """Makes the files that the change of an example leaves, in a folder; their places."""
    change = EXAMPLES[title][1]
    names = [Path(name) for name in re.findall(r"^\+\+\+ b/(.*)$", change, re.M)]
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / name).exists():
            shutil.copy(ROOT / name, folder / name)
    subprocess.run(
        [needed.program("git"), "apply", "-C1", "-"], cwd=folder, input=change, text=True,
        check=True, env={**os.environ, "GIT_CEILING_DIRECTORIES": str(folder.parent)},
    )  # fmt: skip
    return names


def compile_changed(folder: Path, like: str, *how: str) -> None:
    """Compiles a source as the build does, but with the changed headers of the folder first."""
    words, place = compiler_of(ROOT / like)
    at = next((at for at, word in enumerate(words) if word.startswith("-I")), len(words))
    words[at:at] = [f"-I{folder / 'include'}", "-iquote", str((ROOT / like).parent)]
    done = subprocess.run([*words, *how], cwd=place, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("title", "like"),
    [
        ("The derivative of a scalar op", "lib/AD/Rules/ScalarRules.cpp"),
        ("A kind of layout level", "lib/AD/Rules/ScalarRules.cpp"),
        ("An entry point of the runtime", "lib/Runtime/Launch/Abi.cpp"),
        ("A form of an index", "lib/Analysis/Index/IndexBuilder.cpp"),
        ("A form of an index", "test/unit/Analysis/Index/IndexDigitsTest.cpp"),
        ("A form of a reduction", "lib/Conversion/TaiToHost/Reductions/RegisterTotal.cpp"),
    ],
)
def test_the_changed_sources_compile(title, like, tmp_path):
    names = changed_files(title, tmp_path)
    sources = [name for name in names if name.suffix == ".cpp"]
    [source] = [name for name in sources if name == Path(like)] or sources
    compile_changed(tmp_path, like, "-fsyntax-only", str(tmp_path / source))


PLUGIN = """
#include "tai/Transforms/Passes.h"
#include "mlir/Tools/Plugins/PassPlugin.h"
extern "C" mlir::PassPluginLibraryInfo mlirGetPassPluginInfo() {
  return {MLIR_PLUGIN_API_VERSION, "Example", "1", mlir::tai::registerDropPrints};
}
"""


def test_the_pass_runs_and_its_test_passes(tmp_path):
    """Its definition makes the declarations of the room, and its source a plugin."""
    table, source, test = changed_files("A pass", tmp_path)
    words, _ = compiler_of(ROOT / "lib/Transforms/Launches/SummarizeKernels.cpp")
    upstream = Path(words[words.index("-isystem") + 1])
    declarations = (tmp_path / table).with_name("Passes.h.inc")
    subprocess.run(
        [upstream.parent / "bin/mlir-tblgen", "-gen-pass-decls", "-name", "TaiTransforms",
         f"-I{ROOT / 'include'}", f"-I{upstream}", tmp_path / table, "-o", declarations],
        check=True,
    )  # fmt: skip
    plugin = tmp_path / "Plugin.cpp"
    plugin.write_text(PLUGIN)
    library = tmp_path / "Example.so"
    compile_changed(tmp_path, "lib/Transforms/Launches/SummarizeKernels.cpp", "-shared",
                    "-o", str(library), str(tmp_path / source), str(plugin))  # fmt: skip
    [line] = re.findall(r"^// RUN: (.*)$", (tmp_path / test).read_text(), re.M)
    load = f"{ROOT / 'build/bin/tai-opt'} --load-pass-plugin={library}"
    # Passes of a plugin are known to pipelines, and come too late for options of their own.
    line = re.sub(r"--(tai-[a-z-]+)", r"--pass-pipeline='builtin.module(\1)'", line)
    command = line.replace("tai-opt", load).replace("%s", str(tmp_path / test))
    command = command.replace("FileCheck", f"{upstream.parent / 'bin/FileCheck'}")
    done = subprocess.run(["bash", "-o", "pipefail", "-c", command], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


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
    """The command by which the build compiles a source, up to its output, and the folder of the
    command."""
    database = ROOT / "build/compile_commands.json"
    entries = json.loads(database.read_text()) if database.exists() else []
    for entry in entries:
        if Path(entry["file"]) == source:
            words = shlex.split(entry["command"])
            return words[: words.index("-o")], Path(entry["directory"])
    pytest.skip("the sources of this folder are not built here")


def test_the_row_of_an_option_is_all_that_the_sources_need(tmp_path):
    """The session compiles with the option, sets it by its name, and lists it in its errors."""
    changed = tmp_path / "tai/Support/Options.def"
    changed.parent.mkdir(parents=True)
    changed.write_text(changed_options())
    source = ROOT / "lib/ExecutionEngine/Session/SessionOptions.cpp"
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
