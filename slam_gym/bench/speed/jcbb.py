"""JCBB at loop closure, beside scipy's linear assignment on the same gated problem.

A robot maps a square field of point features (.6 per m²) in lanes, with known association. It is then carried elsewhere
with a wide odometry (σ .45 m, .45 m, 2°), so that each measurement has four to five candidates, and looks once: 20
measurements, 30 % of them spurious, against all features of the map. Its sensor reports 90 % of the features in range.
`sparse` is a sensor that reports any quarter of those within 6 m, with 20 % spurious: clutter that lands on one of the
many features not reported cannot be told from it, whatever the search. `share right` is told at χ² confidence .99 and
.999: of 14 right pairings, a gate of .99 turns one away in every tenth scan or so.

JCBB is timed from the call in Python to
its answer: gating, joint covariance of the candidates, search. The assignment is timed as the solver alone, on the
matrix of D²_ij with one column per feature (`dense`) or per candidate feature (`compact`), and one per measurement that
leaves it unpaired at the price of the gate; and together with gating and the filling of the dense matrix (`whole`). It
answers an easier question: each pairing is weighed alone.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from slam_gym.association import jcbb
from slam_gym.association.compatibility import Candidates, chi2_gate, individual
from slam_gym.geometry import compose, observe, relative
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.types import NONE, Array, IntArray, Odometry, Prediction, Scan

DENSITY = 0.6  # [1/m²]
RANGE = 6.0  # [m]
SPURIOUS = 0.3  # share of the measurements
DETECTION = 0.9  # share of the features in range that is reported
SIGMA = 0.03  # [m] of a measurement, in x and in y
LANE = 8.0  # [m] between the lanes of the mapping drive
CARRIED = np.diag([0.45, 0.45, math.radians(2.0)]) ** 2  # covariance of the odometry before the loop closes
TRACKED = np.diag([0.02, 0.02, math.radians(0.5)]) ** 2


@dataclass(frozen=True)
class Field:
    """A mapped field: where the features are, what the map knows, and which feature each map entry stands for."""

    features: Array  # (n, 2) [m]
    map: StochasticMap
    identities: IntArray  # (n',) true feature behind each map feature
    pose: Array  # (3,) [m, m, rad] true pose at the end of the mapping drive


@dataclass(frozen=True)
class Problem:
    """One scan to associate."""

    scan: Scan
    prediction: Prediction
    truth: IntArray  # (m,) map feature behind each measurement, NONE for spurious ones


def mapped_field(n: int, rng: np.random.Generator, density: float = DENSITY) -> Field:
    """A field of n features, `density` per m², mapped in one drive over its lanes with known association."""
    side = math.sqrt(n / density)
    features = rng.uniform(0.0, side, (n, 2))
    lanes = np.arange(min(LANE, side) / 2.0, side, LANE)
    waypoints = [(x, y) for k, y in enumerate(lanes) for x in np.arange(0.0, side, 1.0)[:: 1 if k % 2 == 0 else -1]]
    pose = np.array([*waypoints[0], 0.0])
    slam, index = StochasticMap(MapSpec(), pose, capacity=n), np.full(n, NONE)
    noise = np.diag([0.02, 0.02, math.radians(0.3)]) ** 2
    for x, y in waypoints:
        motion = relative(pose, np.array([x, y, 0.0]))
        pose = compose(pose, motion)
        slam.predict(Odometry(motion + rng.multivariate_normal(np.zeros(3), noise), noise))
        seen = _in_range(features, pose, 2 * RANGE)
        new = np.flatnonzero(index[seen] == NONE)
        known = rng.permutation(np.flatnonzero(index[seen] != NONE))[:15]
        scan = _scan(observe(pose, features[seen]), rng)
        decisions = np.full(len(seen), NONE)
        decisions[known] = index[seen[known]]
        slam.update(scan, decisions)
        index[seen[new]] = slam.add(scan, new)
    mapped = np.flatnonzero(index != NONE)
    identities = np.empty(len(mapped), np.int64)
    identities[index[mapped]] = mapped
    return Field(features, slam, identities, pose)


def problem(
    field: Field,
    m: int,
    reach: float,
    motion: Array,
    rng: np.random.Generator,
    *,
    spurious: float = 0.2,
    sees: float = RANGE,
) -> Problem:
    """The robot is moved to a random place, with an odometry of covariance `motion` (3, 3), and sees m points there.

    A share `spurious` of them is clutter, the others are random ones of the features within `sees` [m].
    """
    slam = field.map.copy()
    side = float(field.features.max())
    target = np.array([*rng.uniform(0.2 * side, 0.8 * side, 2), rng.uniform(-math.pi, math.pi)])
    told = relative(field.pose, target) + rng.multivariate_normal(np.zeros(3), motion)
    slam.predict(Odometry(told, motion))
    index = np.full(len(field.features), NONE)
    index[field.identities] = np.arange(len(field.identities))
    real = m - round(spurious * m)
    seen = rng.permutation(_in_range(field.features, target, sees))[:real]
    points = np.concatenate([observe(target, field.features[seen]), _disc(m - len(seen), sees, rng)])
    order = np.argsort(np.arctan2(points[:, 1], points[:, 0]))
    truth = np.concatenate([index[seen], np.full(m - len(seen), NONE)])
    return Problem(_scan(points[order], rng), slam.prediction(reach), truth[order])


def assignment_matrix(candidates: Candidates, columns: IntArray, count: int, gate: float) -> Array:
    """(m, count + m): D²_ij of the compatible pairings in their `columns` (c,), then `gate` for pairing nothing."""
    m = len(candidates.measurements)
    matrix = np.full((m, count + m), 1e6)
    matrix[candidates.measured, columns] = candidates.distances
    matrix[np.arange(m), count + np.arange(m)] = gate
    return matrix


def microseconds(call: Callable[[], object], repetitions: int = 5) -> float:
    """Least of a few timings [µs]."""
    best = math.inf
    for _ in range(repetitions):
        start = time.perf_counter_ns()
        call()
        best = min(best, time.perf_counter_ns() - start)
    return best / 1e3


def _in_range(features: Array, pose: Array, reach: float) -> IntArray:
    return np.flatnonzero(np.hypot(*(features - pose[:2]).T) < reach)


def _disc(count: int, reach: float, rng: np.random.Generator) -> Array:
    radius, angle = reach * np.sqrt(rng.random(count)), rng.uniform(-math.pi, math.pi, count)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def _scan(points: Array, rng: np.random.Generator) -> Scan:
    m = len(points)
    unknown = np.full(m, np.nan)
    return Scan(
        points + SIGMA * rng.standard_normal((m, 2)), np.tile(SIGMA**2 * np.eye(2), (m, 1, 1)), unknown, unknown
    )


def measure(problem: Problem) -> dict[str, float]:
    """Timings [µs] and figures of one problem."""
    scan, prediction = problem.scan, problem.prediction
    candidates, gate = individual(scan, prediction), chi2_gate(2, 0.99)
    answer = jcbb(scan, prediction)
    rows, n = candidates.rows[candidates.slots], len(prediction)
    dense = assignment_matrix(candidates, rows, n, gate)
    compact = assignment_matrix(candidates, candidates.slots, len(candidates.rows), gate)

    def whole() -> None:
        gated = individual(scan, prediction)
        linear_sum_assignment(assignment_matrix(gated, gated.rows[gated.slots], n, gate))

    return {
        "candidates": len(candidates.slots) / len(scan),
        "nodes": answer.effort.nodes,
        "tests": answer.effort.joint_tests,
        "right": float(np.mean(answer.features == problem.truth)),
        "exact": float(np.array_equal(answer.features, problem.truth)),
        "wider": float(np.array_equal(jcbb(scan, replace(prediction, confidence=0.999)).features, problem.truth)),
        "jcbb": microseconds(lambda: jcbb(scan, prediction)),
        "gating": microseconds(lambda: individual(scan, prediction)),
        "joint": microseconds(lambda: prediction.joint(candidates.rows)),
        "compact": microseconds(lambda: linear_sum_assignment(compact)),
        "dense": microseconds(lambda: linear_sum_assignment(dense)),
        "whole": microseconds(whole),
    }


def main(argv: list[str] | None = None) -> None:
    """Print medians over problems, by size of the map; the last line is a tracking scan in a small map."""
    parser = argparse.ArgumentParser(prog="python -m slam_gym.bench jcbb", description=__doc__)
    parser.add_argument("--features", type=int, nargs="+", default=[100, 300, 1000], help="map sizes")
    parser.add_argument("--measurements", type=int, default=20, help="per scan")
    parser.add_argument("--problems", type=int, default=100, help="per map size")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(argv)
    rng = np.random.default_rng(arguments.seed)
    print(
        "                 candidates                       share right | JCBB [µs]                   | assignment [µs]"
    )
    print(
        "workload            n  m  each nodes tests  meas. scans  .999 | whole  95 %  gating joint | "
        "compact dense whole | JCBB/whole"
    )
    m = arguments.measurements
    near = math.sqrt(round((1.0 - SPURIOUS) * m) / DETECTION / (math.pi * DENSITY))
    for n in arguments.features:
        field = mapped_field(n, rng)
        for workload, spurious, sees in (("loop closure", SPURIOUS, near), ("sparse", 0.2, RANGE)):
            looks = (
                problem(field, m, np.inf, CARRIED, rng, spurious=spurious, sees=sees) for _ in range(arguments.problems)
            )
            _report(workload, n, m, [measure(one) for one in looks])
    field = mapped_field(30, rng)
    _report("tracking", 30, 12, [measure(problem(field, 12, np.inf, TRACKED, rng)) for _ in range(arguments.problems)])


def _report(workload: str, n: int, m: int, rows: list[dict[str, float]]) -> None:
    median = {name: float(np.median([row[name] for row in rows])) for name in rows[0]}
    mean = {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}
    high = float(np.percentile([row["jcbb"] for row in rows], 95))
    print(
        f"{workload:15s} {n:5d} {m:2d} {mean['candidates']:5.1f} {median['nodes']:5.0f} {median['tests']:5.0f}  "
        f"{mean['right']:.3f} {mean['exact']:.3f} {mean['wider']:.3f} | "
        f"{median['jcbb']:5.0f} {high:5.0f}  {median['gating']:6.0f} {median['joint']:5.0f} | "
        f"{median['compact']:7.0f} {median['dense']:5.0f} {median['whole']:5.0f} | "
        f"{median['jcbb'] / median['whole']:.2f}"
    )
