"""Programs that some tests run, and that a machine with a wheel alone may not have."""

import shutil

import pytest


def program(*names: str) -> str:
    """The path of the first of these programs that is here; without one, skips the test."""
    found = next(filter(None, map(shutil.which, names)), None)
    if not found:
        pytest.skip(f"needs {' or '.join(names)}")
    return found
