"""A robot that is carried away: what is done to it, what it notices, and how it finds back."""

from dataclasses import replace

import numpy as np
import pytest

from slam_gym.association import gcbb
from slam_gym.envs.explore import ExploreEnv
from slam_gym.geometry import compose
from slam_gym.scenarios import KidnappingSpec, Scenario
from slam_gym.simulation.kidnapping import pose_is_right
from slam_gym.slam.relocation import relocate_by
from slam_gym.types import Landmarks, Locality, Relocation, Scan
from tests.rollouts import differences, explore, short

BUDGET = 300


def kidnapped(**settings) -> Scenario:
    return short(BUDGET, "kidnapped", kidnapping=KidnappingSpec(**settings))


def nearest_frontier(env: ExploreEnv, world: int) -> dict:
    """Drive one episode to its end; its quality."""
    _, info = env.reset(seed=world, options={"world": world})
    terminated = False
    while not terminated:
        legal = np.flatnonzero(info["action_mask"])
        _, _, terminated, _, info = env.step(int(legal[1]) if len(legal) > 1 else 0)
    return info["map_quality"]


def test_without_relocation_the_robot_never_finds_back_and_with_it_it_does() -> None:
    lost, found = explore(kidnapped()), explore(kidnapped(), relocation="gcbb")
    for world in range(3):
        without, with_it = nearest_frontier(lost, world), nearest_frontier(found, world)
        assert without["kidnapped"] == with_it["kidnapped"] == 1.0
        assert without["recovered"] == 0.0 and without["ticks_astray"] == BUDGET / 2
        assert with_it["recovered"] == with_it["relocations_right"] == 1.0 and with_it["relocations_wrong"] == 0.0
        assert with_it["ticks_astray"] < 30 and with_it["map_error"] < without["map_error"]
        estimate = compose(found.episode.base, found.episode.estimates[-1])
        assert pose_is_right(estimate, found.episode.poses[-1])


def test_nothing_is_learned_while_the_robot_is_lost() -> None:
    def nobody_knows(scan: Scan, landmarks: Landmarks, locality: Locality | None) -> Relocation:
        answer = gcbb(scan, landmarks, locality)
        return replace(answer, min_pairings=len(scan) + 1)

    env = explore(kidnapped(), relocation=nobody_knows)
    seen: list[tuple[bool, int, int]] = []
    env.watch(lambda env: seen.append((env.episode.slam.lost, env.episode.slam.map.n, env.episode.grid.cells.sum())))
    assert nearest_frontier(env, 0)["recovered"] == 0.0
    while_lost = [state[1:] for state in seen if state[0]]
    assert len(while_lost) > BUDGET / 4 and len(set(while_lost)) == 1


@pytest.mark.parametrize("inside", [True, False])
def test_the_robot_is_carried_where_it_is_said_to_be(inside) -> None:
    env = explore(kidnapped(at=0.4, inside=inside, distance=4.0))
    for world in range(3):
        env.reset(seed=world, options={"world": world})
        rng, terminated = np.random.default_rng(world), False
        while not terminated:
            legal = np.flatnonzero(env.action_masks())
            terminated = env.step(int(rng.choice(legal)))[2]
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


def test_a_kidnapping_is_the_same_each_time() -> None:
    one, other = (explore(kidnapped(), relocation="gcbb") for _ in range(2))
    assert not differences(nearest_frontier(one, 1), nearest_frontier(other, 1))
    np.testing.assert_array_equal(one.episode.poses, other.episode.poses)
    replayed = explore(kidnapped(), relocation="gcbb")
    replayed.restore(one.snapshot())
    np.testing.assert_array_equal(one.episode.estimates, replayed.episode.estimates)


def test_relocation_does_no_harm_where_nobody_is_carried_away() -> None:
    env = explore(short(BUDGET, "office"), relocation="gcbb")
    for world in range(3):
        quality = nearest_frontier(env, world)
        assert quality["kidnapped"] == quality["relocations_wrong"] == 0.0 and quality["ate"] < 0.2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"relocation": "oracle"}, "unknown relocator 'oracle'; known: .*gcbb"),
        ({"relocation": "gcbb", "relocation_locality": "rooms"}, "locality: 'rooms' is none of"),
    ],
)
def test_bad_arguments_are_named(arguments, message) -> None:
    with pytest.raises(ValueError, match=message):
        explore(**arguments)


@pytest.mark.parametrize("settings", [{"at": 0.0}, {"at": 1.0}, {"at": np.nan}, {"distance": -1.0}])
def test_bad_settings_are_named(settings) -> None:
    with pytest.raises(ValueError, match=f"KidnappingSpec.{next(iter(settings))}"):
        KidnappingSpec(**settings)
    with pytest.raises(ValueError, match="probability"):
        relocate_by("gcbb", probability=0.0)
