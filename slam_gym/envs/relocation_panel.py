"""The interpretation tree of a relocation, level by level, with the table of what may be chosen."""

from __future__ import annotations

from typing import Any

import numpy as np

from slam_gym.association.relocation_walk import RelocationWalk
from slam_gym.envs import symbols
from slam_gym.envs.drawing import Canvas, Colour, pygame, text
from slam_gym.metrics.association import Decision
from slam_gym.types import NONE, IntArray

_MARGIN, _ROW = 18, 22  # [pixels] at the sides; between rows of the table
_CLOSEST, _WIDEST = 21, 34  # [pixels] between two levels
_STAR, _SPACING, _BRANCHES = 58, 27, 9  # [pixels] column of `*`, and between branches; branches that are drawn
Box = tuple[int, int, int, int]  # left, top, width, height [pixels]


def draw_panel(
    picture: Any,
    box: Box,
    walk: RelocationWalk,
    right: IntArray,
    codes: IntArray,
    figures: tuple[tuple[str, str], ...],
) -> None:
    """Figures, tree, table and legend; `right` (m,) are the true features, `codes` (m,) what became of them."""
    left, top, width, height = box
    x, y, room = left + _MARGIN, top + 13, width - 2 * _MARGIN
    pygame.draw.line(picture, symbols.LINE, (left, top), (left, top + height))
    picture.blit(text("Interpretation tree", 15, symbols.INK, bold=True), (x, y))
    _figures(picture, (x, y + 27), room, figures)
    bottom = top + height - 70
    _legend(picture, (x, bottom + 12), room)
    shown = 0 if walk.offer is None else min(len(walk.offer.features), walk.spec.candidates)
    table = bottom - (shown + 2 + (walk.hidden > 0)) * _ROW - 6
    if walk.offer is None:
        table = bottom - 4 * _ROW
        _verdict(picture, (x, table), room, walk)
    else:
        _table(picture, (x, table), room, walk, right)
    _tree(picture, (x, y + 78, room, table - y - 96), walk, right, codes)


def _figures(picture: Any, corner: tuple[int, int], width: int, figures: tuple[tuple[str, str], ...]) -> None:
    """Two columns of what and how much."""
    column = (width - 24) // 2
    for k, (what, how_much) in enumerate(figures):
        x, y = corner[0] + (k % 2) * (column + 24), corner[1] + (k // 2) * 19
        value = text(how_much, 12, symbols.INK, bold=True)
        picture.blit(text(what, 12, symbols.MUTED), (x, y))
        picture.blit(value, (x + column - value.get_width(), y))


class _Levels:
    """Where the nodes of the tree are, y up."""

    def __init__(self, height: int, walk: RelocationWalk) -> None:
        self.height, room, levels = height, max(3, height // _CLOSEST), len(walk.order)
        self.spacing = min(max(height / max(levels, 1), _CLOSEST), _WIDEST)
        self.branches = min(walk.spec.candidates, _BRANCHES)
        self.first = int(np.clip(walk.level - room // 2, 0, max(levels - room, 0)))
        self.last = min(self.first + room, levels)

    def at(self, level: int, action: int, star: int) -> tuple[float, float]:
        column = _STAR if action == star else _STAR + (1 + min(action, self.branches - 1)) * _SPACING
        return float(column), self.height - 12.0 - (level - self.first) * self.spacing


def _tree(picture: Any, box: Box, walk: RelocationWalk, right: IntArray, codes: IntArray) -> None:
    left, top, width, height = box
    levels, star = _Levels(height, walk), walk.spec.star
    canvas = Canvas((width, height), (0.0, 0.0), 1.0, symbols.PAPER)
    if walk.offer is not None:
        y = levels.at(walk.level, 0, star)[1]
        band = np.array([[0.0, y - 10], [width, y - 10], [width, y + 10], [0.0, y + 10]])
        canvas.polygons(band[None], symbols.BAND)
    for level in range(levels.first, min(levels.last, walk.level + (walk.offer is not None))):
        _edges(canvas, levels, walk, codes, level)
    for level in range(levels.first, levels.last):
        _nodes(canvas, levels, walk, right, codes, level)
    picture.blit(canvas.picture(), (left, top))
    for level in range(levels.first, levels.last):
        now = level == walk.level
        label = text(f"z{walk.order[level]}", 12, symbols.INK if now else symbols.MUTED, bold=now)
        x, y = levels.at(level, star, star)
        picture.blit(label, (left + 8, top + height - round(y) - label.get_height() // 2))
        mark = text("*", 13, symbols.PAPER if _taken(walk, level) == star else symbols.MUTED, bold=True)
        picture.blit(mark, (left + x - mark.get_width() // 2, top + height - y - mark.get_height() // 2 + 2))
        alive = int(walk.node.alive[walk.order[level]].sum())
        if level >= walk.level and alive > levels.branches:
            more = text(f"+ {alive - levels.branches}", 11, symbols.MUTED)
            x = levels.at(level, levels.branches - 1, star)[0]
            picture.blit(more, (left + x + 16, top + height - round(y) - more.get_height() // 2))
    for count, y, words in ((levels.first, top - 16, "earlier"), (len(walk.order) - levels.last, top + height, "more")):
        if count:
            label = text(f"{count} {words}", 11, symbols.MUTED)
            picture.blit(label, (left + width - label.get_width(), y))


def _taken(walk: RelocationWalk, level: int) -> int | None:
    """The action taken at a level."""
    return walk.offered[level][1] if level < walk.level else None


def _edges(canvas: Canvas, levels: _Levels, walk: RelocationWalk, codes: IntArray, level: int) -> None:
    """From the node before to the branches of a level; the path is drawn broad."""
    if level == 0:
        return
    star, before = walk.spec.star, walk.offered[level - 1][1]
    start = levels.at(level - 1, before, star)
    if level < walk.level:
        colour = symbols.DECISIONS[int(codes[walk.order[level]])]
        end = levels.at(level, walk.offered[level][1], star)
        canvas.segments(np.array([[*start, *end]]), colour, 3.0)
        return
    assert walk.offer is not None
    for action in (*range(min(len(walk.offer.features), levels.branches)), star):
        canvas.segments(np.array([[*start, *levels.at(level, action, star)]]), symbols.PLAN, 1.2)


def _nodes(canvas: Canvas, levels: _Levels, walk: RelocationWalk, right: IntArray, codes: IntArray, level: int) -> None:
    """On offer, taken, or ahead: as many as are still legal."""
    star, i = walk.spec.star, int(walk.order[level])
    now, taken = level == walk.level, _taken(walk, level)
    count = walk.offered[level][0] if taken is not None else int(walk.node.alive[i].sum())
    for action in (*range(min(count, levels.branches)), star):
        at = np.array([levels.at(level, action, star)])
        if now:
            canvas.discs(at, 6.0, symbols.PAPER, symbols.PLAN, 1.6)
            if walk.offer is not None and action != star and walk.offer.features[action] == right[i]:
                canvas.discs(at, 8.4, None, symbols.DECISIONS[Decision.RIGHT], 1.6)
        elif action == taken:
            canvas.discs(at, 6.0, symbols.DECISIONS[int(codes[i])], symbols.PAPER, 1.0)
        else:
            canvas.discs(at, 3.6, symbols.PAPER, symbols.LINE, 1.2)


def _table(picture: Any, corner: tuple[int, int], width: int, walk: RelocationWalk, right: IntArray) -> None:
    """What may be chosen: action, feature, what it could come to, D² of its distances to the pairings of the path."""
    left, top = corner
    offer, i, star = walk.offer, walk.measurement, walk.spec.star
    assert offer is not None and i is not None
    m, gate = len(walk.order), walk.tree.chi2[0]
    pygame.draw.line(picture, symbols.LINE, (left, top - 6), (left + width, top - 6))
    columns = (left, left + 64, left + 134, left + 268)
    headings = (f"z{i} is …", "feature", "pairings, at most", "worst distance D²" if walk.node.features.size else "")
    for x, words in zip(columns, headings):
        picture.blit(text(words, 12, symbols.INK if x == left else symbols.MUTED, bold=x == left), (x, top))
    for row, feature in enumerate(offer.features[: walk.spec.candidates].tolist()):
        y = top + (row + 1) * _ROW
        _action(picture, (left + 10, y + 8), str(row), feature == right[i])
        picture.blit(text(str(feature), 12, symbols.INK), (columns[1], y))
        bound = len(walk.node.features) + 1 + int(offer.support[row])
        _bar(picture, (columns[2], y), f"{bound}", bound / m)
        if walk.node.features.size:
            _bar(picture, (columns[3], y), f"{offer.worst[row]:.1f}", float(offer.worst[row]) / gate)
    y = top + (min(len(offer.features), walk.spec.candidates) + 1) * _ROW
    _action(picture, (left + 10, y + 8), "*", right[i] == NONE)
    picture.blit(text("none", 12, symbols.INK), (columns[1], y))
    bound = walk.node.bound_without(i)
    _bar(picture, (columns[2], y), f"{bound}", bound / m)
    if walk.hidden:
        words = f"and {walk.hidden} more that K = {star} hides"
        picture.blit(text(words, 12, symbols.MUTED), (columns[1], y + _ROW))


def _verdict(picture: Any, corner: tuple[int, int], width: int, walk: RelocationWalk) -> None:
    """At a leaf: what the hypothesis comes to."""
    left, top = corner
    pygame.draw.line(picture, symbols.LINE, (left, top - 6), (left + width, top - 6))
    leaf = walk.leaf
    assert leaf is not None
    pairings = int((leaf.features != NONE).sum())
    passed = "passes" if leaf.compatible else "fails"
    words = f"D² = {leaf.located.joint_distance:.1f}, dof {leaf.located.dof}"
    lines = (
        (f"A leaf of {pairings} pairings: {passed} the joint test" if pairings > 1 else "A leaf without a pose", True),
        (words if pairings > 1 else "two pairings at least determine one", False),
        ("the best so far is believed" if walk.best.accepted else "the best so far is not believed", False),
    )
    for row, (line, bold) in enumerate(lines):
        picture.blit(text(line, 12, symbols.INK, bold=bold), (left, top + row * _ROW))


def _action(picture: Any, centre: tuple[int, int], words: str, right: bool) -> None:
    label = text(words, 12, symbols.PAPER, bold=True)
    if right:
        pygame.draw.circle(picture, symbols.DECISIONS[Decision.RIGHT], centre, 12)
        pygame.draw.circle(picture, symbols.PAPER, centre, 10)
    pygame.draw.circle(picture, symbols.PLAN, centre, 9)
    drop = 3 if words == "*" else 0
    picture.blit(label, (centre[0] - label.get_width() // 2, centre[1] - label.get_height() // 2 + drop))


def _bar(picture: Any, corner: tuple[int, int], words: str, share: float) -> None:
    """A number, and how much it is of what it could be."""
    x, y = corner
    picture.blit(text(words, 12, symbols.INK), (x, y))
    pygame.draw.rect(picture, symbols.LINE, (x + 34, y + 5, 64, 6), border_radius=3)
    length = max(3, round(64 * min(max(share, 0.0), 1.0)))
    pygame.draw.rect(picture, symbols.PLAN, (x + 34, y + 5, length, 6), border_radius=3)


def _legend(picture: Any, corner: tuple[int, int], width: int) -> None:
    """What the colours stand for."""
    left, top = corner
    right = symbols.DECISIONS[Decision.RIGHT]
    entries: tuple[tuple[Colour | None, Colour, str], ...] = (
        (right, symbols.PAPER, "paired, right"),
        (symbols.DECISIONS[Decision.WRONG], symbols.PAPER, "paired, wrong"),
        (symbols.DECISIONS[Decision.DISCARDED], symbols.PAPER, "not paired"),
        (symbols.CHOICE, symbols.INK, "to decide now"),
        (symbols.PAPER, symbols.PLAN, "on offer"),
        (symbols.PAPER, symbols.LINE, "legal, later"),
        (symbols.MAPPED, symbols.UNCERTAIN, "mapped, 95 %"),
        (symbols.PAPER, symbols.PROVISIONAL, "local to the first"),
        (None, right, "the truth"),
    )
    pygame.draw.line(picture, symbols.LINE, (left, top - 10), (left + width, top - 10))
    for k, (fill, line, words) in enumerate(entries):
        x, y = left + (k % 3) * 132, top + (k // 3) * 19
        canvas = Canvas((16, 16), (0.0, 0.0), 1.0, symbols.PAPER)
        canvas.discs(np.array([[8.0, 8.0]]), 5.0, fill, line, 1.4)
        picture.blit(canvas.picture(), (x - 3, y))
        picture.blit(text(words, 11, symbols.MUTED), (x + 17, y + 1))
