"""Learned acceptance: whether the pose that a search without a prior found is where the robot is.

The rule of `relocation.acceptance` asks what chance would bring among scattered points. Buildings are none: corners
repeat along walls, rooms repeat each other, and many are their own mirror image. The network is told what the rule
knows, and besides how the pairings compare with what the same search finds for the mirror image of the scan, how much
of what lies among them is paired, and how well sizes agree. It answers with log odds that the pose is right.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from slam_gym.association.learned.network import load_network, log_odds
from slam_gym.association.relocation.acceptance import crowding_of, expected_by_chance, extent
from slam_gym.association.relocation.acceptance import min_pairings as by_rule
from slam_gym.association.relocation.gcbb import gcbb
from slam_gym.geometry import observe
from slam_gym.types import UNPAIRED, Array, IntArray, Landmarks, Locality, Relocation, Scan

WEIGHTS = "acceptance"
VERSION = 1
INPUTS = (
    "pairings",
    "pairings of the measurements",
    "log of the hypotheses of so many pairings that chance would bring",
    "pairings beyond the rule",
    "pairings beyond those of the mirror image",
    "pairings of the mirror image, of the measurements",
    "D² by its degrees of freedom",
    "pairings of the landmarks that lie among them",
    "log of 1 + the landmarks that lie among them",
    "sizes: mean of (a_i − a_j)²/s² over the pairings, 0 where none are known",
    "sizes: whether any are known",
    "log of the distance that the pairings are spread over [m]",
    "log of the measurements",
    "log of the landmarks around a landmark",
    "other poses with as many pairings",
)
COST = 6.0  # of a wrong pose, in right ones: on train worlds, four in a thousand are then invented
_FEWEST = 3  # pairings, below which nothing is accepted
_NEAREST = 0.1  # [m]
_ALONE = np.zeros(1, np.int64)


def learned_relocation(
    scan: Scan,
    landmarks: Landmarks,
    locality: Locality | None = None,
    *,
    cost: float = COST,
    confidence: float = 0.99,
    node_limit: int = 1_000_000,
    weights: str | Path = WEIGHTS,
) -> Relocation:
    """What `gcbb` finds, accepted where that is worth the risk by the network's word.

    With p the probability that the pose is right, and a wrong one that costs `cost` right ones, it is where
    p > cost / (cost + 1). `min_pairings` of the answer says which: as many as there are, or one more. Ties are never
    accepted. `node_limit` is that of the search, and a tenth of it that of the search for the mirror image. Raises
    ValueError as `gcbb`, for a cost that is not positive, and as `load_network`.
    """
    if not 0.0 < cost < math.inf:
        raise ValueError(f"cost: {cost} is not positive and finite")
    network = load_network(weights, VERSION, INPUTS)
    found = gcbb(scan, landmarks, locality, confidence=confidence, min_pairings=_FEWEST, node_limit=node_limit)
    if not found.accepted or found.effort.limit_hit:
        return replace(found, min_pairings=max(found.pairings + 1, _FEWEST))
    about = inputs_of(scan, landmarks, found, of_mirror_image(scan, landmarks, locality, confidence, node_limit // 10))
    believed = log_odds(network, about[None], _ALONE, _ALONE)[0] > math.log(cost)
    return replace(found, min_pairings=found.pairings if believed else found.pairings + 1)


def of_mirror_image(
    scan: Scan, landmarks: Landmarks, locality: Locality | None, confidence: float, node_limit: int
) -> int:
    """The pairings that the search finds for the scan as it would be measured beyond a mirror."""
    flip = np.diag([1.0, -1.0])
    other = replace(scan, points=scan.points @ flip, covariances=flip @ scan.covariances @ flip)
    limit = max(node_limit, 1)
    return gcbb(other, landmarks, locality, confidence=confidence, min_pairings=_FEWEST, node_limit=limit).pairings


def inputs_of(scan: Scan, landmarks: Landmarks, found: Relocation, mirrored: int) -> Array:
    """(inputs,) of an answer with at least three pairings."""
    k, m = found.pairings, len(scan)
    paired = np.flatnonzero(found.features != UNPAIRED)
    features = found.features[paired]
    crowding = crowding_of(landmarks, extent(scan))
    chance = float(expected_by_chance(scan, landmarks, crowding=crowding)[k])
    rule = by_rule(scan, landmarks, crowding=crowding)
    among, spread = _among(landmarks, found, scan.points[paired])
    squares = _size_squares(scan, landmarks, paired, features)
    others = np.arange(len(crowding.landmarks)) @ crowding.landmarks / max(int(crowding.landmarks.sum()), 1)
    return np.array([
        k, k / m, math.log(max(chance, 1e-12)), k - rule, k - mirrored, mirrored / m,
        found.joint_distance / max(found.dof, 1), k / max(among, k), math.log1p(among),
        float(squares.mean()) if len(squares) else 0.0, float(len(squares) > 0),
        math.log(max(spread, _NEAREST)), math.log(m), math.log1p(others), min(found.ties, 5),
    ])  # fmt: skip


def _among(landmarks: Landmarks, found: Relocation, points: Array) -> tuple[int, float]:
    """Number of landmarks within the circle about the paired measurements (k, 2), as they lie from the pose found; and
    [m] how far those are from their centre, root mean square."""
    centre = points.mean(axis=0)
    squares = ((points - centre) ** 2).sum(axis=1)
    away = observe(found.pose, landmarks.positions) - centre
    inside = (away**2).sum(axis=1) <= squares.max() + 1e-9
    return int(inside.sum()), math.sqrt(float(squares.mean()))


def _size_squares(scan: Scan, landmarks: Landmarks, paired: IntArray, features: IntArray) -> Array:
    variance = scan.size_variances[paired] + landmarks.size_variances[features]
    squares: Array = (scan.sizes[paired] - landmarks.sizes[features]) ** 2 / np.maximum(variance, 1e-9)
    return squares[np.isfinite(squares)]
