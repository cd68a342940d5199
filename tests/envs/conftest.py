"""Fixtures of the environments' tests."""

import pytest

from slam_gym.envs.associate import AssociateEnv
from slam_gym.envs.explore import ExploreEnv
from slam_gym.envs.relocate import RelocateEnv


@pytest.fixture(autouse=True)
def no_display(monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows need no display, and follow no clock."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    for env in (ExploreEnv, AssociateEnv, RelocateEnv):
        monkeypatch.setitem(env.metadata, "render_fps", 1000)
