"""Geometric verification: whether the features of all pairs together may be the same, given the map's covariance.

With the innovations ν_ij = F_i − F_j of all pairs, their covariance C, and the directions G of a rigid motion of the
newer features as a whole,

    D² = νᵀC⁻¹ν = D²_shape + D²_motion,    D²_shape = min_δ (ν − Gδ)ᵀC⁻¹(ν − Gδ) = νᵀQν,
    Q = C⁻¹ − C⁻¹G(GᵀC⁻¹G)⁻¹GᵀC⁻¹,

Where the errors of the map are right-invariant, the innovations are V(δθ)⁻¹ (F_i − F_j) instead, so that the motion
between the parts may turn by tens of degrees (`mapping.update.heading_correction`).

D²_shape has 2k − 3 degrees of freedom and tests whether both have one shape; D²_motion has 3 and tests whether the
motion between them is one that the map considers possible. D²_shape is tested as it is. In D²_motion filters become
optimistic, so its standard deviations are multiplied by `RecognitionSpec.inflation`. The part of D²_shape that one pair
adds, given the others, is (Qν)_iᵀ Q_ii⁻¹ (Qν)_i, of 2 degrees of freedom.
"""

from typing import NamedTuple

import numpy as np

from slam_gym.association.compatibility import chi2_gate
from slam_gym.association.relocation.constraints import unary_table
from slam_gym.association.relocation.location import VARIANCE_FLOOR
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.mapping.update import heading_correction, left_jacobian_inverse
from slam_gym.slam.places.recognition import Parts, RecognitionSpec, rigid_motions
from slam_gym.types import Array, BoolArray, IntArray

_ONE_PAIR = 0.99  # confidence of the test of what a single pair adds
_UNARY_CONFIDENCE = 0.9999  # of the test of sizes: it should reject the impossible, not choose among the possible


class Agreement(NamedTuple):
    """How well k pairs agree."""

    shape: float  # D²_shape
    dof: int  # 2k − 3, of D²_shape
    motion: float  # D²_motion, of 3 degrees of freedom
    added: Array  # (k,) what each pair adds to D²_shape, of 2 degrees of freedom


def agreement(m: StochasticMap, pairs: IntArray) -> Agreement:
    """The agreement of pairs (k, 2) of an older and a newer feature of a map, k ≥ 3.

    Raises ValueError for a feature that does not exist, LinAlgError for one that is in two pairs.
    """
    k, (nu, C) = len(pairs), innovation(m, pairs)
    G, W = rigid_motions(m.positions[pairs[:, 1]]), np.linalg.inv(0.5 * (C + C.T))
    WG = W @ G
    Q = W - WG @ np.linalg.solve(G.T @ WG, WG.T)
    weighted, rows = (Q @ nu).reshape(k, 2), np.arange(k)
    added = np.einsum("ki,kij,kj->k", weighted, np.linalg.inv(Q.reshape(k, 2, k, 2)[rows, :, rows, :]), weighted)
    shape = max(float(nu @ Q @ nu), 0.0)
    return Agreement(shape, 2 * k - 3, max(float(nu @ W @ nu) - shape, 0.0), added)


def innovation(m: StochasticMap, pairs: IntArray) -> tuple[Array, Array]:
    """ν (2k,) [m] of all pairs (j, i) of an older and a newer feature, (k, 2), and its covariance C (2k, 2k) [m²].

    ν = F_i − F_j, or V(δθ)⁻¹ (F_i − F_j) with the correction δθ of the heading that the pairs imply.
    """
    C: Array = difference_covariance(m, pairs) + VARIANCE_FLOOR * np.eye(2 * len(pairs))
    nu = m.positions[pairs[:, 1]] - m.positions[pairs[:, 0]]
    gain = np.asarray(np.linalg.solve(C, heading_covariances(m, pairs).ravel()), np.float64)
    return left_jacobian_inverse(nu, heading_correction(nu, gain)).ravel(), C


def heading_covariances(m: StochasticMap, pairs: IntArray) -> Array:
    """(k, 2) [m·rad] covariances of the heading with F_j − F_i for all pairs (j, i) of features, (k, 2).

    They are 0 where the errors of the map are not right-invariant: innovations are then not corrected for a turn.
    """
    older, newer = m.heading_covariances[pairs.T]
    of_heading: Array = float(m.spec.right_invariant) * (older - newer)
    return of_heading


def difference_covariance(m: StochasticMap, pairs: IntArray) -> Array:
    """(2k, 2k) [m²] joint covariance of F_i − F_j for all pairs (j, i) of an older and a newer feature, (k, 2)."""
    k, P = len(pairs), m.covariance_of(pairs.T.ravel())
    HP = P[2 * k :] - P[: 2 * k]
    C: Array = HP[:, 2 * k :] - HP[:, : 2 * k]
    return C


def agreeing(m: StochasticMap, pairs: IntArray, spec: RecognitionSpec, *, prior: bool) -> IntArray:
    """Drop the pairs (k, 2) that disagree with the others, worst first; returns those left (k', 2), or none.

    None are left if they become fewer than `min_loop_pairs` (with `prior`) or `min_pairs`, or if their shape does not
    agree. With `prior`, the map must also consider their motion possible. Raises as `agreement`.
    """
    least = spec.min_loop_pairs if prior else spec.min_pairs
    while len(pairs) >= least:
        fit = agreement(m, pairs)
        worst = int(fit.added.argmax())
        if fit.added[worst] < chi2_gate(2, _ONE_PAIR):
            possible = fit.motion < spec.inflation**2 * chi2_gate(3, spec.confidence)
            holds = fit.shape < chi2_gate(fit.dof, spec.confidence) and (possible or not prior)
            return pairs if holds else pairs[:0]
        pairs = np.delete(pairs, worst, axis=0)
    return pairs[:0]


def overlap(m: StochasticMap, parts: Parts, pairs: IntArray) -> float:
    """Ratio of the pairs (k, 2) to the features of the part that has fewer in the circle around its paired ones."""
    positions, counts = m.positions, []
    for side, features in ((0, parts.older), (1, parts.recent)):
        paired = positions[pairs[:, side]]
        centre = paired.mean(axis=0)
        radius = float(np.hypot(*(paired - centre).T).max()) + 1e-9
        counts.append(int((np.hypot(*(positions[features] - centre).T) <= radius).sum()))
    return len(pairs) / max(min(counts), 1)


def attributes_agree(m: StochasticMap, older: IntArray, newer: IntArray) -> BoolArray:
    """(b, a) whether size and kind allow each pair of a newer (b,) and an older feature (a,)."""
    of_newer, of_older = ((m.sizes[part], m.size_variances[part], m.kinds[part]) for part in (newer, older))
    return unary_table(of_newer, of_older, chi2_gate(1, _UNARY_CONFIDENCE))
