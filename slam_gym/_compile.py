"""`compiled`: numba's njit with a cache that never goes stale.

numba keys a cached function by its own file only, so editing a function that it calls in another file would bring
the old result back. Here the cache folder is named by a hash of all compiled sources of the package. The folder lies in
the user's cache directory, or in `NUMBA_CACHE_DIR` where that is set.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])

_PACKAGE = Path(__file__).parent
_STALE_AFTER = 14 * 24 * 3600  # [s] caches of other versions are removed when untouched for so long


def _source_hash() -> str:
    digest = hashlib.sha256()
    for path in sorted(_PACKAGE.rglob("*.py")):
        text = path.read_bytes()
        if b"compiled" in text:
            digest.update(path.relative_to(_PACKAGE).as_posix().encode() + text)
    return digest.hexdigest()[:16]


def _cache_root() -> Path:
    if os.environ.get("NUMBA_CACHE_DIR"):
        return Path(os.environ["NUMBA_CACHE_DIR"]) / "slam_gym"
    if os.name == "nt":
        return Path(os.environ.get("LOCALAPPDATA", str(Path.home()))) / "slam_gym" / "numba"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "slam_gym" / "numba"


def _open_cache() -> Path | None:
    """The folder of this version's cache, made if need be; None where it cannot be written (then nothing is cached)."""
    root = _cache_root()
    folder = root / _source_hash()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK):
            return None
        os.utime(folder)
        for other in root.iterdir():
            if other != folder and time.time() - other.stat().st_mtime > _STALE_AFTER:
                shutil.rmtree(other, ignore_errors=True)
    except OSError:
        return None
    return folder


CACHE = _open_cache()
_announced = CACHE is not None and any(CACHE.iterdir())


def announce_compilation() -> None:
    """Say once, on stderr, that the inner loops are about to be compiled; silent when they come from the cache."""
    global _announced
    if not _announced:
        _announced = True
        kept = "once; later runs start from the cache" if CACHE else "at every start: the cache folder is not writable"
        print(f"slam_gym: compiling its inner loops, up to half a minute ({kept}) …", file=sys.stderr, flush=True)


def compiled(function: F) -> F:
    """njit(cache=True) into the folder above. IEEE arithmetic (no fastmath): results do not depend on optimisation."""
    config: Any = numba.config
    before = config.CACHE_DIR
    config.CACHE_DIR = str(CACHE) if CACHE else before
    try:
        return cast(F, numba.njit(cache=CACHE is not None, nogil=True, error_model="numpy")(function))
    finally:
        config.CACHE_DIR = before
