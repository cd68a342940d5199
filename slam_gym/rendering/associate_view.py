"""The view of `Associate-v0`: the surroundings of the robot, the current decision, and the interpretation tree."""

from typing import Any

import numpy as np

from slam_gym.association.tracking.walk import Walk
from slam_gym.geometry import rotate_covariances, transform
from slam_gym.metrics.association import Decision
from slam_gym.rendering import symbols
from slam_gym.rendering.canvas import Canvas, fitting
from slam_gym.rendering.panels import KEY, MAP, STAR, ActionRow, Figures, TreeLevel, TreePanel, picture_with
from slam_gym.rendering.scene import Scene, draw_scene, mark_size, scene_of_episode, scene_of_log
from slam_gym.simulation.association_runs import AssociationRun, DrivenRun
from slam_gym.simulation.judged import RightAnswers, decisions
from slam_gym.types import UNLABELLED, UNPAIRED, Array, IntArray

_ROOM = (60, 60, MAP[0] - 120, MAP[1] - 120)  # [pixels] left, bottom, width, height of robot and measurements
_MIN_EXTENT = 6.0  # [m] shown from edge to edge
_KEY = (
    *KEY,
    (symbols.PAPER, symbols.PLAN, "legal, with its gate"),
    (symbols.PAPER, symbols.LATER, "compatible alone"),
)


def draw(run: AssociationRun, walk: Walk | None, answers: RightAnswers, figures: Figures) -> Any:
    """A surface with a run and the walk through the tree of its present scan, or None after the end of the run."""
    scene = scene_of_episode(run) if isinstance(run, DrivenRun) else scene_of_log(run)
    points = np.vstack([scene.pose[:2], transform(scene.pose, run.scan.points)])
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.5 * np.maximum(_MIN_EXTENT - (high - low), 0.0)
    view = fitting(np.concatenate([low - margin, high + margin]), _ROOM)
    canvas = Canvas(MAP, *view, symbols.PAPER)
    draw_scene(canvas, scene if walk is None else _with_decisions(scene, walk, answers))
    panel = _panel(run, walk, answers, figures)
    if walk is None or walk.done:
        return picture_with(canvas, np.empty((0, 2)), panel)
    centres, decided = _draw_choice(canvas, scene.pose, walk)
    return picture_with(canvas, centres, panel, decided)


def _with_decisions(scene: Scene, walk: Walk, answers: RightAnswers) -> Scene:
    """The scene with the scan and the decisions on it so far. What is compatible with no feature stays unpaired."""
    tree, rows, pose = walk.tree, walk.decided, scene.pose
    has_candidates = np.isin(np.arange(len(rows)), walk.candidates.measurements)
    codes = np.where(has_candidates, decisions(walk, answers), Decision.DISCARDED)
    paired, has_feature = np.full((len(rows), 2), np.nan), rows != UNPAIRED
    paired[has_feature] = transform(pose, tree.prediction.positions[rows[has_feature]])
    return scene._replace(scan_points=transform(pose, tree.scan.points), decisions=codes, paired_positions=paired)


def _draw_choice(canvas: Canvas, pose: Array, walk: Walk) -> tuple[Array, Array]:
    """Draw the measurement to decide, and the gates of the candidates; their centres (k, 2) and the former (1, 2)."""
    tree, i, rows = walk.tree, walk.measurement, walk.rows
    centres = transform(pose, tree.prediction.positions[rows])
    spread = tree.prediction.covariances[rows] + tree.scan.covariances[i]
    canvas.ellipses(centres, rotate_covariances(pose[2], spread), None, symbols.PLAN, 1.6, float(tree.gates[1]))
    here = transform(pose, tree.scan.points[i : i + 1])
    for centre in centres:
        canvas.dashes(np.stack([here[0], centre]), symbols.PLAN, 1.6)
    symbols.choice(canvas, here[0], mark_size(canvas))
    return centres, here


def _panel(run: AssociationRun, walk: Walk | None, answers: RightAnswers, figures: Figures) -> TreePanel:
    if walk is None or walk.done:
        return TreePanel(figures, (), 0, _KEY, remarks=("Nothing is left to decide",))
    codes = decisions(walk, answers)
    levels = [_level(walk, answers, codes, k) for k in range(walk.tree.levels)]
    headings = (f"z{walk.measurement} is …", "feature", "alone D²", "with the path D²")
    note = f"and {walk.hidden} more that K = {walk.K} hides" if walk.hidden else ""
    return TreePanel(figures, levels, walk.level, _KEY, headings, _choices(run, walk, answers), note)


def _level(walk: Walk, answers: RightAnswers, codes: IntArray, k: int) -> TreeLevel:
    """Level `k`, branches by ascending D²_ij; at the current level, those compatible with the path are legal."""
    candidates, tree = walk.candidates, walk.tree
    first, last = int(candidates.starts[k]), int(candidates.starts[k + 1])
    i = int(candidates.measurements[k])
    features = tree.prediction.features[candidates.rows[candidates.slots[first:last]]].tolist()
    branch_of = dict(zip(features, range(last - first))) | {UNPAIRED: STAR}
    chosen = int(walk.chosen[k]) if k < walk.level else None
    return TreeLevel(
        f"z{i}",
        last - first,
        legal=frozenset((walk.offered - first).tolist()) if k == walk.level else frozenset(),
        chosen=chosen if chosen is None else STAR if chosen == UNPAIRED else chosen - first,
        decision=Decision.UNJUDGED if chosen is None else int(codes[i]),
        right=None if answers.sources[i] == UNLABELLED else branch_of.get(int(answers.right[i])),
    )


def _choices(run: AssociationRun, walk: Walk, answers: RightAnswers) -> list[ActionRow]:
    """The possible actions: feature, D²_ij, and D²_H, with bars up to their gates."""
    gates = float(walk.tree.gates[1]), float(walk.tree.gates[walk.pairings + 1])
    ids, right = run.slam.map.ids[run.prediction.features[walk.rows]], answers.right_action(walk)
    choices = []
    for action, (alone, joint) in enumerate(zip(walk.individual_distances, walk.joint_distances)):
        cells = (f"{ids[action]}", (f"{alone:.1f}", alone / gates[0]), (f"{joint:.1f}", joint / gates[1]))
        choices.append(ActionRow(str(action), action == right, cells))
    return [*choices, ActionRow("*", right == walk.K, ("nothing that is mapped",))]
