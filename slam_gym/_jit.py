"""`compiled`: numba's njit, cached in one folder for each version of the package's sources.

numba invalidates a cached function only when its own file changes. An edit of a function that it calls in another file
would leave the old machine code in use. Here the folder is named by a hash of all sources, so that any edit compiles
everything again, and installations of the same sources share it. The folders lie in the user's cache directory, or in
`NUMBA_CACHE_DIR` if that is set.
`NUMBA_DISABLE_JIT=1` runs all loops as plain Python.
"""

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
_DIGESTS = "digests.json"  # size and checksum of every cached file, as written by the process that created it
_MIN_FREE = 1 << 26  # bytes that must be free on the disk
_STALE_AFTER = 3 * 24 * 3600  # [s] folders of other versions are removed when untouched for this long
_POLL, _REPORT = 0.2, 4.0  # [s] between checks of what is compiled, and between progress lines
_QUIET, _RARE_POLL = 60.0, 1.0  # [s] without compilation, after which checks are rarer: they cost 3 % of a core
_config: Any = numba.config  # its attributes are set while numba is imported
_loops: list[Any] = []  # of the modules imported so far; a process does not need all of them


def _report_progress() -> None:
    """Report on stderr, for the lifetime of the process, which loop is being compiled and how many are ready, whenever
    a needed loop is not cached."""
    terminal, reported, compiled_at = sys.stderr.isatty(), 0.0, time.monotonic()
    frequency = "at every start, as nothing can be kept" if _folder() is None else "once"
    while True:
        time.sleep(_POLL if time.monotonic() - compiled_at < _QUIET else _RARE_POLL)
        busy = [loop for loop in _loops if _lookups(loop) > _signatures(loop)]
        compiled_at = time.monotonic() if busy else compiled_at
        if busy and (terminal or time.monotonic() - reported >= _REPORT):
            reported, ready, total = time.monotonic(), sum(map(bool, map(_signatures, _loops))), len(_loops)
            message, name = f"slam_gym compiles its inner loops, {frequency}", busy[-1].__name__.strip("_")
            bar = f"{'━' * (24 * ready // total):╌<24} {ready} of up to {total}, {name:<24}"
            print(f"{message}: {bar}", end="\r" if terminal else "\n", file=sys.stderr, flush=True)
        elif reported and terminal and not busy:
            print("\033[2K\r", end="", file=sys.stderr, flush=True)  # clear the progress line
            reported = 0.0


def _lookups(loop: Any) -> int:
    """Number of times a loop was looked up in the cache: once for each signature that was called."""
    return int(sum(loop.stats.cache_hits.values()) + sum(loop.stats.cache_misses.values()))


def _signatures(loop: Any) -> int:
    return len(loop.signatures)


def ready() -> int:
    """The number of loops compiled or read from the cache so far, once for each signature; 0 in plain Python."""
    return 0 if _config.DISABLE_JIT else sum(map(_signatures, _loops))


@functools.cache
def _copied(source: str, folder: Path) -> str:
    """A copy of a source file, named by its content. numba keeps what it compiles beside it, and so all installations
    share it, and the folder may be moved."""
    content = Path(source).read_bytes()
    copy = folder / hashlib.sha256(content).hexdigest()[:20] / Path(source).name
    if not copy.exists():
        copy.parent.mkdir(exist_ok=True)
        temporary = copy.with_suffix(f".{os.getpid()}")
        temporary.write_bytes(content)
        os.replace(temporary, copy)
    return str(copy)


def compiled(function: F, inline: bool = False, cached: bool = True) -> F:
    """numba.njit with IEEE arithmetic (no fastmath), so that results do not depend on optimisation."""
    folder, previous = _folder() if cached and not _config.DISABLE_JIT else None, _config.CACHE_DIR
    if folder is not None:
        code = function.__code__
        function.__code__ = code.replace(co_filename=_copied(code.co_filename, folder))
    _config.CACHE_DIR = ""  # else numba keeps there what is decorated now
    try:
        loop: Any = numba.njit(nogil=True, error_model="numpy", forceinline=inline, cache=folder is not None)(function)
    finally:
        _config.CACHE_DIR = previous
    if not _loops and not _config.DISABLE_JIT:
        threading.Thread(target=_report_progress, daemon=True).start()
    _loops.append(loop)
    return cast(F, loop)


def inlined(function: F) -> F:
    """`compiled` for a small function of innermost loops, which is inlined into its callers. A call with a few arrays
    pushes some forty numbers onto the stack: without inlining, conditioning a candidate of a tree takes two to four
    times as long.
    """
    return compiled(function, inline=True)


def compiled_generator(function: F) -> F:
    """`compiled` for a generator, which is never cached: numba fails to compile callers of a cached one."""
    return compiled(function, cached=False)


def cache_folder() -> Path:
    """The folder that holds the compiled loops of all versions."""
    if os.environ.get("NUMBA_CACHE_DIR"):
        return Path(os.environ["NUMBA_CACHE_DIR"]) / "slam_gym"
    if os.name == "nt":
        return Path(os.environ.get("LOCALAPPDATA", str(Path.home()))) / "slam_gym" / "numba"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "slam_gym" / "numba"


@functools.cache
def _folder() -> Path | None:
    """The cache folder of this version, created and checked; None where nothing can be cached."""
    digest = hashlib.sha256(numba.__version__.encode())  # another one would discard what this one has compiled
    for source in sorted(_PACKAGE.rglob("*.py")):
        if not source.is_relative_to(_PACKAGE / "shipped"):  # a wheel's agents, which the package does not call
            digest.update(source.read_bytes())
    folder = cache_folder().absolute() / digest.hexdigest()[:20]  # the process may change its directory
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        if not os.access(folder, os.W_OK) or shutil.disk_usage(folder).free < _MIN_FREE:
            raise OSError
        _remove_damaged(folder)
    except OSError:
        return None
    atexit.register(_record_digests, folder)
    return folder


def _cached_files(folder: Path) -> list[Path]:
    return [file for file in folder.rglob("*.nb?") if file.suffix in (".nbi", ".nbc")]


def _remove_damaged(folder: Path) -> None:
    """Remove cached files that differ from what was written: numba would fail with a traceback at every start."""
    digests, recorded = _digests(folder)
    damaged = 0
    for file in _cached_files(folder):
        data, name = file.read_bytes(), file.relative_to(folder).as_posix()
        if digests.get(name) == [len(data), zlib.crc32(data)]:
            continue
        # a process that was killed has recorded no digests of the files that it wrote
        if (name not in digests or file.stat().st_mtime > recorded) and _is_whole(data):
            continue
        file.unlink(missing_ok=True)
        damaged += 1
    if damaged:
        print(f"slam_gym: {damaged} damaged files of compiled loops removed from {folder}", file=sys.stderr, flush=True)


def _digests(folder: Path) -> tuple[dict[str, Any], float]:
    """Size and checksum of each file, and the time of their recording; empty where they cannot be read."""
    try:
        digests = json.loads((folder / _DIGESTS).read_bytes())
        return digests if isinstance(digests, dict) else {}, (folder / _DIGESTS).stat().st_mtime
    except (OSError, ValueError):
        return {}, 0.0


def _is_whole(data: bytes) -> bool:
    """Whether these bytes are complete pickles."""
    stream = io.BytesIO(data)
    try:
        while stream.tell() < len(data):
            for _ in pickletools.genops(stream):
                pass
    except Exception:  # damaged bytes raise various errors
        return False
    return len(data) > 0


def _record_digests(folder: Path) -> None:
    """Record the digests of all cached files as the process ends."""
    with contextlib.suppress(OSError):
        _, recorded = _digests(folder)
        if all(file.stat().st_mtime <= recorded for file in _cached_files(folder)):
            return
        contents = {file.relative_to(folder).as_posix(): file.read_bytes() for file in _cached_files(folder)}
        digests = {name: (len(data), zlib.crc32(data)) for name, data in contents.items()}
        temporary = folder / f"{_DIGESTS}.{os.getpid()}"
        temporary.write_text(json.dumps(digests), encoding="utf-8")
        os.replace(temporary, folder / _DIGESTS)
    _remove_old_versions(folder)


def _remove_old_versions(current: Path) -> None:
    for folder in cache_folder().glob("*"):
        with contextlib.suppress(OSError):  # another process was faster
            if folder != current and time.time() - folder.stat().st_mtime > _STALE_AFTER:
                shutil.rmtree(folder, ignore_errors=True)
