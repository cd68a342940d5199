"""Fixtures shared by all tests, and the order of files over processes."""

import os
from pathlib import Path
from typing import Any

import pytest

from slam_gym.envs.associate import AssociateEnv
from slam_gym.envs.explore import ExploreEnv
from slam_gym.envs.relocate import RelocateEnv

TESTS = Path(__file__).parent
ORDER = (
    "agents/drivers/test_clairvoyant.py",  # compiles the loops of a drive
    "agents/learning/test_associator.py",  # compiles the sums over hypotheses
    "association/relocation/test_answer.py",  # compiles the searches without a prior
    "association/test_associators.py",  # compiles the other associators
    "agents/",
    "test_notebooks.py",  # the longest
)
"""What comes before all other tests, so that two processes compile different loops and end at about the same time."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    def place(item: pytest.Item) -> int:
        path = os.path.relpath(item.path, TESTS).replace(os.sep, "/")
        return next((k for k, first in enumerate(ORDER) if path.startswith(first)), len(ORDER))

    items.sort(key=place)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """With `-n`, the tests of a file go to one process: what they share is made once, and what they compile."""
    if config.option.dist != "load":
        return None
    from xdist.scheduler import LoadFileScheduling

    config.option.loadscopereorder = False  # the order is that above
    return LoadFileScheduling(config, log)


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of real recordings and floor plans: `SLAM_GYM_DATA`, or `../shared/data` beside the checkout."""
    given = os.environ.get("SLAM_GYM_DATA")
    folder = Path(given) if given else Path(__file__).parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no recordings: set SLAM_GYM_DATA to their folder (looked in {folder})")
    return folder


@pytest.fixture(autouse=True)
def no_display(monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows need no display, and follow no clock."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    for env in (ExploreEnv, AssociateEnv, RelocateEnv):
        monkeypatch.setitem(env.metadata, "render_fps", 1000)
