"""Checks of gradients in tests: another name of `ti.ad.check`."""

from __future__ import annotations

from ._impl.ad.check import check
from ._impl.base.keywords import check_keywords

# The name of `check` in earlier releases, for tests that use it.
check_gradient = check

__all__ = ["check_gradient"]


check_keywords(globals())
