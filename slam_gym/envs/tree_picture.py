"""Pictures of a walk through the interpretation tree: its levels and branches, beside the map that they are of."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from slam_gym.association.walk import Walk
from slam_gym.envs import symbols
from slam_gym.envs.drawing import Canvas, pygame, text
from slam_gym.envs.rendering import Frame, draw_map
from slam_gym.envs.runs import Run
from slam_gym.envs.scene import scene_of
from slam_gym.envs.tree_panel import draw_panel
from slam_gym.envs.verdicts import Verdicts, decisions
from slam_gym.geometry import compose, rotate_covariances, transform
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
        self.mode, self.size, self.fps = mode, size, fps
        self._window: Any = None
        self._clock: Any = None

    def draw(
        self, run: Run, walk: Walk | None, verdicts: Verdicts, figures: tuple[tuple[str, str], ...]
    ) -> NDArray[np.uint8] | None:
        """The picture (h, w, 3); None in `human` mode, where it goes to the window."""
        picture = pygame.Surface(self.size, depth=32)
        picture.fill(symbols.PAPER)
        width, height = self.size
        _draw_surroundings(picture, (width - _PANEL, height), run, walk, verdicts)
        draw_panel(picture, (width - _PANEL, 0, _PANEL, height), run, walk, verdicts, figures)
        if self.mode == "human":
            self._show(picture)
            return None
        return np.frombuffer(pygame.image.tobytes(picture, "RGB"), np.uint8).reshape(height, width, 3).copy()

    def close(self) -> None:
        """Close the window, if there is one. May be called twice; drawing again opens it anew."""
        if self._window is not None:
            pygame.display.quit()
            self._window = self._clock = None

    def _show(self, picture: Any) -> None:
        if self._window is None:
            pygame.display.init()
            self._window = pygame.display.set_mode(self.size)
            pygame.display.set_caption("slam_gym: the interpretation tree")
            self._clock = pygame.time.Clock()
        self._window.blit(picture, (0, 0))
        pygame.event.pump()
        pygame.display.flip()
        self._clock.tick(self.fps)


def _draw_surroundings(picture: Any, size: tuple[int, int], run: Run, walk: Walk | None, verdicts: Verdicts) -> None:
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
    for action, point in enumerate(labels):
        x, y = (point - np.array(low)) * scale
        _badge(picture, action, (round(x), round(size[1] - y)))


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
    canvas.discs(later, 3.4, symbols.PAPER, symbols.INK, 1.2)
    canvas.ellipses(centres, rotate_covariances(pose[2], spread), None, symbols.PLAN, 1.6)
    here = transform(pose, tree.scan.points[i : i + 1])
    for centre in centres:
        canvas.dashes(np.stack([here[0], centre]), symbols.PLAN, 1.6, 6.0)
    canvas.discs(here, 5.0, symbols.CHOICE, symbols.INK, 1.4)
    return centres


def _badge(picture: Any, action: int, at: tuple[int, int]) -> None:
    """An action's number beside its candidate: each in a direction of its own, since candidates lie close together."""
    angle = math.radians(50.0 - 72.0 * action)
    x, y = at[0] + round(24 * math.cos(angle)), at[1] - round(24 * math.sin(angle))
    label = text(str(action), 12, symbols.PAPER, bold=True)
    pygame.draw.aaline(picture, symbols.PLAN, at, (x, y))
    pygame.draw.circle(picture, symbols.PLAN, (x, y), 9)
    picture.blit(label, (x - label.get_width() // 2, y - label.get_height() // 2))
