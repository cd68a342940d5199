"""Parts of a panel: figures, a table of the actions to choose from, the key to the colours; and badges on the map."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from slam_gym.rendering import symbols
from slam_gym.rendering.canvas import Canvas, Colour, pygame, text

Figures = tuple[tuple[str, str], ...]
"""What, and how much."""
Point = tuple[float, float]
Box = tuple[int, int, int, int]  # left, top, width, height [pixels]
KeyEntry = tuple[Colour | None, Colour, str]  # fill and line of a dot, what it stands for

ROW = 22  # [pixels] of a table
_FIGURE, _GAP = 20, 22  # [pixels] between two rows of figures, and between two columns
_KEY_ROW, _KEY_COLUMNS = 19, 3
_BADGE, _APART = 9, 19  # [pixels] radius of a badge; between the centres of two
_AROUND = ((0.7, -0.7), (-0.7, -0.7), (0.7, 0.7), (-0.7, 0.7), (1.0, 0.0), (-1.0, 0.0), (0.0, -1.0), (0.0, 1.0))


def figures(picture: Any, shown: Figures, corner: tuple[int, int], width: int, columns: int) -> None:
    """Write what and how much, column by column."""
    rows = math.ceil(len(shown) / columns)
    for k, (what, how_much) in enumerate(shown):
        x, y = corner[0] + (k // rows) * (width + _GAP) // columns, corner[1] + (k % rows) * _FIGURE
        value = text(how_much, 12, symbols.INK, bold=True)
        picture.blit(text(what, 12, symbols.MUTED), (x, y))
        picture.blit(value, (x + (width + _GAP) // columns - _GAP - value.get_width(), y))


def key(picture: Any, box: Box, entries: Sequence[KeyEntry]) -> int:
    """What the dots stand for, three to a row, at the foot of a box; returns where the line above it is."""
    left, top, width, height = box
    top += height - 15 - math.ceil(len(entries) / _KEY_COLUMNS) * _KEY_ROW
    pygame.draw.line(picture, symbols.LINE, (left, top), (left + width, top))
    for k, (fill, line, words) in enumerate(entries):
        x = left + (k % _KEY_COLUMNS) * (width + 12) // _KEY_COLUMNS
        y = top + 10 + (k // _KEY_COLUMNS) * _KEY_ROW
        canvas = Canvas((16, 16), (0.0, 0.0), 1.0, symbols.PAPER)
        canvas.discs(np.array([[8.0, 8.0]]), 5.0, fill, line, 1.4)
        picture.blit(canvas.picture(), (x - 3, y))
        picture.blit(text(words, 11, symbols.MUTED), (x + 17, y + 1))
    return top


class Choice(NamedTuple):
    """A row of the table of actions. A cell is words, or a number with the fraction (0 … 1) that its bar shows."""

    action: str
    right: bool  # the truth would take it
    cells: tuple[str | tuple[str, float], ...]


def table(picture: Any, box: Box, columns: Sequence[tuple[int, str]], choices: Sequence[Choice], note: str) -> None:
    """The actions and what speaks for each; `columns` are offset [pixels] and heading, `note` comes below."""
    left, top, width, _ = box
    pygame.draw.line(picture, symbols.LINE, (left, top - 6), (left + width, top - 6))
    for k, (offset, heading) in enumerate(columns):
        picture.blit(text(heading, 12, symbols.MUTED if k else symbols.INK, bold=k == 0), (left + offset, top))
    for row, choice in enumerate(choices, start=1):
        y = top + row * ROW
        _action(picture, (left + 10, y + 8), choice)
        for (offset, _), cell in zip(columns[1:], choice.cells):
            words, fraction = (cell, None) if isinstance(cell, str) else cell
            picture.blit(text(words, 12, symbols.INK), (left + offset, y))
            if fraction is not None:
                _bar(picture, (left + offset + 36, y + 5), fraction)
    picture.blit(text(note, 12, symbols.MUTED), (left + columns[1][0], top + (len(choices) + 1) * ROW))


def badges(picture: Any, points: Sequence[Point]) -> None:
    """The number of each action beside its candidate [pixels], where there is room, and tied to it by a line."""
    centres: list[Point] = []
    for x, y in points:
        spots = [(x + r * dx, y + r * dy) for r in (17, 27, 38) for dx, dy in _AROUND]
        clear = [spot for spot in spots if all(math.dist(spot, other) > _APART for other in centres)]
        centres.append((clear or spots)[0])
        pygame.draw.aaline(picture, symbols.PLAN, (x, y), centres[-1])
    for action, centre in enumerate(centres):
        badge(picture, centre, str(action))


def badge(picture: Any, centre: Point, words: str) -> None:
    """The name of an action on a disc."""
    pygame.draw.aacircle(picture, symbols.PLAN, centre, _BADGE)
    label = text(words, 12, symbols.PAPER, bold=True)
    picture.blit(label, (round(centre[0] - label.get_width() / 2), round(centre[1] - label.get_height() / 2)))


def star(picture: Any, centre: Point, colour: Colour) -> None:
    """`*`, which stands high in its line of text, in the middle of a node."""
    label = text("*", 15, colour, bold=True)
    picture.blit(label, (round(centre[0] - label.get_width() / 2), round(centre[1] - label.get_height() / 2 + 3)))


def _action(picture: Any, centre: Point, choice: Choice) -> None:
    if choice.right:
        pygame.draw.aacircle(picture, symbols.TRUTH, centre, _BADGE + 3)
        pygame.draw.aacircle(picture, symbols.PAPER, centre, _BADGE + 1)
    badge(picture, centre, "" if choice.action == "*" else choice.action)
    if choice.action == "*":
        star(picture, centre, symbols.PAPER)


def _bar(picture: Any, corner: tuple[int, int], fraction: float) -> None:
    length = max(3, round(60 * min(max(fraction, 0.0), 1.0)))
    pygame.draw.rect(picture, symbols.LINE, (*corner, 60, 6), border_radius=3)
    pygame.draw.rect(picture, symbols.PLAN, (*corner, length, 6), border_radius=3)
