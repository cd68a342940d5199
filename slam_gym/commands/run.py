"""`slam-gym COMMAND …`: every command of the package by one name, from wherever it is installed.

The commands are modules of `agents/`, which stands at the top of a checkout. A wheel brings it along inside the
package, in a folder that only this process puts on its path: nobody else's `agents` is taken from them.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable, Sequence
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import NamedTuple

import slam_gym

_INSTALLED = Path(__file__).parent / "shipped"  # where a wheel has the folder `agents`
_CHECKOUT = Path(__file__).parents[2]  # … and where a checkout has it


class Command(NamedTuple):
    """A command, by the module whose `main` it is."""

    module: str
    about: str


COMMANDS: dict[str, Command] = {
    "evaluate": Command("agents.evaluate", "drivers on the same test worlds: table, report, films"),
    "evaluate-association": Command("agents.evaluate_association", "associators in the loop, over the suite, on logs"),
    "train": Command("agents.train", "a driver by reinforcement learning"),
    "train-associate": Command("agents.train_associate", "an associator by reinforcement learning"),
    "leaderboard": Command("agents.leaderboard", "an entry through the frozen protocol, ranked among all"),
    "reproduce": Command("agents.reproduce", "train from nothing what ships"),
    "report": Command("agents.report", "the report of a finished evaluation, once more"),
    "gallery": Command("agents.gallery", "films of the same worlds by scenario and associator, on one page"),
    "play": Command("agents.play", "drive with the keyboard"),
    "doctor": Command("slam_gym.commands.doctor", "what is installed, compiled, cached, and where data are looked for"),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code; 2 for one that does not exist or misses a package, said in one line."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    name, *rest = arguments or ["--help"]
    if name in ("-h", "--help"):
        print(usage())
        return 0
    if name in ("-V", "--version"):
        print(f"slam_gym {slam_gym.__version__}")
        return 0
    name = name.replace("_", "-")  # as the module of a command has it
    if name not in COMMANDS:
        from slam_gym.validation import known_names  # which imports numba

        _say(f"unknown command {name!r}; {known_names(name, COMMANDS)}")
        return 2
    return _run(name, rest)


def usage() -> str:
    """What `--help` prints."""
    width = max(map(len, COMMANDS))
    lines = [f"  {name:{width}}  {command.about}" for name, command in COMMANDS.items()]
    return "\n".join(["usage: slam-gym COMMAND … (slam-gym COMMAND --help tells its options)", "", *lines])


def _run(name: str, argv: list[str]) -> int:
    """Run a command that is known."""
    _find_agents()
    if "" not in sys.path:
        sys.path.append("")  # as `python -m` has it: "mymodule:MyDriver" is looked for where the command is given

    def command() -> int:
        module = importlib.import_module(COMMANDS[name].module)
        if not hasattr(module, "app"):
            return int(module.main(argv))
        try:
            module.app(argv, prog_name=f"slam-gym {name}")
        except SystemExit as end:
            return int(end.code or 0)
        return 0

    return ended(command)


def ended(command: Callable[[], int]) -> int:
    """The exit code of a command: bad input, a package that is missing, a full disk or a worker that was killed end in
    one line on stderr and 2, Ctrl-C in 130."""
    try:
        return command()
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if missing in ("", "slam_gym", "agents"):
            raise
        _say(f"{missing} is missing: pip install 'slam_gym[agents]'")
    except BrokenProcessPool:
        _say("a worker process was killed, perhaps for want of memory: --resume goes on with what is left")
    except (ValueError, ImportError, OSError) as error:
        _say(str(error))
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    return 2


def _say(error: str) -> None:
    print(f"error: {error}", file=sys.stderr)


def _find_agents() -> None:
    """Put the folder in which `agents` lies first on the path of this process and of those that it starts."""
    folder = _INSTALLED if (_INSTALLED / "agents").is_dir() else _CHECKOUT
    if (folder / "agents" / "cli.py").is_file() and str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
        known = os.environ.get("PYTHONPATH")
        os.environ["PYTHONPATH"] = os.pathsep.join([str(folder), *([known] if known else [])])
