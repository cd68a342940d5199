"""Pictures of a relocation: the map with what the scan may be of, the scan itself, and the interpretation tree."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from slam_gym.association.relocation.location import locate
from slam_gym.association.relocation.tree import hypothesis
from slam_gym.association.relocation.walk import RelocationWalk
from slam_gym.geometry import compose, rotate_covariances, transform
from slam_gym.metrics.association import Decision
from slam_gym.rendering import symbols
from slam_gym.rendering.canvas import Canvas, pygame, text
from slam_gym.rendering.figures_panel import Figures, badges
from slam_gym.rendering.relocation_panel import draw_panel
from slam_gym.rendering.window import Window
from slam_gym.simulation.relocation_problems import Kidnapped, MappedWorld
from slam_gym.types import NONE, Array, IntArray

_SIZE, _PANEL = (1140, 720), 420  # [pixels] picture; width of the panel
_INSET = 190  # [pixels] side of the scan
_MARGIN = 0.7  # [m] around the plan


class RelocationRenderer:
    """Draws the decision at hand: left the whole map, in a corner the scan as the robot sees it, right the tree."""

    def __init__(self, mode: Literal["rgb_array", "human"], fps: float) -> None:
        self._window = Window(mode, _SIZE, "slam_gym: relocation", fps)

    def draw(
        self, walk: RelocationWalk, mapped: MappedWorld, kidnapped: Kidnapped, figures: Figures
    ) -> NDArray[np.uint8] | None:
        """The picture (h, w, 3); None in `human` mode, where it goes to the window."""
        picture = pygame.Surface(_SIZE, depth=32)
        picture.fill(symbols.PAPER)
        width, height = _SIZE[0] - _PANEL, _SIZE[1]
        codes = _codes(walk, kidnapped)
        _draw_map(picture, (width, height), walk, mapped, kidnapped, codes)
        _draw_scan(picture, (10, height - _INSET - 10), walk, codes)
        draw_panel(picture, (width, 0, _PANEL, height), walk, kidnapped.features, codes, figures)
        return self._window.show(picture)

    def close(self) -> None:
        """Close the window, if there is one. May be called twice."""
        self._window.close()


def _codes(walk: RelocationWalk, kidnapped: Kidnapped) -> IntArray:
    """(m,) `Decision` on each measurement, NONE where it is undecided."""
    features, right = hypothesis(walk.tree, walk.node), kidnapped.features
    codes = np.where(features == right, int(Decision.RIGHT), int(Decision.WRONG))
    codes[features == NONE] = Decision.DISCARDED
    codes[~walk.node.decided] = NONE
    return codes


def _draw_map(
    picture: Any,
    size: tuple[int, int],
    walk: RelocationWalk,
    mapped: MappedWorld,
    kidnapped: Kidnapped,
    codes: IntArray,
) -> None:
    x0, y0, x1, y1 = mapped.site.plan.bounds + _MARGIN * np.array([-1.0, -1.0, 1.0, 1.0])
    room = size[0], size[1] - _INSET
    scale = float(min(room[0] / (x1 - x0), room[1] / (y1 - y0)))
    low = 0.5 * (x0 + x1) - 0.5 * size[0] / scale, 0.5 * (y0 + y1) - (0.5 * room[1] + _INSET) / scale
    canvas = Canvas(size, (float(low[0]), float(low[1])), scale, symbols.PAPER)
    landmarks = transform(mapped.base, mapped.landmarks.positions)
    canvas.segments(mapped.site.plan.walls, symbols.LINE, 1.6)
    spread = rotate_covariances(mapped.base[2], mapped.landmarks.covariances)
    symbols.uncertainties(canvas, landmarks, spread, np.zeros(len(landmarks), np.bool_))
    symbols.landmarks(canvas, landmarks, np.zeros(len(landmarks), np.bool_), 2.3)
    if walk.node.features.size:
        first = int(walk.node.features[0])
        local = mapped.landmarks.positions[:0] if walk.tree.locality is None else walk.tree.locality.of(first)
        canvas.discs(landmarks[local.astype(np.int64).ravel()], 4.6, None, symbols.PROVISIONAL, 0.9)
    if kidnapped.inside:
        symbols.robot_body(canvas, kidnapped.true_pose, 0.2)
    _draw_hypothesis(canvas, walk, mapped, landmarks, codes)
    shown = _shown(walk)
    canvas.discs(landmarks[shown], 5.4, None, symbols.PLAN, 1.8)
    picture.blit(canvas.picture(), (0, 0))
    badges(picture, [(x * scale, size[1] - y * scale) for x, y in (landmarks[shown] - np.array(low)).tolist()])
    where = "the robot is not in this map" if not kidnapped.inside else mapped.site.plan.name
    picture.blit(text(where, 13, symbols.MUTED), (14, 10))


def _shown(walk: RelocationWalk) -> IntArray:
    return np.empty(0, np.int64) if walk.offer is None else walk.offer.features[: walk.spec.candidates]


def _draw_hypothesis(
    canvas: Canvas, walk: RelocationWalk, mapped: MappedWorld, landmarks: Array, codes: IntArray
) -> None:
    """The features paired; and where they put the robot and its measurements, once there are two."""
    features = hypothesis(walk.tree, walk.node)
    paired = features != NONE
    if paired.sum() < 2:
        for code in (Decision.RIGHT, Decision.WRONG):
            canvas.discs(landmarks[features[codes == code]], 4.2, symbols.DECISIONS[code], symbols.PAPER, 0.8)
        return
    located = locate(walk.tree.scan, walk.tree.landmarks, features)
    if not np.isfinite(located.pose).all():
        return
    pose = compose(mapped.base, located.pose)
    points, ends = transform(pose, walk.tree.scan.points), np.full((len(features), 2), np.nan)
    ends[paired] = landmarks[features[paired]]
    known = codes != NONE
    symbols.undecided(canvas, points[~known])
    symbols.decisions(canvas, pose[:2], points[known], ends[known], codes[known])
    turned = rotate_covariances(mapped.base[2], located.covariance[None, :2, :2])
    canvas.ellipses(pose[None, :2], turned, None, symbols.MAPPED)
    symbols.robot_estimate(canvas, pose, 0.2)


def _draw_scan(picture: Any, corner: tuple[int, int], walk: RelocationWalk, codes: IntArray) -> None:
    """The scan in R, x up: what is decided, what is to be decided now, what is left."""
    points = walk.tree.scan.points[:, ::-1] * np.array([-1.0, 1.0])  # x ahead, drawn upwards
    reach = 1.3 * max(float(np.abs(points).max(initial=1.0)), 1.0)
    canvas = Canvas((_INSET, _INSET), (-reach, -reach), 0.5 * _INSET / reach, symbols.PAPER)
    canvas.segments(np.concatenate([np.zeros_like(points), points], axis=1), symbols.LINE, 0.8)
    symbols.undecided(canvas, points[codes == NONE])
    for code, colour in symbols.DECISIONS.items():
        canvas.discs(points[codes == code], 3.4, colour, symbols.PAPER, 0.8)
    symbols.robot_estimate(canvas, np.array([0.0, 0.0, 0.5 * np.pi]), 0.0)
    if walk.measurement is not None:
        symbols.choice(canvas, points[walk.measurement])
    picture.blit(canvas.picture(), corner)
    pygame.draw.rect(picture, symbols.LINE, (*corner, _INSET, _INSET), 1)
    picture.blit(text("the scan", 12, symbols.MUTED), (corner[0] + 8, corner[1] + 6))
