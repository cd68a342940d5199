"""Pictures: what is drawn stands where it should and says what it should; no display is needed."""

import dataclasses
import os
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("pygame")

from slam_gym.geometry import transform
from slam_gym.metrics.association import Decision
from slam_gym.rendering import symbols
from slam_gym.rendering.canvas import SUPERSAMPLING, Canvas, pygame
from slam_gym.rendering.explore_view import Frame, Renderer
from slam_gym.rendering.side_panel import arrange

BOUNDS = np.array([0.0, 0.0, 10.0, 8.0])


def frame(**changes):
    """A room of 10 × 8 m with a robot in its middle and nothing else."""
    nothing = Frame(
        walls=np.array([[0.0, 0, 10, 0], [10, 0, 10, 8], [10, 8, 0, 8], [0, 8, 0, 0]]),
        features=np.empty((0, 2)),
        kinds=np.empty(0, np.int64),
        furniture=np.empty((0, 5)),
        people=np.empty((0, 3)),
        robot_radius=0.2,
        true_pose=np.array([5.0, 4.0, 0.3]),
        true_trail=np.empty((0, 2)),
        pose=np.array([5.0, 4.0, 0.3]),
        pose_covariance=np.zeros((3, 3)),
        trail=np.empty((0, 2)),
        landmarks=np.empty((0, 2)),
        landmark_covariances=np.empty((0, 2, 2)),
        provisional=np.empty(0, bool),
        scan_points=np.empty((0, 2)),
        decisions=np.empty(0, np.int64),
        paired_positions=np.empty((0, 2)),
        path=np.empty((0, 2)),
        goals=np.empty((0, 2)),
    )
    return dataclasses.replace(nothing, **changes)


def full_frame(rng):
    covariances = np.tile(np.diag([0.02, 0.01]), (20, 1, 1))
    landmarks = rng.uniform(1, 7, (20, 2))
    return frame(
        features=rng.uniform(1, 7, (30, 2)),
        kinds=np.arange(30) % 3,
        furniture=np.array([[2.0, 2.0, 0.8, 0.5, 0.4]]),
        people=np.array([[7.0, 6.0, 0.25]]),
        true_trail=np.array([[3.0, 4.0], [5.0, 4.0]]),
        trail=np.array([[3.0, 4.1], [5.0, 4.0]]),
        pose_covariance=np.diag([0.01, 0.02, 0.01]),
        landmarks=landmarks,
        landmark_covariances=covariances,
        provisional=np.arange(20) % 4 == 0,
        scan_points=landmarks[:6] + 0.1,
        decisions=np.arange(6),
        paired_positions=np.where(np.arange(6)[:, None] < 2, landmarks[:6], np.nan),
        path=np.array([[5.0, 4.0], [6.0, 5.0], [8.0, 5.0]]),
        goals=rng.uniform(1, 7, (4, 2)),
        covisibility=np.array([[0, 1], [1, 2]]),
        cells=rng.integers(0, 3, (40, 50)).astype(np.uint8),
        cells_origin=np.array([-5.0, -4.0]),
        cells_base=np.array([5.0, 4.0, 0.3]),
        cells_resolution=0.2,
        title="test",
        panel=(("map error", "0.5"), ("tick", "10 of 100"), ("precision", "0.98")),
    )


def map_part(picture, size=(960, 720)):
    width, height = arrange(size, BOUNDS).map_size
    return picture[:height, :width]


def pixel(picture, position, size=(960, 720)):
    """The colour at a position [m] of the map."""
    layout = arrange(size, BOUNDS)
    x, y = (np.array(position) - layout.low) * layout.scale
    return tuple(picture[int(layout.map_size[1] - y), int(x)].tolist())


def count(picture, colour):
    return int((map_part(picture) == colour).all(axis=2).sum())


def draw(*args, **changes):
    return Renderer("rgb_array", BOUNDS).draw(frame(*args, **changes))


def test_pictures_are_fresh_uint8_arrays_of_the_asked_size_and_repeatable():
    rendered = full_frame(np.random.default_rng(0))
    for size in ((960, 720), (640, 480), (500, 900)):
        renderer = Renderer("rgb_array", BOUNDS, size)
        first, second = renderer.draw(rendered), renderer.draw(rendered)
        assert first.shape == (size[1], size[0], 3) and first.dtype == np.uint8 and first.flags.writeable
        assert first is not second and not np.shares_memory(first, second)
        np.testing.assert_array_equal(first, second)


def test_the_robot_stands_at_its_true_pose():
    picture = draw(true_pose=np.array([2.0, 6.0, 0.0]), pose=np.array([8.0, 2.0, 0.0]))
    rows, columns = np.nonzero((map_part(picture) == symbols.INK).all(axis=2))
    layout = arrange((960, 720), BOUNDS)
    robot = (columns < layout.map_size[0] / 2) & (rows < layout.map_size[1] / 2)  # the scale bar is of the same colour
    centre = np.array([columns[robot].mean(), layout.map_size[1] - rows[robot].mean()]) / layout.scale + layout.low
    np.testing.assert_allclose(centre, [2.0, 6.0], atol=0.1)


@pytest.mark.parametrize("heading", [0.0, 0.7, -2.5])
def test_explored_cells_lie_where_base_and_origin_put_them(heading):
    base, origin, resolution = np.array([5.0, 4.0, heading]), np.array([-1.5, -1.0]), 0.5
    cells = np.random.default_rng(1).integers(0, 3, (4, 6)).astype(np.uint8)
    picture = draw(
        cells=cells,
        cells_origin=origin,
        cells_base=base,
        cells_resolution=resolution,
        true_pose=np.array([9.0, 1.0, 0.0]),
        pose=np.array([9.0, 1.0, 0.0]),
    )
    colours = (symbols.UNKNOWN_CELL, symbols.FREE_CELL, symbols.WALL_CELL)
    for row in range(4):
        for column in range(6):
            centre = origin + resolution * (np.array([column, row]) + 0.5)
            assert pixel(picture, transform(base, centre[None])[0]) == colours[cells[row, column]]
    outside = transform(base, (origin - 0.2)[None])[0]
    assert pixel(picture, outside) == symbols.UNKNOWN_CELL


@pytest.mark.parametrize("decision", list(Decision)[:4])
def test_each_decision_shows_in_its_colour(decision):
    at = np.array([[2.0, 2.0]])
    picture = draw(scan_points=at, decisions=np.array([int(decision)]), paired_positions=np.full((1, 2), np.nan))
    for other in list(Decision)[:4]:
        assert (count(picture, symbols.DECISIONS[other]) > 0) == (other == decision)
    assert pixel(picture, at[0]) == symbols.DECISIONS[decision]


def test_a_pairing_is_a_line_from_measurement_to_landmark():
    points, paired = np.array([[2.0, 2.0]]), np.array([[2.0, 5.0]])
    picture = draw(scan_points=points, decisions=np.array([1]), paired_positions=paired)
    assert pixel(picture, (2.0, 3.5)) == symbols.DECISIONS[Decision.WRONG]


def test_ellipses_hold_95_percent():
    rng = np.random.default_rng(2)
    covariance = np.array([[1.0, 0.6], [0.6, 0.8]])
    canvas = Canvas((800, 800), (-8.0, -8.0), 50.0, (255, 255, 255))
    canvas.ellipses(np.array([[0.5, -0.5]]), covariance[None], (0, 0, 0), None)
    painted = pygame.surfarray.array3d(canvas.surface)[:, :, 0] == 0
    samples = rng.multivariate_normal([0.5, -0.5], covariance, 20_000)
    x, y = ((samples + 8.0) * 50.0 * SUPERSAMPLING).astype(int).T
    assert 0.94 < painted[x, 800 * SUPERSAMPLING - 1 - y].mean() < 0.96


def test_the_plan_is_drawn_from_where_the_robot_is_by_now():
    path = np.array([[1.0, 2.0], [9.0, 2.0]])
    far, near = (draw(path=path, pose=np.array([x, 2.0, 0.0]), true_pose=np.array([x, 7.0, 0.0])) for x in (1.0, 7.0))
    assert count(far, symbols.PLAN) > 2.5 * count(near, symbols.PLAN) > 0
    assert count(draw(path=path[:1]), symbols.PLAN) > 0  # a goal that is reached has no way left


@pytest.mark.parametrize(
    "bounds", [(0, 0, 24, 14), (-30, 5, -22, 60), (0, 0, 0, 0), (0, 0, 300, 80), (1e4, 1e4, 1e4 + 1, 1e4 + 1)]
)
@pytest.mark.parametrize("size", [(960, 720), (400, 1200), (1600, 500)])
def test_the_plan_fits_into_the_map_and_the_panel_covers_none_of_it(bounds, size):
    layout = arrange(size, np.array(bounds, float))
    corners = (np.reshape(bounds, (2, 2)) - np.array(layout.low)) * layout.scale
    assert (corners >= 10).all() and (corners <= np.array(layout.map_size) - 10).all()
    left, top, width, height = layout.panel
    assert left >= layout.map_size[0] or top >= layout.map_size[1]
    assert (left + width, top + height) == size
    assert Renderer("rgb_array", np.array(bounds, float), size).draw(frame()).shape == (size[1], size[0], 3)


def test_bounds_may_change_between_frames():
    renderer = Renderer("rgb_array", BOUNDS)
    before = renderer.draw(frame())
    renderer.bounds = np.array([0.0, 0.0, 40.0, 30.0])
    assert (renderer.draw(frame()) != before).any()


def test_what_lies_far_outside_or_nowhere_does_no_harm():
    far = np.array([[1e9, -1e9], [2e9, 5.0]])
    picture = draw(
        landmarks=far,
        landmark_covariances=np.tile(1e12 * np.eye(2), (2, 1, 1)),
        provisional=np.array([True, False]),
        scan_points=far,
        decisions=np.array([0, 1]),
        paired_positions=np.array([[np.nan, np.nan], [3e9, 0.0]]),
        path=far,
        goals=far,
        trail=far,
    )
    assert picture.shape == (720, 960, 3)


def test_the_legend_explains_what_the_map_shows():
    rendered = full_frame(np.random.default_rng(3))
    with_all = Renderer("rgb_array", BOUNDS).draw(rendered)
    without = Renderer("rgb_array", BOUNDS).draw(dataclasses.replace(rendered, people=np.empty((0, 3))))
    width = arrange((960, 720), BOUNDS).map_size[0]
    assert (with_all[:, width:] == symbols.PERSON[0]).all(axis=2).any()
    assert not (without[:, width:] == symbols.PERSON[0]).all(axis=2).any()


def test_human_mode_keeps_a_window_until_closed(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    renderer = Renderer("human", BOUNDS, fps=1000.0)
    for _ in range(2):
        assert renderer.draw(frame()) is None
    assert pygame.display.get_surface().get_size() == (960, 720)
    renderer.close()
    renderer.close()
    assert not pygame.display.get_init()


def test_closing_twice_is_harmless_and_drawing_goes_on():
    renderer = Renderer("rgb_array", BOUNDS)
    renderer.close()
    renderer.draw(frame())
    renderer.close()
    renderer.close()
    assert renderer.draw(frame()) is not None


def test_bad_arguments_are_named():
    with pytest.raises(ValueError, match="'ansi'; known: rgb_array, human"):
        Renderer("ansi", BOUNDS)
    with pytest.raises(ValueError, match="240 pixels"):
        Renderer("rgb_array", BOUNDS, (100, 700))


def test_without_pygame_the_error_names_the_extra():
    code = "import sys; sys.modules['pygame'] = None; import slam_gym.rendering.explore_view"
    environment = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert done.returncode != 0 and "slam_gym[render]" in done.stderr
