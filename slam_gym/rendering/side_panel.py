"""What stands beside the map: the layout, the panel of figures, the legend and the scale bar."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from slam_gym.metrics.association import Decision
from slam_gym.rendering import symbols
from slam_gym.rendering.canvas import Canvas, pygame, text
from slam_gym.rendering.figures_panel import Figures, figures
from slam_gym.types import Array

_MARGIN = 16  # [pixels] around the plan, and within the panel
_ROW = 20  # [pixels]
_COLUMN = 186  # [pixels] of the legend
_BESIDE, _BELOW = 226, 172  # [pixels] width of a panel beside the map, height of one below it
_SYMBOL = (40, 16)  # [pixels] room for one symbol of the legend


@dataclass(frozen=True)
class Layout:
    """Where things go, in pixels from the upper left, and how the map is scaled."""

    map_size: tuple[int, int]
    low: tuple[float, float]  # [m] position of the map's lower left corner
    scale: float  # [pixels/m]
    panel: tuple[int, int, int, int]  # left, top, width, height

    @property
    def beside(self) -> bool:
        """The panel is beside the map, not below it."""
        return self.panel[1] == 0


def arrange(size: tuple[int, int], bounds: Array) -> Layout:
    """The layout of a picture (width, height) that shows `bounds` (4,) [m] largest: panel beside or below."""
    width, height = size
    beside = (width - _BESIDE, height), (width - _BESIDE, 0, _BESIDE, height)
    below = (width, height - _BELOW), (0, height - _BELOW, width, _BELOW)
    layouts = [_fit(area, panel, bounds) for area, panel in (beside, below)]
    return max(layouts, key=lambda layout: layout.scale)


def _fit(area: tuple[int, int], panel: tuple[int, int, int, int], bounds: Array) -> Layout:
    x0, y0, x1, y1 = (float(b) for b in bounds)
    room = area[0] - 2 * _MARGIN, area[1] - 2 * _MARGIN - 14  # the scale bar stands below the plan
    scale = min(room[0] / max(x1 - x0, 1e-3), room[1] / max(y1 - y0, 1e-3))
    low = 0.5 * (x0 + x1) - 0.5 * area[0] / scale, 0.5 * (y0 + y1) - (0.5 * area[1] + 7) / scale
    return Layout(area, low, scale, panel)


def draw(picture: Any, layout: Layout, title: str, rows: Figures, shown: frozenset[str]) -> None:
    """Draw all that stands beside the map onto the surface `picture`.

    `rows` are the figures; `shown` names the entries of the legend that not every map has.
    """
    left, top, width, height = layout.panel
    edge = ((left, top), (left, top + height)) if layout.beside else ((left, top), (left + width, top))
    pygame.draw.line(picture, symbols.LINE, *edge)
    _scale_bar(picture, layout)
    x, y = left + _MARGIN, top + _MARGIN - 3
    key = _legend(shown, layout.beside)
    room = width - 2 * _MARGIN if layout.beside else width - key.get_width() - 2 * _MARGIN - 8
    corner = (x, top + height - _MARGIN - key.get_height()) if layout.beside else (width - key.get_width(), y + 1)
    picture.blit(key, corner)
    picture.blit(_fitting(title, room), (x, y))
    figures(picture, rows, (x, y + 30), room, 1 if layout.beside else max(1, math.ceil(len(rows) / 6)))


def _fitting(title: str, width: int) -> Any:
    """The title, as large as fits into `width` [pixels]."""
    sizes = (text(title, size, symbols.INK, bold=True) for size in range(15, 8, -1))
    return next((line for line in sizes if line.get_width() <= width), text(title, 8, symbols.INK, bold=True))


def _scale_bar(picture: Any, layout: Layout) -> None:
    """A bar of 1, 2 or 5 · 10^k metres in the lower right corner of the map."""
    longest = 130.0 / layout.scale
    decade = 10.0 ** math.floor(math.log10(longest))
    metres = max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= longest)
    length = round(metres * layout.scale)
    right, y = layout.map_size[0] - _MARGIN, layout.map_size[1] - 13
    label = text(f"{metres:g} m", 12, symbols.INK)
    pygame.draw.rect(picture, symbols.INK, (right - length, y, length, 2))
    for x in (right - length, right - 2):
        pygame.draw.rect(picture, symbols.INK, (x, y - 4, 2, 6))
    picture.blit(label, (right - length - 8 - label.get_width(), y - 8))


def _corner_jamb_pillar(canvas: Canvas) -> None:
    symbols.true_features(canvas, np.array([[7.0, 8.0], [20.0, 8.0], [33.0, 8.0]]), np.arange(3), 3.6)


def _mapped(canvas: Canvas) -> None:
    at, covariance, sure = np.array([[20.0, 8.0]]), np.array([[[34.0, 5.0], [5.0, 7.0]]]), np.array([False])
    symbols.uncertainties(canvas, at, covariance, sure)
    symbols.landmarks(canvas, at, sure, 2.3)


def _seen_once(canvas: Canvas) -> None:
    at, covariance, unsure = np.array([[20.0, 8.0]]), np.array([[[34.0, 5.0], [5.0, 7.0]]]), np.array([True])
    symbols.uncertainties(canvas, at, covariance, unsure)
    symbols.landmarks(canvas, at, unsure, 2.3)


def _covisible(canvas: Canvas) -> None:
    canvas.segments(np.array([[6.0, 4.0, 34.0, 12.0]]), symbols.COVISIBLE, 1.4)
    symbols.landmarks(canvas, np.array([[6.0, 4.0], [34.0, 12.0]]), np.zeros(2, np.bool_), 2.3)


def _true_robot(canvas: Canvas) -> None:
    canvas.segments(np.array([[2.0, 8.0, 28.0, 8.0]]), symbols.TRAIL, 1.6)
    symbols.robot_body(canvas, np.array([28.0, 8.0, 0.0]), 6.0)


def _estimated_robot(canvas: Canvas) -> None:
    canvas.segments(np.array([[2.0, 8.0, 18.0, 8.0]]), symbols.ESTIMATED_TRAIL, 1.3)
    symbols.robot_estimate(canvas, np.array([25.0, 8.0, 0.0]), 4.5)


def _plan(canvas: Canvas) -> None:
    symbols.plan(canvas, np.zeros(2), np.array([[1.0, 8.0], [21.0, 8.0]]), np.array([[35.0, 8.0]]))


def _measurement(code: Decision) -> Callable[[Canvas], None]:
    def paint(canvas: Canvas) -> None:
        paired = [12.0, 8.0] if code in (Decision.RIGHT, Decision.WRONG) else [math.nan, math.nan]
        points = np.array([[28.0, 8.0]])
        symbols.decisions(canvas, np.array([2.0, 8.0]), points, np.array([paired]), np.array([int(code)]))

    return paint


def _cells(canvas: Canvas) -> None:
    for x, colour in ((6.0, symbols.FREE_CELL), (16.0, symbols.WALL_CELL), (26.0, symbols.UNKNOWN_CELL)):
        square = np.array([[x, 3.0], [x + 10.0, 3.0], [x + 10.0, 13.0], [x, 13.0]])
        canvas.polygons(square[None], colour, symbols.LINE)


def _person(canvas: Canvas) -> None:
    symbols.people(canvas, np.array([[20.0, 8.0, 6.0]]))


def _furniture(canvas: Canvas) -> None:
    symbols.furniture(canvas, np.array([[20.0, 8.0, 20.0, 10.0, 0.0]]))


_Entry = tuple[str, str, Callable[[Canvas], None]]  # what must be shown for it ("" = always), words, symbol
_GROUPS: tuple[tuple[str, tuple[_Entry, ...]], ...] = (
    (
        "True world",
        (
            ("", "corner, jamb, pillar", _corner_jamb_pillar),
            ("", "robot and its trail", _true_robot),
            ("furniture", "furniture", _furniture),
            ("people", "person", _person),
        ),
    ),
    (
        "Estimate",
        (
            ("", "mapped feature, 95 %", _mapped),
            ("", "seen only once", _seen_once),
            ("covisibility", "seen together", _covisible),
            ("", "robot and its trail", _estimated_robot),
            ("cells", "free, wall, unknown", _cells),
            ("plan", "plan, goals on offer", _plan),
        ),
    ),
    (
        "Measurements of this tick",
        (
            ("", "paired, right", _measurement(Decision.RIGHT)),
            ("", "paired, wrong", _measurement(Decision.WRONG)),
            ("", "new feature", _measurement(Decision.NEW)),
            ("", "spurious, accepted", _measurement(Decision.SPURIOUS)),
            ("", "discarded", _measurement(Decision.DISCARDED)),
        ),
    ),
)


@functools.lru_cache(maxsize=16)
def _legend(shown: frozenset[str], stacked: bool) -> Any:
    """A surface with the entries that are `shown`: the groups stacked, or side by side."""
    groups = [(name, [e for e in entries if not e[0] or e[0] in shown]) for name, entries in _GROUPS]
    heights = [_ROW * (1 + len(entries)) for _, entries in groups]
    size = (_COLUMN, sum(heights) + 8 * (len(groups) - 1)) if stacked else (_COLUMN * len(groups), max(heights))
    surface = pygame.Surface(size, depth=32)
    surface.fill(symbols.PAPER)
    x, y = 0, 0
    for (name, entries), height in zip(groups, heights):
        surface.blit(text(name, 12, symbols.INK, bold=True), (x, y))
        for row, (_, words, paint) in enumerate(entries, start=1):
            canvas = Canvas(_SYMBOL, (0.0, 0.0), 1.0, symbols.PAPER)
            paint(canvas)
            surface.blit(canvas.picture(), (x, y + row * _ROW))
            surface.blit(text(words, 12, symbols.MUTED), (x + _SYMBOL[0] + 8, y + row * _ROW + 1))
        x, y = (x, y + height + 8) if stacked else (x + _COLUMN, y)
    return surface
