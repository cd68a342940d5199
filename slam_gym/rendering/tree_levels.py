"""The levels of an interpretation tree: the path, the branches of the level at hand, and what is ahead of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from slam_gym.metrics.association import Decision
from slam_gym.rendering import symbols
from slam_gym.rendering.canvas import Canvas, Colour, text
from slam_gym.rendering.figures_panel import Box, star
from slam_gym.types import NONE, Array

_CLOSEST, _WIDEST = 21, 36  # [pixels] between two levels
_BRANCHES = 9  # at most so many of a level are drawn, besides `*`
_STAR, _SPACING = 70, 28  # [pixels] column of `*`; between branches


@dataclass(frozen=True)
class Level:
    """One level. Branches are numbered from 0, `*` is NONE."""

    name: str
    branches: int  # besides `*`
    on_offer: frozenset[int] = frozenset()  # at the level at hand
    taken: int | None = None  # None: not decided
    colour: Colour = symbols.LINE  # of what was decided
    right: int | None = None  # the branch that the truth would take; None: there is none, or nobody knows


def draw_levels(picture: Any, box: Box, levels: Sequence[Level], at: int) -> None:
    """As many levels as there is room for, level `at` among them; it is at a leaf where `at` is their number."""
    left, top, width, height = box
    view = _View(box, len(levels), at)
    canvas = Canvas((width, height), (0.0, 0.0), 1.0, symbols.PAPER)
    if at < len(levels):
        y = view.position(at, NONE)[1]
        canvas.polygons(np.array([[[0.0, y - 11], [width, y - 11], [width, y + 11], [0.0, y + 11]]]), symbols.BAND)
    for k in range(max(view.first, 1), min(view.last, at + 1)):
        _edges(canvas, view, levels, k, at)
    for k in range(view.first, view.last):
        _nodes(canvas, view, levels[k], k, at)
    picture.blit(canvas.picture(), (left, top))
    for k in range(view.first, view.last):
        _labels(picture, view, levels[k], k, at)
    for count, y, words in ((view.first, top - 16, "earlier"), (len(levels) - view.last, top + height, "more")):
        if count:
            label = text(f"{count} {words}", 11, symbols.MUTED)
            picture.blit(label, (left + width - label.get_width(), y))


class _View:
    """Which levels are drawn, and where their nodes are."""

    def __init__(self, box: Box, levels: int, at: int) -> None:
        self.left, self.top, _, self.height = box
        room = max(3, self.height // _CLOSEST)
        self.first = int(np.clip(at - room // 2, 0, max(levels - room, 0)))
        self.last = min(self.first + room, levels)
        self.step = min(_WIDEST, self.height / max(self.last - self.first, 1))

    def position(self, level: int, branch: int) -> tuple[float, float]:
        """On the canvas, y up."""
        column = 0 if branch == NONE else 1 + min(branch, _BRANCHES - 1)
        return _STAR + column * _SPACING, self.height - 12.0 - (level - self.first) * self.step

    def pixels(self, level: int, branch: int) -> tuple[float, float]:
        """In the picture, y down."""
        x, y = self.position(level, branch)
        return self.left + x, self.top + self.height - y


def _branches(level: Level) -> tuple[int, ...]:
    return *range(min(level.branches, _BRANCHES)), NONE


def _edges(canvas: Canvas, view: _View, levels: Sequence[Level], k: int, at: int) -> None:
    """From the node before to the branches of a level; the path is drawn broad."""
    before, level = levels[k - 1].taken, levels[k]
    start = view.position(k - 1, NONE if before is None else before)
    if level.taken is not None:
        canvas.segments(np.array([[*start, *view.position(k, level.taken)]]), level.colour, 3.0)
    elif k == at:
        for branch in _branches(level):
            colour = symbols.PLAN if branch == NONE or branch in level.on_offer else symbols.LINE
            canvas.segments(np.array([[*start, *view.position(k, branch)]]), colour, 1.2)


def _nodes(canvas: Canvas, view: _View, level: Level, k: int, at: int) -> None:
    for branch in _branches(level):
        centre: Array = np.array([view.position(k, branch)])
        if branch == level.taken:
            canvas.discs(centre, 6.0, level.colour, symbols.PAPER, 1.0)
        elif k == at and (branch == NONE or branch in level.on_offer):
            canvas.discs(centre, 6.0, symbols.PAPER, symbols.PLAN, 1.6)
        else:
            canvas.discs(centre, 6.0 if branch == NONE else 4.0, symbols.PAPER, symbols.LINE, 1.2)
        if branch == level.right:
            canvas.discs(centre, 8.4, None, symbols.DECISIONS[Decision.RIGHT], 1.6)


def _labels(picture: Any, view: _View, level: Level, k: int, at: int) -> None:
    """The name of a level, its `*`, and how many branches are not drawn."""
    x, y = view.pixels(k, NONE)
    name = text(level.name, 12, symbols.INK if k == at else symbols.MUTED, bold=k == at)
    picture.blit(name, (view.left + 8, round(y - name.get_height() / 2)))
    star(picture, (x, y), symbols.PAPER if level.taken == NONE else symbols.MUTED)
    if level.taken is None and level.branches > _BRANCHES:
        more = text(f"+ {level.branches - _BRANCHES}", 11, symbols.MUTED)
        picture.blit(more, (round(view.pixels(k, _BRANCHES - 1)[0] + 14), round(y - more.get_height() / 2)))
