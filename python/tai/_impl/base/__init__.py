"""The lowest layer of the package: types, options, the program.

Each module of the package imports it first. An interpreter without an extension module is refused
here, before a line that an older Python cannot read, and before NumPy is looked for.
"""

from .native import check_built

check_built()
