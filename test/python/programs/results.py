"""How a program hands its numbers to the test that ran it: JSON on the last line."""

from __future__ import annotations

import json
from typing import Any

import numpy as np


def report(**numbers: Any) -> None:
    """Prints the numbers, arrays as nested lists."""

    def plain(value: Any) -> Any:
        if isinstance(value, (np.ndarray, np.generic)):
            return value.tolist()
        if isinstance(value, (list, tuple)):
            return [plain(item) for item in value]
        return value

    print(json.dumps({name: plain(value) for name, value in numbers.items()}))
