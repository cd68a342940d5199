"""Goals on offer, the gain they promise, and the driver that carries them out."""

import math
from dataclasses import replace

import numpy as np
import pytest

from slam_gym.envs.goal_observation import GOAL_FIELDS, encode_goals, unsquash_goals
from slam_gym.geometry import observe, relative
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.navigation.expected_gain import MOST_FEATURES, expected_reduction
from slam_gym.navigation.explored_grid import WALL, ExploredGrid
from slam_gym.navigation.planner import distance_field
from slam_gym.scenarios import get_scenario
from slam_gym.simulation import driver, goals
from slam_gym.simulation.driver import ARRIVED, STUCK_TICKS, carry_out
from slam_gym.simulation.goals import FRONTIERS, LOOK, PLACE_SPACING, REVISITS, SLOTS, WORTH_SEEING, Places
from slam_gym.types import Beams, Odometry, Scan
from slam_gym.world.physics import RobotSpec
from tests.rollouts import SCENARIOS, episode, explore, random_action, short

FIRST_REVISIT = 1 + FRONTIERS
DRIFT = np.array([0.03, 0.03, 0.02])
SIGMA = 0.05


# -- expected reduction --------------------------------------------------------------------------------------------


def scan_of(points: np.ndarray, sigma: float) -> Scan:
    unknown = np.full(len(points), np.nan)
    return Scan(points, np.tile(np.eye(2) * sigma**2, (len(points), 1, 1)), unknown, unknown)


def correlated_map(rng: np.random.Generator, features: int) -> StochasticMap:
    """A map built on the move, so that everything is correlated with everything."""
    slam_map = StochasticMap()
    true = rng.uniform(-6, 6, (features, 2))
    for k in range(6):
        turn = rng.normal(0, 0.5)
        slam_map.predict(Odometry(np.array([0.7, 0.0, turn]), np.diag([0.05, 0.02, 0.04]) ** 2))
        local = observe(slam_map.pose, true) + rng.normal(0, 0.05, true.shape)
        if k < 3:
            slam_map.add(scan_of(local, 0.1), np.arange(k * features // 3, (k + 1) * features // 3))
        some = rng.permutation(slam_map.n)[: slam_map.n // 2]
        pairings = np.full(features, -1)
        pairings[some] = some
        slam_map.update(scan_of(local, 0.1), pairings)
    return slam_map


def blank_grid() -> ExploredGrid:
    return ExploredGrid(np.array([-15.0, -15.0, 15.0, 15.0]))


def by_ekf(slam_map: StochasticMap, place: np.ndarray, heading: float, measured: np.ndarray) -> float:
    """Drop of Σ tr P_jj in a copy of the map that is driven to the place and sees the features `measured` there."""
    after = slam_map.copy()
    destination = np.array([*place, heading])
    c, s = math.cos(after.pose[2]), math.sin(after.pose[2])
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    noise = turn.T @ np.diag(DRIFT**2) @ turn
    after.predict(Odometry(relative(after.pose, destination), 0.5 * (noise + noise.T)))
    after.update(scan_of(observe(destination, after.positions[measured]), SIGMA), measured)
    return float(np.trace(slam_map.covariance[3:, 3:]) - np.trace(after.covariance[3:, 3:]))


@pytest.mark.parametrize("seed", range(6))
def test_expected_reduction_is_that_of_an_ekf_update_of_a_copy(seed) -> None:
    rng = np.random.default_rng(seed)
    slam_map = correlated_map(rng, 30)
    mean, covariance = slam_map.mean, slam_map.covariance
    places, reach = rng.uniform(-6, 6, (8, 2)), 5.0
    found = expected_reduction(mean, covariance, blank_grid(), places, reach=reach, sigma=SIGMA, drift=DRIFT)
    for place, gain in zip(places, found):
        distances = np.hypot(*(slam_map.positions - place).T)
        measured = np.argsort(distances)[:MOST_FEATURES]
        measured = measured[distances[measured] <= reach]
        expected = by_ekf(slam_map, place, rng.uniform(-math.pi, math.pi), measured)
        assert gain == pytest.approx(expected, rel=1e-9, abs=1e-12)
    assert found.max() > 0.0
    np.testing.assert_array_equal(mean, slam_map.mean)
    np.testing.assert_array_equal(covariance, slam_map.covariance)


def test_expected_reduction_counts_what_is_in_reach_and_in_sight_only() -> None:
    slam_map = StochasticMap(pose_covariance=np.diag([0.1, 0.1, 0.01]))
    slam_map.add(scan_of(np.array([[4.0, 0.0]]), 0.3), np.array([0]))
    grid = blank_grid()

    def gain(x: float, reach: float = 6.0) -> float:
        place = np.array([[x, 0.0]])
        found = expected_reduction(
            slam_map.mean, slam_map.covariance, grid, place, reach=reach, sigma=SIGMA, drift=DRIFT
        )
        return float(found[0])

    assert gain(-3.0) == 0.0 and gain(-3.0, reach=8.0) > 0.0  # farther than the sensor sees
    assert gain(0.0) == pytest.approx(by_ekf(slam_map, np.zeros(2), 0.0, np.array([0])), rel=1e-9)
    bearings = np.linspace(-0.6, 0.6, 40)
    grid.integrate(np.zeros(3), Beams(bearings, 2.1 / np.cos(bearings), 6.0))
    assert grid.cells[int(15 / 0.2), int(17.1 / 0.2)] == WALL
    assert gain(0.0) == 0.0 and gain(3.0) > 0.0  # a wall in between, and from beyond it
    slam_map.add(scan_of(np.array([[2.15, 0.0]]), 0.3), np.array([0]))
    assert gain(0.0) > 0.0  # a feature of the wall itself hides behind nothing


def test_an_empty_map_has_nothing_to_gain() -> None:
    slam_map, places = StochasticMap(), np.zeros((3, 2))
    gains = expected_reduction(
        slam_map.mean, slam_map.covariance, blank_grid(), places, reach=6.0, sigma=SIGMA, drift=DRIFT
    )
    np.testing.assert_array_equal(gains, np.zeros(3))


# -- goals ---------------------------------------------------------------------------------------------------------


def decisions(scenario: str, steps: int = 8, seed: int = 0):
    """(env, its goals) at each decision of a random episode."""
    env = explore(scenario)
    for _ in episode(env, steps, seed=seed):
        yield env, env.goals


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_goals_are_what_they_say(scenario) -> None:
    frontiers = revisits = 0
    for env, offer in decisions(scenario):
        slam_map, grid, scene = env.episode.slam.map, env.episode.grid, env.scenario
        field = distance_field(grid, slam_map.pose[:2], scene.robot.radius + goals.CLEARANCE)
        ends, back = offer.legal[1:FIRST_REVISIT].sum(), offer.legal[FIRST_REVISIT:].sum()
        frontiers, revisits = frontiers + ends, revisits + back
        assert offer.legal[: 1 + ends].all() and offer.legal[FIRST_REVISIT : FIRST_REVISIT + back].all()  # no gaps
        np.testing.assert_array_equal(offer.positions[LOOK], slam_map.pose[:2])
        for slot in np.flatnonzero(offer.legal)[1:]:
            assert offer.lengths[slot] == field.length_to(offer.positions[slot]) < math.inf
            assert len(field.path(offer.positions[slot])) >= 2
        np.testing.assert_array_equal(
            offer.areas[offer.legal], grid.expected_area(offer.positions[offer.legal], scene.beams.range)
        )
        assert (offer.areas[1 : 1 + ends] >= WORTH_SEEING).all()
        assert (np.diff(offer.lengths[1 : 1 + ends]) >= 0.0).all()
        assert (offer.reductions >= 0.0).all() and np.isfinite(offer.reductions).all()
        for values in (offer.positions, offer.lengths, offer.areas, offer.reductions):
            assert not values[~offer.legal].any()
    assert frontiers > 5 and revisits > 0


@pytest.mark.parametrize("scenario", ["office", "hall"])
def test_revisits_are_places_passed_apart_from_each_other_and_best_per_metre_first(scenario) -> None:
    most = 0
    for env, offer in decisions(scenario, 12):
        slots = FIRST_REVISIT + np.flatnonzero(offer.legal[FIRST_REVISIT:])
        spots = offer.positions[slots]
        been = np.array(env.episode.estimates)[:, :2]
        for i, spot in enumerate(spots):
            assert np.hypot(*(been - spot).T).min() == 0.0
            assert all(np.hypot(*(spot - other)) >= 3.0 for other in spots[:i])
        assert (offer.lengths[slots] > PLACE_SPACING).all()
        worth = offer.reductions[slots] / (offer.lengths[slots] + 1.0)
        assert (np.diff(worth) <= 0.0).all()
        most = max(most, len(slots))
    assert 2 <= most <= REVISITS


def test_the_promised_reduction_is_that_of_the_foreseen_update() -> None:
    *_, (env, offer) = decisions("office", 6)
    ep, sensor = env.episode, env.scenario.sensor
    sigma = math.hypot(sensor.range_sigma, sensor.bearing_sigma * sensor.range / 2.0) / math.sqrt(5.0)
    drift = np.array([0.03, 0.03, 0.02])
    again = expected_reduction(
        ep.slam.map.mean,
        ep.slam.map.covariance,
        ep.grid,
        offer.positions[offer.legal],
        reach=6.0,
        sigma=sigma,
        drift=drift,
    )
    np.testing.assert_allclose(offer.reductions[offer.legal], again, rtol=1e-12)


def test_goals_come_back_in_their_units_in_the_robot_frame() -> None:
    for env, offer in decisions("office", 10):
        pose = env.episode.slam.map.pose
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


def test_places_are_thinned_out_and_the_first_and_the_last_are_kept() -> None:
    places = Places()
    assert places.candidates().shape == (0, 2)
    way = np.stack([np.arange(0.0, 200.0, 0.1), np.zeros(2000)], axis=1)
    for position in way:
        places.pass_by(position)
        places.pass_by(position + 0.05)
    candidates = places.candidates()
    assert 20 <= len(candidates) <= 32
    np.testing.assert_array_equal(candidates[0], [0.0, 0.0])
    assert candidates[-1, 0] > 200.0 - 2 * PLACE_SPACING
    assert (np.diff(candidates[:, 0]) >= PLACE_SPACING).all()


# -- the driver ----------------------------------------------------------------------------------------------------


def why_handed_back(env, slot: int, goal: np.ndarray) -> str:
    ep = env.episode
    if slot == LOOK:
        return "looked"
    if math.dist(ep.slam.map.pose[:2], goal) < ARRIVED:
        return "arrived"
    if ep.over:
        return "over"
    field = distance_field(ep.grid, ep.slam.map.pose[:2], env.scenario.robot.radius + goals.CLEARANCE)
    if len(field.path(goal)) == 0:
        return "lost"
    unseen = float(ep.grid.expected_area(goal[None], env.scenario.beams.range)[0])
    return "out of date" if slot <= FRONTIERS and unseen < WORTH_SEEING else "stuck"


def test_goals_are_reached_lost_or_out_of_date_and_hardly_ever_given_up() -> None:
    reasons: list[str] = []
    for seed, scenario in enumerate(["office", "office", "aliased", "hall", "hall", "crowd"]):
        env, rng = explore(scenario), np.random.default_rng(seed)
        _, info = env.reset(seed=seed)
        while not env.episode.over:
            slot = random_action(env, info, rng)
            goal, far = env.goals.positions[slot], env.goals.lengths[slot]
            *_, info = env.step(slot)
            reasons.append(why_handed_back(env, slot, goal))
            # half the greatest speed and a turn on the spot, or as long as it takes to see that nothing helps
            assert info["ticks"] <= 20.0 * far + 2 * STUCK_TICKS + 64
            assert len(env.episode.path) == 0
    count = {reason: reasons.count(reason) for reason in set(reasons)}
    assert count["arrived"] >= 0.4 * len(reasons) and count["out of date"] >= 5, count
    assert count.get("stuck", 0) <= 0.05 * len(reasons), count


def test_a_revisit_where_nobody_walks_arrives() -> None:
    env = explore(replace(get_scenario("hall"), budget=10**6))
    for seed in range(4):
        *_, (_, _, _, _, info) = episode(env, 5, seed=seed)
        slots = np.flatnonzero(info["action_mask"][FIRST_REVISIT:]) + FIRST_REVISIT
        goal = env.goals.positions[slots[0]]
        env.step(int(slots[0]))
        assert math.dist(env.episode.slam.map.pose[:2], goal) < ARRIVED


def test_looking_around_turns_once_on_the_spot() -> None:
    env = explore("hall")
    env.reset(seed=0)
    turned = []
    env.watch(lambda watched: turned.append(watched.episode.odometry.motion[2]))
    start = env.episode.world.pose
    *_, info = env.step(LOOK)
    assert len(turned) == info["ticks"]
    assert sum(turned[:-1]) < 2.0 * math.pi <= sum(turned)
    assert math.dist(start[:2], env.episode.world.pose[:2]) < 0.1


def test_looking_around_is_given_up_by_a_robot_that_cannot_turn() -> None:
    robot = RobotSpec(max_angular_acceleration=1e-3)
    env = explore(short(400, robot=robot))
    env.reset(seed=0)
    assert env.step(LOOK)[-1]["ticks"] == math.ceil(4.0 * math.pi / (robot.max_turn * env.scenario.dynamics.tick))


def test_a_goal_is_given_up_by_a_robot_that_cannot_move() -> None:
    env = explore(short(400, robot=RobotSpec(max_acceleration=1e-6, max_angular_acceleration=1e-6)))
    _, info = env.reset(seed=0)
    slot = np.flatnonzero(info["action_mask"])[1]
    assert env.step(slot)[-1]["ticks"] == STUCK_TICKS + 1


def test_the_length_left_is_measured_along_the_path() -> None:
    path = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0]])
    for position, left in [
        ((0, 0), 7.0),
        ((1, 0), 6.0),
        ((3.9, 0), 3.1),
        ((4, 2), 1.0),
        ((2, 0.5), 5.5),
        ((4, 4), 1.0),
    ]:
        assert driver._length_left(path, np.array(position, float)) == pytest.approx(left)
    assert driver._length_left(np.zeros((2, 2)), np.array([0.3, 0.4])) == pytest.approx(0.5)


def test_a_goal_that_no_path_leads_to_costs_one_tick_at_rest() -> None:
    env, calls = explore("office"), []
    env.reset(seed=0)
    before = env.episode.world.pose
    carry_out(env.episode, 1, np.array([500.0, 500.0]), lambda: calls.append(env.episode.ticks))
    assert calls == [1]
    np.testing.assert_allclose(env.episode.world.pose, before, atol=1e-9)


def test_a_goal_ends_with_the_budget_in_its_middle() -> None:
    env = explore(short(5, "hall"))
    _, info = env.reset(seed=0)
    *_, terminated, _, info = env.step(int(np.flatnonzero(info["action_mask"])[-1]))
    assert terminated and info["ticks"] == 5


def test_the_path_is_there_while_it_is_followed() -> None:
    env, paths = explore("office"), []
    _, info = env.reset(seed=0)
    env.watch(lambda watched: paths.append(len(watched.episode.path)))
    slot = int(np.flatnonzero(info["action_mask"])[1])
    *_, info = env.step(slot)
    assert len(paths) == info["ticks"] and min(paths) >= 2 and len(env.episode.path) == 0
