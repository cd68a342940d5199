"""Panels beside a map: figures, an interpretation tree, a table of the possible actions, the key to the colours; and
badges that connect actions with the map."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from slam_gym.metrics.association import Decision
from slam_gym.rendering import symbols
from slam_gym.rendering.canvas import TEXT, Canvas, Colour, pygame, text
from slam_gym.types import Array

Figures = tuple[tuple[str, str], ...]
"""Names and values."""
Point = tuple[float, float]
Box = tuple[int, int, int, int]  # left, top, width, height [pixels]
KeyEntry = tuple[Decision | Colour | None, Colour, str]  # a decision, or fill and line of a dot; its meaning

ROW = 24  # [pixels] height of a row of a table
_FIGURE, _GAP = 22, 16  # [pixels] between two rows of figures, and between two columns
_KEY_ROW, _KEY_COLUMNS = 22, 2
_BADGE, _BADGE_DISTANCE = 10, 21  # [pixels] radius of a badge; least distance between two centres
_AROUND = ((0.7, -0.7), (-0.7, -0.7), (0.7, 0.7), (-0.7, 0.7), (1.0, 0.0), (-1.0, 0.0), (0.0, -1.0), (0.0, 1.0))

SIZE, PANEL = (960, 720), 400  # [pixels] of a picture; width of the panel on the right of a tree's picture
MAP = (SIZE[0] - PANEL, SIZE[1])  # [pixels] of the map on its left
_COLUMNS = (0, 62, 130, 252)  # [pixels] of the table of actions

KEY: tuple[KeyEntry, ...] = (  # common entries of both views
    (Decision.RIGHT, symbols.PAPER, "paired, right"),
    (Decision.WRONG, symbols.PAPER, "paired, wrong"),
    (Decision.DISCARDED, symbols.PAPER, "not paired"),
    (symbols.PAPER, symbols.INK, "not decided yet"),
    (symbols.CHOICE, symbols.INK, "to decide now"),
    (symbols.MAPPED, symbols.MAPPED, "mapped feature"),
    (None, symbols.TRUTH, "the truth"),
)
STAR = -1  # the branch `*`, which leaves the measurement unpaired
_MARGIN = 18  # [pixels]
_CLOSEST, _WIDEST = 21, 36  # [pixels] least and greatest distance between two levels
_BRANCHES = 9  # largest number of branches of a level that are drawn, besides `*`
_STAR, _SPACING = 70, 28  # [pixels] column of `*`; between branches
_CHOICES = 12  # largest number of rows of the table
_MIN_TREE = 66  # [pixels] least height of the tree, at the cost of the table


def figures(picture: Any, shown: Figures, corner: tuple[int, int], width: int, columns: int) -> None:
    """Write names and values, column by column."""
    rows = math.ceil(len(shown) / columns)
    for k, (name, value) in enumerate(shown):
        x, y = corner[0] + (k // rows) * (width + _GAP) // columns, corner[1] + (k % rows) * _FIGURE
        label = text(value, TEXT, symbols.INK, bold=True)
        picture.blit(text(name, TEXT, symbols.MUTED), (x, y))
        picture.blit(label, label.get_rect(topright=(x + (width + _GAP) // columns - _GAP, y)))


def key(picture: Any, box: Box, entries: Sequence[KeyEntry]) -> int:
    """Draw the key to the marks, two to a row, at the bottom of a box; returns the y [pixels] of the line above it."""
    left, top, width, height = box
    top += height - 15 - math.ceil(len(entries) / _KEY_COLUMNS) * _KEY_ROW
    pygame.draw.line(picture, symbols.LINE, (left, top), (left + width, top))
    for k, (fill, line, words) in enumerate(entries):
        x = left + (k % _KEY_COLUMNS) * (width + 12) // _KEY_COLUMNS
        y = top + 10 + (k // _KEY_COLUMNS) * _KEY_ROW
        canvas = Canvas((16, 16), (0.0, 0.0), 1.0, symbols.PAPER)
        if isinstance(fill, Decision):
            symbols.marks(canvas, np.array([[8.0, 8.0]]), np.array([fill]), 1.4)
        else:
            canvas.discs(np.array([[8.0, 8.0]]), 5.0, fill, line, 1.4)
        picture.blit(canvas.picture(), (x - 3, y))
        picture.blit(text(words, TEXT, symbols.MUTED), (x + 17, y))
    return top


def scale_bar(picture: Any, size: tuple[int, int], scale: float) -> None:
    """Draw a bar of 1, 2 or 5 · 10^k metres in the lower right corner of a map of `size` and `scale` [pixels/m]."""
    longest = min(130.0, 0.4 * size[0]) / scale
    decade = 10.0 ** math.floor(math.log10(longest))
    metres = max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= longest)
    length, right, y = round(metres * scale), size[0] - _GAP, size[1] - 13
    label = text(f"{metres:g} m", TEXT, symbols.INK)
    pygame.draw.rect(picture, symbols.INK, (right - length, y, length, 2))
    for x in (right - length, right - 2):
        pygame.draw.rect(picture, symbols.INK, (x, y - 4, 2, 6))
    picture.blit(label, (right - length - 8 - label.get_width(), y - 8))


class ActionRow(NamedTuple):
    """A row of the table of actions. A cell is text, or text with the fraction (0 … 1) that its bar shows."""

    action: str
    right: bool  # the truth is this action
    cells: tuple[str | tuple[str, float], ...]


def table(picture: Any, box: Box, headings: Sequence[str], choices: Sequence[ActionRow], note: str) -> None:
    """Draw the table of actions, with the `note` below it."""
    left, top, width, _ = box
    pygame.draw.line(picture, symbols.LINE, (left, top - 6), (left + width, top - 6))
    for k, (offset, heading) in enumerate(zip(_COLUMNS, headings)):
        picture.blit(text(heading, TEXT, symbols.MUTED if k else symbols.INK, bold=k == 0), (left + offset, top))
    for row, choice in enumerate(choices, start=1):
        y = top + row * ROW
        centre = (left + 10, y + 8)
        if choice.right:
            pygame.draw.aacircle(picture, symbols.TRUTH, centre, _BADGE + 3, 2)
        badge(picture, centre, choice.action)
        for offset, cell in zip(_COLUMNS[1:], choice.cells):
            words, fraction = (cell, None) if isinstance(cell, str) else cell
            picture.blit(text(words, TEXT, symbols.INK), (left + offset, y))
            if fraction is not None:
                corner, length = (left + offset + 38, y + 6), max(3, round(60 * min(max(fraction, 0.0), 1.0)))
                pygame.draw.rect(picture, symbols.LINE, (*corner, 60, 6), border_radius=3)
                pygame.draw.rect(picture, symbols.PLAN, (*corner, length, 6), border_radius=3)
    picture.blit(text(note, TEXT, symbols.MUTED), (left + _COLUMNS[1], top + (len(choices) + 1) * ROW))


def badges(picture: Any, points: Sequence[Point], occupied: Sequence[Point]) -> None:
    """Draw the number of each action beside its candidate [pixels], with a line to it, where there is room in the map
    beside other badges and `occupied` places [pixels]."""
    centres = list(occupied)
    for x, y in points:
        spots = [(x + r * dx, y + r * dy) for r in (17, 27, 38) for dx, dy in _AROUND]
        inside = [(u, v) for u, v in spots if _BADGE < u < MAP[0] - _BADGE and _BADGE < v < MAP[1] - _BADGE]
        clear = [spot for spot in inside if all(math.dist(spot, other) > _BADGE_DISTANCE for other in centres)]
        centres.append((clear or inside or spots)[0])
        pygame.draw.aaline(picture, symbols.PLAN, (x, y), centres[-1])
    for action, centre in enumerate(centres[len(occupied) :]):
        badge(picture, centre, str(action))


def badge(picture: Any, centre: Point, action: str) -> None:
    """Draw the name of an action on a disc."""
    pygame.draw.aacircle(picture, symbols.PLAN, centre, _BADGE)
    if action == "*":
        star(picture, centre, symbols.PAPER)
    else:
        label = text(action, TEXT, symbols.PAPER, bold=True)
        picture.blit(label, label.get_rect(center=centre))


def star(picture: Any, centre: Point, colour: Colour) -> None:
    """Draw `*` in the middle of a node; it is moved down, since it stands high in its line of text."""
    label = text("*", 17, colour, bold=True)
    picture.blit(label, label.get_rect(center=(centre[0], centre[1] + 3)))


class TreeLevel(NamedTuple):
    """One level of a tree. Branches are numbered from 0; `*` is `STAR`."""

    name: str
    branches: int  # besides `*`
    legal: frozenset[int] = frozenset()  # at the current level
    chosen: int | None = None  # None: not decided
    decision: int = Decision.UNJUDGED  # the judgement of the chosen branch
    right: int | None = None  # the true branch; None: there is none, or it is unknown


class TreePanel(NamedTuple):
    """The contents of a panel."""

    figures: Figures
    levels: Sequence[TreeLevel]
    current: int  # the level to decide; the number of levels at a leaf
    key: Sequence[KeyEntry]
    headings: Sequence[str] = ()  # of the table
    choices: Sequence[ActionRow] = ()  # its rows, `*` last
    note: str = ""  # below the table
    remarks: Sequence[str] = ()  # in place of a table, where there are no choices


def picture_with(canvas: Canvas, candidates: Array, shown: TreePanel, decided: Array | None = None) -> Any:
    """A surface with a map on the left, the actions beside their `candidates` (k, 2) [m] there, and the panel.

    No action covers the measurement that is `decided` (1, 2) [m].
    """
    picture = pygame.Surface(SIZE, depth=32)
    picture.fill(symbols.PAPER)
    picture.blit(canvas.picture(), (0, 0))
    badges(picture, canvas.places(candidates), [] if decided is None else canvas.places(decided))
    scale_bar(picture, MAP, canvas.scale)
    draw_panel(picture, (MAP[0], 0, PANEL, SIZE[1]), shown)
    return picture


def draw_panel(picture: Any, box: Box, shown: TreePanel) -> None:
    """Draw title, figures, tree, table or remarks, and the key, from top to bottom."""
    left, top, width, height = box
    pygame.draw.line(picture, symbols.LINE, (left, top), (left, top + height))
    x, y, room = left + _MARGIN, top + 13, width - 2 * _MARGIN
    picture.blit(text("Interpretation tree", 18, symbols.INK, bold=True), (x, y))
    figures(picture, shown.figures, (x, y + 30), room, 2)
    tree_top = y + 48 + math.ceil(len(shown.figures) / 2) * _FIGURE
    bottom = key(picture, (x, top, room, height), shown.key)
    if shown.remarks:
        tree_bottom = bottom - (len(shown.remarks) + 1) * ROW
        pygame.draw.line(picture, symbols.LINE, (x, tree_bottom - 6), (x + room, tree_bottom - 6))
        for row, line in enumerate(shown.remarks):
            picture.blit(text(line, TEXT, symbols.INK, bold=row == 0), (x, tree_bottom + row * ROW))
    else:
        choices, note = _fitting(shown, (bottom - tree_top - _MIN_TREE - 30) // ROW - 2)
        tree_bottom = bottom - (len(choices) + 1 + bool(note)) * ROW - 8
        table(picture, (x, tree_bottom, room, 0), shown.headings, choices, note)
    draw_levels(picture, (x, tree_top, room, tree_bottom - tree_top - 22), shown.levels, shown.current)


def _fitting(shown: TreePanel, room: int) -> tuple[Sequence[ActionRow], str]:
    """As many choices as fit into `room` rows, including `*`, and the note."""
    room = max(min(room, _CHOICES), 2)
    left_out = len(shown.choices) - room
    if left_out <= 0:
        return shown.choices, shown.note
    return [*shown.choices[: room - 1], shown.choices[-1]], shown.note or f"and {left_out} more"


def draw_levels(picture: Any, box: Box, levels: Sequence[TreeLevel], current: int) -> None:
    """Draw as many levels as fit, including the level `current`, which is the number of levels at a leaf."""
    left, top, width, height = box
    view = _View(box, len(levels), current)
    canvas = Canvas((width, height), (0.0, 0.0), 1.0, symbols.PAPER)
    if current < len(levels):
        y = view.position(current, STAR)[1]
        canvas.polygons(np.array([[[0.0, y - 11], [width, y - 11], [width, y + 11], [0.0, y + 11]]]), symbols.BAND)
    for k in range(max(view.first, 1), min(view.last, current + 1)):
        _edges(canvas, view, levels, k, current)
    for k in range(view.first, view.last):
        _nodes(canvas, view, levels[k], k, current)
    picture.blit(canvas.picture(), (left, top))
    for k in range(view.first, view.last):
        _labels(picture, view, levels[k], k, current)
    for count, y, words in ((view.first, top - 16, "earlier"), (len(levels) - view.last, top + height, "more")):
        if count:
            label = text(f"{count} {words}", TEXT, symbols.MUTED)
            picture.blit(label, label.get_rect(topright=(left + width, y)))


class _View:
    """The range of levels that is drawn, and the positions of their nodes."""

    def __init__(self, box: Box, levels: int, current: int) -> None:
        self.left, self.top, _, self.height = box
        room = max(3, self.height // _CLOSEST)
        self.first = int(np.clip(current - room // 2, 0, max(levels - room, 0)))
        self.last = min(self.first + room, levels)
        self.step = min(_WIDEST, self.height / max(self.last - self.first, 1))

    def position(self, level: int, branch: int) -> tuple[float, float]:
        """The position of a node on the canvas [pixels], y up."""
        column = 0 if branch == STAR else 1 + min(branch, _BRANCHES - 1)
        return _STAR + column * _SPACING, self.height - 12.0 - (level - self.first) * self.step

    def pixels(self, level: int, branch: int) -> tuple[float, float]:
        """The position of a node in the picture [pixels], y down."""
        x, y = self.position(level, branch)
        return self.left + x, self.top + self.height - y


def _branches(level: TreeLevel) -> tuple[int, ...]:
    return *range(min(level.branches, _BRANCHES)), STAR


def _edges(canvas: Canvas, view: _View, levels: Sequence[TreeLevel], k: int, current: int) -> None:
    """Draw the edges from the previous node to the branches of level `k`; edges of the path are broad."""
    before, level = levels[k - 1].chosen, levels[k]
    start = view.position(k - 1, STAR if before is None else before)
    if level.chosen is not None:
        symbols.decided_line(canvas, np.array([start, view.position(k, level.chosen)]), level.decision, 3.0)
    elif k == current:
        for branch in _branches(level):
            colour = symbols.PLAN if branch == STAR or branch in level.legal else symbols.LINE
            canvas.segments(np.array([[*start, *view.position(k, branch)]]), colour, 1.2)


def _nodes(canvas: Canvas, view: _View, level: TreeLevel, k: int, current: int) -> None:
    for branch in _branches(level):
        centre: Array = np.array([view.position(k, branch)])
        if branch == level.chosen:
            symbols.marks(canvas, centre, np.array([level.decision]), 1.9)
        elif k == current and (branch == STAR or branch in level.legal):
            canvas.discs(centre, 6.0, symbols.PAPER, symbols.PLAN, 1.6)
        else:
            canvas.discs(centre, 6.0 if branch == STAR else 4.0, symbols.PAPER, symbols.LATER, 1.2)
        if branch == level.right:
            canvas.discs(centre, 8.4, None, symbols.TRUTH, 1.6)


def _labels(picture: Any, view: _View, level: TreeLevel, k: int, current: int) -> None:
    """Write the name of a level, its `*`, and the number of branches that are not drawn."""
    x, y = view.pixels(k, STAR)
    name = text(level.name, TEXT, symbols.INK if k == current else symbols.MUTED, bold=k == current)
    picture.blit(name, name.get_rect(midleft=(view.left + 8, y)))
    star(picture, (x, y), symbols.PAPER if level.chosen == STAR else symbols.MUTED)
    if level.chosen is None and level.branches > _BRANCHES:
        more = text(f"+ {level.branches - _BRANCHES}", TEXT, symbols.MUTED)
        picture.blit(more, more.get_rect(midleft=(view.pixels(k, _BRANCHES - 1)[0] + 14, y)))
