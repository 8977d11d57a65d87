"""The version of the project, stated here alone: CMake and the wheels read this file."""

__version__ = "0.2.0.dev0"
