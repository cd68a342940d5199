"""`slam-gym doctor`: what is installed, compiled and cached, and where data are looked for."""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

import slam_gym
from slam_gym._jit import cache_folder
from slam_gym.recordings.catalogue import DATA, PUBLISHED

_MUCH = 500  # [MB] of compiled loops, more than one version of the package leaves


def report() -> Iterator[str]:
    """Its lines."""
    yield f"slam_gym {slam_gym.__version__} in {Path(slam_gym.__file__).parent}"
    yield f"Python {platform.python_version()} on {platform.platform()}, {os.cpu_count()} cores"
    yield f"threads of BLAS: OMP_NUM_THREADS={os.environ.get('OMP_NUM_THREADS', 'unset')} (1 is fastest here)"
    yield ""
    yield from _packages()
    yield ""
    yield from _cache()
    yield from _data()


def _packages() -> Iterator[str]:
    """Every package that the core or an extra asks for: the versions of those that are there, and for each extra of
    which some are missing a line that installs it. What several extras ask for stands at the smallest."""
    asked: dict[str, set[str]] = {}
    for requirement in requires("slam_gym") or []:
        condition = re.search(r"extra == ['\"](\w+)", requirement)
        asked.setdefault(condition[1] if condition else "", set()).add(re.split(r"[^\w.-]", requirement)[0])
    seen, missing = {"slam_gym"}, []
    for extra, names in sorted(asked.items(), key=lambda each: (each[0] != "", len(each[1]))):
        lacking = []
        for name in sorted(names - seen):
            try:
                yield f"  {name:26} {version(name)}"
            except PackageNotFoundError:
                lacking.append(name)
        seen |= names
        if lacking:
            missing.append(f"  pip install 'slam_gym[{extra}]'  ({', '.join(lacking)})")
    if missing:
        yield from ("", "not installed; only what you use is needed:", *missing)


def _cache() -> Iterator[str]:
    """Where compiled loops are kept, and how much of them."""
    folder = cache_folder()
    files = list(folder.rglob("*.nbc")) if folder.is_dir() else []
    size = sum(file.stat().st_size for file in files) / 1e6  # [MB]
    state = f"{len(files)} compiled functions, {size:.0f} MB" if files else "empty: the first step ever compiles"
    state += "; delete the folder to free it, it is made again" if size > _MUCH else ""
    writable = "" if os.access(folder if folder.is_dir() else folder.parent, os.W_OK) else ", not writable"
    yield f"compiled loops: {folder} ({state}{writable})"


def _data() -> Iterator[str]:
    """Where recordings are looked for, and which are there."""
    if DATA not in os.environ:
        yield f"recordings: {DATA} is not set; {', '.join(PUBLISHED)} need it or --data"
        return
    folder = Path(os.environ[DATA])
    found = [name for name in PUBLISHED if (folder / name).is_dir()]
    yield f"recordings: {DATA}={folder} ({', '.join(found) or 'none of ' + ', '.join(PUBLISHED)})"
