"""`slam-gym doctor`: report what is installed, compiled and cached, and where data are searched."""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

import slam_gym
from slam_gym._jit import cache_folder
from slam_gym.recordings import DATA, PUBLISHED

_MUCH = 500  # [MB] of compiled loops: more than one version of the package creates


def report() -> Iterator[str]:
    """Yields the lines of the report."""
    yield f"slam_gym {slam_gym.__version__} in {Path(slam_gym.__file__).parent}"
    yield f"Python {platform.python_version()} on {platform.platform()}, {os.cpu_count()} cores"
    yield f"threads of BLAS: OMP_NUM_THREADS={os.environ.get('OMP_NUM_THREADS', 'unset')} (1 is fastest here)"
    yield ""
    yield from _packages()
    yield ""
    yield from _cache()
    yield from _data()


def _packages() -> Iterator[str]:
    """Yields the versions of the installed packages that the core or an extra requires, and for each extra with missing
    packages a line that installs it. A package of several extras is listed under the smallest of them."""
    required: dict[str, set[str]] = {}
    for requirement in requires("slam_gym") or []:
        condition = re.search(r"extra == ['\"](\w+)", requirement)
        required.setdefault(condition[1] if condition else "", set()).add(re.split(r"[^\w.-]", requirement)[0])
    listed, missing = {"slam_gym"}, []
    for extra, names in sorted(required.items(), key=lambda each: (each[0] != "", len(each[1]))):
        absent = []
        for name in sorted(names - listed):
            try:
                yield f"  {name:26} {version(name)}"
            except PackageNotFoundError:
                absent.append(name)
        listed |= names
        if absent:
            missing.append(f"  pip install 'slam_gym[{extra}]'  ({', '.join(absent)})")
    if missing:
        yield from ("", "not installed; only what you use is needed:", *missing)


def _cache() -> Iterator[str]:
    """Yields where compiled loops are cached, and their size."""
    folder = cache_folder()
    files = list(folder.rglob("*.nbc")) if folder.is_dir() else []
    size = sum(file.stat().st_size for file in files) / 1e6  # [MB]
    state = f"{len(files)} compiled functions, {size:.0f} MB" if files else "empty: the first step ever compiles"
    state += "; delete the folder to free it, it is made again" if size > _MUCH else ""
    writable = "" if os.access(folder if folder.is_dir() else folder.parent, os.W_OK) else ", not writable"
    yield f"compiled loops: {folder} ({state}{writable})"


def _data() -> Iterator[str]:
    """Yields where recordings are searched, and which were found."""
    if DATA not in os.environ:
        yield f"recordings: {DATA} is not set; {', '.join(PUBLISHED)} need it or --data"
        return
    folder = Path(os.environ[DATA])
    found = [name for name in PUBLISHED if (folder / name).is_dir()]
    yield f"recordings: {DATA}={folder} ({', '.join(found) or 'none of ' + ', '.join(PUBLISHED)})"
