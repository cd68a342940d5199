"""Fixtures shared by all tests."""

import os
from pathlib import Path

import pytest

from slam_gym.envs.associate import AssociateEnv
from slam_gym.envs.explore import ExploreEnv
from slam_gym.envs.relocate import RelocateEnv


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
