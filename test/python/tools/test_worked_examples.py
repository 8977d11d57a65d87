"""What docs/developing.md says one more of each takes, as changes that apply to the tree."""

import re
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


def test_the_row_of_an_option_is_one_that_scripts_read():
    """The rows of Python and of the page follow from it."""
    parts = EXAMPLES["An option of a context"][1].split("+++ b/")
    change = next(part for part in parts if part.startswith("include/tai/Support/Options.def"))
    added = "\n".join(line[1:] for line in change.splitlines() if line.startswith("+"))
    assert [row.name for row in options.rows(added)] == ["contract"]
