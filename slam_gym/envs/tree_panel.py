"""The interpretation tree, drawn level by level: the path, the branches of the level at hand, and what is ahead."""

from __future__ import annotations

from typing import Any

import numpy as np

from slam_gym.association.walk import Walk
from slam_gym.envs import symbols
from slam_gym.envs.drawing import SUPERSAMPLING, Colour, pygame, text
from slam_gym.envs.runs import Run
from slam_gym.envs.verdicts import Verdicts, decisions
from slam_gym.metrics.association import Decision
from slam_gym.types import NONE, IntArray

_MARGIN = 18  # [pixels]
_LEVEL, _WIDEST = 21, 36  # [pixels] between two levels, at least and at most
_BRANCHES = 9  # at most so many branches of a level are drawn, besides `*`
_TABLE_ROW = 22  # [pixels]
_LABELS, _SPACING = 74, 29  # [pixels] room for the names of the levels; between branches
Box = tuple[int, int, int, int]  # left, top, width, height [pixels]


def draw_panel(
    picture: Any, box: Box, run: Run, walk: Walk | None, verdicts: Verdicts, figures: tuple[tuple[str, str], ...]
) -> None:
    """Figures, tree, the table of the branches to choose from, and the legend."""
    left, top, width, height = box
    pygame.draw.line(picture, symbols.LINE, (left, top), (left, top + height))
    x, y = left + _MARGIN, top + 13
    picture.blit(text("Interpretation tree", 15, symbols.INK, bold=True), (x, y))
    _figures(picture, (x, y + 27), width - 2 * _MARGIN, figures)
    bottom = top + height - 74
    _legend(picture, (x, bottom + 12))
    if walk is None or walk.done:
        picture.blit(text("nothing left to decide", 13, symbols.MUTED), (x, y + 110))
        return
    rows = len(walk.offered) + 1 + (walk.hidden > 0)
    table = bottom - (rows + 1) * _TABLE_ROW - 8
    _tree(picture, (left + _MARGIN, y + 92, width - 2 * _MARGIN, table - y - 110), walk, verdicts)
    _table(picture, (x, table, width - 2 * _MARGIN, 0), walk, verdicts, run)


def _figures(picture: Any, corner: tuple[int, int], width: int, figures: tuple[tuple[str, str], ...]) -> None:
    """Two columns of what and how much."""
    column = (width - 24) // 2
    for k, (what, how_much) in enumerate(figures):
        x, y = corner[0] + (k % 2) * (column + 24), corner[1] + (k // 2) * 19
        value = text(how_much, 12, symbols.INK, bold=True)
        picture.blit(text(what, 12, symbols.MUTED), (x, y))
        picture.blit(value, (x + column - value.get_width(), y))


def _tree(picture: Any, box: Box, walk: Walk, verdicts: Verdicts) -> None:
    """As many levels as there is room for; the one at hand is among them."""
    left, top, width, height = box
    room = max(3, height // _LEVEL)
    first = int(np.clip(walk.level - room // 2, 0, max(walk.tree.levels - room, 0)))
    last = min(first + room, walk.tree.levels)
    step = min(_WIDEST, height // max(last - first, 1))
    surface = pygame.Surface((width * SUPERSAMPLING, height * SUPERSAMPLING), depth=32)
    surface.fill(symbols.PAPER)
    codes = decisions(walk, verdicts)
    band = (0, _y(walk.level - first, step) - 11, width, 22)
    pygame.draw.rect(surface, symbols.BAND, [SUPERSAMPLING * v for v in band], border_radius=8)
    for level in range(first, last):
        _edges(surface, walk, codes, level, first, step)
    for level in range(first, last):
        _nodes(surface, walk, codes, verdicts, level, first, step)
    picture.blit(pygame.transform.smoothscale(surface, (width, height)), (left, top))
    for level in range(first, last):
        colour = symbols.INK if level == walk.level else symbols.MUTED
        label = text(f"z{walk.candidates.measurements[level]}", 12, colour, bold=level == walk.level)
        picture.blit(label, (left + 8, top + _y(level - first, step) - label.get_height() // 2))
    _rest(picture, box, first, walk.tree.levels - last)


def _rest(picture: Any, box: Box, before: int, after: int) -> None:
    """How many levels there was no room for."""
    left, top, width, height = box
    for count, y, words in ((before, top - 17, "earlier"), (after, top + height, "more")):
        if count:
            label = text(f"{count} {words}", 11, symbols.MUTED)
            picture.blit(label, (left + width - label.get_width(), y))


def _y(row: int, step: int) -> int:
    return 11 + row * step


def _x(branch: int) -> int:
    """Branches by ascending D²_ij to the right of `*`, which has a column of its own."""
    return _LABELS + (0 if branch == NONE else (1 + min(branch, _BRANCHES - 1)) * _SPACING)


def _branch(walk: Walk, level: int) -> int:
    """Which branch was taken at a level: 0 is nearest, NONE `*`."""
    c = int(walk.chosen[level])
    return NONE if c == NONE else c - int(walk.candidates.starts[level])


def _edges(surface: Any, walk: Walk, codes: IntArray, level: int, first: int, step: int) -> None:
    """From the node before to the branches of a level; the path is drawn broad."""
    if level > walk.level or level == first == 0:
        return
    start = (_x(_branch(walk, level - 1)), _y(level - 1 - first, step)) if level > 0 else (_LABELS, _y(-1, step))
    count = int(walk.candidates.starts[level + 1] - walk.candidates.starts[level])
    if level == walk.level:
        legal = (walk.offered - walk.candidates.starts[level]).tolist()
        for branch in [*range(min(count, _BRANCHES)), NONE]:
            on_offer = branch in legal or branch == NONE
            _line(surface, start, (_x(branch), _y(level - first, step)), symbols.PLAN if on_offer else symbols.LINE, 1)
        return
    colour = symbols.DECISIONS[int(codes[walk.candidates.measurements[level]])]
    _line(surface, start, (_x(_branch(walk, level)), _y(level - first, step)), colour, 3)


def _nodes(surface: Any, walk: Walk, codes: IntArray, verdicts: Verdicts, level: int, first: int, step: int) -> None:
    y, start = _y(level - first, step), int(walk.candidates.starts[level])
    count = int(walk.candidates.starts[level + 1]) - start
    taken = _branch(walk, level) if level < walk.level else None
    i = int(walk.candidates.measurements[level])
    for branch in [*range(min(count, _BRANCHES)), NONE]:
        at = (_x(branch), y)
        row = walk.tree.rows[walk.tree.slots[start + branch]] if branch != NONE else NONE
        right = row != NONE and walk.tree.prediction.features[row] == verdicts.right[i]
        if level == walk.level:
            on_offer = branch == NONE or start + branch in walk.offered
            _node(surface, at, symbols.PAPER, symbols.PLAN if on_offer else symbols.LINE, 6 if on_offer else 4)
        elif branch == taken:
            _node(surface, at, symbols.DECISIONS[int(codes[i])], symbols.PAPER, 6)
        else:
            _node(surface, at, symbols.PAPER, symbols.LINE, 6 if branch == NONE else 4)
        if right:
            _node(surface, at, None, symbols.DECISIONS[Decision.RIGHT], 8)
        if branch == NONE:
            _star(surface, at, symbols.PAPER if taken == NONE else symbols.MUTED)


def _node(surface: Any, at: tuple[int, int], fill: Colour | None, line: Colour, radius: int) -> None:
    centre = (at[0] * SUPERSAMPLING, at[1] * SUPERSAMPLING)
    if fill is not None:
        pygame.draw.circle(surface, fill, centre, radius * SUPERSAMPLING)
    pygame.draw.circle(surface, line, centre, radius * SUPERSAMPLING, 3)


def _star(surface: Any, at: tuple[int, int], colour: Colour) -> None:
    label = text("*", 16 * SUPERSAMPLING, colour, bold=True)
    x, y = at[0] * SUPERSAMPLING - label.get_width() // 2, at[1] * SUPERSAMPLING - label.get_height() // 2
    surface.blit(label, (x, y + 3 * SUPERSAMPLING))


def _line(surface: Any, a: tuple[int, int], b: tuple[int, int], colour: Colour, width: int) -> None:
    start, end = ((x * SUPERSAMPLING, y * SUPERSAMPLING) for x, y in (a, b))
    pygame.draw.aaline(surface, colour, start, end, width * SUPERSAMPLING)


def _table(picture: Any, box: Box, walk: Walk, verdicts: Verdicts, run: Run) -> None:
    """What may be chosen: action, feature, D²_ij and D²_H with bars up to their gates."""
    left, top, width, _ = box
    pygame.draw.line(picture, symbols.LINE, (left, top - 6), (left + width, top - 6))
    columns = (left, left + 64, left + 156, left + 274)
    for x, words in zip(columns, (f"z{walk.measurement} is …", "feature", "alone D²", "with the path D²")):
        picture.blit(text(words, 12, symbols.INK if x == left else symbols.MUTED, bold=x == left), (x, top))
    gates = float(walk.tree.gates[1]), float(walk.tree.gates[walk.pairings + 1])
    ids, right = run.slam.map.ids[run.prediction.features[walk.rows]], verdicts.right_action(walk)
    for action in range(len(walk.offered)):
        y = top + (action + 1) * _TABLE_ROW
        _action(picture, (columns[0] + 10, y + 8), str(action), action == right)
        picture.blit(text(f"{ids[action]}", 12, symbols.INK), (columns[1], y))
        for x, value, gate in zip(columns[2:], (walk.individual_distances, walk.joint_distances), gates):
            _bar(picture, (x, y), float(value[action]), gate)
    y = top + (len(walk.offered) + 1) * _TABLE_ROW
    _action(picture, (columns[0] + 10, y + 8), "*", right == walk.K)
    picture.blit(text("nothing that is mapped", 12, symbols.INK), (columns[1], y))
    if walk.hidden:
        words = f"and {walk.hidden} more that K = {walk.K} hides"
        picture.blit(text(words, 12, symbols.MUTED), (columns[1], y + _TABLE_ROW))


def _action(picture: Any, centre: tuple[int, int], words: str, right: bool) -> None:
    label = text(words, 12, symbols.PAPER, bold=True)
    if right:
        pygame.draw.circle(picture, symbols.DECISIONS[Decision.RIGHT], centre, 12)
        pygame.draw.circle(picture, symbols.PAPER, centre, 10)
    pygame.draw.circle(picture, symbols.PLAN, centre, 9)
    drop = 3 if words == "*" else 0
    picture.blit(label, (centre[0] - label.get_width() // 2, centre[1] - label.get_height() // 2 + drop))


def _bar(picture: Any, corner: tuple[int, int], value: float, gate: float) -> None:
    """A number and how much of its gate it takes."""
    x, y = corner
    picture.blit(text(f"{value:.1f}", 12, symbols.INK), (x, y))
    pygame.draw.rect(picture, symbols.LINE, (x + 38, y + 5, 56, 6), border_radius=3)
    share = min(value / gate, 1.0)
    pygame.draw.rect(picture, symbols.PLAN, (x + 38, y + 5, max(3, round(56 * share)), 6), border_radius=3)


def _legend(picture: Any, corner: tuple[int, int]) -> None:
    """What the colours stand for."""
    left, top = corner
    entries = (
        (symbols.DECISIONS[Decision.RIGHT], None, "paired, right"),
        (symbols.DECISIONS[Decision.WRONG], None, "paired, wrong"),
        (symbols.DECISIONS[Decision.DISCARDED], None, "not paired"),
        (symbols.PAPER, symbols.INK, "not decided yet"),
        (symbols.CHOICE, symbols.INK, "to decide now"),
        (symbols.PAPER, symbols.PLAN, "legal, 95 % gate"),
        (symbols.PAPER, symbols.LINE, "compatible alone"),
        (None, symbols.DECISIONS[Decision.RIGHT], "the truth"),
    )
    pygame.draw.line(picture, symbols.LINE, (left, top - 10), (left + 384, top - 10))
    for k, (fill, line, words) in enumerate(entries):
        x, y = left + (k % 3) * 132, top + (k // 3) * 19
        dot = pygame.Surface((16 * SUPERSAMPLING, 16 * SUPERSAMPLING))
        dot.fill(symbols.PAPER)
        _node(dot, (8, 8), fill, line or symbols.PAPER, 5)
        picture.blit(pygame.transform.smoothscale(dot, (16, 16)), (x - 3, y))
        picture.blit(text(words, 11, symbols.MUTED), (x + 15, y + 1))
