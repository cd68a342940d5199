"""Colours and symbols of pictures, which the map and its legend share."""

import math

import numpy as np

from slam_gym.geometry import transform
from slam_gym.metrics.association import Decision
from slam_gym.navigation.pursuit import on_path
from slam_gym.rendering.canvas import Canvas, Colour
from slam_gym.simulation.judged import UNDECIDED
from slam_gym.types import Array, BoolArray, IntArray

PAPER: Colour = (255, 255, 255)
INK: Colour = (38, 43, 51)
MUTED: Colour = (100, 109, 121)
LINE: Colour = (205, 210, 217)
LATER: Colour = (140, 147, 158)  # candidates that are not on offer now
UNKNOWN_CELL: Colour = (229, 232, 237)
FREE_CELL: Colour = (255, 255, 255)
WALL_CELL: Colour = (143, 170, 208)
WALL: Colour = (62, 68, 79)
FURNITURE: tuple[Colour, Colour] = ((243, 236, 224), (193, 177, 150))  # fill, line
PERSON: tuple[Colour, Colour] = ((251, 222, 199), (216, 142, 91))
TRUE_FEATURE: Colour = (132, 141, 154)
MAPPED: Colour = (31, 95, 173)
UNCERTAIN: Colour = (216, 230, 247)
PROVISIONAL: Colour = (138, 176, 221)
COVISIBLE: Colour = (150, 180, 222)
TRAIL: Colour = (172, 178, 187)
ESTIMATED_TRAIL: Colour = (92, 143, 206)
PLAN: Colour = (0, 124, 128)
BAND: Colour = (237, 243, 250)  # behind the current level
TRUTH: Colour = (120, 56, 168)  # around the right branch
CHOICE: Colour = (255, 196, 61)  # the measurement to decide now
DECISIONS: dict[int, Colour] = {
    Decision.RIGHT: (0, 150, 105),
    Decision.WRONG: (208, 32, 58),
    Decision.NEW: (236, 156, 0),
    Decision.SPURIOUS: (138, 63, 178),
    Decision.DISCARDED: (150, 157, 168),
    Decision.UNJUDGED: (150, 157, 168),
}

_SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
_DIAMOND = 1.3 * np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]])
_TURN = np.linspace(0.0, 2.0 * math.pi, 25)[:-1]
_CIRCLE = 1.15 * np.stack([np.cos(_TURN), np.sin(_TURN)], axis=1)
_OUTLINES = (_SQUARE, _DIAMOND, _CIRCLE)  # of corners, door jambs, pillars
_ARM = np.array([[0.0, 0.4], [0.6, 1.0], [1.0, 0.6]])
_CROSS = np.concatenate([_ARM, _ARM[:, ::-1] * [1, -1], -_ARM, _ARM[:, ::-1] * [-1, 1]])
_TRIANGLE = np.array([[0.0, 1.2], [1.05, -0.75], [-1.05, -0.75]])


def true_features(canvas: Canvas, positions: Array, kinds: IntArray, radius: float) -> None:
    """Draw hollow marks of `radius` [pixels] at positions (N, 2), with a shape for each kind (N,)."""
    for kind, outline in enumerate(_OUTLINES):
        canvas.markers(positions[kinds == kind], radius * outline, PAPER, TRUE_FEATURE)


def uncertainties(canvas: Canvas, positions: Array, covariances: Array, provisional: BoolArray) -> None:
    """Draw 95 % ellipses (n, 2), (n, 2, 2): tinted for confirmed features, outlines for provisional ones."""
    canvas.tint(positions[~provisional], covariances[~provisional], UNCERTAIN)
    canvas.ellipses(positions, covariances, None, PROVISIONAL)


def landmarks(canvas: Canvas, positions: Array, provisional: BoolArray, radius: float) -> None:
    """Draw mapped features (n, 2): dots of `radius` [pixels], hollow where `provisional` (n,)."""
    canvas.discs(positions[~provisional], radius, MAPPED)
    canvas.discs(positions[provisional], radius, PAPER, MAPPED, 0.8)


def covisibility(canvas: Canvas, pairs: Array) -> None:
    """Draw lines between landmarks seen together (e, 2, 2), thinner and paler where there are many."""
    pale = min(1.0, max(0.55, 300.0 / max(len(pairs), 1)))
    canvas.segments(pairs.reshape(-1, 4), _mixed(COVISIBLE, pale), 1.4 if len(pairs) < 20 else 0.7)


def decisions(canvas: Canvas, robot: Array, points: Array, paired: Array, codes: IntArray, size: float = 1.0) -> None:
    """Draw measurements (m, 2) as rays from `robot` (2,), with lines to the landmarks `paired` (m, 2).

    `codes` (m,) are values of `metrics.association.Decision`, or UNDECIDED; `size` scales the marks.
    """
    for code, colour in DECISIONS.items():
        chosen = codes == code
        rays = np.concatenate([np.broadcast_to(robot, (chosen.sum(), 2)), points[chosen]], axis=1)
        canvas.segments(rays, _mixed(colour, 0.6), 0.9)
    known = np.isfinite(paired).all(axis=1)
    for code, point, feature in zip(codes[known].tolist(), points[known], paired[known]):
        decided_line(canvas, np.stack([point, feature]), code, 2.4 * size)
    marks(canvas, points, codes, size)


def decided_line(canvas: Canvas, ends: Array, code: int, width: float) -> None:
    """Draw a line (2, 2) in the colour of a decision; wrong ones are dashed."""
    if code == Decision.WRONG:
        canvas.dashes(ends, DECISIONS[code], width)
    else:
        canvas.segments(ends.reshape(1, 4), DECISIONS[code], width)


def marks(canvas: Canvas, points: Array, codes: IntArray, size: float = 1.0) -> None:
    """Draw measurements (m, 2) in the colours of the decisions on them (m,): as crosses if wrong, as triangles if
    spurious, else as dots, which are hollow if undecided."""
    canvas.discs(points[codes == UNDECIDED], 3.4 * size, PAPER, INK, 1.2)
    for code, colour in DECISIONS.items():
        if code == Decision.WRONG:
            canvas.markers(points[codes == code], 5.0 * size * _CROSS, colour, PAPER, 0.8)
        elif code == Decision.SPURIOUS:
            canvas.markers(points[codes == code], 4.2 * size * _TRIANGLE, colour, PAPER, 0.8)
        else:
            canvas.discs(points[codes == code], 3.2 * size, colour, PAPER, 0.8)


def choice(canvas: Canvas, point: Array, size: float = 1.0) -> None:
    """Draw the measurement (2,) that is to be decided now."""
    canvas.discs(point[None], 5.0 * size, CHOICE, INK, 1.4)


def robot_body(canvas: Canvas, pose: Array, radius: float, min_pixels: float = 6.0) -> None:
    """Draw the true robot, pose (3,), radius [m]: a disc with a wedge that points ahead; nothing if unknown."""
    if not np.isfinite(pose).all():
        return
    pixels = max(radius * canvas.scale, min_pixels)
    canvas.discs(pose[None, :2], pixels, INK, PAPER, 1.0)
    wedge = np.array([[0.85, 0.0], [-0.6, 0.4], [-0.6, -0.4]]) * (pixels / canvas.scale)
    canvas.polygons(transform(pose, wedge)[None], PAPER)


def robot_estimate(canvas: Canvas, pose: Array, radius: float, min_pixels: float = 6.0) -> None:
    """Draw the estimated robot, pose (3,), radius [m]: a ring with its heading."""
    pixels = max(radius * canvas.scale, min_pixels)
    canvas.discs(pose[None, :2], pixels + 1.5, None, MAPPED, 1.6)
    nose = np.array([[pixels + 2.0, 0.0], [pixels + 8.0, 0.0]]) / canvas.scale
    canvas.polyline(transform(pose, nose), MAPPED, 1.8)


def plan(canvas: Canvas, robot: Array, path: Array, goals: Array, size: float = 1.0) -> None:
    """Draw the legal goals (g, 2), and the rest of the path (p, 2) to the chosen goal, from the robot (2,)."""
    canvas.discs(goals, 3.6 * size, PAPER, PLAN, 1.2)
    if len(path):
        canvas.dashes(_ahead(robot, path), PLAN, 2.2 * size)
        canvas.discs(path[-1:], 4.6 * size, PLAN, PAPER, 1.2)
        canvas.discs(path[-1:], 1.6 * size, PAPER)


def furniture(canvas: Canvas, boxes: Array) -> None:
    """Draw boxes (f, 5): x, y, length, width [m], heading [rad]."""
    for x, y, length, width, heading in boxes.tolist():
        corners = transform(np.array([x, y, heading]), 0.5 * _SQUARE * np.array([length, width]))
        canvas.polygons(corners[None], *FURNITURE)


def people(canvas: Canvas, discs: Array) -> None:
    """Draw people (p, 3): x, y, radius [m]."""
    for x, y, radius in discs.tolist():
        canvas.discs(np.array([[x, y]]), radius * canvas.scale, *PERSON)


def _ahead(robot: Array, path: Array) -> Array:
    """The part of a path (p, 2) beyond its point closest to the robot (2,)."""
    if len(path) < 2:
        return path
    segment, covered, _ = on_path(path, robot)
    start, along = path[segment], path[segment + 1] - path[segment]
    nearest = start + covered / max(float(np.hypot(*along)), 1e-12) * along
    return np.vstack([nearest, path[segment + 1 :]])


def _mixed(colour: Colour, fraction: float) -> Colour:
    """A colour with opacity `fraction` on white paper."""
    red, green, blue = (round(fraction * part + (1.0 - fraction) * 255) for part in colour)
    return red, green, blue
