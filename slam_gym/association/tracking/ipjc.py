"""IPJC: joint compatibility tested after the pose has been optimised for the hypothesis.

Olson and Li, "IPJC: the incremental posterior joint compatibility test for fast feature cloud matching", IROS 2012.
JCBB linearises at the predicted pose. For a feature at range r this is wrong by about r φ²/2 if the true heading
differs from the predicted one by φ. For a robot turned by φ from its predicted heading, a feature predicted at p̂_j
lies at Rot(−φ)(p̂_j + δ_j). The error of measurement i, rotated into the predicted axes, is then

    e(φ) = ν + (cos φ − 1) z_i + sin φ J z_i − φ a_j,   a_j = J p̂_j + c_j / σ²,   J = [0 −1; 1 0],

where σ² is the variance of the heading and c_j = Cov(h_j, θ); given φ, δ is Gaussian with covariance S − c cᵀ/σ². Here
p̂_j and S are those of first order. With
G the 4 × 4 matrix of the products of these four vectors, whitened by S_{H|θ}, and q = (1, cos φ − 1, sin φ, −φ),

    D²_H = min over φ of φ²/σ² + qᵀ G q.
"""

import math
from dataclasses import replace

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.compatibility import joint_gates
from slam_gym.association.prediction import Prediction
from slam_gym.association.tracking.jcbb import jcbb
from slam_gym.association.tracking.near_first import Offer, near_first
from slam_gym.association.tree import Pairings, may_follow
from slam_gym.mapping.measurement import joint_covariance
from slam_gym.types import Array, Effort, Hypothesis, IntArray, Scan
from slam_gym.validation import check_count

_ITERATIONS, _CONVERGED = 30, 1e-10  # [rad]


def ipjc(scan: Scan, prediction: Prediction, *, node_limit: int = 10_000) -> Hypothesis:
    """The hypothesis with most pairings, then least D²_H, whose prefixes are compatible, each at its best pose.

    Candidates must pass the individual gate at the predicted pose, as in `jcbb`. A prediction whose heading is certain
    is linear: the result is then that of JCBB. Every hypothesis is factored as a whole, which makes this plain baseline
    many times slower than JCBB.

    `joint_distance` is the optimised D²_H. `node_limit`, localities, `effort.limit_hit` and errors are those of `jcbb`,
    but a limit that is reached before all measurements were decided once leaves all of them unpaired.
    """
    check_count("node_limit", node_limit)
    variance = prediction.heading_variance
    if not variance > 0.0:
        return jcbb(scan, prediction, node_limit=node_limit)
    gates, optimised = joint_gates(len(scan), prediction.confidence), [0.0]
    known = prediction.expected

    def search(offer: Offer, rows: IntArray) -> Effort:
        p, mean, across = offer.pairings, prediction.positions[offer.rows], prediction.heading_covariances[offer.rows]
        z = scan.points[p.measured]
        if known.second_order:  # back to the mean and covariance of first order, since e(φ) is exact in the heading
            shift, features = 0.5 * np.column_stack([across[:, 1], -across[:, 0]]), known.features[offer.rows]
            mean, first_order = mean - shift, joint_covariance(known.state, known.covariance, features, False)
            p = p._replace(innovations=p.innovations + shift[p.slots], covariance=first_order)
        slopes = (np.column_stack([-mean[:, 1], mean[:, 0]]) + across / variance)[p.slots]
        errors = np.stack([p.innovations, z, np.column_stack([-z[:, 1], z[:, 0]]), slopes], axis=2)
        p = p._replace(covariance=p.covariance - np.outer(across, across) / variance)
        path, nodes, limit_hit = _search(p, offer.starts, errors, variance, gates, node_limit)
        optimised.append(_distance(p, errors, path, variance))
        rows[p.measured[path]] = offer.rows[p.slots[path]]
        return Effort(nodes=nodes, joint_tests=nodes, limit_hit=limit_hit)

    return replace(near_first(scan, prediction, search), joint_distance=optimised[-1])


@compiled
def _search(
    pairings: Pairings, starts: IntArray, errors: Array, variance: float, gates: Array, node_limit: int
) -> tuple[IntArray, int, bool]:
    """The pairings of the best hypothesis, the nodes visited, and whether the limit was reached. Depth first, `*` last.

    `errors` (c, 2, 4) are the four vectors of e(φ).
    """
    levels, first = len(starts) - 1, pairings.fixed + starts
    later = np.zeros(levels + 1, np.int64)  # number of levels from this one on that have a candidate
    for level in range(levels - 1, -1, -1):
        later[level] = later[level + 1] + (first[level] < first[level + 1])
    path = np.arange(pairings.fixed + levels)
    distance, made = np.zeros(levels + 1), np.full(levels + 1, pairings.fixed)
    distance[0] = _distance(pairings, errors, path[: pairings.fixed], variance)
    best, least, best_path = -1, math.inf, path[: pairings.fixed].copy()
    trial, level, nodes = first.copy(), 0, 0
    while level >= 0:
        bound = made[level] + later[level]
        hopeless = bound < best or (bound == best and distance[level] >= least)
        if level == levels or hopeless or trial[level] > first[level + 1]:
            if level == levels and not hopeless:
                best, least, best_path = made[level], distance[level], path[: made[level]].copy()
            trial[level] = first[level]
            level -= 1
            continue
        if nodes == node_limit:
            break
        c, p = trial[level], made[level]
        trial[level] += 1
        nodes += 1
        if c == first[level + 1]:  # `*`
            made[level + 1], distance[level + 1] = p, distance[level]
            level += 1
        elif may_follow(pairings, path, p, c):
            path[p] = c
            total = _distance(pairings, errors, path[: p + 1], variance)
            if total < gates[p + 1]:
                made[level + 1], distance[level + 1] = p + 1, total
                level += 1
    return best_path, nodes, level >= 0


@compiled
def _distance(pairings: Pairings, errors: Array, path: IntArray, variance: float) -> float:
    """min over φ of φ²/σ² + qᵀ G q, by Gauss–Newton from φ = 0 with step halving."""
    p = len(path)
    S, E = np.empty((2 * p, 2 * p)), np.empty((2 * p, 4))
    for a in range(p):
        E[2 * a : 2 * a + 2] = errors[path[a]]
        for b in range(p):
            i, j = 2 * pairings.slots[path[a]], 2 * pairings.slots[path[b]]
            S[2 * a : 2 * a + 2, 2 * b : 2 * b + 2] = pairings.covariance[i : i + 2, j : j + 2]
        S[2 * a : 2 * a + 2, 2 * a : 2 * a + 2] += pairings.noise[pairings.measured[path[a]]]
    G = E.T @ np.linalg.solve(S, E)
    phi, value = 0.0, float(G[0, 0])
    for _ in range(_ITERATIONS):
        q = np.array([1.0, math.cos(phi) - 1.0, math.sin(phi), -phi])
        slope = np.array([0.0, -math.sin(phi), math.cos(phi), -1.0])
        Gq = G @ q
        step = -(phi / variance + slope @ Gq) / (1.0 / variance + slope @ (G @ slope))
        while True:
            trial = phi + step
            q = np.array([1.0, math.cos(trial) - 1.0, math.sin(trial), -trial])
            after = float(trial * trial / variance + q @ (G @ q))
            if not (after > value and abs(step) > _CONVERGED):
                break
            step *= 0.5
        if abs(step) <= _CONVERGED:
            break
        phi, value = phi + step, after
    return value
