"""JCBB at loop closure, beside scipy's linear assignment on the same gated problem.

A robot maps a square field of point features (.6 per m²) in lanes, with known association. It is then carried elsewhere
with a wide odometry (σ .45 m, .45 m, 2°), so that each measurement has four to five candidates, and looks once: 20
measurements, 30 % of them spurious, against all features of the map. Its sensor reports 90 % of the features in range.
`sparse` is a sensor that reports any quarter of those within 6 m, with 20 % spurious: clutter that lands on one of the
many features not reported cannot be told from it, whatever the search. Scans are told right at χ² confidence .99 and
.999: of 14 right pairings, a gate of .99 turns one away in every tenth scan or so.

JCBB is timed from the call in Python to its answer: gating, joint covariance of the candidates, search. The assignment
is timed as the solver alone, on the matrix of D²_ij with one column per feature (`dense`) or per candidate feature
(`compact`), and one per measurement that leaves it unpaired at the price of the gate; and together with gating and the
filling of the dense matrix (`whole`). It answers an easier question: each pairing is weighed alone. Times are in µs.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from slam_gym.association import ASSOCIATORS, jcbb
from slam_gym.association.compatibility import Candidates, chi2_gate, individual
from slam_gym.bench.records import Record, column, means, medians
from slam_gym.bench.report import Report
from slam_gym.bench.speed.loop_closure import (
    CARRIED,
    DENSITY,
    DETECTION,
    RANGE,
    SPURIOUS,
    TRACKED,
    ClosureScan,
    closure_scan,
    mapped_field,
)
from slam_gym.bench.timing import THREAD, fastest
from slam_gym.types import Array, IntArray

CEILING = "true_association"
_FORBIDDEN = 1e6  # price of an incompatible pairing


def assignment_matrix(candidates: Candidates, columns: IntArray, count: int, gate: float) -> Array:
    """(m, count + m): D²_ij of the compatible pairings in their `columns` (c,), then `gate` for pairing nothing."""
    m = len(candidates.measurements)
    matrix = np.full((m, count + m), _FORBIDDEN)
    matrix[candidates.measured, columns] = candidates.distances
    matrix[np.arange(m), count + np.arange(m)] = gate
    return matrix


def measure(problem: ClosureScan) -> Record:
    """Figures and times of one scan."""
    scan, prediction, truth = problem.scan, problem.prediction, problem.truth
    candidates, answer = individual(scan, prediction), jcbb(scan, prediction)
    wider = jcbb(scan, replace(prediction, confidence=0.999))
    return {
        "candidates each": len(candidates.slots) / len(scan),
        "nodes": answer.effort.nodes,
        "joint tests": answer.effort.joint_tests,
        "right": float(np.mean(answer.features == truth)),
        "scans exact": np.array_equal(answer.features, truth),
        "exact at .999": np.array_equal(wider.features, truth),
        "JCBB": fastest(jcbb, scan, prediction),
        "gating": fastest(individual, scan, prediction),
        "joint": fastest(prediction.joint, candidates.rows),
        **_assignment_times(problem, candidates),
    }


def _assignment_times(problem: ClosureScan, candidates: Candidates) -> Record:
    scan, prediction = problem.scan, problem.prediction
    rows, n, gate = candidates.rows[candidates.slots], len(prediction), chi2_gate(2, prediction.confidence)

    def whole() -> None:
        gated = individual(scan, prediction)
        linear_sum_assignment(assignment_matrix(gated, gated.rows[gated.slots], n, gate))

    compact = assignment_matrix(candidates, candidates.slots, len(candidates.rows), gate)
    return {
        "compact": fastest(linear_sum_assignment, compact),
        "dense": fastest(linear_sum_assignment, assignment_matrix(candidates, rows, n, gate)),
        "whole": fastest(whole),
    }


def summary(problems: Iterable[ClosureScan]) -> Record:
    """Means of what is right, medians of what it took."""
    measured = [measure(problem) for problem in problems]
    row = means(measured, "candidates each", "right", "scans exact", "exact at .999")
    row |= medians(measured, "nodes", "joint tests", "JCBB")
    row |= {"95 %": float(np.percentile(column(measured, "JCBB"), 95))}
    row |= medians(measured, "gating", "joint", "compact", "dense", "whole")
    return row | {"JCBB / whole": row["JCBB"] / row["whole"]}


def beside_jcbb(scans: Sequence[ClosureScan], repeats: int = 5) -> list[Record]:
    """Processor time [µs] of every associator, and how many times JCBB's it is, each on the same scans."""
    times = {
        name: np.array([fastest(search, one.scan, one.prediction, repeats=repeats, clock=THREAD) for one in scans])
        for name, search in ASSOCIATORS.items()
        if name != CEILING
    }
    ratios = {name: taken / times["jcbb"] for name, taken in times.items()}
    return [
        {
            "search": name,
            "median": float(np.median(taken)),
            "× JCBB": float(np.median(ratios[name])),
            "of all together": float(taken.sum() / times["jcbb"].sum()),
            "at worst": float(ratios[name].max()),
        }
        for name, taken in sorted(times.items(), key=lambda item: float(np.median(item[1])))
    ]


def run(
    report: Report,
    *,
    features: tuple[int, ...] = (100, 300, 1000),
    measurements: int = 20,
    problems: int = 100,
    seed: int = 0,
) -> None:
    """One row per workload and size of the map; the last one is a tracking scan in a small map.

    Arguments:
        features: map sizes
        measurements: per scan
        problems: scans per map size
        seed: of everything random
    """
    rng, m = np.random.default_rng(seed), measurements
    near = math.sqrt(
        round((1.0 - SPURIOUS) * m) / DETECTION / (math.pi * DENSITY)
    )  # holds m features that are detected
    rows = []
    for n in features:
        field = mapped_field(n, rng)
        for workload, spurious, reach in (("loop closure", SPURIOUS, near), ("sparse", 0.2, RANGE)):
            scans = (closure_scan(field, m, CARRIED, rng, spurious=spurious, reach=reach) for _ in range(problems))
            rows.append({"workload": workload, "n": n, "m": m, **summary(scans)})
    field = mapped_field(30, rng)
    tracked = summary(closure_scan(field, 12, TRACKED, rng) for _ in range(problems))
    rows.append({"workload": "tracking", "n": 30, "m": 12, **tracked})
    large = mapped_field(max(features), rng)
    for workload, sigma in (("tracking", TRACKED), ("loop closure", CARRIED)):
        drawn = [closure_scan(large, m, sigma, rng) for _ in range(min(problems, 30))]
        title = f"Every associator, {workload}, {m} × {max(features)} [µs]"
        report.table(title, beside_jcbb(drawn), f"jcbb_{workload[:4]}")
    report.table("JCBB beside linear assignment (compact, dense, whole) [µs]", rows, "jcbb")
