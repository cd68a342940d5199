"""All searches with a prior, side by side, at loop closure: what they get right, at what price.

A robot has mapped a field of n point features (.25 per m²) and comes back with an uncertain pose (σ .6 m, .6 m, 4°).
It looks once, over 180°, as far as holds m measurements: those features in view that it detects (P_D .9), and uniform
clutter. Three difficulties: no spurious measurements; 30 % of them; 50 % of them, with σ of the pose half as large
again and a fifth of the features never mapped. Scans are pooled over n = 20, 100, 300, 1 000 and m = 5, 10, 20.

A scan is `exact` if every measurement is decided as its source says; `recall` counts measurements of mapped features
that are paired rightly, `precision` pairings that are right. Intervals (±) are 95 %, by bootstrap over scans.

MAP is told the true P_D; `+ field of view` is also told what the sensor would have in view from each hypothesis's pose.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from slam_gym.association import (
    global_nearest_neighbour,
    ipjc,
    jcbb,
    map_hypothesis,
    nearest_neighbour,
    one_point_ransac,
    singles,
)
from slam_gym.bench.records import Record, column
from slam_gym.bench.report import Report
from slam_gym.bench.sensing import clutter, features_in_view
from slam_gym.bench.speed.loop_closure import ClosureScan, MappedField, mapped_field
from slam_gym.bench.timing import timed
from slam_gym.geometry import observe, relative
from slam_gym.navigation.visibility import FieldOfView
from slam_gym.types import UNPAIRED, Associator, IntArray, Odometry, Scan

DENSITY = 0.25  # [1/m²]
FIELD_OF_VIEW = math.pi  # [rad]
DETECTION = 0.9
SIGMA = 0.05  # [m] of a measurement, in x and in y
POSE_SIGMA = np.array([0.6, 0.6, math.radians(4.0)])  # of the pose at closure
_RESAMPLES = 500


class Difficulty(NamedTuple):
    """One table."""

    name: str
    spurious: float  # fraction of the measurements
    widening: float  # of the pose's σ
    unmapped: float  # fraction of the features


DIFFICULTIES = (
    Difficulty("no spurious", 0.0, 1.0, 0.0),
    Difficulty("30 % spurious", 0.3, 1.0, 0.0),
    Difficulty("50 % spurious, σ × 1.5, 20 % unmapped", 0.5, 1.5, 0.2),
)


def difficult_scan(field: MappedField, m: int, difficulty: Difficulty, rng: np.random.Generator) -> ClosureScan:
    """The robot is moved to a random place of the field and sees about m measurements there; with visibilities."""
    field = _partly_mapped(field, difficulty.unmapped, rng)
    sigma, target = difficulty.widening * POSE_SIGMA, field.place(rng)
    field.map.predict(Odometry(relative(field.pose, target) + sigma * rng.standard_normal(3), np.diag(sigma**2)))
    strays = round(difficulty.spurious * m)
    reach = math.sqrt(2.0 * (m - strays) / DETECTION / (FIELD_OF_VIEW * DENSITY))
    seen = features_in_view(field.features, target, reach, FIELD_OF_VIEW)
    seen = seen[rng.random(len(field.features))[seen] < DETECTION]
    points = np.concatenate([observe(target, field.features[seen]), clutter(strays, reach, FIELD_OF_VIEW, rng)])
    truth = np.concatenate([field.index[seen], np.full(strays, UNPAIRED)])
    order = np.argsort(np.arctan2(points[:, 1], points[:, 0]))
    scan = Scan.from_points(points[order] + SIGMA * rng.standard_normal(points.shape), sigma=SIGMA)
    view = FieldOfView(FIELD_OF_VIEW, reach).in_view
    return ClosureScan(scan, replace(field.map.prediction(reach), view=view), truth[order])


def _partly_mapped(field: MappedField, unmapped: float, rng: np.random.Generator) -> MappedField:
    """The same field with a copy of its map that lacks a fraction of the features."""
    partial = field.map.copy()
    kept = partial.remove(rng.permutation(partial.n)[: round(unmapped * partial.n)])
    return replace(field, map=partial, identities=field.identities[kept])


def _not_told_the_view(associator: Associator) -> Associator:
    return lambda scan, prediction: associator(scan, replace(prediction, view=None))


def associators() -> dict[str, Associator]:
    """By the names of the table."""
    return {
        "nearest neighbour": nearest_neighbour,
        "GNN": global_nearest_neighbour,
        "SINGLES": singles,
        "1-point RANSAC": one_point_ransac,
        "JCBB": jcbb,
        "IPJC": ipjc,
        "MAP": _not_told_the_view(map_hypothesis),
        "MAP + field of view": map_hypothesis,
    }


def associate(associator: Associator, scans: Sequence[ClosureScan]) -> list[Record]:
    """Have every scan associated."""
    records = []
    for one in scans:
        answer, microseconds = timed(associator, one.scan, one.prediction)
        paired, agrees = answer.features != UNPAIRED, answer.features == one.truth
        records.append({
            "right": int((paired & agrees).sum()),
            "paired": int(paired.sum()),
            "mapped": int((one.truth != UNPAIRED).sum()),
            "exact": bool(agrees.all()),
            "ms": 1e-3 * microseconds,
            "limit hit": answer.effort.limit_hit,
        })  # fmt: skip
    return records


def summary(records: Sequence[Record]) -> Record:
    """One row of the table."""
    right, paired, mapped, exact, ms = (column(records, n) for n in ("right", "paired", "mapped", "exact", "ms"))
    rng, count = np.random.default_rng(0), len(records)
    middle, high = np.percentile(ms, [50, 95]).tolist()
    return {
        "exact": with_half_interval(lambda k: float(exact[k].mean()), count, rng),
        "recall": with_half_interval(lambda k: float(right[k].sum() / mapped[k].sum()), count, rng),
        "precision": with_half_interval(lambda k: float(right[k].sum() / max(paired[k].sum(), 1.0)), count, rng),
        **{"median ms": middle, "95 %": high, "limit hit": sum(record["limit hit"] for record in records)},
    }


def with_half_interval(statistic: Callable[[IntArray], float], count: int, rng: np.random.Generator) -> str:
    """A statistic of all `count` scans, ± half its 95 % bootstrap interval."""
    drawn = [statistic(rng.integers(0, count, count)) for _ in range(_RESAMPLES)]
    low, high = np.percentile(drawn, [2.5, 97.5])
    return f"{statistic(np.arange(count)):.3f}±{0.5 * float(high - low):.3f}"


def run(
    report: Report,
    *,
    features: tuple[int, ...] = (20, 100, 300, 1000),
    measurements: tuple[int, ...] = (5, 10, 20),
    scans: int = 30,
    seed: int = 0,
) -> None:
    """One table for each difficulty.

    Arguments:
        features: map sizes n
        measurements: per scan, m
        scans: per n, m and difficulty
        seed: of everything random
    """
    rng = np.random.default_rng(seed)
    fields = [mapped_field(n, rng, DENSITY) for n in features]
    for difficulty in DIFFICULTIES:
        drawn = [
            difficult_scan(field, m, difficulty, rng) for _ in range(scans) for field in fields for m in measurements
        ]
        rows = []
        for name, associator in associators().items():
            associator(drawn[0].scan, drawn[0].prediction)  # compiled before it is timed
            rows.append({"search": name, **summary(associate(associator, drawn))})
        report.table(f"{difficulty.name}: {len(drawn)} scans", rows, f"prior_{100 * difficulty.spurious:.0f}")
