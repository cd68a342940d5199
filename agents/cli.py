"""What the commands share: the options that choose a world, and errors told in one line."""

from __future__ import annotations

import argparse
import platform
import shlex
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import slam_gym
from agents.evaluation.rollout import Setting

CHECKOUT = Path(__file__).parents[1]
PACKAGES = ("numpy", "scipy", "numba", "gymnasium", "pymunk", "torch", "stable-baselines3", "sb3-contrib", "joblib")


def add_world_options(parser: argparse.ArgumentParser, scenario: str) -> None:
    """--scenario, --floor-plan, --resolution, --associator, --relocation."""
    world = parser.add_argument_group("world")
    world.add_argument("--scenario", default=scenario, help="name of a scenario (default: %(default)s)")
    world.add_argument("--floor-plan", metavar="FILE", help="drive on this floor instead: JSON, or an occupancy image")
    world.add_argument("--resolution", type=float, metavar="M", help="metres per pixel of an occupancy image")
    world.add_argument("--associator", default="jcbb", help="name or module:function (default: %(default)s)")
    world.add_argument(
        "--relocation", metavar="NAME", help="search that finds a lost robot: gcbb, rs, module:function …"
    )


def setting_of(arguments: argparse.Namespace, **more: str) -> Setting:
    """The setting that the options above choose."""
    plan = str(Path(arguments.floor_plan).resolve()) if arguments.floor_plan else None
    return Setting(
        arguments.scenario,
        arguments.associator,
        floor_plan=plan,
        resolution=arguments.resolution,
        relocation=arguments.relocation,
        **more,
    )


def run_main(main: Callable[[list[str]], int]) -> int:
    """Run a command: bad input ends in one line on stderr and exit code 2, Ctrl-C in exit code 130."""
    try:
        return main(sys.argv[1:])
    except (ValueError, ImportError, FileNotFoundError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130


def command_line(module: str, argv: list[str]) -> str:
    """The command as it would be typed."""
    return " ".join(["python -m", module, *map(shlex.quote, argv)])


def versions() -> dict[str, str]:
    """Versions of everything that results depend on; the commit of the checkout where it is one."""
    found = {"slam_gym": slam_gym.__version__, "python": platform.python_version(), "machine": platform.platform()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    try:
        git = ["git", "-C", str(CHECKOUT), "describe", "--always", "--dirty", "--abbrev=12"]
        found["commit"] = subprocess.run(git, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        found["commit"] = "unknown"
    return found
