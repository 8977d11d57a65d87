"""Programs and folders that tests need; a machine with a wheel alone may lack or move them."""

import shutil
from pathlib import Path

import pytest
import tai

# The folder of the package: the checkout's, or that of an installed wheel that is tested.
PACKAGE = Path(tai.__file__).resolve().parents[1]


def program(*names: str) -> str:
    """The path of the first of these programs that is here; without one, skips the test."""
    found = next(filter(None, map(shutil.which, names)), None)
    if not found:
        pytest.skip(f"needs {' or '.join(names)}")
    return found
