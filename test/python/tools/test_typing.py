"""The types that editors see: mypy and pyright on a program, completion, names of the stub."""

import ast
import importlib.util
import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import tai as ti

PROGRAM = Path(__file__).with_name("typed_program.py")
PACKAGE = Path(ti.__file__).parent
EXAMPLES = Path(__file__).parents[3] / "examples"


def _run(command, folder):
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300)


@pytest.mark.skipif(importlib.util.find_spec("mypy") is None, reason="mypy is not installed")
def test_mypy(tmp_path):
    config = tmp_path / "mypy.ini"
    config.write_text(f"[mypy]\nstrict = True\nmypy_path = {PACKAGE.parent}\n")
    command = [sys.executable, "-m", "mypy", "--config-file", str(config), str(PROGRAM)]
    found = _run(command, tmp_path)
    # A kernel without a result has no annotation of it.
    problems = [line for line in found.stdout.splitlines() if ": error:" in line]
    assert [line for line in problems if "no-untyped-def" not in line] == []
    wrong = tmp_path / "wrong.py"
    wrong.write_text("import tai as ti\nti.field(ti.f32, 3).grda\nti.fieldd\n")
    found = _run([*command[:-1], str(wrong)], tmp_path)
    assert '"grda"' in found.stdout and '"fieldd"' in found.stdout


@pytest.mark.skipif(importlib.util.find_spec("mypy") is None, reason="mypy is not installed")
@pytest.mark.slow
def test_mypy_on_all_examples(tmp_path):
    programs = tmp_path / "examples"
    shutil.copytree(EXAMPLES, programs, ignore=shutil.ignore_patterns("__pycache__", "dialect"))
    config = tmp_path / "mypy.ini"
    config.write_text(
        f"[mypy]\nmypy_path = {PACKAGE.parent}:{programs}\nignore_missing_imports = True\n"
        "check_untyped_defs = True\n"
    )
    files = [str(path) for path in sorted(programs.glob("*.py"))]
    found = _run([sys.executable, "-m", "mypy", "--config-file", str(config), *files], programs)
    problems = [
        line for line in found.stdout.splitlines()
        if ": error:" in line and not line.startswith((str(PACKAGE), ".."))
    ]  # fmt: skip
    # Where torch is not installed, its names are none to mypy.
    assert [line for line in problems if "torch.autograd.Function" not in line] == []
    assert f"checked {len(files)} source files" in found.stdout, found.stdout


_needs_pyright = pytest.mark.skipif(
    shutil.which("pyright", path=str(Path(sys.executable).parent)) is None,
    reason="pyright is not installed: make peers",
)


def _strict_errors(folder, names, paths):
    """The errors of pyright in strict mode, in copies of programs."""
    config = {
        "include": names, "extraPaths": [str(path) for path in paths], "pythonVersion": "3.11",
        "typeCheckingMode": "strict",
    }  # fmt: skip
    (folder / "pyrightconfig.json").write_text(json.dumps(config))
    command = [str(Path(sys.executable).with_name("pyright")), "--outputjson",
               "--pythonpath", sys.executable]  # fmt: skip
    answer = json.loads(_run(command, folder).stdout)
    found = [d for d in answer["generalDiagnostics"] if d["severity"] == "error"]
    lines = [f"{d['file']}:{d['range']['start']['line'] + 1}: {d['message']}" for d in found]
    return answer["summary"]["filesAnalyzed"], lines


@_needs_pyright
def test_pyright_in_strict_mode(tmp_path):
    shutil.copy(PROGRAM, tmp_path / "program.py")
    count, errors = _strict_errors(tmp_path, ["program.py"], [PACKAGE.parent])
    assert count == 1 and not errors, "\n".join(errors)
    (tmp_path / "wrong.py").write_text("import tai as ti\nti.field(ti.f32, 3).grda\n")
    count, errors = _strict_errors(tmp_path, ["wrong.py"], [PACKAGE.parent])
    assert any('"grda"' in error for error in errors)


@_needs_pyright
@pytest.mark.slow
def test_pyright_in_strict_mode_on_all_examples(tmp_path):
    programs = tmp_path / "examples"
    shutil.copytree(EXAMPLES, programs, ignore=shutil.ignore_patterns("__pycache__", "dialect"))
    count, errors = _strict_errors(tmp_path, ["examples"], [PACKAGE.parent, programs])
    assert count >= len(list(EXAMPLES.glob("*.py"))) > 20
    assert not errors, "\n".join(errors)


@pytest.mark.skipif(importlib.util.find_spec("jedi") is None, reason="jedi is not installed")
@pytest.mark.parametrize(
    "name, wanted", [("v", "to_numpy"), ("v.grad", "fill"), ("tape", "stats"), ("gui", "circles"),
                     ("w", "normalized"), ("ti", "kernel"), ("ti.linalg", "cg")],
)  # fmt: skip
def test_completion(name, wanted):
    import jedi

    text = PROGRAM.read_text() + f"\n{name}."
    project = jedi.Project(PACKAGE.parent.parent, added_sys_path=[str(PACKAGE.parent)])
    script = jedi.Script(text, path="program.py", project=project)
    completions = script.complete(len(text.splitlines()), len(name) + 1)
    assert wanted in {completion.name for completion in completions}


def test_the_stub_has_the_names_of_the_package():
    tree = ast.parse((PACKAGE / "__init__.pyi").read_text())
    named = set()
    for node in tree.body:
        if isinstance(node, ast.ImportFrom):
            named |= {alias.asname or alias.name for alias in node.names}
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            named.add(node.target.id)
        elif isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            named.add(node.name)
    # Other tests import modules of the package, which are names of it from then on.
    modules = {file.stem for file in PACKAGE.glob("*.py")}
    public = {name for name in dir(ti) if not name.startswith("_")}
    assert public - named <= modules | {"annotations", "alias", "dtypes", "native", "Any"}
    missing = {name for name in named if not name.startswith("_")} - public
    assert missing <= {"Any", "Callable", "Iterator", "Generic", "ParamSpec", "TypeAlias",
                       "TypeVar", "overload", "npt"}  # fmt: skip
