"""What an episode of Associate-v0 is run on, and the options that choose it."""

from __future__ import annotations

import argparse
from dataclasses import asdict, dataclass
from typing import Any, Literal

import gymnasium as gym

import slam_gym  # noqa: F401  (registers the environments)

ENV_ID = "slam_gym/Associate-v0"


@dataclass(frozen=True)
class AssociationSetting:
    """Arguments of the environment. The i-th episode is the same for every policy."""

    scenario: str = "office-small"
    split: str = "train"
    driver: str = "nearest_frontier"
    reward: str = "truth"
    candidates: int = 5
    order: str = "as_scanned"
    compatibility: str = "joint"
    wrong_cost: float = 10.0

    def make(self, action: Literal["branch"] = "branch", render_mode: str | None = None) -> gym.Env[Any, Any]:
        """The environment, which has one action only. ValueError, with the known names, for what it does not know."""
        return gym.make(ENV_ID, render_mode=render_mode, disable_env_checker=True, **asdict(self))


def add_association_options(parser: argparse.ArgumentParser) -> None:
    """An option for every field but the split."""
    group = parser.add_argument_group("environment (see slam_gym/Associate-v0)")
    default = AssociationSetting()
    group.add_argument("--scenario", default=default.scenario, help="a scenario, or corridor (default: %(default)s)")
    group.add_argument("--driver", default=default.driver, help="nearest_frontier or random (default: %(default)s)")
    group.add_argument("--reward", default=default.reward, help="truth or map_error (default: %(default)s)")
    group.add_argument("--candidates", type=int, default=default.candidates, metavar="K", help="default: %(default)s")
    group.add_argument("--order", default=default.order, help="of the measurements (default: %(default)s)")
    group.add_argument("--compatibility", default=default.compatibility, help="joint or individual")
    group.add_argument("--wrong-cost", type=float, default=default.wrong_cost, metavar="C", help="default: %(default)s")


def association_setting(arguments: argparse.Namespace, split: str) -> AssociationSetting:
    """The setting that the options choose."""
    names = ("scenario", "driver", "reward", "candidates", "order", "compatibility", "wrong_cost")
    return AssociationSetting(split=split, **{name: getattr(arguments, name) for name in names})
