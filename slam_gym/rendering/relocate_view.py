"""The view of `Relocate-v0`: the map with the candidates, the scan, and the interpretation tree."""

from typing import Any

import numpy as np

from slam_gym.association.relocation.location import locate
from slam_gym.association.relocation.walk import RelocationWalk
from slam_gym.geometry import compose, rotate_covariances, transform
from slam_gym.metrics.association import Decision
from slam_gym.rendering import symbols
from slam_gym.rendering.canvas import TEXT, Canvas, fitting, pygame, text
from slam_gym.rendering.panels import KEY, MAP, STAR, ActionRow, Figures, TreeLevel, TreePanel, picture_with
from slam_gym.rendering.scene import Scene, draw_scene
from slam_gym.simulation.judged import UNDECIDED
from slam_gym.simulation.relocation_problems import Kidnapped, MappedWorld
from slam_gym.types import UNPAIRED, Array, IntArray

_INSET, _HEADING = 260, 34  # [pixels] side of the scan, height of the line above the map
_MARGIN = 0.7  # [m] around the plan
_KEY = (
    *KEY,
    (symbols.PAPER, symbols.PLAN, "on offer"),
    (symbols.PAPER, symbols.LATER, "legal, later"),
    (symbols.PAPER, symbols.PROVISIONAL, "local to the first"),
    (symbols.INK, symbols.INK, "true robot"),
    (symbols.PAPER, symbols.MAPPED, "robot as located"),
)


def draw(walk: RelocationWalk, mapped: MappedWorld, kidnapped: Kidnapped, figures: Figures) -> Any:
    """A surface with the walk: the whole map on the left, the scan in R in a corner, and the tree on the right."""
    features, right = walk.node.hypothesis, kidnapped.features
    codes = np.where(features == right, int(Decision.RIGHT), int(Decision.WRONG))  # (m,) by measurement
    codes[features == UNPAIRED] = Decision.DISCARDED
    codes[walk.order[walk.level :]] = UNDECIDED
    picture = picture_with(*_map(walk, mapped, kidnapped, codes), _panel(walk, right, codes, figures))
    where = "the robot is not in this map" if not kidnapped.inside else mapped.site.plan.name
    picture.blit(text(where, TEXT, symbols.MUTED), (14, 10))
    _draw_scan(picture, (10, MAP[1] - _INSET - 10), walk, codes)
    return picture


def _map(walk: RelocationWalk, mapped: MappedWorld, kidnapped: Kidnapped, codes: IntArray) -> tuple[Canvas, Array]:
    """The map with the paired features and, once it is located, the robot with its scan; features on offer (k, 2)."""
    view = fitting(mapped.site.plan.bounds, (0, _INSET, MAP[0], MAP[1] - _INSET - _HEADING), _MARGIN)
    canvas, base, features = Canvas(MAP, *view, symbols.PAPER), mapped.base, walk.node.hypothesis
    landmarks, paired = transform(base, mapped.landmarks.positions), features != UNPAIRED
    ends = np.full((len(features), 2), np.nan)
    ends[paired] = landmarks[features[paired]]
    located = locate(walk.scan, walk.landmarks, features)
    pose = compose(base, located.pose)
    scene = Scene(
        true_pose=kidnapped.true_pose if kidnapped.inside else np.full(3, np.nan),
        landmarks=landmarks,
        landmark_covariances=rotate_covariances(base[2], mapped.landmarks.covariances),
        provisional=np.zeros(len(landmarks), np.bool_),
    )
    if np.isfinite(pose).all():
        scene = scene._replace(
            pose=pose,
            position_covariance=rotate_covariances(base[2], located.covariance[None, :2, :2])[0],
            scan_points=transform(pose, walk.scan.points),
            decisions=codes,
            paired_positions=ends,
        )
    canvas.segments(mapped.site.plan.walls, symbols.LINE, 1.6)  # pale, below what was mapped
    draw_scene(canvas, scene, 1.0)
    if np.isnan(scene.pose).any():
        symbols.marks(canvas, ends[paired], codes[paired], 1.3)
    if walk.node.pairings and walk.locality is not None:
        local = walk.locality.of(int(walk.node.path.features[0]))
        canvas.discs(landmarks[local], 4.6, None, symbols.PROVISIONAL, 0.9)
    canvas.discs(landmarks[walk.shown], 5.4, None, symbols.PLAN, 1.8)
    return canvas, landmarks[walk.shown]


def _draw_scan(picture: Any, corner: tuple[int, int], walk: RelocationWalk, codes: IntArray) -> None:
    """Draw the scan in R, x up: decided measurements, the one to decide now, and the others."""
    points = walk.scan.points[:, ::-1] * np.array([-1.0, 1.0])  # x ahead, drawn upwards
    reach = 1.3 * max(float(np.abs(points).max(initial=1.0)), 1.0)
    canvas = Canvas((_INSET, _INSET), (-reach, -reach), 0.5 * _INSET / reach, symbols.PAPER)
    canvas.segments(np.concatenate([np.zeros_like(points), points], axis=1), symbols.LINE, 0.8)
    symbols.marks(canvas, points, codes)
    symbols.robot_estimate(canvas, np.array([0.0, 0.0, 0.5 * np.pi]), 0.0)
    if walk.measurement is not None:
        symbols.choice(canvas, points[walk.measurement])
    picture.blit(canvas.picture(), corner)
    pygame.draw.rect(picture, symbols.LINE, (*corner, _INSET, _INSET), 1)
    picture.blit(text("the scan", TEXT, symbols.MUTED), (corner[0] + 8, corner[1] + 6))


def _panel(walk: RelocationWalk, right: IntArray, codes: IntArray, figures: Figures) -> TreePanel:
    """The panel; `right` (m,) are the true features, `codes` (m,) the decisions on the measurements."""
    levels = [_level(walk, right, codes, k) for k in range(len(walk.order))]
    if walk.offer is None:
        return TreePanel(figures, levels, walk.level, _KEY, remarks=_remarks(walk))
    headings = (f"z{walk.measurement} is …", "feature", "pairings, at most", "worst D²" if walk.node.pairings else "")
    note = f"and {walk.hidden} more that K = {walk.spec.star} hides" if walk.hidden else ""
    return TreePanel(figures, levels, walk.level, _KEY, headings, _choices(walk, right), note)


def _level(walk: RelocationWalk, right: IntArray, codes: IntArray, k: int) -> TreeLevel:
    """Level `k`, branches by rank: those that were on offer when it was decided, or else those that are legal now."""
    i, star = int(walk.order[k]), walk.spec.star
    if k < walk.level:
        branches, action = walk.offered[k]
        chosen = STAR if action == star else action
        return TreeLevel(f"z{i}", branches, chosen=chosen, decision=int(codes[i]))
    alive = int(walk.node.alive[i].sum())
    if k > walk.level or walk.at_leaf:
        return TreeLevel(f"z{i}", alive)
    of_truth = walk.action_of(int(right[i]))
    return TreeLevel(f"z{i}", alive, frozenset(range(len(walk.shown))), right=STAR if of_truth == star else of_truth)


def _choices(walk: RelocationWalk, right: IntArray) -> list[ActionRow]:
    """The possible actions: feature, bound on the pairings, and worst D² of its distances to paired features."""
    offer, i = walk.offer, walk.measurement
    assert offer is not None and i is not None
    m, gate, k = len(walk.order), walk.problem.scan.gate_one, walk.node.pairings
    choices = []
    for action, feature in enumerate(walk.shown.tolist()):
        bound, worst = k + 1 + int(offer.support[action]), float(offer.worst[action])
        cells = (str(feature), (str(bound), bound / m), (f"{worst:.1f}", worst / gate))
        choices.append(ActionRow(str(action), feature == right[i], cells if k else cells[:2]))
    bound = walk.node.bound_without(i)
    return [*choices, ActionRow("*", right[i] == UNPAIRED, ("none", (str(bound), bound / m)))]


def _remarks(walk: RelocationWalk) -> tuple[str, ...]:
    """The result of a hypothesis at a leaf."""
    pairings = walk.node.pairings
    verdict = "the best so far is believed" if walk.best.accepted else "the best so far is not believed"
    if pairings < 2:
        return "A leaf without a pose", "two pairings at least determine one", verdict
    passed, located = "passes" if walk.compatible else "fails", locate(walk.scan, walk.landmarks, walk.node.hypothesis)
    distance = f"D² = {located.joint_distance:.1f}, dof {located.dof}"
    return f"A leaf of {pairings} pairings: {passed} the joint test", distance, verdict
