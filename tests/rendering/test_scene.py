"""Scenes: what an episode and a log come to, and that it is drawn in its colours, where it stands."""

import numpy as np
import pytest

from slam_gym.geometry import compose, observe
from slam_gym.metrics.association import Decision
from slam_gym.rendering import symbols
from slam_gym.rendering.canvas import Canvas, pixels
from slam_gym.rendering.scene import (
    DrawnGrid,
    Scene,
    draw_scene,
    legend,
    paired_positions,
    scene_of_episode,
    scene_of_log,
    shown_in,
)
from slam_gym.simulation.association_runs import DrivenRun, nearest_frontier
from tests.rollouts import associate, episode, explore, short
from tests.simulation.episodes import site_of

pytest.importorskip("pygame")

SIZE, SCALE = (1000, 800), 100.0


def drawn(**fields) -> np.ndarray:
    """A scene of 10 × 8 m."""
    canvas = Canvas(SIZE, (0.0, 0.0), SCALE, symbols.PAPER)
    draw_scene(canvas, Scene(**fields))
    return pixels(canvas.picture())


def pixel(picture, x, y) -> tuple[int, ...]:
    return tuple(picture[int(SIZE[1] - SCALE * y), int(SCALE * x)].tolist())


def count(picture, colour) -> int:
    return int((picture == colour).all(axis=2).sum())


def test_the_true_robot_and_its_estimate_stand_where_they_are() -> None:
    picture = drawn(true_pose=np.array([2.0, 6.0, 0.0]), pose=np.array([8.0, 2.0, 0.0]))
    for colour, where in ((symbols.INK, [2.0, 6.0]), (symbols.MAPPED, [8.0, 2.0])):
        rows, columns = np.nonzero((picture == colour).all(axis=2))
        np.testing.assert_allclose([columns.mean() / SCALE, (SIZE[1] - rows.mean()) / SCALE], where, atol=0.15)
    nowhere = drawn(true_pose=np.full(3, np.nan), pose=np.array([8.0, 2.0, 0.0]))
    assert count(nowhere, symbols.INK) == 0


@pytest.mark.parametrize("decision", list(Decision)[:4])
def test_each_decision_shows_in_its_colour(decision) -> None:
    at, nothing = np.array([[2.0, 2.0]]), np.full((1, 2), np.nan)
    picture = drawn(scan_points=at, decisions=np.array([int(decision)]), paired_positions=nothing)
    for other in list(Decision)[:4]:
        assert (count(picture, symbols.DECISIONS[other]) > 0) == (other == decision)
    assert pixel(picture, 2.0, 2.0) == symbols.DECISIONS[decision]


def test_wrong_pairings_have_a_form_of_their_own() -> None:
    forms, at, feature = [], np.array([[8.0, 8.0]]), np.array([[32.0, 32.0]])
    for code in (Decision.RIGHT, Decision.WRONG):
        canvas = Canvas((40, 40), (0.0, 0.0), 1.0, symbols.PAPER)
        symbols.decisions(canvas, at[0], at, feature, np.array([code]))
        forms.append((pixels(canvas.picture()) != symbols.PAPER).any(axis=2))  # whatever the colour
    assert (forms[0] != forms[1]).sum() > 0.2 * forms[0].sum()


def test_the_plan_is_drawn_from_where_the_robot_is_by_now() -> None:
    path = np.array([[1.0, 2.0], [9.0, 2.0]])
    far, near = (drawn(path=path, pose=np.array([x, 2.0, 0.0])) for x in (1.0, 7.0))
    assert count(far, symbols.PLAN) > 2.5 * count(near, symbols.PLAN) > 0
    assert count(drawn(path=path[:1]), symbols.PLAN) > 0  # a goal that is reached has no way left


def test_the_scene_of_an_episode_is_in_the_world_and_that_of_a_log_in_the_frame_of_its_start() -> None:
    env = explore(short(60), action="twist")
    for _ in episode(env, 40):
        pass
    run = env.episode
    scene = scene_of_episode(run, goals=np.zeros((1, 2)), covisibility=True)
    np.testing.assert_allclose(scene.pose, compose(run.base, run.slam.map.pose))
    np.testing.assert_allclose(observe(run.base, scene.landmarks), run.slam.map.positions, atol=1e-9)
    np.testing.assert_allclose(scene.goals, run.base[None, :2])
    np.testing.assert_array_equal(scene.trail.shape, scene.true_trail.shape)
    assert scene.covisibility.max() < len(scene.landmarks) == len(scene.provisional)
    paired, ids = paired_positions(run.last_step, run.slam.map.ids, scene.landmarks), run.slam.map.ids
    assert np.isfinite(paired).all(axis=1).sum() >= 3
    steps, seen = run.last_step.ids[np.isfinite(paired).all(axis=1)], paired[np.isfinite(paired).all(axis=1)]
    np.testing.assert_array_equal(seen, scene.landmarks[(ids == steps[:, None]).argmax(axis=1)])
    logged = associate("corridor")
    logged.reset(seed=0)
    scene = scene_of_log(logged.run)
    np.testing.assert_allclose(scene.pose, logged.run.slam.map.pose)
    assert scene.grid is None and len(scene.features) == len(logged.run.targets)


def test_the_trail_of_a_long_drive_is_a_line_that_is_cut_where_the_robot_was_carried() -> None:
    run = DrivenRun(short(2), site_of(short(2)), nearest_frontier, np.random.default_rng(0))
    ahead = [np.array([0.1 * k + 50.0 * (k > 15_000), 0.0, 0.0]) for k in range(20_000)]
    run.poses, run.estimates = ahead, ahead
    trail = scene_of_episode(run).true_trail
    assert len(trail) < 2_000 and np.flatnonzero(np.isnan(trail[:, 0])).size == 1
    np.testing.assert_array_equal(trail[-1], ahead[-1][:2])


ALL = frozenset({"furniture", "people", "covisibility", "grid", "goals"})


def test_what_is_not_in_the_scene_is_not_in_the_legend() -> None:
    assert shown_in(Scene()) == frozenset()
    grid = DrawnGrid(np.zeros((2, 2), np.uint8), np.zeros(3), 0.2)
    scene = Scene(
        people=np.ones((1, 3)),
        furniture=np.ones((1, 5)),
        goals=np.ones((1, 2)),
        covisibility=np.zeros((1, 2), int),
        grid=grid,
    )
    assert shown_in(scene) == ALL
    for colour, name in ((symbols.PERSON[0], "people"), (symbols.FURNITURE[0], "furniture"), (symbols.PLAN, "goals")):
        for shown in (ALL, ALL - {name}):
            assert (pixels(legend(shown, True)) == colour).all(axis=2).any() == (name in shown)
