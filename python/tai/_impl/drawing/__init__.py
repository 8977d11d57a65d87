"""Windows, their widgets, and pictures drawn by OpenGL, for `tai.gui`, `tai.ui` and `tai.view`."""
