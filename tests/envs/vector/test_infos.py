"""Infos of many worlds are what Gymnasium's own vector environments make of them, entered at once or in groups."""

import gymnasium as gym
import numpy as np

from slam_gym.envs.vector.infos import enter, joined
from tests.rollouts import differences

INFOS = [
    {"a": 1, "where": {"pose": np.arange(3.0), "name": "x"}, "flag": True},
    {},
    {"a": 2, "late": 0.5, "where": {"pose": np.ones(3), "more": {"deep": np.float32(2.0)}}, "flag": False},
    {"final_obs": {"image": np.zeros((2, 2), np.uint8)}, "final_info": {"late": 1.5}, "text": "end"},
]


def test_infos_are_entered_as_gymnasium_does_it() -> None:
    theirs = gym.vector.VectorEnv()
    theirs.num_envs = len(INFOS)
    expected, ours = {}, {}
    for world, info in enumerate(INFOS):
        expected = theirs._add_info(expected, info, world)
        enter(ours, info, world, len(INFOS))
    assert ours["final_obs"][3] is INFOS[3]["final_obs"]
    for infos in (expected, ours):
        infos.pop("final_obs")
        assert infos["where"].pop("name").tolist() == ["x", None, None, None]
        assert infos.pop("text").tolist() == [None, None, None, "end"]
    assert not differences(ours, expected)


def test_groups_are_joined_into_the_same() -> None:
    whole, groups, rows = {}, [], [range(0, 1), range(1, 2), range(2, 4)]
    for world, info in enumerate(INFOS):
        enter(whole, info, world, len(INFOS))
    for group in rows:
        groups.append({})
        for row, world in enumerate(group):
            enter(groups[-1], INFOS[world], row, len(group))
    both = [whole, joined(groups, rows, len(INFOS))]
    for infos in both:
        assert infos.pop("final_obs").tolist() == [None, None, None, INFOS[3]["final_obs"]]
        assert infos["where"].pop("name").tolist() == ["x", None, None, None]
        assert infos.pop("text").tolist() == [None, None, None, "end"]
    assert not differences(*both)
