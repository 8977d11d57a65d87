"""The paper's experiments as one command: each once, and the messages about failures."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from PIL import Image

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "examples"))

from paper import page  # noqa: E402
from paper.experiments import EXPERIMENTS  # noqa: E402
from paper.lab import Lab, Result, last_line  # noqa: E402

REPORTS = ROOT / "docs" / "reports"
COMMAND = [sys.executable, "-m", "tai", "paper", "--once"]


def run_paper(out, *options, cwd=ROOT, **environment):
    words = [*COMMAND, "--out", out, *options]
    return subprocess.run(
        list(map(str, words)), capture_output=True, text=True, cwd=cwd,
        env=os.environ | environment,
    )  # fmt: skip


def results(out):
    files = (out / "results").glob("*.json")
    return {path.stem: json.loads(path.read_text())["result"] for path in files}


@pytest.mark.parametrize("name", [experiment.name for experiment in EXPERIMENTS])
def test_each_experiment_once(tmp_path, name):
    done = run_paper(tmp_path, "--only", name)
    (result,) = results(tmp_path).values()
    if name == "water_renderer" and result["status"] == "left out":
        assert "torch" in result["reason"] and "pip install torch" in result["reason"]
        return
    assert done.returncode == 0 and result["status"] == "ok", done.stdout + done.stderr
    text, hypertext = (tmp_path / "paper.md").read_text(), (tmp_path / "paper.html").read_text()
    kinds = [block[0] for block in result["blocks"]]
    assert "table" in kinds and text.count("\n## ") == 1
    pictures = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", text)
    assert len(pictures) == kinds.count("picture") == hypertext.count("<img src=")
    for picture in pictures:
        assert Image.open(tmp_path / picture).size[0] > 400


# A folder of examples whose programs a test writes.

FRAME = "def plot(*args, **options): pass\n"
TOI = """import sys, pathlib, time
here = pathlib.Path(__file__).parent
out = pathlib.Path(sys.argv[sys.argv.index("--out") + 1])
(here / "started").write_text(" ".join(sys.argv))
{action}
rows = ["lift,naive,naive by y,toi,toi by y"] + ["0,0.5,{naive},0.5,-1"] * 15
(out / "rigid_body_toi.heights.csv").write_text("\\n".join(rows))
"""


@pytest.fixture
def examples(tmp_path):
    folder = tmp_path / "examples"
    (folder / "studio").mkdir(parents=True)
    (folder / "studio/__init__.py").write_text(FRAME)
    (folder / "mass_spring_simple.py").write_text("raise SystemExit('toy: no springs today')")

    def program(action="", naive=1):
        (folder / "rigid_body_toi.py").write_text(TOI.format(action=action, naive=naive))
        return folder

    program()
    return program


def test_a_failed_experiment_does_not_stop_the_others(tmp_path, examples):
    done = run_paper(tmp_path / "out", "--examples", examples(), "--only", "lengths", "toi")
    assert done.returncode == 1, done.stderr
    found = results(tmp_path / "out")
    assert found["toi"]["status"] == "ok"
    assert found["lengths"]["status"] == "failed"
    assert found["lengths"]["reason"].endswith("toy: no springs today")
    assert "FAILED: mass_spring_simple: toy: no springs today" in done.stdout
    assert "FAILED" in (tmp_path / "out/paper.md").read_text()
    assert "1 failed" in done.stdout.splitlines()[-1]


def test_numbers_that_are_wrong_fail(tmp_path, examples):
    done = run_paper(tmp_path / "out", "--examples", examples(naive=-1), "--only", "toi")
    assert done.returncode == 1
    assert "FAILED: naive: a derivative is 2 away from +1" in done.stdout


@pytest.mark.parametrize(
    "action, reason",
    [
        ("import os, signal; os.kill(os.getpid(), signal.SIGKILL)", "ended by signal SIGKILL"),
        ("1 / 0", "ZeroDivisionError: division by zero"),
        ("sys.exit()", "FileNotFoundError"),
    ],
)
def test_programs_that_end(tmp_path, examples, action, reason):
    done = run_paper(tmp_path / "out", "--examples", examples(action), "--only", "toi")
    assert done.returncode == 1 and reason in done.stdout


def test_what_a_machine_lacks_is_left_out(tmp_path, examples):
    action = "sys.exit('toy: it needs torch, which is not installed: pip install torch')"
    done = run_paper(tmp_path / "out", "--examples", examples(action), "--only", "toi")
    assert done.returncode == 0
    assert "left out: toy: it needs torch, which is not installed: pip install torch" in done.stdout


def interrupted(tmp_path, examples, number):
    """Runs `lengths`, which fails, and `toi`, which is stopped as soon as its program waits."""
    action = 'sys.stdin.close(); import signal; (here / "waits").touch(); signal.pause()'
    folder, out = examples(action), tmp_path / "out"
    (folder / "mass_spring_simple.py").write_text(
        "import sys, pathlib\n"
        "out = pathlib.Path(sys.argv[sys.argv.index('--out') + 1])\n"
        "area, wall = '0.2' in sys.argv, '--wall' in sys.argv\n"
        "text = '0.650, 0.731, 0.676' if wall else '0.600, 0.600, 0.529'\n"
        "print(f\"rest lengths  [{'0.858, 0.858, 0.762' if area else text}]\")\n"
        "(out / 'mass_spring_simple.losses.csv').write_text('loss\\n1\\n')\n"
        "(out / 'mass_spring_simple.npz').touch()\n"
    )
    words = [*COMMAND, "--out", out, "--examples", folder, "--only", "lengths", "toi"]
    process = subprocess.Popen(list(map(str, words)), stderr=subprocess.PIPE, text=True, cwd=ROOT)
    end = time.monotonic() + 120
    while not (folder / "waits").exists():
        assert process.poll() is None and time.monotonic() < end
    process.send_signal(number)
    return process, process.communicate(timeout=120)[1], out, folder


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_run_goes_on(tmp_path, examples, number):
    process, errors, out, folder = interrupted(tmp_path, examples, number)
    assert process.returncode == 130 and "Traceback" not in errors
    line = errors.splitlines()[-1]
    assert line.startswith("paper: stopped in toi; 1 of 2 experiments are kept in ")
    # Finished experiments are not run again, and their places on the page stay.
    examples()
    (folder / "mass_spring_simple.py").write_text("1 / 0")
    done = run_paper(out, "--examples", folder, "--only", "lengths", "toi", "--resume")
    assert done.returncode == 0, done.stdout + done.stderr
    assert (out / "paper.md").read_text().count("\n## ") == 2
    # Without --resume all runs again, and so it does for other settings.
    done = run_paper(out, "--examples", folder, "--only", "lengths")
    assert done.returncode == 1 and "ZeroDivisionError" in done.stdout


def test_programs_are_resumed_too(tmp_path, examples):
    folder, out = examples(), tmp_path / "out"
    run = out / "runs/toi/run"
    run.mkdir(parents=True)
    (run / "rigid_body_toi.npz").touch()
    assert run_paper(out, "--examples", folder, "--only", "toi", "--resume").returncode == 0
    assert " --resume" in (folder / "started").read_text()
    assert run_paper(out, "--examples", folder, "--only", "toi").returncode == 0
    assert " --resume" not in (folder / "started").read_text()


def test_runs_with_other_settings_do_not_go_on(tmp_path, examples):
    folder, out = examples(), tmp_path / "out"
    assert run_paper(out, "--examples", folder, "--only", "toi").returncode == 0
    (out / "runs/toi/run/rigid_body_toi.npz").touch()
    assert (
        run_paper(
            out, "--examples", folder, "--only", "toi", "--resume", "--arch", "cuda"
        ).returncode
        == 0
    )
    assert "--arch cuda" in (folder / "started").read_text()
    assert " --resume" not in (folder / "started").read_text()


def test_a_new_start_forgets_its_experiments_and_no_others(tmp_path, examples):
    out = tmp_path / "out"
    assert run_paper(out, "--examples", examples(), "--only", "toi").returncode == 0
    (out / "runs/billiards").mkdir()
    assert "toi" in results(out)
    # Experiments that an interrupted run has not done must not be taken from the run before it.
    interrupted(tmp_path, examples, signal.SIGINT)
    assert list(results(out)) == ["lengths"]
    assert (out / "runs/billiards").is_dir()


def test_bad_input(tmp_path):
    def line(*options, **more):
        done = run_paper(*options, **more)
        assert done.returncode == 2 and done.stdout == "" and done.stderr.count("\n") == 1
        return done.stderr

    (tmp_path / "file").write_text("")
    assert f"--out {tmp_path}/file/below: cannot write there" in line(tmp_path / "file/below")
    assert "--page" in line(tmp_path, "--page", tmp_path / "file/below")
    text = line(tmp_path, "--examples", tmp_path)
    assert text.startswith(f"paper: {tmp_path} has no examples: name the folder 'examples'")
    assert "invalid choice: 'none'" in line(tmp_path, "--only", "none")


def test_a_page_elsewhere(tmp_path, examples):
    docs = tmp_path / "docs"
    (docs / "pictures").mkdir(parents=True)
    (docs / "pictures/paper_old.png").touch()
    (docs / "pictures/other.png").touch()
    options = ("--examples", examples(), "--only", "toi", "--page", docs)
    assert run_paper(tmp_path / "out", *options).returncode == 0
    assert (docs / "paper.md").read_text() == (tmp_path / "out/paper.md").read_text()
    assert [path.name for path in (docs / "pictures").iterdir()] == ["other.png"]


def test_the_page_of_a_gpu_lies_beside_that_of_the_cpu(tmp_path):
    """From a run that was copied here: the GPU it names is the one that computed."""
    out, docs = tmp_path / "out", tmp_path / "docs"
    (out / "results").mkdir(parents=True)
    (out / "pictures").mkdir()
    (docs / "pictures").mkdir(parents=True)
    for path in (out / "pictures/paper_toi_1.png", docs / "pictures/paper_toi_1.png"):
        path.write_text(path.parent.parent.name)
    blocks = [["picture", "pictures/paper_toi_1.png", "Bounces"]]
    result = {"name": "toi", "seconds": 1.0, "machine": "a host, a GPU", "blocks": blocks}
    kept = {"settings": {"level": "once", "arch": "cuda"}, "result": result}
    (out / "results/toi.json").write_text(json.dumps(kept))
    options = ("--only", "toi", "--page", docs, "--arch", "cuda", "--resume")
    done = run_paper(out, *options)
    assert done.returncode == 0, done.stdout + done.stderr
    text = (docs / "paper-cuda.md").read_text()
    assert "Machine: a host, a GPU; arch cuda." in text
    assert "![Bounces](pictures/paper-cuda_toi_1.png)" in text
    assert (docs / "pictures/paper-cuda_toi_1.png").read_text() == "out"
    assert (docs / "pictures/paper_toi_1.png").read_text() == "docs"
    assert not (docs / "paper.md").exists()


def test_pages(tmp_path):
    lab = Lab(ROOT / "examples", tmp_path, "once", "cpu", resume=False)
    result = lab.begin("some")
    lab.table(["a <b>", "c"], [[1.23456789, "`x`"], [2, ""]])
    lab.text("One & two.")
    lab.plot("two", {"runs": [[3, 2], [1, 0]], "one": [2, 1]}, "Two", x="iteration", y="loss")
    lab.near(1.0, 1.1, 1e-3, "a number")
    lab.near(1.0, 1.0, 0, "another")
    assert (result.status, result.reason) == ("failed", "a number is 1 and not 1.1")
    rows = [("some", "figure 1", "Some", result)]
    text = page.markdown(["Head."], rows)
    assert "| a <b> | c |\n|---|---|\n| 1.23457 | `x` |\n| 2 |  |" in text
    assert "**FAILED: a number is 1 and not 1.1**" in text
    assert "![Two](pictures/paper_some_1.png)" in text
    hypertext = page.hypertext(["Of [a](b.md), *c d* and **e**."], rows, tmp_path)
    assert "<p>Of a, <i>c d</i> and <b>e</b>.</p>" in hypertext
    assert "<th>a &lt;b&gt;</th>" in hypertext and "<code>x</code>" in hypertext
    assert "One &amp; two." in hypertext and "data:image/png;base64,iVBOR" in hypertext


def test_without_matplotlib(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    lab = Lab(ROOT / "examples", tmp_path, "once", "cpu", resume=False)
    result = lab.begin("some")
    lab.plot("two", {"one": [2, 1]}, "Two", x="iteration", y="loss")
    assert result.status == "ok"
    assert result.blocks == [["text", "(No picture: that takes `pip install matplotlib`.)"]]


def test_words():
    assert last_line("a\n b \n\n") == "b" and last_line("\n") == "it said nothing"
    assert page.verdict(Result("x", "failed", "a|b")) == "FAILED: a/b"


def test_a_package_without_a_checkout(tmp_path):
    """The command of an installed package finds the experiments beside the examples."""
    copy = tmp_path / "command.py"
    copy.write_text((ROOT / "python/tai/__main__.py").read_text().replace("from .", "from tai"))

    def run(*options, cwd):
        command = [sys.executable, copy, "paper", "--list", *options]
        return subprocess.run(
            list(map(str, command)), capture_output=True, text=True, cwd=cwd, timeout=200,
            env=os.environ | {"PYTHONPATH": str(ROOT / "python")},
        )  # fmt: skip

    assert run(cwd=ROOT).returncode == 0
    assert run("--examples", ROOT / "examples", cwd=tmp_path).returncode == 0
    assert run(f"--examples={ROOT}/examples", cwd=tmp_path).returncode == 0
    done = run(cwd=tmp_path)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.startswith(f"paper: {tmp_path}/examples has no folder 'paper': name the")


def test_the_list():
    done = subprocess.run([*COMMAND, "--list"], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0
    assert [line.split()[0] for line in done.stdout.splitlines()] == [e.name for e in EXPERIMENTS]


@pytest.mark.parametrize("name", ["paper.md", "paper-cuda.md"])
def test_the_pages_of_this_repository(name):
    text = (REPORTS / name).read_text()
    names = re.findall(r"^\| [^|]+ \| [^|]+ \| `(\w+)` \| ([a-z ]+)", text, re.M)
    assert [name for name, _ in names] == [e.name for e in EXPERIMENTS]
    assert {result.strip() for _, result in names} <= {"as expected", "left out"}
    pictures = re.findall(r"\]\((pictures/[^)]+)\)", text)
    assert len(pictures) > 10 and all((REPORTS / name).is_file() for name in pictures)
