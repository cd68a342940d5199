"""What is compatible with the features foreseen, in every narrow heading of theirs, in compiled code.

As `association.tracking.headings` has it, for `by_marginals`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.compatibility import gate_pairings
from slam_gym.association.tracking.headings import NARROW, joint_of_part, predicted, split
from slam_gym.association.tracking.marginals import greatest_score
from slam_gym.association.tracking.scan_hypotheses import Rates
from slam_gym.mapping.measurement import joint_covariance
from slam_gym.navigation.visibility import SightArrays
from slam_gym.types import Array, BoolArray, IntArray


class Foreseen(NamedTuple):
    """The prediction, (k,) features."""

    features: IntArray
    sizes: Array  # (k,) [m], and their variances (k,) [m²]
    size_variances: Array
    kinds: IntArray
    ages: IntArray
    sightings: IntArray
    near: BoolArray
    positions: Array  # (k, 2) [m]
    covariances: Array  # (k, 2, 2) [m²]
    across: Array  # (k, 2) with the heading
    variance: float  # [rad²] of the heading


class Scene(NamedTuple):
    """Where to look up what else there is to know."""

    x: Array
    P: Array
    second_order: bool
    sight: SightArrays
    pose: Array  # (≥ 3,) predicted


class Part(NamedTuple):
    """A narrow heading."""

    log_weight: float
    variance: float  # [rad²] of the heading in it
    positions: Array
    covariances: Array
    phi: float  # [rad]
    across: Array  # (k, 2) g_j of `headings`
    given: Array  # (2k, 2k), or (0, 0) where the heading is not split


class Look(NamedTuple):
    """What is compatible in it."""

    part: Part
    starts: IntArray
    measured: IntArray
    slots: IntArray
    innovations: Array
    rows: IntArray
    tests: int
    strange: int  # measurements without a candidate
    rates: Rates
    at_most: float


@compiled
def compatible(
    points: Array,
    noise: Array,
    foreseen: Foreseen,
    scene: Scene,
    gate: float,
    unseen: float,
    belief: tuple[float, float, float],
    learned: bool,
) -> list[Look]:
    """What is compatible in every narrow heading; nothing, where a number is none to work with."""
    every, (detection, a, b) = np.arange(len(points)), belief
    looks: list[Look] = []
    parts = _parts(foreseen, scene)
    for k in range(len(parts)):
        part = parts[k]
        fault, _, starts, measured, slots, _, innovations, rows, tests = gate_pairings(
            points, noise, part.positions, part.covariances, every, np.empty(0, np.bool_), gate
        )
        if fault:
            return looks[:0]
        strange = 0
        for i in range(len(points)):
            strange += starts[i] == starts[i + 1]
        rates = Rates(detection, unseen, (a + strange) / b)
        at_most = math.inf
        if not learned:
            at_most = part.log_weight + greatest_score(noise, starts, rates[:])
        looks.append(Look(part, starts, measured, slots, innovations, rows, tests, strange, rates, at_most))
    return looks


@compiled
def _parts(foreseen: Foreseen, scene: Scene) -> list[Part]:
    """The narrow headings: `headings.headings`."""
    positions, covariances, variance = foreseen.positions, foreseen.covariances, foreseen.variance
    phi, log_weights = split(variance)
    if len(phi) == 1 or len(positions) == 0:
        return [Part(0.0, variance, positions, covariances, 0.0, foreseen.across, np.empty((0, 0)))]
    joint = joint_covariance(scene.x, scene.P, foreseen.features, scene.second_order)
    moved, across, spread, given = predicted(positions, foreseen.across, joint, max(variance, 0.0), phi)
    out: list[Part] = []
    for k in range(len(phi)):
        out.append(Part(log_weights[k], NARROW * NARROW, moved[k], spread[k], phi[k], across[k], given))
    return out


@compiled
def joint_in(scene: Scene, foreseen: Foreseen, part: Part, rows: IntArray) -> Array:
    """(2r, 2r) covariance of the features at `rows` together, in a narrow heading."""
    if part.given.size == 0:
        return joint_covariance(scene.x, scene.P, foreseen.features[rows], scene.second_order)
    return joint_of_part(part.given, part.phi, part.across, rows)
