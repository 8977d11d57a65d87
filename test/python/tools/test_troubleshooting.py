"""The programs of the page on troubleshooting give the messages under which they stand."""

import re
import runpy
import warnings
from pathlib import Path

import pytest
import tai as ti

PAGE = Path(__file__).resolve().parents[3] / "docs" / "guides" / "troubleshooting.md"
ENTRIES = re.findall(r"^### ([^\n]*)\n\n```python\n(.*?)```", PAGE.read_text(), re.M | re.S)


@pytest.mark.parametrize(("message", "program"), ENTRIES, ids=[m for m, _ in ENTRIES])
def test_message(message, program, tmp_path, monkeypatch):
    monkeypatch.delenv("TI_ARCH", raising=False)
    monkeypatch.setenv("TAI_CUDA_DRIVER", "no-such-library")
    file = tmp_path / "program.py"
    file.write_text(f"import tai as ti\n\nti.init()\n{program}")
    error = None
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        try:
            runpy.run_path(str(file))
        except (ti.TaiError, AttributeError) as raised:
            error = str(raised)
    shown = "\n".join([error or "", *(str(warning.message) for warning in found)])
    assert re.search(re.escape(message).replace("…", ".*"), shown), shown
    # The page calls a message that is no error a warning.
    text = PAGE.read_text().split(f"### {message}\n", 1)[1].split("```\n", 1)[1]
    assert text.strip().startswith("This is a warning.") == (error is None)


def test_there_are_entries():
    assert len(ENTRIES) >= 20
