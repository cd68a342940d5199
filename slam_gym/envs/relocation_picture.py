"""Pictures of a relocation: the map with what the scan may be of, the scan itself, and the interpretation tree."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from slam_gym.association.located import locate
from slam_gym.association.relocation_tree import hypothesis
from slam_gym.association.relocation_walk import RelocationWalk
from slam_gym.envs import symbols
from slam_gym.envs.drawing import Canvas, pygame, text
from slam_gym.envs.kidnappings import Kidnapped, MappedWorld
from slam_gym.envs.relocation_panel import draw_panel
from slam_gym.envs.window import Window
from slam_gym.geometry import compose, rotate_covariances, transform
from slam_gym.metrics.association import Decision
from slam_gym.types import NONE, Array, IntArray

_SIZE, _PANEL = (1140, 720), 420  # [pixels] picture; width of the panel
_INSET = 190  # [pixels] side of the scan
_MARGIN = 0.7  # [m] around the plan
_BESIDE = ((0.7, -0.7), (-0.7, -0.7), (0.7, 0.7), (-0.7, 0.7), (1.0, 0.0), (-1.0, 0.0), (0.0, -1.0), (0.0, 1.0))


class RelocationRenderer:
    """Draws the decision at hand: left the whole map, in a corner the scan as the robot sees it, right the tree."""

    def __init__(self, mode: Literal["rgb_array", "human"], fps: float) -> None:
        self._window = Window(mode, _SIZE, "slam_gym: relocation", fps)

    def draw(
        self, walk: RelocationWalk, mapped: MappedWorld, kidnapped: Kidnapped, figures: tuple[tuple[str, str], ...]
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
    _badges(picture, [(x * scale, size[1] - y * scale) for x, y in (landmarks[shown] - np.array(low)).tolist()])
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
    canvas.discs(points[~known], 3.2, symbols.PAPER, symbols.MUTED, 1.0)
    symbols.decisions(canvas, pose[:2], points[known], ends[known], codes[known])
    turned = rotate_covariances(mapped.base[2], located.covariance[None, :2, :2])
    canvas.ellipses(pose[None, :2], turned, None, symbols.MAPPED)
    symbols.robot_estimate(canvas, pose, 0.2)


def _draw_scan(picture: Any, corner: tuple[int, int], walk: RelocationWalk, codes: IntArray) -> None:
    """The scan in R, x up: what is decided, what is to be decided now, what is left."""
    points = walk.tree.scan.points[:, ::-1] * np.array([-1.0, 1.0])  # x ahead, drawn upwards
    reach = 1.15 * max(float(np.abs(points).max(initial=1.0)), 1.0)
    canvas = Canvas((_INSET, _INSET), (-reach, -reach), 0.5 * _INSET / reach, symbols.PAPER)
    for code, colour in ((NONE, symbols.MUTED), *symbols.DECISIONS.items()):
        of_code = points[codes == code]
        if len(of_code):
            rays = np.concatenate([np.zeros_like(of_code), of_code], axis=1)
            canvas.segments(rays, symbols.LINE, 0.8)
            canvas.discs(of_code, 3.4, symbols.PAPER if code == NONE else colour, colour, 1.2)
    symbols.robot_estimate(canvas, np.array([0.0, 0.0, 0.5 * np.pi]), 0.0)
    if walk.measurement is not None:
        canvas.discs(points[walk.measurement][None], 5.0, symbols.CHOICE, symbols.INK, 1.4)
    picture.blit(canvas.picture(), corner)
    pygame.draw.rect(picture, symbols.LINE, (*corner, _INSET, _INSET), 1)
    picture.blit(text("the scan", 12, symbols.MUTED), (corner[0] + 8, corner[1] + 6))


def _badges(picture: Any, points: list[tuple[float, float]]) -> None:
    """The number of each action beside its candidate, where there is room."""
    taken: list[tuple[float, float]] = []
    for action, (x, y) in enumerate(points):
        spots = [(x + r * dx, y + r * dy) for r in (15, 26) for dx, dy in _BESIDE]
        clear = [spot for spot in spots if all(math.dist(spot, other) > 16 for other in taken)]
        spot = (clear or spots)[0]
        taken.append(spot)
        label = text(str(action), 11, symbols.PAPER, bold=True)
        pygame.draw.circle(picture, symbols.PLAN, spot, 8)
        picture.blit(label, (round(spot[0]) - label.get_width() // 2, round(spot[1]) - label.get_height() // 2))
