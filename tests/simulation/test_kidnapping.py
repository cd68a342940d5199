"""A robot that is carried away: what is done to it, what it notices, and how it finds back."""

import functools
from dataclasses import replace

import numpy as np
import pytest

from slam_gym.association import gcbb
from slam_gym.envs.explore import ExploreEnv
from slam_gym.geometry import compose
from slam_gym.scenarios import KidnappingSpec, Scenario
from slam_gym.simulation.kidnapping import HEADING, POSITION, Kidnapping, is_right
from slam_gym.types import Array, Landmarks, Locality, Relocation, Scan
from tests.rollouts import episode, explore, short

BUDGET = 300


def kidnapped(**settings) -> Scenario:
    return short(BUDGET, "kidnapped", kidnapping=KidnappingSpec(**settings))


# --- what is done to the robot ----------------------------------------------------------------------------------------

CELLS = np.array([[float(x), 0.0] for x in range(20)])
FREE = CELLS, 0.2, np.empty((0, 5))
TRAIL = [np.array([x, 0.0, 0.0]) for x in np.linspace(0.0, 9.0, 91)]


def destination(tick: int = 50, been: list[Array] = TRAIL, seed: int = 0, **settings) -> Array | None:
    kidnapping = Kidnapping(KidnappingSpec(**settings), 100)
    return kidnapping.destination(tick, been, FREE, np.random.default_rng(seed))


def test_inside_is_a_place_where_the_robot_has_been_and_far_enough_away() -> None:
    drawn = np.array([destination(seed=seed, distance=4.0) for seed in range(200)])
    been = np.array(TRAIL)[:, 0]
    assert np.isin(drawn[:, 0], been[been <= 5.0]).all() and len(np.unique(drawn[:, 0])) > 30
    assert drawn[:, 2].min() < -3.0 and drawn[:, 2].max() > 3.0  # facing anywhere


def test_nobody_is_put_into_furniture() -> None:
    free = CELLS, 0.2, np.array([[19.0, 0.0, 1.5, 1.5, 0.0]])  # at the place that is farthest away
    kidnapping = Kidnapping(KidnappingSpec(inside=False), 100)
    pose = kidnapping.destination(50, TRAIL, free, np.random.default_rng(0))
    assert pose is not None and pose[0] == 18.0 and destination(inside=False)[0] == 19.0
    for seed in range(30):
        free, kidnapping = (CELLS, 0.2, np.array([[2.0, 0.0, 1.5, 1.5, 0.0]])), Kidnapping(KidnappingSpec(), 100)
        pose = kidnapping.destination(50, TRAIL, free, np.random.default_rng(seed))
        assert pose is not None and abs(pose[0] - 2.0) > 0.9


def test_it_happens_once_when_it_is_due_and_never_without_a_spec() -> None:
    kidnapping, rng = Kidnapping(KidnappingSpec(at=0.5), 100), np.random.default_rng(0)
    carried = [tick for tick in range(100) if kidnapping.destination(tick, TRAIL, FREE, rng) is not None]
    assert carried == [50] and kidnapping.happened == 50
    nobody, before = Kidnapping(None, 100), rng.bit_generator.state
    assert all(nobody.destination(tick, TRAIL, FREE, rng) is None for tick in range(100))
    assert nobody.happened is None and rng.bit_generator.state == before


def test_a_robot_has_recovered_when_its_pose_is_right_and_it_is_not_lost() -> None:
    kidnapping, here, elsewhere = Kidnapping(KidnappingSpec(), 10), np.zeros(3), np.array([3.0, 0.0, 0.0])
    kidnapping.judge(4, here, here, 0, False)
    assert kidnapping.recovered is None  # nothing has happened yet
    kidnapping.destination(5, TRAIL, FREE, np.random.default_rng(0))
    kidnapping.judge(5, elsewhere, here, 0, False)
    kidnapping.judge(6, here, here, 0, True)  # by chance, and it does not know
    assert kidnapping.recovered is None
    kidnapping.judge(7, elsewhere, here, 1, False)
    kidnapping.judge(8, here, here, 2, False)
    kidnapping.judge(9, elsewhere, here, 2, False)
    assert (kidnapping.recovered, kidnapping.right, kidnapping.wrong) == (8, 1, 1)


def test_a_pose_is_right_up_to_its_tolerances_in_position_and_heading() -> None:
    true = np.array([2.0, -1.0, 3.1])
    for share, right in ((0.99, True), (1.01, False)):
        for off in ([share * POSITION, 0.0, 0.0], [0.0, -share * POSITION, 0.0], [0.0, 0.0, share * HEADING]):
            assert is_right(compose(true, np.array(off)), true) is right
            assert is_right(true, compose(true, np.array(off))) is right


# --- what becomes of it -----------------------------------------------------------------------------------------------


def nearest_frontier(env: ExploreEnv, observation: dict, info: dict) -> int:
    """The first goal on offer after looking around, if there is one."""
    return int(np.flatnonzero(info["action_mask"])[:2][-1])


def quality_of(env: ExploreEnv, world: int) -> dict:
    """Of one episode, driven to its end."""
    *_, (*_, info) = episode(env, seed=world, options={"world": world}, choose=nearest_frontier)
    return info["map_quality"]


@functools.cache
def played(world: int, relocation: str | None) -> tuple[ExploreEnv, dict]:
    """The environment after an episode with a kidnapping in it, and its quality; not to be stepped any more."""
    env = explore(kidnapped(), relocation=relocation)
    return env, quality_of(env, world)


def test_without_relocation_the_robot_never_finds_back_and_with_it_it_does() -> None:
    for world in range(3):
        (_, without), (found, with_it) = played(world, None), played(world, "gcbb")
        assert without["kidnapped"] == with_it["kidnapped"] == 1.0
        assert without["recovered"] == 0.0 and without["ticks_astray"] == BUDGET / 2
        assert with_it["recovered"] == with_it["relocations_right"] == 1.0 and with_it["relocations_wrong"] == 0.0
        assert with_it["ticks_astray"] < 30 and with_it["map_error"] < without["map_error"]
        estimate = compose(found.episode.base, found.episode.estimates[-1])
        assert is_right(estimate, found.episode.poses[-1])


def test_without_an_atlas_nothing_is_learned_while_the_robot_is_lost() -> None:
    def nobody_knows(scan: Scan, landmarks: Landmarks, locality: Locality | None) -> Relocation:
        answer = gcbb(scan, landmarks, locality)
        return replace(answer, min_pairings=len(scan) + 1)

    env = explore(kidnapped(), relocation=nobody_knows, atlas=False)
    seen: list[tuple[bool, int, int]] = []
    env.watch(lambda env: seen.append((env.episode.slam.lost, env.episode.slam.map.n, env.episode.grid.cells.sum())))
    assert quality_of(env, 0)["recovered"] == 0.0
    while_lost = [state[1:] for state in seen if state[0]]
    assert len(while_lost) > BUDGET / 4 and len(set(while_lost)) == 1


@pytest.mark.parametrize("inside", [True, False])
def test_the_robot_is_carried_where_it_is_said_to_be(inside) -> None:
    env = explore(kidnapped(at=0.4, inside=inside, distance=4.0))
    for world in range(2):
        for _ in episode(env, seed=world, options={"world": world}):
            pass
        poses, at = np.array(env.episode.poses), env.episode.kidnapping.happened
        assert at == 0.4 * BUDGET and len(poses) == BUDGET + 1
        steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
        assert steps.argmax() == at - 1 and np.delete(steps, at - 1).max() < 0.2
        before = np.hypot(*(poses[:at, :2] - poses[at, :2]).T)
        apart = np.hypot(*(poses[:at, :2] - poses[at - 1, :2]).T).max()
        if inside:
            assert before.min() < 0.5 and before[-1] > min(4.0, apart) - 0.5
        else:
            cells = env.episode.site.cells
            farthest = np.hypot(*(cells[:, None] - poses[:at:10, :2]).transpose(2, 0, 1)).min(axis=1).max()
            assert before.min() > 0.8 * farthest - 0.5
