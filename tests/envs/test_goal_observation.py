"""Goals as an agent sees them: in its own frame, zero where not legal, and back in their units."""

import math

import numpy as np
import pytest

from slam_gym.envs.goal_observation import GOAL_FIELDS, encode_goals, unsquash_goals
from slam_gym.geometry import transform
from slam_gym.simulation.goals import FRONTIERS, SLOTS, Goals


def some_goals(rng: np.random.Generator) -> Goals:
    legal = rng.random(SLOTS) < 0.6
    legal[0] = True
    masked = legal.astype(float)
    return Goals(
        positions=rng.uniform(-20.0, 20.0, (SLOTS, 2)) * masked[:, None],
        lengths=rng.uniform(0.0, 30.0, SLOTS) * masked,
        areas=rng.uniform(0.0, 20.0, SLOTS) * masked,
        reductions=rng.uniform(0.0, 0.3, SLOTS) * masked,
        legal=legal,
        in_view=rng.uniform(0.0, 15.0, SLOTS) * masked,
    )


@pytest.mark.parametrize("seed", range(3))
def test_goals_come_back_in_their_units_and_in_the_frame_of_the_robot(seed) -> None:
    rng = np.random.default_rng(seed)
    goals, pose = some_goals(rng), np.array([1.0, -2.0, rng.uniform(-math.pi, math.pi)])
    shown = encode_goals(goals, pose)
    assert shown.shape == (SLOTS * len(GOAL_FIELDS),) and shown.dtype == np.float32
    assert (np.abs(shown) <= 1.0).all()
    told = unsquash_goals(shown)
    assert tuple(told) == GOAL_FIELDS
    legal = goals.legal
    np.testing.assert_array_equal(told["legal"] == 1.0, legal)
    positions = transform(pose, np.stack([told["x"], told["y"]], axis=1))
    np.testing.assert_allclose(positions[legal], goals.positions[legal], rtol=1e-4, atol=1e-4)
    numbers = {"path": goals.lengths, "area": goals.areas, "reduction": goals.reductions, "in_view": goals.in_view}
    for name, values in numbers.items():
        np.testing.assert_allclose(told[name], values, rtol=1e-4, atol=1e-6)
    assert all(not told[name][~legal].any() for name in GOAL_FIELDS)
    assert (told["frontier"][1 : 1 + FRONTIERS] == legal[1 : 1 + FRONTIERS]).all() and not told["frontier"][0]
    assert (told["revisit"][1 + FRONTIERS :] == legal[1 + FRONTIERS :]).all()


def test_a_vector_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match="13 numbers do not divide into rows of 9"):
        unsquash_goals(np.zeros(13, np.float32))
