"""The optional libraries behind windows and scenes: GLFW, and OpenGL by ModernGL."""

from __future__ import annotations

import atexit
import os
import sys
from typing import Any

from ...errors import TaiRuntimeError

INSTALL = 'pip install "tai[view]"'
# The Linux package of the software renderer for OpenGL, for machines without a driver.
_MESA = "apt install libegl1 libgl1 libgl1-mesa-dri"
_messages: list[str] = []
_started: list[Any] = []
# All open windows, which are closed before GLFW stops.
windows: set[Any] = set()
# OpenGL 3.3 is the newest version that all drivers of the last ten years have.
_VERSION = 330


class NoWindow(Exception):
    """The reason why a window cannot be opened, in a few words."""


def has_display() -> bool:
    """Whether the process has a display; on macOS and Windows there always is one."""
    if not sys.platform.startswith("linux"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def start_glfw() -> Any:
    """Returns the module of GLFW, initialised.

    Raises:
        NoWindow: there is no display, or no library.
    """
    if not has_display():
        raise NoWindow("there is no display")
    try:
        import glfw
        import moderngl  # noqa: F401
    except ImportError as error:
        raise NoWindow(f"{error.name or error} is missing ({INSTALL})") from None
    glfw.set_error_callback(_note)
    if not glfw.init():
        raise NoWindow(last_message())
    if not _started:
        _started.append(glfw)
        atexit.register(stop)
    return glfw


def stop() -> None:
    """Closes all windows; the next window may be on another display."""
    for window in list(windows):
        window.close()
    while _started:
        _started.pop().terminate()


def _note(_: int, text: Any) -> None:
    _messages[:] = [text.decode(errors="replace") if isinstance(text, bytes) else text]


def last_message() -> str:
    """Returns the last error message of GLFW, in one line."""
    return _messages[0].splitlines()[0] if _messages else "GLFW gives no reason"


class _Functions:
    """Finds the functions of OpenGL for a window of X11 or Wayland."""

    def __init__(self, glfw: Any, window: Any):
        self.glfw, self.window = glfw, window

    def load_opengl_function(self, name: str) -> int:
        return self.glfw.get_proc_address(name) or 0

    def __enter__(self) -> None:
        self.glfw.make_context_current(self.window)

    def __exit__(self, *error: Any) -> None:
        # A context of EGL cannot become the current one while one of GLX is.
        self.glfw.make_context_current(None)

    def release(self) -> None:
        pass


def context_of(glfw: Any, window: Any) -> Any:
    """Returns the ModernGL context of a window of GLFW."""
    import moderngl

    functions: Any = _Functions(glfw, window)
    with functions:
        return moderngl.create_context(require=_VERSION, context=functions)


def offscreen_context() -> Any:
    """Makes a ModernGL context without a window.

    Raises:
        TaiRuntimeError: a library is missing, or there is no driver.
    """
    try:
        import moderngl
    except ImportError:
        raise TaiRuntimeError("a 3-D scene needs the package moderngl", INSTALL) from None
    errors = []
    ways: tuple[dict[str, Any], ...] = ({"backend": "egl"}, {})
    for settings in ways if sys.platform.startswith("linux") else ways[1:]:
        try:
            return moderngl.create_context(standalone=True, require=_VERSION, **settings)
        except Exception as error:
            errors.append(str(error).splitlines()[0] if str(error) else type(error).__name__)
    raise TaiRuntimeError(
        f"a 3-D scene needs OpenGL 3.3, and there is no driver for it ({errors[0]})",
        f"without a GPU, Mesa draws on the CPU: {_MESA}",
    )
