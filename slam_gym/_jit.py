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
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])

_PACKAGE = Path(__file__).parent
_DIGESTS = "digests.json"  # size and checksum of every cached file, as the process that wrote it left it
_ROOM = 1 << 26  # bytes that must be free on the disk
_STALE_AFTER = 3 * 24 * 3600  # [s] folders of other versions are removed when untouched for so long
_PERIOD = 5.0  # [s] between two words on how far a compilation is
_config: Any = numba.config  # whose attributes are set as numba is imported
_announced = False


def compiled(function: F) -> F:
    """njit. IEEE arithmetic (no fastmath), so that results do not depend on optimisation."""
    return _compiled(function, inline=False)


def inlined(function: F) -> F:
    """The same for a small function that the innermost loops of others call: it is compiled into its callers.

    A call with a few arrays pushes some forty numbers onto the stack: left to itself, the step that conditions a
    candidate of the interpretation tree takes two to four times as long.
    """
    return _compiled(function, inline=True)


def _compiled(function: F, inline: bool) -> F:
    with _caching_into(_folder()) as cached:
        decorate = numba.njit(nogil=True, error_model="numpy", forceinline=inline, cache=cached)
        return cast(F, decorate(function))


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


@contextlib.contextmanager
def _caching_into(folder: Path | None) -> Iterator[bool]:
    """While a function is decorated, numba takes `folder` for the one that caches are in; whether there is one."""
    before, _config.CACHE_DIR = _config.CACHE_DIR, str(folder or _config.CACHE_DIR)
    try:
        yield folder is not None
    finally:
        _config.CACHE_DIR = before


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


def announce_compilation() -> bool:
    """Say once, on stderr, that loops are about to be compiled, and then how far that is; silent when they are cached.

    Returns whether it was said and what is compiled will be kept.
    """
    global _announced
    if _announced or _config.DISABLE_JIT:
        return False
    _announced = True
    folder = _folder()
    if folder is not None and _cached(folder):
        return False
    kept = "at every start: nothing can be kept in the cache folder" if folder is None else "once, then cached"
    print(f"slam_gym: compiling its inner loops, a minute or two ({kept}) …", file=sys.stderr, flush=True)
    if folder is not None:
        threading.Thread(target=_report_progress, args=(folder,), daemon=True).start()
        _forget_old_versions(folder)
    return folder is not None


def _report_progress(folder: Path) -> None:
    """Say how many loops are compiled, as long as there are more and more."""
    before = -1
    while (count := len(list(folder.rglob("*.nbi")))) > before:
        if before >= 0:
            print(f"slam_gym: {count} loops compiled …", file=sys.stderr, flush=True)
        before = count
        time.sleep(_PERIOD)


def _forget_old_versions(current: Path) -> None:
    for folder in cache_folder().glob("*"):
        with contextlib.suppress(OSError):  # another process was faster
            if folder != current and time.time() - folder.stat().st_mtime > _STALE_AFTER:
                shutil.rmtree(folder, ignore_errors=True)
