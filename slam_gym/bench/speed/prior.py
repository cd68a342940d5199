"""All searches with a prior, side by side, at loop closure: what they get right, at what price.

A robot has mapped a field of n point features (.25 per m²) and comes back with an uncertain pose (σ .6 m, .6 m, 4°).
It looks once, over 180°, as far as holds m measurements: those features in view that it detects (P_D .9), and uniform
clutter. Three settings: no spurious measurements; 30 % of them; 50 % of them, with σ of the pose half as large again
and a fifth of the features never mapped. Scans are pooled over n = 20, 100, 300, 1 000 and m = 5, 10, 20.

A scan is `exact` if every measurement is decided as its source says; `recall` counts measurements of mapped features
that are paired rightly, `precision` pairings that are right. Intervals (±) are 95 %, by bootstrap over scans.

MAP is told the true P_D. It takes its default densities of what is not in the map; `+ learned density` estimates them
online (`MostProbable`); `+ field of view` is also told what the sensor would have in view from each hypothesis's pose.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from slam_gym.association import (
    MostProbable,
    global_nearest_neighbour,
    ipjc,
    jcbb,
    map_hypothesis,
    nearest_neighbour,
    one_point_ransac,
    singles,
)
from slam_gym.bench.speed.jcbb import Field, mapped_field
from slam_gym.geometry import observe, relative
from slam_gym.navigation.visibility import FieldOfView
from slam_gym.types import NONE, Array, Associator, IntArray, Odometry, Prediction, Scan

DENSITY = 0.25  # [1/m²]
FIELD_OF_VIEW = math.pi  # [rad]
DETECTION = 0.9
SIGMA = 0.05  # [m] of a measurement, in x and in y
POSE_SIGMA = np.array([0.6, 0.6, math.radians(4.0)])  # of the pose at closure


@dataclass(frozen=True)
class Setting:
    """One column of the table."""

    name: str
    spurious: float  # share of the measurements
    widening: float  # of the pose's σ
    unmapped: float  # share of the features


SETTINGS = (
    Setting("no spurious", 0.0, 1.0, 0.0),
    Setting("30 % spurious", 0.3, 1.0, 0.0),
    Setting("50 % spurious, σ × 1.5, 20 % unmapped", 0.5, 1.5, 0.2),
)


@dataclass(frozen=True)
class Look:
    """One scan at loop closure."""

    scan: Scan
    prediction: Prediction  # with visibilities
    truth: IntArray  # (m,) map feature behind each measurement, NONE for spurious and unmapped ones


def look(field: Field, m: int, setting: Setting, rng: np.random.Generator) -> Look:
    """The robot is moved to a random place of the field and sees about m measurements there."""
    slam, side = field.map.copy(), float(field.features.max())
    dropped = rng.permutation(slam.n)[: round(setting.unmapped * slam.n)]
    kept = slam.remove(dropped)
    index = np.full(len(field.features), NONE)
    index[field.identities[kept]] = np.arange(len(kept))
    sigma = setting.widening * POSE_SIGMA
    target = np.array([*rng.uniform(0.2 * side, 0.8 * side, 2), rng.uniform(-math.pi, math.pi)])
    slam.predict(Odometry(relative(field.pose, target) + sigma * rng.standard_normal(3), np.diag(sigma**2)))
    real, clutter = m - round(setting.spurious * m), round(setting.spurious * m)
    reach = math.sqrt(2.0 * real / DETECTION / (FIELD_OF_VIEW * DENSITY))
    seen = observe(target, field.features)
    inside = (np.hypot(*seen.T) < reach) & (np.abs(np.arctan2(seen[:, 1], seen[:, 0])) < 0.5 * FIELD_OF_VIEW)
    detected = np.flatnonzero(inside & (rng.random(len(seen)) < DETECTION))
    radius = reach * np.sqrt(rng.random(clutter))
    bearing = FIELD_OF_VIEW * (rng.random(clutter) - 0.5)
    points = np.concatenate([seen[detected], np.column_stack([radius * np.cos(bearing), radius * np.sin(bearing)])])
    truth = np.concatenate([index[detected], np.full(clutter, NONE)])
    order, unknown = np.argsort(np.arctan2(points[:, 1], points[:, 0])), np.full(len(points), np.nan)
    noise = np.tile(SIGMA**2 * np.eye(2), (len(points), 1, 1))
    scan = Scan(points[order] + SIGMA * rng.standard_normal(points.shape), noise, unknown, unknown)
    prediction = slam.prediction(reach)

    view = FieldOfView(FIELD_OF_VIEW, reach).in_view
    return Look(scan, dataclasses.replace(prediction, view=view), truth[order])


def _blind(associator: Associator) -> Associator:
    """The associator, not told what is in view."""
    return lambda scan, prediction: associator(scan, dataclasses.replace(prediction, view=None))


def associators() -> dict[str, Associator]:
    """Fresh ones: some of them learn."""
    learning = MostProbable(options={"detection": DETECTION})
    seeing = MostProbable(options={"detection": DETECTION})
    return {
        "nearest neighbour": nearest_neighbour,
        "GNN": global_nearest_neighbour,
        "SINGLES": singles,
        "1-point RANSAC": one_point_ransac,
        "JCBB": jcbb,
        "IPJC": ipjc,
        "MAP": _blind(map_hypothesis),
        "MAP + learned density": _blind(learning),
        "MAP + field of view": seeing,
    }


@dataclass(frozen=True)
class Answers:
    """What one associator answered to a row of scans."""

    right: Array  # (s,) pairings that are right
    paired: Array  # (s,)
    mapped: Array  # (s,) measurements of mapped features
    exact: Array  # (s,)
    milliseconds: Array  # (s,)
    limit_hit: int


def ask(associator: Associator, looks: list[Look]) -> Answers:
    """Have every scan associated."""
    figures, milliseconds, limits = [], [], 0
    for one in looks:
        start = time.perf_counter_ns()
        answer = associator(one.scan, one.prediction)
        milliseconds.append((time.perf_counter_ns() - start) / 1e6)
        made, agrees = answer.features != NONE, answer.features == one.truth
        figures.append(((made & agrees).sum(), made.sum(), (one.truth != NONE).sum(), agrees.all()))
        limits += answer.effort.limit_hit
    right, paired, mapped, exact = np.array(figures, dtype=np.float64).T
    return Answers(right, paired, mapped, exact, np.array(milliseconds), limits)


def interval(statistic: Callable[[IntArray], float], count: int, rng: np.random.Generator) -> tuple[float, float]:
    """A statistic of all scans, and half its 95 % bootstrap interval."""
    drawn = [statistic(rng.integers(0, count, count)) for _ in range(500)]
    low, high = np.percentile(drawn, [2.5, 97.5])
    return statistic(np.arange(count)), 0.5 * float(high - low)


def main(argv: list[str] | None = None) -> None:
    """Print one table for each setting."""
    parser = argparse.ArgumentParser(
        prog="python -m slam_gym.bench prior", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--features", type=int, nargs="+", default=[20, 100, 300, 1000], help="map sizes n")
    parser.add_argument("--measurements", type=int, nargs="+", default=[5, 10, 20], help="per scan, m")
    parser.add_argument("--scans", type=int, default=30, help="per n, m and setting")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(argv)
    rng = np.random.default_rng(arguments.seed)
    fields = [mapped_field(n, rng, DENSITY) for n in arguments.features]
    for setting in SETTINGS:
        looks = [
            look(field, m, setting, rng)
            for _ in range(arguments.scans)
            for field in fields
            for m in arguments.measurements
        ]
        print(f"\n{setting.name}: {len(looks)} scans")
        print("                        exact       recall      precision   median ms  95 %  limit hit")
        for name, associator in associators().items():
            associator(looks[0].scan, looks[0].prediction)  # compiled before it is timed
            _report(name, ask(associator, looks), np.random.default_rng(0))


def _report(name: str, a: Answers, rng: np.random.Generator) -> None:
    count = len(a.exact)
    figures = (
        interval(lambda k: float(a.exact[k].mean()), count, rng),
        interval(lambda k: float(a.right[k].sum() / a.mapped[k].sum()), count, rng),
        interval(lambda k: float(a.right[k].sum() / max(a.paired[k].sum(), 1.0)), count, rng),
    )
    told = "  ".join(f"{value:.3f}±{half:.3f}" for value, half in figures)
    middle, high = np.percentile(a.milliseconds, [50, 95])
    print(f"{name:22s}  {told}  {middle:9.2f} {high:6.2f} {a.limit_hit:8d}")
