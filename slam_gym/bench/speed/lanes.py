"""One map against a sequence of local maps, as the robot drives over a field of features lane by lane.

Both take the same scans with JCBB. A step in one map costs as much as its square; in a local map, which is closed with
so many features, it costs the same however far the robot has come, and memory grows with the number of features. What
is measured from two lanes stands in two local maps until they are joined, which takes as long as the one map.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from slam_gym.association import jcbb
from slam_gym.bench.memory import resident
from slam_gym.bench.records import Record
from slam_gym.bench.sensing import features_in_view
from slam_gym.bench.timing import THREAD, timed
from slam_gym.geometry import observe, relative, transform
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.slam.local_maps import LocalMapSlam
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import Array, IntArray, Odometry, Scan

REACH = 6.0  # [m] of the sensor
_AREA = 6.0  # [m²] for each feature
_LANE, _STEP = 8.0, 0.5  # [m] between lanes, and between steps
_SIGMA, _DETECTION = 0.03, 0.9  # [m] of a measurement; fraction of the features in reach that is reported
_DRIFT = np.diag([0.02, 0.02, math.radians(0.3)]) ** 2  # covariance of the odometry of a step
_FEW = 20  # steps that may still compile something


class Look(NamedTuple):
    """What one step brings."""

    odometry: Odometry
    scan: Scan
    seen: IntArray  # (m,) feature behind each measurement


def looks(features: Array, side: float, rng: np.random.Generator) -> Iterator[Look]:
    """Those of a drive over lanes of a square, there and back; all poses face along +x."""
    lanes, along = np.arange(0.5 * _LANE, side, _LANE), np.arange(0.0, side, _STEP)
    way = np.array([(x, y, 0.0) for k, y in enumerate(lanes) for x in along[:: 1 if k % 2 == 0 else -1]])
    before = way[0]
    for pose in way:
        told = relative(before, pose) + rng.multivariate_normal(np.zeros(3), _DRIFT)
        seen = features_in_view(features, pose, REACH)
        seen = seen[rng.random(len(seen)) < _DETECTION]
        points = observe(pose, features[seen]) + _SIGMA * rng.standard_normal((len(seen), 2))
        yield Look(Odometry(told, _DRIFT), Scan.from_points(points, sigma=_SIGMA), seen)
        before = pose


def measure(count: int, per_map: int | None, joined: bool, seed: int) -> Record:
    """A drive over so many features with one map (None) or local maps of so many; `joined` at its end."""
    rng, side, before = np.random.default_rng(seed), math.sqrt(_AREA * count), resident()
    features = rng.uniform(0.0, side, (count, 2))
    spec = SlamSpec(reach=REACH)
    slam = Slam(spec) if per_map is None else LocalMapSlam(spec, per_map)
    sources, taken = np.full(0, -1), []
    for look in looks(features, side, rng):
        one = timed(slam.step, look.odometry, look.scan, jcbb, clock=THREAD)
        taken.append(one.microseconds)
        ids = one.answer.ids
        sources = np.append(sources, np.full(max(0, ids.max(initial=-1) + 1 - len(sources)), -1))
        sources[ids[one.answer.created]] = look.seen[one.answer.created]
    start = np.array([0.0, 0.5 * _LANE, 0.0])
    late = 1e-3 * float(np.median(taken[-len(taken) // 10 :]))
    row: Record = {"features": count, "map": "one" if per_map is None else "local", "steps": len(taken)}
    row |= {"step ms": 1e-3 * float(np.median(taken[_FEW:])), "last tenth ms": late, "memory MB": resident() - before}
    if isinstance(slam, Slam):
        return (
            row
            | _off(start, slam.map.ids, slam.map.positions, features, sources)
            | _nees(start, slam.map, features, sources)
        )
    ids = np.concatenate([m.ids for m in slam.maps])
    unjoined = np.concatenate([transform(base, m.positions) for base, m in zip(slam.maps.bases, slam.maps)])
    row |= {"maps": len(slam.maps)} | _off(start, ids, unjoined, features, sources)
    if not joined:
        return row
    whole = timed(slam.joined, clock=THREAD)
    m = whole.answer
    found = _off(start, m.ids, m.positions, features, sources) | _nees(start, m, features, sources)
    return row | {"join s": 1e-6 * whole.microseconds} | {f"{name}, joined": value for name, value in found.items()}


def _off(start: Array, ids: IntArray, positions: Array, features: Array, sources: IntArray) -> Record:
    """By how much features are off, root mean square, each against the one it was started from; and how many are
    duplicates of others."""
    off = np.hypot(*(transform(start, positions) - features[sources[ids]]).T)
    return {"off m": math.sqrt(float(np.mean(off**2))), "duplicates": len(ids) - len(np.unique(sources[ids]))}


def _nees(start: Array, m: StochasticMap, features: Array, sources: IntArray) -> Record:
    """Mean of D² of the features' errors by what the map knows of each, over its 2 degrees of freedom."""
    error = observe(start, features[sources[m.ids]]) - m.positions
    squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(m.covariances), error)
    return {"NEES / 2": 0.5 * float(squared.mean())}
