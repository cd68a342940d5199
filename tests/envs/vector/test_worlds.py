"""Worlds stepped one after the other: they write into their rows and nowhere else, errors have its number."""

import pickle

import pytest
from gymnasium.vector import AutoresetMode

from slam_gym.envs.explore import ExploreEnv
from slam_gym.envs.vector.buffers import Layout
from slam_gym.envs.vector.infos import InfoLayout, SharedInfos
from slam_gym.envs.vector.worlds import Making, WorldError, Worlds
from tests.rollouts import short


def group(rows, count):
    making = Making(ExploreEnv, {"scenario": short(6), "action": "twist"}, AutoresetMode.NEXT_STEP, None)
    env = making()
    layout = Layout.of(env.observation_space, env.action_space, count)
    buffers = layout.buffers(bytearray(layout.size))
    return Worlds(making, rows, buffers.of(rows)), buffers


def test_a_group_writes_into_its_own_rows() -> None:
    worlds, buffers = group(range(1, 3), 4)
    infos, _ = worlds.reset({1: 5, 2: None}, {1: {}, 2: {"world": 3}})
    assert [world for world, _ in infos] == [1, 2]
    layout = InfoLayout.of(infos[0][1], 4)
    block = bytearray(layout.size)
    worlds.share_infos(layout, block)
    buffers.actions[:] = 0.5
    assert worlds.step({}) is None
    shared = SharedInfos(layout, block).read()
    assert shared["_pose"].tolist() == [False, True, True, False]
    assert shared["pose"][1:3].any() and not shared["pose"][0].any() and not shared["pose"][3].any()
    for part in buffers.observations.values():
        assert part[1:3].any() and not part[0].any() and not part[3].any()


def test_an_error_has_the_number_of_its_world_and_its_cause_and_survives_pickling() -> None:
    worlds, _ = group(range(2, 4), 4)
    with pytest.raises(WorldError, match="world 3: ValueError: world -1 of split") as caught:
        worlds.reset({2: 0, 3: 0}, {2: {}, 3: {"world": -1}})
    assert isinstance(caught.value.__cause__, ValueError)
    caught.value.add_note("from afar")
    again = pickle.loads(pickle.dumps(caught.value))
    assert (again.world, str(again), again.__notes__) == (3, str(caught.value), ["from afar"])
    with pytest.raises(WorldError, match="world 2: AttributeError"):
        worlds.call("no_such_thing", (), {}, range(4))
