"""The one way in which benchmarks take memory."""

from __future__ import annotations

import math
import os
from pathlib import Path


def resident() -> float:
    """[MB] of memory that this process holds; NaN where the system does not tell."""
    statm = Path("/proc/self/statm")
    if not statm.exists():
        return math.nan
    return int(statm.read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
