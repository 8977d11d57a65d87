"""What the tests share."""

import pytest
import tai as ti


@pytest.fixture(autouse=True)
def fresh_program():
    """Each test starts with no fields and the default options."""
    ti.init(arch=ti.cpu, offline_cache=False)
    yield
    ti.reset()
