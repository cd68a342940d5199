"""`Associate-v0`: arguments, rewards that rank associators, associators and policies through it, what is handed out."""

from dataclasses import replace

import numpy as np
import pytest

import slam_gym  # noqa: F401 (registers the environment)
from slam_gym.association import jcbb, nearest_neighbour, singles
from slam_gym.association.policy import from_policy, greedy
from slam_gym.association.tracking.walk import Walk
from slam_gym.envs.associate import AssociateEnv
from slam_gym.scenarios import get_scenario
from slam_gym.simulation.association_runs import CORRIDOR
from slam_gym.simulation.judged import NOT_OFFERED
from slam_gym.slam.slam import Slam
from slam_gym.world.corridor import walk_round
from slam_gym.world.floor_plan_file import save_floor_plan
from slam_gym.world.generators import OfficeGenerator
from tests.oracles import association as oracles
from tests.rollouts import associate, differences, episode, short

INFO = ["look", "hidden", "score", "map_error", "action_mask", "truth"]


def fixed_noise(_rng):
    return walk_round(np.random.default_rng(3))


WITH_FIXED_NOISE = replace(CORRIDOR, scans=fixed_noise)


def refuse(env, observation, info):
    return env.K


def by_truth(env, observation, info):
    return env.K if info["truth"]["action"] == NOT_OFFERED else info["truth"]["action"]


class Playing:
    """Plays the hypotheses of an associator, and remembers them."""

    def __init__(self, associator):
        self.associator, self.look, self.hypotheses, self.unplayable = associator, -1, [], 0

    def __call__(self, env, observation, info):
        if env.walk is None:
            return env.K
        if info["look"] != self.look:
            self.look = info["look"]
            self.hypotheses.append((self.look, self.associator(env.run.scan, env.run.prediction)))
        action = env.action_of(self.hypotheses[-1][1])
        self.unplayable += action is None
        return env.K if action is None else action


def total(steps):
    return sum(step[1] for step in steps)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scenario": "atlantis"}, "office-small.*corridor"),
        ({"driver": "me"}, "nearest_frontier, random"),
        ({"reward": "money"}, "truth, map_error"),
        ({"candidates": 0}, "candidates: expected a whole number"),
        ({"order": "any"}, "as_scanned"),
        ({"compatibility": "any"}, "joint, individual"),
        ({"wrong_cost": -1.0}, "wrong_cost=-1"),
        ({"wrong_cost": float("nan")}, "wrong_cost=nan"),
    ],
)
def test_bad_arguments_are_refused_by_name(options, message):
    with pytest.raises(ValueError, match=message):
        AssociateEnv(**options)


def test_the_return_ranks_nearest_neighbour_below_singles_below_jcbb():
    env = associate("corridor", split="test", compatibility="individual", candidates=8)
    returns = {}
    for associator in (nearest_neighbour, singles, jcbb):
        players = [Playing(associator) for _ in range(6)]
        episodes = [list(episode(env, choose=player, seed=k)) for k, player in enumerate(players)]
        assert sum(player.unplayable for player in players) == 0
        returns[associator] = np.array([(total(steps), steps[-1][4]["score"]) for steps in episodes])
    worst, middle, best = (returns[a].mean(axis=0) for a in (nearest_neighbour, singles, jcbb))
    assert (worst < 0.0).all()
    assert (middle > 0.1).all()
    assert (middle + 0.2 < best).all()
    assert (best <= 1.0).all()


@pytest.mark.parametrize("scenario", ["corridor", short(150), short(150, "crowd")])
@pytest.mark.parametrize("compatibility", ["joint", "individual"])
def test_answers_are_those_of_the_tally(scenario, compatibility):
    env = associate(scenario, compatibility=compatibility, wrong_cost=np.float32(3.0))
    *_, (_, reward, *_, info) = episode(env, seed=5)
    assert type(reward) is float
    tally = env.run.identities.total
    assert tally.fp > 10
    assert info["score"] == pytest.approx((tally.tp - 3.0 * tally.fp) / tally.in_map)


@pytest.mark.parametrize(
    ("associator", "compatibility"),
    [
        (nearest_neighbour, "individual"),
        (singles, "individual"),
        (jcbb, "individual"),
        (lambda scan, prediction: jcbb(scan, oracles.without_locality(prediction)), "joint"),
    ],
)
def test_classical_associators_reach_the_same_map_through_the_environment(associator, compatibility):
    env = associate(WITH_FIXED_NOISE, compatibility=compatibility, candidates=10)
    player, direct = Playing(associator), Slam(CORRIDOR.slam)
    for _ in episode(env, choose=player):
        pass

    def walked(scan, prediction):
        """The answer decision by decision: a walk also says what is new."""
        answer, walk = associator(scan, prediction), Walk(scan, prediction, candidates=10, compatibility=compatibility)
        while not walk.done:
            walk.take(walk.action_of(int(answer.features[walk.measurement])))
        return walk.hypothesis()

    hypotheses = [direct.step(odometry, scan, walked).hypothesis for odometry, scan, _ in fixed_noise(None)]
    assert player.unplayable == 0
    assert len(player.hypotheses) > 30
    for look, played in player.hypotheses:
        np.testing.assert_array_equal(hypotheses[look - 1].features, played.features)
    np.testing.assert_array_equal(direct.map.mean, env.run.slam.map.mean)
    np.testing.assert_array_equal(direct.map.covariance, env.run.slam.map.covariance)


def test_a_policy_sees_as_an_associator_what_it_sees_in_the_environment():
    env, seen, shown = associate(WITH_FIXED_NOISE, order="nearest_first"), [], []
    for observation, *_ in episode(env, choose=lambda env, observation, info: greedy({}, info["action_mask"])):
        seen.append({name: vector for name, vector in observation.items() if name != "budget"})

    def policy(observation, mask):
        shown.append(observation)
        return greedy(observation, mask)

    slam, associator = Slam(CORRIDOR.slam), from_policy(policy, order="nearest_first")
    for odometry, scan, _ in fixed_noise(None):
        slam.step(odometry, scan, associator)
    assert not differences(shown, seen[:-1])  # the last is that of an episode that is over
    np.testing.assert_array_equal(slam.map.mean, env.run.slam.map.mean)


@pytest.mark.parametrize("scenario", ["corridor", "office-small", short(150, "crowd")])
def test_observations_are_inside_their_space_and_info_has_fixed_keys(scenario):
    env, hid = associate(scenario, candidates=2, compatibility="individual"), 0
    for observation, _, over, _, info in episode(env, seed=1):
        assert env.observation_space.contains(observation)
        assert list(info) == INFO
        assert info["action_mask"][env.K]
        assert over or info["action_mask"].sum() >= 2, "a level with one legal branch is played by the environment"
        assert -1 <= info["truth"]["action"] <= env.K
        assert info["look"] == len(env.run.estimates) + (not over), "the scan to be decided counts"
        assert observation["budget"] == pytest.approx(1 - info["look"] / env.run.length)
        hid += info["hidden"]
    assert over
    assert env.action_masks().tolist() == [False, False, True]
    assert info["look"] == env.run.length
    assert hid > 0 or scenario != "corridor"


def test_it_is_driven_on_a_floor_plan(tmp_path):
    path, plan = tmp_path / "two.json", OfficeGenerator(rooms=2)(np.random.default_rng(1))
    save_floor_plan(plan, path)
    env = associate("office-small", floor_plan=path, overrides={"budget": 20})
    *_, last = episode(env)
    assert last[2] and env.scenario.sensor == get_scenario("office-small").sensor
    np.testing.assert_array_equal(env.run.site.plan.walls, plan.walls)
    assert associate(None, floor_plan=path).scenario.sensor == get_scenario("building").sensor
    with pytest.raises(ValueError, match="floor plans are for simulated scenarios, and 'corridor' is a log"):
        associate("corridor", floor_plan=path)
