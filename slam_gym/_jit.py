"""`compiled`: numba's njit, cached in one folder for each version of the package's sources.

numba keys a cached function by its own file only, so editing a function that it calls in another file would bring the
old machine code back. Here the folder is named by a hash of all sources: an edit anywhere compiles everything again.
The folders lie in the user's cache directory, or in `NUMBA_CACHE_DIR` if that is set. `NUMBA_DISABLE_JIT=1` runs all
loops as plain Python.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import hashlib
import io
import json
import os
import pickletools
import shutil
import sys
import threading
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])

_PACKAGE = Path(__file__).parent
_DIGESTS = "digests.json"  # size and checksum of every cached file, as the process that wrote it left it
_ROOM = 1 << 26  # bytes that must be free on the disk
_STALE_AFTER = 3 * 24 * 3600  # [s] folders of other versions are removed when untouched for so long
_PERIOD, _WORD = 0.2, 4.0  # [s] between looks at what is compiled, and between lines about it
_config: Any = numba.config  # whose attributes are set as numba is imported


_loops: list[Any] = []  # of the modules imported so far, not all of which are needed


def _tell() -> None:
    """As long as the process lives, say on stderr what is compiled, and how far that is, whenever a loop that is needed
    is not cached."""
    terminal, last = sys.stderr.isatty(), 0.0
    kept = "at every start, as nothing can be kept" if _folder() is None else "once"
    while True:
        time.sleep(_PERIOD)
        busy = [loop for loop in _loops if _asked(loop) > _ready(loop)]
        if busy and (terminal or time.monotonic() - last >= _WORD):
            last, ready, known = time.monotonic(), sum(map(bool, map(_ready, _loops))), len(_loops)
            told, name = f"slam_gym compiles its inner loops, {kept}", busy[-1].__name__.strip("_")
            bar = f"{'━' * (24 * ready // known):╌<24} {ready} of up to {known}, {name:<24}"
            print(f"{told}: {bar}", end="\r" if terminal else "\n", file=sys.stderr, flush=True)
        elif last and terminal and not busy:
            print("\033[2K\r", end="", file=sys.stderr, flush=True)  # what comes next begins an empty line
            last = 0.0


def _asked(loop: Any) -> int:
    """How often a loop was looked for in the cache, once for each signature that was called."""
    return int(sum(loop.stats.cache_hits.values()) + sum(loop.stats.cache_misses.values()))


def _ready(loop: Any) -> int:
    return len(loop.signatures)


def compiled(function: F) -> F:
    """njit. IEEE arithmetic (no fastmath), so that results do not depend on optimisation."""
    return _compiled(function, inline=False)


def inlined(function: F) -> F:
    """The same for a small function of innermost loops, compiled into its callers: a call with a few arrays pushes some
    forty numbers onto the stack, and the step that conditions a candidate of a tree takes two to four times as long.
    """
    return _compiled(function, inline=True)


def _compiled(function: F, inline: bool) -> F:
    folder, before = _folder(), _config.CACHE_DIR
    _config.CACHE_DIR = str(folder or before)  # where numba keeps what is decorated meanwhile
    try:
        loop: Any = numba.njit(nogil=True, error_model="numpy", forceinline=inline, cache=folder is not None)(function)
    finally:
        _config.CACHE_DIR = before
    if not _loops and not _config.DISABLE_JIT:
        threading.Thread(target=_tell, daemon=True).start()
    _loops.append(loop)
    return cast(F, loop)


def cache_folder() -> Path:
    """Where compiled loops are kept, of all versions."""
    if os.environ.get("NUMBA_CACHE_DIR"):
        return Path(os.environ["NUMBA_CACHE_DIR"]) / "slam_gym"
    if os.name == "nt":
        return Path(os.environ.get("LOCALAPPDATA", str(Path.home()))) / "slam_gym" / "numba"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "slam_gym" / "numba"


@functools.cache
def _folder() -> Path | None:
    """Cache folder of this version, made if need be and checked; None where nothing can be kept."""
    digest = hashlib.sha256()
    for source in sorted(_PACKAGE.rglob("*.py")):
        digest.update(source.read_bytes())
    folder = cache_folder() / digest.hexdigest()[:20]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        if not os.access(folder, os.W_OK) or shutil.disk_usage(folder).free < _ROOM:
            raise OSError
        _remove_damaged(folder)
    except OSError:
        return None
    atexit.register(_record, folder)
    return folder


def _cached(folder: Path) -> list[Path]:
    return [file for file in folder.rglob("*.nb?") if file.suffix in (".nbi", ".nbc")]


def _remove_damaged(folder: Path) -> None:
    """Remove cached files that are not as they were written: numba would end in a traceback at every start."""
    known, noted = _digests(folder)
    damaged = 0
    for file in _cached(folder):
        data, name = file.read_bytes(), file.relative_to(folder).as_posix()
        if known.get(name) == [len(data), zlib.crc32(data)]:
            continue
        # a process that did not come to its end has noted nothing of what it wrote
        if (name not in known or file.stat().st_mtime > noted) and _is_whole(data):
            continue
        file.unlink(missing_ok=True)
        damaged += 1
    if damaged:
        print(f"slam_gym: {damaged} damaged files of compiled loops removed from {folder}", file=sys.stderr, flush=True)


def _digests(folder: Path) -> tuple[dict[str, Any], float]:
    """Size and checksum of each file, and when they were noted; nothing, where that cannot be read."""
    try:
        found = json.loads((folder / _DIGESTS).read_bytes())
        return found if isinstance(found, dict) else {}, (folder / _DIGESTS).stat().st_mtime
    except (OSError, ValueError):
        return {}, 0.0


def _is_whole(data: bytes) -> bool:
    """Whether these bytes are pickles that come to their end."""
    stream = io.BytesIO(data)
    try:
        while stream.tell() < len(data):
            for _ in pickletools.genops(stream):
                pass
    except Exception:  # whatever damaged bytes lead to
        return False
    return len(data) > 0


def _record(folder: Path) -> None:
    """Note what was written, as the process ends."""
    with contextlib.suppress(OSError):
        _, noted = _digests(folder)
        if all(file.stat().st_mtime <= noted for file in _cached(folder)):
            return
        found = {file.relative_to(folder).as_posix(): file.read_bytes() for file in _cached(folder)}
        digests = {name: (len(data), zlib.crc32(data)) for name, data in found.items()}
        fresh = folder / f"{_DIGESTS}.{os.getpid()}"
        fresh.write_text(json.dumps(digests), encoding="utf-8")
        os.replace(fresh, folder / _DIGESTS)
    _forget_old_versions(folder)


def _forget_old_versions(current: Path) -> None:
    for folder in cache_folder().glob("*"):
        with contextlib.suppress(OSError):  # another process was faster
            if folder != current and time.time() - folder.stat().st_mtime > _STALE_AFTER:
                shutil.rmtree(folder, ignore_errors=True)
