"""Infos of many worlds are what Gymnasium's own vector environments make of them, entered one by one or shared."""

import gymnasium as gym
import numpy as np

from slam_gym.envs.vector.infos import InfoLayout, SharedInfos, enter, plainest
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


def test_what_is_shared_and_what_is_sent_make_the_same_together() -> None:
    infos = [{"a": k, "flag": k > 1, "where": {"pose": np.full(3, k + 0.5), "deep": np.float32(k)}} for k in range(5)]
    infos[1]["late"] = 2.0  # tells more than the layout knows
    infos[3] = {"a": 3}  # tells less
    infos[4]["where"]["pose"] = np.ones(3, np.float32)  # in another type
    layout = InfoLayout.of(plainest([infos[1], infos[0]]), len(infos))
    block = bytearray(layout.size)
    writer, whole = SharedInfos(layout, block), {}
    for world, info in enumerate(infos):
        writer.write(infos[0], world)  # of the step before
        assert writer.write(info, world) == (world in (0, 2))
        enter(whole, info, world, len(infos))
    found = SharedInfos(layout, block).read()
    for world in (1, 3, 4):
        enter(found, infos[world], world, len(infos))
    assert not differences(_sorted(found), _sorted(whole))


def test_what_was_read_is_a_copy_and_what_nobody_told_is_not_there() -> None:
    layout = InfoLayout.of({"a": 1, "b": {"c": 0.5}}, 2)
    shared = SharedInfos(layout, bytearray(layout.size))
    assert shared.read() == {}
    shared.write({"a": 7, "b": {"c": 1.5}}, 1)
    before = shared.read()
    shared.write({"a": 8, "b": {"c": 2.5}}, 1)
    assert before["a"].tolist() == [0, 7] and before["_b"].tolist() == [False, True]
    assert before["b"]["c"].tolist() == [0.0, 1.5] and before["b"]["_c"].tolist() == [False, True]


def test_infos_that_no_numbers_hold_are_not_laid_out() -> None:
    assert InfoLayout.of({"a": 1, "name": "x"}, 2) is None and InfoLayout.of({"a": {"b": None}}, 2) is None


def _sorted(infos):
    return {key: _sorted(infos[key]) if isinstance(infos[key], dict) else infos[key] for key in sorted(infos)}
