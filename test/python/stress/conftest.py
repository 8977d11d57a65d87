"""A fixture that the stress cases share: measured figures, with their bounds."""

import math

import pytest


@pytest.fixture
def measure(record_property):
    """Asserts that a figure is at most its bound, and keeps both for `make stress`."""

    def check(what: str, value: float, bound: float) -> None:
        record_property("measured", (what, float(value), float(bound)))
        assert not math.isnan(value) and value <= bound, f"{what}: {value:.3g}, at most {bound:.3g}"

    return check


@pytest.fixture
def long(request) -> bool:
    """Whether the sizes are those of the table, or small ones."""
    return request.config.getoption("--long")
