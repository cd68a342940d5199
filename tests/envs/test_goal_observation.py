"""Goals as the agent sees them: in the robot frame, in their units once they are unsquashed."""

import numpy as np
import pytest

from slam_gym.envs.goal_observation import GOAL_FIELDS, encode_goals, unsquash_goals
from slam_gym.geometry import observe
from slam_gym.simulation.goals import FRONTIERS, SLOTS
from tests.rollouts import episode, explore

FIRST_REVISIT = 1 + FRONTIERS


def test_goals_come_back_in_their_units_in_the_robot_frame() -> None:
    env = explore("office")
    for _ in episode(env, 10):
        pose, offer = env.episode.slam.map.pose, env.goals
        seen = unsquash_goals(encode_goals(offer, pose))
        assert set(GOAL_FIELDS) <= set(seen)
        np.testing.assert_array_equal(seen["legal"], offer.legal)
        local = np.where(offer.legal[:, None], observe(pose, offer.positions), 0.0)
        for name, values in {
            "x": local[:, 0],
            "y": local[:, 1],
            "path": offer.lengths,
            "area": offer.areas,
            "reduction": offer.reductions,
        }.items():
            np.testing.assert_allclose(seen[name], values, rtol=1e-4, atol=1e-5, err_msg=name)
        slots = np.arange(SLOTS)
        np.testing.assert_array_equal(seen["frontier"], offer.legal & (slots >= 1) & (slots < FIRST_REVISIT))
        np.testing.assert_array_equal(seen["revisit"], offer.legal & (slots >= FIRST_REVISIT))


def test_unsquash_takes_any_number_of_slots_and_refuses_half_a_row() -> None:
    assert unsquash_goals(np.zeros(3 * len(GOAL_FIELDS), np.float32))["path"].shape == (3,)
    with pytest.raises(ValueError, match="do not divide"):
        unsquash_goals(np.zeros(9, np.float32))
    ends = unsquash_goals(np.ones(len(GOAL_FIELDS), np.float32))
    assert all(np.isfinite(column).all() for column in ends.values())
