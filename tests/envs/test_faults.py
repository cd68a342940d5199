"""Bad input and faults: refused by name, nothing corrupted."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks import long_run
from slam_gym.association import jcbb
from slam_gym.envs.explore import ExploreEnv
from slam_gym.scenarios import Scenario, get_scenario
from slam_gym.types import UNPAIRED, Effort, Hypothesis, Scan
from slam_gym.world.floor_plan import Features, FloorPlan
from slam_gym.world.sensor import SensorSpec
from tests.mapping.small_maps import smallest_over_largest
from tests.rollouts import episode, explore, short


@pytest.mark.parametrize(
    ("arguments", "known"),
    [
        ({"action": "drive"}, "action='drive'.*goal, twist"),
        ({"reward": "coverage"}, "'coverage'.*map_error, a_opt, d_opt, entropy"),
        ({"atlas": "marginal"}, "atlas: expected True, False or an AtlasSpec, got 'marginal'"),
        ({"locality": "distance"}, "locality='distance'.*covisibility, None"),
        ({"associator": "icp"}, "'icp'.*known: .*jcbb, .*nearest_neighbour, .*true_association"),
    ],
)
def test_an_unknown_name_is_refused_with_the_known_ones(arguments, known) -> None:
    with pytest.raises(ValueError, match=known):
        ExploreEnv(**arguments)


@pytest.mark.parametrize("right", [(1.0, -1.0), [0.0, 0.5], np.array([0.2, 0.1], np.float32), np.zeros(2)])
def test_twists_may_come_as_any_pair(right) -> None:
    env = explore(action="twist")
    env.reset(seed=0)
    assert env.step(right)[-1]["ticks"] == 1
    for wrong in (None, 0.5, [None, 1], [2.0, 0.0], [np.nan, 0.0], [0.1, 0.2, 0.3], "ab"):
        with pytest.raises(ValueError, match="expected two fractions"):
            env.step(wrong)


def hypothesis(features: list[int]) -> Hypothesis:
    return Hypothesis(np.array(features, np.int64), 0.0, 0, Effort(), exclusive=False)


def test_an_associator_that_answers_nonsense_is_refused_and_corrupts_nothing() -> None:
    def faulty(scan: Scan, prediction) -> Hypothesis:
        at_fault = prediction.features.size > 5 and len(scan) > 5
        return hypothesis([10**6] * len(scan)) if at_fault else jcbb(scan, prediction)

    env = explore("office", action="twist", associator=faulty, render_mode="rgb_array")
    with pytest.raises(ValueError, match="features"):
        for _ in episode(env, 50):
            pass
    assert env.render().shape[2] == 3, "what there was before"
    assert smallest_over_largest(env.episode.slam.map) >= -1e-9 and np.isfinite(env.episode.slam.map.mean).all()


def test_an_associator_that_pairs_at_random_does_not_break_the_filter() -> None:
    """The worst that a learner can do: the map is worthless, but it stays one."""
    rng = np.random.default_rng(0)

    def reckless(scan: Scan, prediction) -> Hypothesis:
        choices = np.append(prediction.features, UNPAIRED)
        return hypothesis(rng.choice(choices, len(scan)).tolist())

    env = explore(short(300), action="twist", associator=reckless)
    for observation, reward, *_ in episode(env):
        assert math.isfinite(reward) and env.observation_space.contains(observation)
    assert smallest_over_largest(env.episode.slam.map) >= -1e-9 and np.isfinite(env.episode.slam.map.mean).all()


def box(width: float, height: float, x: float = 0.0, y: float = 0.0) -> list[list[float]]:
    """Walls of a rectangle."""
    corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
    return [[*a, *b] for a, b in zip(corners, corners[1:] + corners[:1])]


def world_of(walls, features=(), furniture=(), **changes) -> Scenario:
    """A scenario on one given plan."""
    points = np.array(list(features), float).reshape(-1, 2)
    plan = FloorPlan(
        "little",
        np.array(walls, float),
        Features(points, np.zeros(len(points), np.int64), np.full(len(points), 0.5)),
        furniture=np.array(furniture, float).reshape(-1, 5),
    )
    return replace(get_scenario("office-small"), generator=lambda rng: plan, budget=60, **changes)


@pytest.mark.parametrize(
    ("scenario", "message"),
    [
        (world_of(box(0.3, 0.3), [[0.0, 0.0]]), "'little': no free space for a robot of radius 0.2 m"),
        (world_of(box(5, 5)), "'little': has no features"),
        (world_of(box(9, 9) + box(2, 2, 4, 4), [[5, 5]]), "'little': none of its 1 features can be seen"),
        (world_of(box(30, 3), [[0.0, 0.0]], [[x, 1.5, 4.0, 2.4, 0.0] for x in range(2, 30, 3)]), "furniture"),
    ],
    ids=["no free space", "no features", "none visible", "furniture everywhere"],
)
def test_a_plan_that_cannot_be_mapped_says_why(scenario, message) -> None:
    env = explore(scenario)
    with pytest.raises(ValueError, match=message):
        env.reset(seed=0)


@pytest.mark.parametrize(("action", "reward"), [("goal", "entropy"), ("twist", "map_error")])
@pytest.mark.parametrize(
    "scenario",
    [
        world_of(box(4, 4), [[0.0, 0.0]]),  # one feature
        world_of(box(0.8, 0.8), [[0.0, 0.0], [0.8, 0.8]]),  # hardly room to turn
        world_of(box(30, 30), [[0.0, 0.0]]),  # more space than the sensor spans
        world_of(box(4, 4), [[0.0, 0.0]], sensor=SensorSpec(detection=0.0, clutter=0.0)),  # blind
        world_of(box(4, 4), [[0.0, 0.0]], sensor=SensorSpec(detection=0.0, clutter=8.0)),  # nothing but clutter
        world_of(box(6, 6), itertools.product(np.arange(0.0, 6.1, 0.5), (0.0, 6.0)), sensor=SensorSpec(max_features=1)),
    ],
    ids=["one feature", "closet", "field", "blind", "clutter", "one measurement"],
)
def test_odd_worlds_work(scenario, action, reward) -> None:
    env = explore(scenario, action=action, reward=reward)
    for observation, paid, _, _, info in episode(env, seed=1):
        assert env.observation_space.contains(observation)
        assert math.isfinite(paid) and math.isfinite(info["map_error"])
    assert info["map_quality"]["ticks"] == 60


@pytest.mark.parametrize(
    ("number", "associator"), [*((number, "") for number in (0, 1, 5, 8, 14, 29)), (2, "jcbb"), (3, "learned")]
)
def test_a_long_run_in_its_shortest_form_breaks_nothing(number: int, associator: str) -> None:
    """A few episodes with extreme settings."""
    words, env = long_run.episode(number, 0, 24, associator)
    assert sum(ticks for ticks, _ in long_run.checked(env, number)) > 0, words
