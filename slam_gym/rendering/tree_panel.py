"""The panel of an association: its interpretation tree, and the table of what may be chosen."""

from __future__ import annotations

from typing import Any

from slam_gym.association.tracking.walk import Walk
from slam_gym.metrics.association import Decision
from slam_gym.rendering import symbols
from slam_gym.rendering.canvas import pygame, text
from slam_gym.rendering.figures_panel import ROW, Box, Choice, Figures, KeyEntry, figures, key, table
from slam_gym.rendering.tree_levels import Level, draw_levels
from slam_gym.simulation.association_runs import AssociationRun
from slam_gym.simulation.verdicts import Verdicts, decisions
from slam_gym.types import NONE, UNKNOWN, IntArray

_MARGIN = 18  # [pixels]
_COLUMNS = (0, 64, 156, 274)  # [pixels] of the table
_KEY: tuple[KeyEntry, ...] = (
    (symbols.DECISIONS[Decision.RIGHT], symbols.PAPER, "paired, right"),
    (symbols.DECISIONS[Decision.WRONG], symbols.PAPER, "paired, wrong"),
    (symbols.DECISIONS[Decision.DISCARDED], symbols.PAPER, "not paired"),
    (symbols.PAPER, symbols.INK, "not decided yet"),
    (symbols.CHOICE, symbols.INK, "to decide now"),
    (symbols.PAPER, symbols.PLAN, "legal, 95 % gate"),
    (symbols.PAPER, symbols.LINE, "compatible alone"),
    (symbols.MAPPED, symbols.MAPPED, "mapped feature"),
    (None, symbols.DECISIONS[Decision.RIGHT], "the truth"),
)


def draw_panel(
    picture: Any, box: Box, run: AssociationRun, walk: Walk | None, verdicts: Verdicts, shown: Figures
) -> None:
    """Figures, tree, the table of the branches to choose from, and the key."""
    left, top, width, height = box
    pygame.draw.line(picture, symbols.LINE, (left, top), (left, top + height))
    x, y, room = left + _MARGIN, top + 13, width - 2 * _MARGIN
    picture.blit(text("Interpretation tree", 15, symbols.INK, bold=True), (x, y))
    figures(picture, shown, (x, y + 27), room, 2)
    bottom = key(picture, (x, top, room, height), _KEY)
    if walk is None or walk.done:
        picture.blit(text("nothing left to decide", 13, symbols.MUTED), (x, y + 110))
        return
    below = bottom - (len(walk.offered) + 2 + (walk.hidden > 0)) * ROW - 8
    codes = decisions(walk, verdicts)
    levels = [_level(walk, verdicts, codes, k) for k in range(walk.tree.levels)]
    draw_levels(picture, (x, y + 104, room, below - y - 126), levels, walk.level)
    _table(picture, (x, below, room, 0), walk, verdicts, run)


def _level(walk: Walk, verdicts: Verdicts, codes: IntArray, k: int) -> Level:
    """Branches by ascending D²_ij; those of the level at hand that stayed compatible with the path are on offer."""
    candidates, tree = walk.candidates, walk.tree
    first, last = int(candidates.starts[k]), int(candidates.starts[k + 1])
    i = int(candidates.measurements[k])
    features = tree.prediction.features[tree.rows[candidates.slots[first:last]]].tolist()
    right = NONE if verdicts.right[i] == NONE else None
    if verdicts.sources[i] == UNKNOWN:
        right = None
    elif verdicts.right[i] in features:
        right = features.index(verdicts.right[i])
    taken = int(walk.chosen[k]) if k < walk.level else None
    return Level(
        f"z{i}",
        last - first,
        on_offer=frozenset((walk.offered - first).tolist()) if k == walk.level else frozenset(),
        taken=taken if taken in (None, NONE) else taken - first,
        colour=symbols.LINE if taken is None else symbols.DECISIONS[int(codes[i])],
        right=right,
    )


def _table(picture: Any, box: Box, walk: Walk, verdicts: Verdicts, run: AssociationRun) -> None:
    """What may be chosen: action, feature, D²_ij and D²_H with bars up to their gates."""
    gates = float(walk.tree.gates[1]), float(walk.tree.gates[walk.pairings + 1])
    ids, right = run.slam.map.ids[run.prediction.features[walk.rows]], verdicts.right_action(walk)
    choices = []
    for action, distances in enumerate(zip(walk.individual_distances, walk.joint_distances)):
        alone, joint = (f"{value:.1f}" for value in distances)
        shares = float(distances[0]) / gates[0], float(distances[1]) / gates[1]
        choices.append(Choice(str(action), action == right, (f"{ids[action]}", (alone, shares[0]), (joint, shares[1]))))
    choices.append(Choice("*", right == walk.K, ("nothing that is mapped",)))
    headings = (f"z{walk.measurement} is …", "feature", "alone D²", "with the path D²")
    note = f"and {walk.hidden} more that K = {walk.K} hides" if walk.hidden else ""
    table(picture, box, tuple(zip(_COLUMNS, headings)), choices, note)
