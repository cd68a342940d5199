"""The driver that carries goals out: when it hands back, what that costs, and what it leaves behind."""

import math
from collections import Counter
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from slam_gym.navigation.explored_grid import FREE, WALL
from slam_gym.navigation.planner import distance_field
from slam_gym.scenarios import get_scenario
from slam_gym.simulation import driver, goals
from slam_gym.simulation.driver import ARRIVED, STUCK_TICKS, commands
from slam_gym.simulation.goals import FRONTIERS, LOOK, WORTH_SEEING
from slam_gym.world.physics import RobotSpec
from tests.navigation.test_planner import centre, grid_of
from tests.rollouts import episode, explore, random_action, short

FIRST_REVISIT = 1 + FRONTIERS


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


class CarriedOut(NamedTuple):
    """A goal of a random episode, and what came of it."""

    slot: int
    far: float  # [m] of the way there
    ticks: int
    why: str  # it was handed back
    noted: int  # how often more it was tried in vain
    over: bool  # the episode


@pytest.fixture(scope="module")
def carried() -> list[CarriedOut]:
    """Every goal of six random episodes."""
    out = []
    for seed, scenario in enumerate(["office", "office", "aliased", "hall", "hall", "crowd"]):
        env, rng = explore(scenario), np.random.default_rng(seed)
        _, info = env.reset(seed=seed)
        while not env.episode.over:
            slot = random_action(env, info, rng)
            goal, far = env.goals.positions[slot].copy(), env.goals.lengths[slot]
            before = env.episode.tried.times(goal[None])[0]
            *_, info = env.step(slot)
            noted = env.episode.tried.times(goal[None])[0] - before
            out.append(CarriedOut(slot, far, info["ticks"], why_handed_back(env, slot, goal), noted, env.episode.over))
            assert len(env.episode.path) == 0
    return out


def test_goals_are_reached_lost_or_out_of_date_and_hardly_ever_given_up(carried) -> None:
    # half the greatest speed and a turn on the spot, or as long as it takes to see that nothing helps
    assert all(goal.ticks <= 20.0 * goal.far + 2 * STUCK_TICKS + 64 for goal in carried)
    count = Counter(goal.why for goal in carried)
    assert count["arrived"] >= 0.4 * len(carried) and count["out of date"] >= 5, count
    assert count["stuck"] <= 0.05 * len(carried), count


def test_a_robot_that_turns_slowly_is_waited_for() -> None:
    env = explore(replace(get_scenario("office"), robot=RobotSpec(max_turn=0.5)))
    (_, info), rng, reasons = env.reset(seed=0), np.random.default_rng(0), []
    while len(reasons) < 12 and not env.episode.over:
        slot = random_action(env, info, rng)
        goal = env.goals.positions[slot].copy()
        *_, info = env.step(slot)
        reasons.append(why_handed_back(env, slot, goal))
    assert len(reasons) > 5 and "stuck" not in reasons, reasons


def test_frontiers_that_do_not_go_away_are_noted_and_others_are_not(carried) -> None:
    for goal in carried:
        if goal.slot == LOOK or goal.slot >= FIRST_REVISIT:
            assert goal.noted == 0
        elif not goal.over:
            assert goal.noted == 0 if goal.why == "out of date" else goal.noted <= 1
    assert sum(goal.noted > 0 for goal in carried) > 1


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
    env = explore(short(400, robot=RobotSpec(max_acceleration=1e-3, max_angular_acceleration=1e-3)))
    _, info = env.reset(seed=0)
    slot = np.flatnonzero(info["action_mask"])[1]
    assert env.step(slot)[-1]["ticks"] == STUCK_TICKS + 1


def test_a_goal_that_no_path_leads_to_costs_one_tick_at_rest() -> None:
    env = explore("office")
    env.reset(seed=0)
    before = env.episode.world.pose
    for slot in (FRONTIERS, FIRST_REVISIT):
        for command in commands(env.episode, slot, np.array([500.0, 500.0])):
            env.episode.tick(*command)
    assert env.episode.ticks == 2 and env.episode.tried.times(np.full((1, 2), 500.0))[0] == 1  # as a frontier only
    np.testing.assert_allclose(env.episode.world.pose, before, atol=1e-9)


def walled_up(grid, point: np.ndarray, radius: float) -> None:
    """A wall freshly drawn around a point, as a person or a wrong pose draws it."""
    cells, evidence, *_ = grid._layers
    rows, columns = np.indices(cells.shape)
    x, y = grid.origin[0] + (columns + 0.5) * grid.resolution, grid.origin[1] + (rows + 0.5) * grid.resolution
    near = np.hypot(x - point[0], y - point[1]) < radius
    cells[near], evidence[near] = WALL, 8


@pytest.mark.parametrize(("radius", "arrives"), [(0.6, True), (2.5, False)])
def test_a_goal_that_is_walled_up_gives_way_to_a_place_nearby_if_there_is_one(radius, arrives) -> None:
    env = explore(replace(get_scenario("hall"), budget=10**6))
    for _ in episode(env, 6, seed=1):
        pass
    ep = env.episode
    goal = max(np.array(ep.estimates)[:, :2], key=lambda place: math.dist(place, ep.slam.map.pose[:2]))
    assert math.dist(goal, ep.slam.map.pose[:2]) > 4.0
    walled_up(ep.grid, goal, radius)
    ticks = ep.ticks
    for command in commands(ep, FIRST_REVISIT, goal):
        ep.tick(*command)
    left = math.dist(ep.slam.map.pose[:2], goal)
    assert left < driver.NEAR_ENOUGH + ARRIVED if arrives else (ep.ticks == ticks + 1 and left > 3.0)


def test_a_robot_that_stands_near_its_goal_squeezes_through_the_passage_between() -> None:
    cells = np.full((11, 21), FREE, np.uint8)
    cells[:, 10], cells[5, 10] = WALL, FREE
    grid = grid_of(cells)
    here, goal = centre(grid, 5, 8), centre(grid, 5, 12)
    near, through = (driver.way_to(grid, 0.2, here, goal, least=least) for least in (0.0, ARRIVED))
    assert math.dist(near[-1], here) < ARRIVED and math.dist(through[-1], goal) < 0.1
