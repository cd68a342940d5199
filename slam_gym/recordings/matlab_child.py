"""The child process that reads a MATLAB file: `python matlab_child.py GIVEN ANSWER NAME …`; it imports nothing of ours.

Variables that are there and numeric go into the `.npz` file ANSWER; the last line on stderr says what went wrong.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from scipy.io import loadmat

_MEMORY = 1 << 30  # bytes above those that are in use once everything is imported


def taken_apart(name: str, value: Any) -> dict[str, np.ndarray]:
    """A variable as arrays of numbers: as it is, or for a cell array the shape, its cells' shapes, and all values."""
    if isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
        return {name: value}
    if not (isinstance(value, np.ndarray) and value.dtype == object):
        raise ValueError(f"variable {name!r} is neither numbers nor cells of numbers")
    cells = [np.asarray(cell) for cell in value.ravel()]
    if any(cell.ndim != 2 or cell.dtype.kind not in "fiub" for cell in cells):
        raise ValueError(f"variable {name!r}: not all cells are tables of numbers")
    return {
        f"{name} shape": np.array(value.shape),
        f"{name} shapes": np.array([cell.shape for cell in cells], np.int64).reshape(-1, 2),
        f"{name} values": np.concatenate([np.zeros(0), *(cell.ravel() for cell in cells)]),
    }


def _bound_memory() -> None:
    """On Linux; elsewhere the bound on time has to do."""
    if sys.platform != "linux":
        return
    import resource

    with open("/proc/self/statm", encoding="ascii") as file:
        wanted = int(file.read().split()[0]) * resource.getpagesize() + _MEMORY
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    resource.setrlimit(resource.RLIMIT_AS, (wanted if hard == resource.RLIM_INFINITY else min(wanted, hard), hard))


def main(given: str, answer: str, *names: str) -> int:
    _bound_memory()
    try:
        content = loadmat(given, variable_names=list(names))
        parts: dict[str, Any] = {}
        for name in names:
            if name in content:
                parts |= taken_apart(name, content[name])
        np.savez(answer, **parts)
    except BaseException as error:
        sys.stderr.write(f"{type(error).__name__}: {error}".replace("\n", " ") + "\n")
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:]))
