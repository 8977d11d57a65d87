"""`ti.lang.util`."""

import importlib.util


def has_pytorch() -> bool:
    """Whether the package torch can be imported."""
    return importlib.util.find_spec("torch") is not None


def has_paddle() -> bool:
    """Paddle is not supported."""
    return False
