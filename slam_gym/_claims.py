"""Processes that fill a cache at the same time wait for each other's kernels instead of compiling them as well.

Where a process would wait, it does meanwhile what else there is to prepare.
"""

from __future__ import annotations

import contextlib
import functools
import zlib
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import IO

fcntl: ModuleType | None
try:
    import fcntl
except ImportError:  # Windows: each process compiles for itself
    fcntl = None

meanwhile: deque[Callable[[], object]] = deque()
"""What to do, last first, instead of waiting: each calls kernels that will be needed."""


@functools.cache
def _opened(file: Path) -> IO[bytes] | None:
    """A file of claims; never closed, since that would give up all that this process has claimed in it."""
    try:
        return file.open("ab")
    except OSError:
        return None


@contextlib.contextmanager
def claimed(folder: Path | None, name: str, busy: bool = False) -> Iterator[None]:
    """While no other process compiles the kernel of this name, where the system can lock bytes of a file.

    `folder` is the one that the kernel is kept in; `busy`: do not wait for it idly.
    """
    file = None if folder is None or fcntl is None else _opened(folder.parent / "claims")
    if file is None or fcntl is None or folder is None:
        yield
        return
    where = zlib.crc32(f"{folder.name} {name}".encode())
    while busy and meanwhile and not _free(file, where):
        meanwhile.pop()()
    with contextlib.suppress(OSError):
        fcntl.lockf(file, fcntl.LOCK_EX, 1, where)
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            fcntl.lockf(file, fcntl.LOCK_UN, 1, where)


def _free(file: IO[bytes], where: int) -> bool:
    """Whether nobody else has claimed that byte; it is claimed then."""
    assert fcntl is not None
    try:
        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, where)
    except OSError:
        return False
    return True
