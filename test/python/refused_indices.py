"""The error of a launch with an index out of range."""

import pytest
import tai as ti


def refused(call, *args, index, line=""):
    """The launch fails with this index, at a line of the kernel that holds `line`."""
    with pytest.raises(ti.TaiAssertionError, match="out of range") as caught:
        call(*args)
        ti.sync()
    assert f"index [{index}]" in str(caught.value), str(caught.value)
    assert line in str(caught.value), str(caught.value)
