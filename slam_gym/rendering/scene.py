"""A scene: the truth, the robot's estimate and its latest decisions, in one frame; and the legend."""

import functools
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_gym.association.prediction import SlamStep
from slam_gym.geometry import compose, observe, relative, rotate_covariances, transform
from slam_gym.metrics.association import Decision
from slam_gym.rendering import symbols
from slam_gym.rendering.canvas import TEXT, Canvas, pygame, text
from slam_gym.rendering.plot import trail
from slam_gym.simulation.association_runs import LoggedRun
from slam_gym.simulation.episode import Episode
from slam_gym.types import NO_ID, Array, BoolArray, IntArray

_TRAIL = 400  # points of a trail that are drawn


class DrawnGrid(NamedTuple):
    """The explored grid."""

    cells: NDArray[np.uint8]  # (h, w) 0 unknown, 1 free, 2 wall; row 0 lowest
    corner: Array  # (3,) pose of its lower left corner
    resolution: float  # [m] side of a cell


class Scene(NamedTuple):
    """The contents of a picture of the plane, in one frame: W, or B where W is unknown. All fields are optional."""

    walls: Array = np.empty((0, 4))  # (s, 4) [m] x1 y1 x2 y2
    features: Array = np.empty((0, 2))  # (N, 2) [m] true
    kinds: IntArray = np.empty(0, np.int64)  # (N,) 0 corner, 1 door jamb, 2 pillar
    furniture: Array = np.empty((0, 5))  # (f, 5) x, y, length, width [m], heading [rad]
    people: Array = np.empty((0, 3))  # (p, 3) x, y, radius [m]
    robot_radius: float = 0.2  # [m]
    true_pose: Array = np.full(3, np.nan)  # (3,) [m, m, rad]; NaN where unknown
    true_trail: Array = np.empty((0, 2))  # (t, 2) [m]
    pose: Array = np.full(3, np.nan)  # (3,) estimated; NaN where unknown
    position_covariance: Array = np.zeros((2, 2))  # (2, 2) [m²] of that pose
    trail: Array = np.empty((0, 2))  # (t, 2) [m] estimated
    landmarks: Array = np.empty((0, 2))  # (n, 2) [m] the map
    landmark_covariances: Array = np.empty((0, 2, 2))  # (n, 2, 2) [m²]
    provisional: BoolArray = np.empty(0, np.bool_)  # (n,) not confirmed yet
    scan_points: Array = np.empty((0, 2))  # (m, 2) [m] measurements, seen from the estimated pose
    decisions: IntArray = np.empty(0, np.int64)  # (m,) `metrics.association.Decision`, or UNDECIDED
    paired_positions: Array = np.empty((0, 2))  # (m, 2) [m] of the landmark with which each is paired, NaN if none
    path: Array = np.empty((0, 2))  # (p, 2) [m] that the robot is going to follow
    goals: Array = np.empty((0, 2))  # (g, 2) [m] that are legal
    covisibility: IntArray = np.empty((0, 2), np.int64)  # (e, 2) pairs of landmarks seen together
    grid: DrawnGrid | None = None


def mark_size(canvas: Canvas) -> float:
    """The size of marks, which grow with the scale, so that they do not overlap where it is small."""
    return min(1.8, max(0.75, canvas.scale / 36.0))


def draw_scene(canvas: Canvas, scene: Scene, size: float | None = None) -> None:
    """Draw, in this order, explored cells, uncertainties, the true world, the map, decisions and the robot.

    `size` scales the marks (default: see `mark_size`).
    """
    size = mark_size(canvas) if size is None else size
    if scene.grid is not None:
        canvas.surface.fill(symbols.UNKNOWN_CELL)
        canvas.cells(scene.grid.cells, symbols.FREE_CELL, symbols.WALL_CELL, *scene.grid[1:])
    symbols.uncertainties(canvas, scene.landmarks, scene.landmark_covariances, scene.provisional)
    symbols.covisibility(canvas, scene.landmarks[scene.covisibility])
    symbols.furniture(canvas, scene.furniture)
    canvas.segments(scene.walls, symbols.WALL, 1.6 * max(size, 0.7))
    canvas.polyline(scene.true_trail, symbols.TRAIL, 2.0 * size)
    canvas.polyline(scene.trail, symbols.ESTIMATED_TRAIL, 1.2)
    is_located = np.isfinite(scene.pose).all()
    here = scene.pose[:2] if is_located else np.zeros(2)
    symbols.plan(canvas, here, scene.path, scene.goals, size)
    symbols.true_features(canvas, scene.features, scene.kinds, 3.0 * size)
    symbols.landmarks(canvas, scene.landmarks, scene.provisional, 2.3 * size)
    symbols.people(canvas, scene.people)
    if is_located and scene.position_covariance.any():
        canvas.ellipses(scene.pose[None, :2], scene.position_covariance[None], None, symbols.MAPPED)
    symbols.decisions(canvas, here, scene.scan_points, scene.paired_positions, scene.decisions, size)
    symbols.robot_body(canvas, scene.true_pose, scene.robot_radius, 6.0 * size)
    if is_located:
        symbols.robot_estimate(canvas, scene.pose, scene.robot_radius, 6.0 * size)


def scene_of_episode(episode: Episode, *, goals: Array | None = None, covisibility: bool = False) -> Scene:
    """The present state of an episode in W, without its scan; `goals` (g, 2) in B are the legal ones."""
    base, slam_map, plan = episode.base, episode.slam.map, episode.site.plan
    corner = compose(base, np.array([*episode.grid.origin, 0.0]))
    return Scene(
        walls=plan.walls,
        features=plan.features.positions,
        kinds=plan.features.kinds,
        furniture=episode.world.furniture,
        people=episode.world.people,
        robot_radius=episode.scenario.robot.radius,
        true_pose=episode.world.pose,
        true_trail=trail(episode.poses, _TRAIL),
        pose=compose(base, slam_map.pose),
        position_covariance=rotate_covariances(base[2], slam_map.pose_covariance[None, :2, :2])[0],
        trail=transform(base, trail(episode.estimates, _TRAIL)),
        landmarks=transform(base, slam_map.positions),
        landmark_covariances=rotate_covariances(base[2], slam_map.covariances),
        provisional=slam_map.provisional,
        path=transform(base, episode.path),
        goals=np.empty((0, 2)) if goals is None else transform(base, goals),
        covisibility=episode.slam.covisibility.edges().pairs if covisibility else np.empty((0, 2), np.int64),
        grid=DrawnGrid(episode.grid.cells, corner, episode.grid.resolution),
    )


def scene_of_log(run: LoggedRun) -> Scene:
    """The present state of a run on a log in B, without its scan. It has no walls, and perhaps no true robot."""
    slam_map, targets = run.slam.map, run.targets
    poses = np.array([*run.poses, run.truth.pose])  # NaN where unknown
    return Scene(
        features=targets,
        kinds=np.zeros(len(targets), np.int64),
        true_pose=relative(poses[0], run.truth.pose),
        true_trail=observe(poses[0], poses[:, :2]) if np.isfinite(poses).all() else np.empty((0, 2)),
        pose=slam_map.pose,
        position_covariance=slam_map.pose_covariance[:2, :2],
        trail=np.array([*(estimate[:2] for estimate in run.estimates), slam_map.pose[:2]]),
        landmarks=slam_map.positions,
        landmark_covariances=slam_map.covariances,
        provisional=slam_map.provisional,
    )


def paired_positions(step: SlamStep, ids: IntArray, landmarks: Array) -> Array:
    """(m, 2) the one of `landmarks` (n, 2), with `ids` (n,), with which each measurement was paired, NaN if none."""
    positions = np.full((len(step.ids), 2), np.nan)
    paired = (step.ids != NO_ID) & ~step.created & np.isin(step.ids, ids)
    positions[paired] = landmarks[np.searchsorted(ids, step.ids[paired])]
    return positions


# -- legend ----------------------------------------------------------------------------------------------------------

_ROW, _COLUMN = 22, 202  # [pixels] height of an entry, width of a group
_SYMBOL = (40, 16)  # [pixels] size of a symbol


def _symbol(**fields: Any) -> Scene:
    arrays: dict[str, Any] = {name: np.array(value) for name, value in fields.items()}
    return Scene(**arrays)


def _landmark(provisional: bool) -> Scene:
    spread = [[[34.0, 5.0], [5.0, 7.0]]]
    return _symbol(landmarks=[[20.0, 0.0]], landmark_covariances=spread, provisional=[provisional])


def _decision(code: Decision, paired: float = math.nan) -> Scene:
    return _symbol(scan_points=[[28.0, 0.0]], decisions=[code], paired_positions=[[paired, 0.0]])


_PAIR = _symbol(
    landmarks=[[6.0, -4.0], [34.0, 4.0]],
    landmark_covariances=np.zeros((2, 2, 2)),
    provisional=[False, False],
    covisibility=[[0, 1]],
)
_CELLS = np.tile(np.array([0, 2, 1, 1, 1, 1, 2, 0], np.uint8), (4, 1))
_GRID = Scene(grid=DrawnGrid(_CELLS, np.array([0.0, -10.0, 0.0]), 5.0))
_GROUPS: dict[str, dict[str, Scene]] = {  # words, and the scene that is their symbol, with one metre per pixel
    "True world": {
        "corner, jamb, pillar": _symbol(features=[[7.0, 0.0], [20.0, 0.0], [33.0, 0.0]], kinds=[0, 1, 2]),
        "robot and its trail": _symbol(true_trail=[[2.0, 0.0], [28.0, 0.0]], true_pose=[28.0, 0.0, 0.0]),
        "furniture": _symbol(furniture=[[20.0, 0.0, 20.0, 10.0, 0.0]]),
        "person": _symbol(people=[[20.0, 0.0, 6.0]]),
    },
    "Estimate": {
        "mapped feature, 95 %": _landmark(provisional=False),
        "not confirmed yet": _landmark(provisional=True),
        "seen together": _PAIR,
        "robot and its trail": _symbol(trail=[[2.0, 0.0], [18.0, 0.0]], pose=[25.0, 0.0, 0.0]),
        "free, wall, unknown": _GRID,
        "plan, goals on offer": _symbol(path=[[1.0, 0.0], [21.0, 0.0]], goals=[[35.0, 0.0]]),
    },
    "Measurements of this tick": {
        "paired, right": _decision(Decision.RIGHT, 12.0),
        "paired, wrong": _decision(Decision.WRONG, 12.0),
        "new feature": _decision(Decision.NEW),
        "spurious, accepted": _decision(Decision.SPURIOUS),
        "discarded": _decision(Decision.DISCARDED),
    },
}


def shown_in(scene: Scene) -> frozenset[str]:
    """The non-empty fields of a scene among those without which the entries that show them are left out."""
    fields = {name: getattr(scene, name) for name in ("furniture", "people", "covisibility", "grid", "goals")}
    return frozenset(name for name, value in fields.items() if value is not None and len(value))


@functools.lru_cache(maxsize=16)
def legend(shown: frozenset[str], stacked: bool) -> Any:
    """A surface with the entries for the fields that are `shown`; groups are stacked, or side by side."""
    groups = [
        (name, {words: symbol for words, symbol in entries.items() if shown_in(symbol) <= shown})
        for name, entries in _GROUPS.items()
    ]
    heights = [_ROW * (1 + len(entries)) for _, entries in groups]
    size = (_COLUMN, sum(heights) + 8 * (len(groups) - 1)) if stacked else (_COLUMN * len(groups), max(heights))
    surface = pygame.Surface(size, depth=32)
    surface.fill(symbols.PAPER)
    x, y = 0, 0
    for (name, entries), height in zip(groups, heights):
        surface.blit(text(name, TEXT, symbols.INK, bold=True), (x, y))
        for row, (words, symbol) in enumerate(entries.items(), start=1):
            canvas = Canvas(_SYMBOL, (0.0, -8.0), 1.0, symbols.PAPER)
            draw_scene(canvas, symbol, 1.0)
            surface.blit(canvas.picture(), (x, y + row * _ROW))
            surface.blit(text(words, TEXT, symbols.MUTED), (x + _SYMBOL[0] + 8, y + row * _ROW))
        x, y = (x, y + height + 8) if stacked else (x + _COLUMN, y)
    return surface
