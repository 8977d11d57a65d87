"""The commands `tai-opt`, `tai-run` and others of an installed package.

Each starts the program of its name in the folder `bin` of the package. A checkout has them in
`build/bin`.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import NoReturn

FOLDER = Path(__file__).parent / "bin"


def run() -> NoReturn:
    """Replaces this process by the program whose name it was started with."""
    program = FOLDER / Path(sys.argv[0]).name
    if not program.exists():
        sys.exit(f"{program.name}: there is no {program}; in a checkout it is in build/bin")
    os.execv(program, [str(program), *sys.argv[1:]])
