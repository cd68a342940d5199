"""`slam-gym COMMAND …`, or `python -m slam_gym COMMAND …`: all commands of the package, wherever it is installed.

The commands are modules of `agents/`, which is at the top of a checkout. A wheel contains it inside the package. Only
this process puts that folder on its path, so that no other package named `agents` is shadowed elsewhere.
"""

import importlib
import os
import platform
import re
import sys
from collections.abc import Iterable, Iterator
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Literal

import typer

import slam_gym

_INSTALLED = Path(__file__).parent / "shipped"  # folder that contains `agents` in a wheel
_CHECKOUT = Path(__file__).parents[1]  # … and in a checkout
_MUCH = 500  # [MB] of compiled loops: more than one version of the package creates

COMMANDS = (
    "demo", "slam", "evaluate", "evaluate-association", "train", "record-decisions", "leaderboard", "reproduce",
    "report", "play",
)  # fmt: skip
"""The commands of `agents`. Each is in the `app` of the module of that name."""

Topic = Literal["scenarios", "associators", "relocators", "drivers", "recordings"]
"""Topics of `slam-gym list`."""


def _find_agents() -> None:
    """Put the folder that contains `agents` first on the path of this process and of its child processes, and the
    current folder last, as with `python -m`: "mymodule:MyDriver" is found there."""
    folder = str(_INSTALLED if (_INSTALLED / "agents").is_dir() else _CHECKOUT)
    if sys.path[0] != folder:  # behind the current folder, a package `agents` there would come first
        sys.path.insert(0, folder)
        previous = os.environ.get("PYTHONPATH")
        os.environ["PYTHONPATH"] = os.pathsep.join([folder, *([previous] if previous else [])])
    if "" not in sys.path:
        sys.path.append("")


app = typer.Typer(pretty_exceptions_enable=False)


@app.callback(invoke_without_command=True, no_args_is_help=True)
def about(version: bool = typer.Option(False, "--version", "-V", help="Show the version and exit.")) -> None:
    """Data association in SLAM: evaluate, train, play. slam-gym COMMAND --help lists its options."""
    if version:
        print(f"slam_gym {slam_gym.__version__}")
        raise typer.Exit()


_find_agents()
for _name in COMMANDS:
    app.add_typer(importlib.import_module(f"agents.{_name.replace('-', '_')}").app)


@app.command("list", epilog="Example: slam-gym list scenarios")
def list_names(topic: Topic) -> None:
    """List the names that other commands take."""
    from slam_gym.association import ASSOCIATORS, RELOCATORS
    from slam_gym.recordings import PUBLISHED
    from slam_gym.scenarios import SCENARIOS

    drivers = importlib.import_module("agents.drivers.base").AGENTS
    names: dict[Topic, Iterable[str]] = {
        "associators": ASSOCIATORS,
        "relocators": RELOCATORS,
        "scenarios": SCENARIOS,
        "recordings": PUBLISHED,
        "drivers": [f"{name}  (with --model FILE)" if name == "ppo" else name for name in drivers],
    }
    print("\n".join(names[topic]))


@app.command(epilog="Example: slam-gym doctor")
def doctor() -> None:
    """Report what is installed, compiled and cached, and where data are searched."""
    print("\n".join(report()))


def report() -> Iterator[str]:
    """Yields the lines of `slam-gym doctor`."""
    yield f"slam_gym {slam_gym.__version__} in {Path(slam_gym.__file__).parent}"
    yield f"Python {platform.python_version()} on {platform.platform()}, {os.cpu_count()} cores"
    yield f"threads of BLAS: OMP_NUM_THREADS={os.environ.get('OMP_NUM_THREADS', 'unset')} (1 is fastest here)"
    yield ""
    yield from _packages()
    yield ""
    yield _cache()
    yield _data()


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


def _cache() -> str:
    """Where compiled loops are cached, and their size."""
    from slam_gym._jit import cache_folder  # which imports numba

    folder = cache_folder()
    files = list(folder.rglob("*.nbc")) if folder.is_dir() else []
    size = sum(file.stat().st_size for file in files) / 1e6  # [MB]
    state = f"{len(files)} compiled functions, {size:.0f} MB" if files else "empty: the first step ever compiles"
    state += "; delete the folder to free it, it is made again" if size > _MUCH else ""
    existing = next(path for path in (folder, *folder.parents) if path.is_dir())
    writable = "" if os.access(existing, os.W_OK) else ", not writable"
    return f"compiled loops: {folder} ({state}{writable})"


def _data() -> str:
    """Where recordings are searched, and which were found."""
    from slam_gym.recordings import DATA, PUBLISHED

    if DATA not in os.environ:
        return f"recordings: {DATA} is not set; {', '.join(PUBLISHED)} need it or --data"
    folder = Path(os.environ[DATA])
    found = [name for name in PUBLISHED if (folder / name).is_dir()]
    return f"recordings: {DATA}={folder} ({', '.join(found) or 'none of ' + ', '.join(PUBLISHED)})"


if __name__ == "__main__":
    app()
