"""`compiled`: numba's njit with a cache that never goes stale.

numba keys a cached function by its own file only, so editing a function that it calls in another file would bring the
old result back. Here each module caches into a folder named by a hash of its source and of all modules of the package
that it imports, directly or not, and of what code is compiled by and for: numba, the interpreter, the processor. The
folders lie in the user's cache directory, or in `NUMBA_CACHE_DIR` if that is set.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import re
import shutil
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar, cast

import llvmlite.binding
import numba

from slam_gym._kernels import Kernel
from slam_gym._parts import PART, caching_into

F = TypeVar("F", bound=Callable[..., object])

_PACKAGE = Path(__file__).parent
_IMPORT = re.compile(r"^\s*(?:from (slam_gym[\w.]*) import ([^\n(]*|\([^)]*\))|import (slam_gym[\w.]*))", re.MULTILINE)
_TARGET = f"{numba.__version__} {sys.implementation.cache_tag} {llvmlite.binding.get_host_cpu_name()}"
_OPTIONS = {"nopython": True, "nogil": True, "error_model": "numpy"}
_STALE_AFTER = 3 * 24 * 3600  # [s] folders of other versions are removed when untouched for so long


@functools.cache
def _imported(path: Path) -> frozenset[Path]:
    """Files of the package that a file imports."""
    names: set[str] = set()
    for module, members, plain in _IMPORT.findall(path.read_text(encoding="utf-8")):
        names |= {module or plain} | {f"{module}.{name}" for name in re.findall(r"\w+", members)}
    files = (_PACKAGE.parent.joinpath(*name.split(".")).with_suffix(".py") for name in names)
    return frozenset(file for file in files if file.is_file())


def _closure(path: Path) -> set[Path]:
    """A file of the package and all that it depends on."""
    found, todo = {path}, [path]
    while todo:
        fresh = _imported(todo.pop()) - found
        found |= fresh
        todo.extend(fresh)
    return found


def cache_folder() -> Path:
    """Where compiled loops are kept, of all versions."""
    if os.environ.get("NUMBA_CACHE_DIR"):
        return Path(os.environ["NUMBA_CACHE_DIR"]) / "slam_gym"
    if os.name == "nt":
        return Path(os.environ.get("LOCALAPPDATA", str(Path.home()))) / "slam_gym" / "numba"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "slam_gym" / "numba"


@functools.cache
def _folder(path: Path) -> Path | None:
    """Cache folder of a module, made if need be; None where it cannot be written (then nothing is cached)."""
    digest = hashlib.sha256(_TARGET.encode())
    for source in sorted(_closure(path)):
        digest.update(source.read_bytes())
    folder = cache_folder() / digest.hexdigest()[:20]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None


_folders: set[Path | None] = set()
_announced = False


def announce_compilation(modules: Iterable[ModuleType]) -> bool:
    """Say once, on stderr, that the inner loops of these modules are about to be compiled; silent when all are cached.

    Returns whether it was said and what is compiled will be kept.
    """
    global _announced
    if _announced:
        return False
    _announced = True
    folders = [_folder(Path(str(module.__file__))) for module in modules]
    due = any(folder is None or not any(map(_is_kernel, folder.rglob("*.nbi"))) for folder in folders)
    if due:
        kept = "at every start: the cache folder is not writable" if None in folders else "once, then cached"
        long = "half a minute, a minute or two if the machine is busy"
        print(f"slam_gym: compiling its inner loops, {long} ({kept}) …", file=sys.stderr, flush=True)
    _forget_old_versions()
    return due and None not in folders


def _is_kernel(index: Path) -> bool:
    """Whether a file tells of machine code; others tell of parts of it."""
    return not index.name.startswith(PART)


def _forget_old_versions() -> None:
    for folder in cache_folder().glob("*"):
        try:
            if folder not in _folders and time.time() - folder.stat().st_mtime > _STALE_AFTER:
                shutil.rmtree(folder, ignore_errors=True)
        except OSError:  # another process was faster
            continue


def compiled(function: F) -> F:
    """njit into the cache described above. IEEE arithmetic (no fastmath), so results do not depend on optimisation."""
    return _compiled(function, inline=False)


def inlined(function: F) -> F:
    """The same for a small function that the innermost loops of others call: it is compiled into its callers.

    A call with a few arrays pushes some forty numbers onto the stack: left to itself, the step that conditions a
    candidate of the interpretation tree takes two to four times as long.
    """
    return _compiled(function, inline=True)


def apart(function: F) -> F:
    """`inlined`, for a function that writes to no array that overlaps another one: its loops need not look whether one
    does, which makes short ones twice as fast."""
    return _compiled(function, inline=True, apart=True)


def _compiled(function: F, inline: bool, apart: bool = False) -> F:
    config: Any = numba.config
    if config.DISABLE_JIT:
        return function
    folder = _folder(Path(function.__code__.co_filename))
    _folders.add(folder)
    with contextlib.nullcontext() if folder is None else caching_into(folder):
        kernel = Kernel(function, {}, _OPTIONS | {"forceinline": inline}, apart)
        if folder is not None:
            kernel.cache_in(folder)
        return cast(F, kernel)
