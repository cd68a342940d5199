"""Worlds drawn ahead by another process arrive for the world of the vector that needs them, and are handed out once."""

import pickle

import pytest
from gymnasium.vector import AutoresetMode

from slam_gym.envs.explore import ExploreEnv
from slam_gym.envs.vector.buffers import Layout, SharedBlock
from slam_gym.envs.vector.drawing import Drawing
from slam_gym.envs.vector.worlds import Making
from tests.rollouts import differences, explore, short


@pytest.fixture
def drawing():
    making = Making(ExploreEnv, {"scenario": short(6), "action": "twist"}, AutoresetMode.NEXT_STEP, None)
    env = making()
    layout = Layout.of(env.observation_space, env.action_space, 1)
    block = SharedBlock(layout.size)
    drawing = Drawing(making, layout, block.path)
    block.forget()
    yield drawing
    drawing.close()


def test_what_is_asked_for_arrives_once(drawing) -> None:
    drawing.ask({0: 11, 2: 12})
    found = {}
    while len(found) < 2:
        found |= drawing.ready(range(4))
    assert {world: number for world, (number, _) in found.items()} == {0: 11, 2: 12}
    assert drawing.ready(range(4)) == {}
    here = pickle.loads(explore(short(6)).draw(12))
    there = pickle.loads(found[2][1])
    assert not differences(vars(here.plan.features), vars(there.plan.features))
    assert not differences((here.cells, here.observable), (there.cells, there.observable))
