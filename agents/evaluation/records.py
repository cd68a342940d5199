"""Records of episodes, and the files with records and their provenance."""

import math
import os
import platform
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import slam_gym
from slam_gym._files import replacing

Record = dict[str, Any]
"""Numbers of one episode. Lists and dicts, such as curves over time, become JSON in a cell of the table."""

PACKAGES = ("numpy", "scipy", "numba", "gymnasium", "pymunk", "torch", "stable-baselines3", "sb3-contrib", "joblib")


def stem(*names: str) -> str:
    """A file name made of names that may be paths, levels of the suite, or `module:name`."""
    return ".".join(re.sub(r"[^\w\-]+", "-", name).strip("-") for name in names)


def results_folder(name: str, resume: bool) -> Path:
    """A new folder in results/ of the current directory or, to resume, the latest one of that name."""
    results, name = Path("results"), stem(name)
    if not resume:
        return results / f"{name}-{datetime.now():%Y%m%d-%H%M%S}-{os.getpid()}"
    folders = sorted(results.glob(f"{name}-[0-9]*"))
    if not folders:
        raise ValueError(f"there is no evaluation of {name} to resume in {results.resolve()}: give its --output")
    return folders[-1]


def write_whole(path: Path, text: str) -> None:
    """Write a text file completely or not at all. Raises OSError, naming the file."""
    with replacing(path) as file:
        file.write(text.encode())


@contextmanager
def undamaged(what: str | Path) -> Iterator[None]:
    """Convert the errors that reading a damaged file can raise to a ValueError that names the file."""
    try:
        yield
    except (ValueError, TypeError, LookupError, AttributeError, ArithmeticError, RecursionError) as error:
        raise ValueError(f"{what} is damaged ({type(error).__name__}: {error})") from error


def plain(value: Any) -> Any:
    """The value as it is after writing and reading JSON: NaN and ±∞ become None."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def command_line() -> str:
    """The running command as a user types it: `slam-gym train …`."""
    program = Path(sys.argv[0])
    command = [] if program.stem in ("slam-gym", "__main__") else [program.stem.replace("_", "-")]
    return shlex.join(["slam-gym", *command, *sys.argv[1:]])


def versions() -> dict[str, str]:
    """Versions of everything on which results depend, and the commit of a checkout."""
    known = {"slam_gym": slam_gym.__version__, "python": platform.python_version(), "machine": platform.platform()}
    for package in PACKAGES:
        with suppress(PackageNotFoundError):
            known[package] = version(package)
    if Path(__file__).parents[2].name == "shipped":  # in a wheel, which may lie within any repository
        return known | {"commit": "unknown"}
    try:
        git = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty", "--abbrev=12"]
        known["commit"] = subprocess.run(git, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        known["commit"] = "unknown"
    return known
