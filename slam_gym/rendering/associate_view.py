"""Pictures of a walk through the interpretation tree: its levels and branches, beside the map that they are of."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from slam_gym.association.tracking.walk import Walk
from slam_gym.geometry import compose, rotate_covariances, transform
from slam_gym.rendering import symbols
from slam_gym.rendering.canvas import Canvas, pygame
from slam_gym.rendering.explore_view import Frame, draw_map
from slam_gym.rendering.figures_panel import Figures, badges
from slam_gym.rendering.scene import scene_of
from slam_gym.rendering.tree_panel import draw_panel
from slam_gym.rendering.window import Window
from slam_gym.simulation.association_runs import AssociationRun
from slam_gym.simulation.verdicts import Verdicts, decisions
from slam_gym.types import NONE, Array

_PANEL = 420  # [pixels] width of the tree
_MARGIN = 60  # [pixels] around the robot and what it sees
_LEAST = 6.0  # [m] shown from edge to edge


class TreeRenderer:
    """Draws the decision at hand: left the robot's surroundings, right the tree.

    In `rgb_array` mode needs no display; in `human` mode keeps a window that follows the clock at `fps`.
    """

    def __init__(
        self, mode: Literal["rgb_array", "human"], size: tuple[int, int] = (1140, 720), fps: float = 4.0
    ) -> None:
        self.size = size
        self._window = Window(mode, size, "slam_gym: the interpretation tree", fps)

    def draw(
        self, run: AssociationRun, walk: Walk | None, verdicts: Verdicts, figures: Figures
    ) -> NDArray[np.uint8] | None:
        """The picture (h, w, 3); None in `human` mode, where it goes to the window."""
        picture = pygame.Surface(self.size, depth=32)
        picture.fill(symbols.PAPER)
        width, height = self.size
        _draw_surroundings(picture, (width - _PANEL, height), run, walk, verdicts)
        draw_panel(picture, (width - _PANEL, 0, _PANEL, height), run, walk, verdicts, figures)
        return self._window.show(picture)

    def close(self) -> None:
        """Close the window, if there is one. May be called twice; drawing again opens it anew."""
        self._window.close()


def _draw_surroundings(
    picture: Any, size: tuple[int, int], run: AssociationRun, walk: Walk | None, verdicts: Verdicts
) -> None:
    base, frame = scene_of(run)
    pose = compose(base, run.slam.map.pose)
    low, scale = _view(size, np.vstack([pose[:2], transform(pose, run.scan.points)]))
    canvas = Canvas(size, low, scale, symbols.UNKNOWN_CELL if frame.cells is not None else symbols.PAPER)
    if walk is None:
        draw_map(canvas, frame)
        picture.blit(canvas.picture(), (0, 0))
        return
    draw_map(canvas, _with_decisions(frame, pose, walk, verdicts))
    labels = _draw_choice(canvas, pose, walk)
    picture.blit(canvas.picture(), (0, 0))
    badges(picture, [(x * scale, size[1] - y * scale) for x, y in (labels - np.array(low)).tolist()])


def _view(size: tuple[int, int], points: Array) -> tuple[tuple[float, float], float]:
    """Lower left corner [m] and scale [pixels/m] of a view that holds the points (k, 2)."""
    room = np.array(size) - 2 * _MARGIN
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    scale = float((room / np.maximum(np.ptp(points, axis=0), _LEAST)).min())
    corner = middle - 0.5 * np.array(size) / scale
    return (float(corner[0]), float(corner[1])), scale


def _with_decisions(frame: Frame, pose: Array, walk: Walk, verdicts: Verdicts) -> Frame:
    """The frame with what has been decided about the scan so far."""
    tree, rows = walk.tree, walk.decided
    codes = decisions(walk, verdicts)
    done = np.flatnonzero(codes != NONE)
    paired = np.full((len(rows), 2), np.nan)
    has = rows != NONE
    paired[has] = transform(pose, tree.prediction.positions[rows[has]])
    points = transform(pose, tree.scan.points[done])
    return replace(frame, scan_points=points, decisions=codes[done], paired_positions=paired[done])


def _draw_choice(canvas: Canvas, pose: Array, walk: Walk) -> Array:
    """The measurement to decide, what is undecided, and the gates of the candidates, whose centres are returned."""
    tree, i = walk.tree, walk.measurement
    rows = walk.rows
    centres = transform(pose, tree.prediction.positions[rows])
    spread = tree.prediction.covariances[rows] + tree.scan.covariances[i]
    later = transform(pose, tree.scan.points[walk.candidates.measurements[walk.level + 1 :]])
    symbols.undecided(canvas, later)
    canvas.ellipses(centres, rotate_covariances(pose[2], spread), None, symbols.PLAN, 1.6)
    here = transform(pose, tree.scan.points[i : i + 1])[0]
    for centre in centres:
        canvas.dashes(np.stack([here, centre]), symbols.PLAN, 1.6, 6.0)
    symbols.choice(canvas, here)
    return centres
