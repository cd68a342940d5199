"""The panel of a relocation: its interpretation tree, and the table of what may be chosen."""

from __future__ import annotations

from typing import Any

from slam_gym.association.relocation.walk import RelocationWalk
from slam_gym.metrics.association import Decision
from slam_gym.rendering import symbols
from slam_gym.rendering.canvas import pygame, text
from slam_gym.rendering.figures_panel import ROW, Box, Choice, Figures, KeyEntry, figures, key, table
from slam_gym.rendering.tree_levels import Level, draw_levels
from slam_gym.types import NONE, IntArray

_MARGIN = 18  # [pixels]
_COLUMNS = (0, 64, 134, 268)  # [pixels] of the table
_KEY: tuple[KeyEntry, ...] = (
    (symbols.DECISIONS[Decision.RIGHT], symbols.PAPER, "paired, right"),
    (symbols.DECISIONS[Decision.WRONG], symbols.PAPER, "paired, wrong"),
    (symbols.DECISIONS[Decision.DISCARDED], symbols.PAPER, "not paired"),
    (symbols.PAPER, symbols.INK, "not decided yet"),
    (symbols.CHOICE, symbols.INK, "to decide now"),
    (symbols.PAPER, symbols.PLAN, "on offer"),
    (symbols.PAPER, symbols.LINE, "legal, later"),
    (symbols.PAPER, symbols.PROVISIONAL, "local to the first"),
    (symbols.MAPPED, symbols.MAPPED, "mapped feature"),
    (None, symbols.DECISIONS[Decision.RIGHT], "the truth"),
    (symbols.INK, symbols.INK, "true robot"),
    (symbols.PAPER, symbols.MAPPED, "robot as located"),
)


def draw_panel(picture: Any, box: Box, walk: RelocationWalk, right: IntArray, codes: IntArray, shown: Figures) -> None:
    """Figures, tree, table and key; `right` (m,) are the true features, `codes` (m,) what became of them."""
    left, top, width, height = box
    x, y, room = left + _MARGIN, top + 13, width - 2 * _MARGIN
    pygame.draw.line(picture, symbols.LINE, (left, top), (left, top + height))
    picture.blit(text("Interpretation tree", 15, symbols.INK, bold=True), (x, y))
    figures(picture, shown, (x, y + 27), room, 2)
    bottom = key(picture, (x, top, room, height), _KEY)
    if walk.offer is None:
        below = bottom - 4 * ROW
        _verdict(picture, (x, below), room, walk)
    else:
        below = bottom - (min(len(walk.offer.features), walk.spec.candidates) + 2 + (walk.hidden > 0)) * ROW - 8
        _table(picture, (x, below, room, 0), walk, right)
    levels = [_level(walk, right, codes, k) for k in range(len(walk.order))]
    draw_levels(picture, (x, y + 84, room, below - y - 106), levels, walk.level)


def _level(walk: RelocationWalk, right: IntArray, codes: IntArray, k: int) -> Level:
    """Branches by rank: of a level decided those that were on offer, of any other those that are legal now."""
    i, star = int(walk.order[k]), walk.spec.star
    if k < walk.level:
        branches, action = walk.offered[k]
        taken = NONE if action == star else action
        return Level(f"z{i}", branches, taken=taken, colour=symbols.DECISIONS[int(codes[i])])
    alive = int(walk.node.alive[i].sum())
    if k > walk.level or walk.offer is None:
        return Level(f"z{i}", alive)
    action_of_truth = walk.action_of(int(right[i]))
    return Level(
        f"z{i}",
        alive,
        on_offer=frozenset(range(min(len(walk.offer.features), star))),
        right=NONE if action_of_truth == star else action_of_truth,
    )


def _table(picture: Any, box: Box, walk: RelocationWalk, right: IntArray) -> None:
    """What may be chosen: action, feature, what it could come to, D² of its distances to the pairings of the path."""
    offer, i, star = walk.offer, walk.measurement, walk.spec.star
    assert offer is not None and i is not None
    m, gate, k = len(walk.order), walk.tree.chi2[0], len(walk.node.features)
    choices = []
    for action, feature in enumerate(offer.features[:star].tolist()):
        bound, worst = k + 1 + int(offer.support[action]), float(offer.worst[action])
        cells = (str(feature), (str(bound), bound / m), (f"{worst:.1f}", worst / gate))
        choices.append(Choice(str(action), feature == right[i], cells if k else cells[:2]))
    bound = walk.node.bound_without(i)
    choices.append(Choice("*", right[i] == NONE, ("none", (str(bound), bound / m))))
    headings = (f"z{i} is …", "feature", "pairings, at most", "worst distance D²" if k else "")
    note = f"and {walk.hidden} more that K = {star} hides" if walk.hidden else ""
    table(picture, box, tuple(zip(_COLUMNS, headings)), choices, note)


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
        picture.blit(text(line, 12, symbols.INK, bold=bold), (left, top + row * ROW))
