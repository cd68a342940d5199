"""The legend of a scene: every symbol with the words for it, drawn by the same code as the scene."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from slam_gym.metrics.association import Decision
from slam_gym.rendering import symbols
from slam_gym.rendering.canvas import Canvas, pygame, text
from slam_gym.rendering.scene import Scene, draw_scene
from slam_gym.types import Array

_ROW, _COLUMN = 20, 186  # [pixels] height of an entry, width of a group
_SYMBOL = (40, 16)  # [pixels] room for one symbol
_Paint = Callable[[Canvas], None]  # on a canvas of that size with one metre a pixel


class _Entry(NamedTuple):
    words: str
    paint: _Paint
    only_with: str = ""  # the field of the scene without which the entry is left out


def _scene(**fields: Any) -> _Paint:
    arrays: dict[str, Any] = {name: np.array(value) for name, value in fields.items()}
    scene = Scene(**arrays)
    return lambda canvas: draw_scene(canvas, scene, 1.0)


def _landmark(provisional: bool) -> _Paint:
    spread = [[[34.0, 5.0], [5.0, 7.0]]]
    return _scene(landmarks=[[20.0, 8.0]], landmark_covariances=spread, provisional=[provisional])


def _decision(code: Decision) -> _Paint:
    paired = [12.0, 8.0] if code in (Decision.RIGHT, Decision.WRONG) else [math.nan, math.nan]
    robot, point = np.array([2.0, 8.0]), np.array([[28.0, 8.0]])
    return lambda canvas: symbols.decisions(canvas, robot, point, np.array([paired]), np.array([int(code)]))


def _cells(canvas: Canvas) -> None:
    square: Array = np.array([[0.0, 3.0], [10.0, 3.0], [10.0, 13.0], [0.0, 13.0]])
    for x, colour in ((6.0, symbols.FREE_CELL), (16.0, symbols.WALL_CELL), (26.0, symbols.UNKNOWN_CELL)):
        canvas.polygons(square[None] + [x, 0.0], colour, symbols.LINE)


_THREE_KINDS = _scene(features=[[7.0, 8.0], [20.0, 8.0], [33.0, 8.0]], kinds=[0, 1, 2])
_TRUE_ROBOT = _scene(true_trail=[[2.0, 8.0], [28.0, 8.0]], true_pose=[28.0, 8.0, 0.0])
_ESTIMATED_ROBOT = _scene(trail=[[2.0, 8.0], [18.0, 8.0]], pose=[25.0, 8.0, 0.0])
_PAIR = _scene(
    landmarks=[[6.0, 4.0], [34.0, 12.0]],
    landmark_covariances=np.zeros((2, 2, 2)),
    provisional=[False, False],
    covisibility=[[0, 1]],
)
_GROUPS: dict[str, tuple[_Entry, ...]] = {
    "True world": (
        _Entry("corner, jamb, pillar", _THREE_KINDS),
        _Entry("robot and its trail", _TRUE_ROBOT),
        _Entry("furniture", _scene(furniture=[[20.0, 8.0, 20.0, 10.0, 0.0]]), "furniture"),
        _Entry("person", _scene(people=[[20.0, 8.0, 6.0]]), "people"),
    ),
    "Estimate": (
        _Entry("mapped feature, 95 %", _landmark(provisional=False)),
        _Entry("not confirmed yet", _landmark(provisional=True)),
        _Entry("seen together", _PAIR, "covisibility"),
        _Entry("robot and its trail", _ESTIMATED_ROBOT),
        _Entry("free, wall, unknown", _cells, "grid"),
        _Entry("plan, goals on offer", _scene(path=[[1.0, 8.0], [21.0, 8.0]], goals=[[35.0, 8.0]]), "goals"),
    ),
    "Measurements of this tick": (
        _Entry("paired, right", _decision(Decision.RIGHT)),
        _Entry("paired, wrong", _decision(Decision.WRONG)),
        _Entry("new feature", _decision(Decision.NEW)),
        _Entry("spurious, accepted", _decision(Decision.SPURIOUS)),
        _Entry("discarded", _decision(Decision.DISCARDED)),
    ),
}


def shown_in(scene: Scene) -> frozenset[str]:
    """Which of the fields are not empty that decide about an entry."""
    wanted = {entry.only_with for entries in _GROUPS.values() for entry in entries} - {""}
    fields = {name: getattr(scene, name) for name in wanted}
    return frozenset(name for name, value in fields.items() if value is not None and len(value))


@functools.lru_cache(maxsize=16)
def legend(shown: frozenset[str], stacked: bool) -> Any:
    """A surface with the entries for what is `shown`: the groups stacked, or side by side."""
    groups = {
        name: [entry for entry in entries if entry.only_with in shown | {""}] for name, entries in _GROUPS.items()
    }
    heights = [_ROW * (1 + len(entries)) for entries in groups.values()]
    size = (_COLUMN, sum(heights) + 8 * (len(groups) - 1)) if stacked else (_COLUMN * len(groups), max(heights))
    surface = pygame.Surface(size, depth=32)
    surface.fill(symbols.PAPER)
    x, y = 0, 0
    for (name, entries), height in zip(groups.items(), heights):
        surface.blit(text(name, 12, symbols.INK, bold=True), (x, y))
        for row, entry in enumerate(entries, start=1):
            canvas = Canvas(_SYMBOL, (0.0, 0.0), 1.0, symbols.PAPER)
            entry.paint(canvas)
            surface.blit(canvas.picture(), (x, y + row * _ROW))
            surface.blit(text(entry.words, 12, symbols.MUTED), (x + _SYMBOL[0] + 8, y + row * _ROW + 1))
        x, y = (x, y + height + 8) if stacked else (x + _COLUMN, y)
    return surface
