"""How effort grows: exponents and factors fitted to the means at several points, with intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from slam_gym.bench.records import Record, column, grouped
from slam_gym.metrics.statistics import Interval
from slam_gym.types import Array

_RESAMPLES = 2000


def power(attempts: Sequence[Record], axis: str, name: str, rng: np.random.Generator) -> Interval:
    """Exponent p of the means ∝ axis^p, by least squares on logarithms; 95 % by resampling the scans of each point."""
    points = grouped(attempts, axis)
    return _slope(np.log([float(key[axis]) for key, _ in points]), [column(g, name) for _, g in points], rng)


def growth(attempts: Sequence[Record], axis: str, name: str, rng: np.random.Generator) -> Interval:
    """Factor by which the means grow with each step of one along the axis, likewise."""
    points = grouped(attempts, axis)
    slope = _slope(np.array([float(key[axis]) for key, _ in points]), [column(g, name) for _, g in points], rng)
    return Interval(math.exp(slope.estimate), math.exp(slope.low), math.exp(slope.high))


def exponent(x: Sequence[float], y: Sequence[float]) -> float:
    """p of y ∝ x^p, by least squares on logarithms."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def _slope(x: Array, values: Sequence[Array], rng: np.random.Generator) -> Interval:
    """Of the logarithms of the means over x; NaN for fewer than two points."""
    if len(x) < 2:
        return Interval(math.nan, math.nan, math.nan)
    resampled = [v[rng.integers(0, len(v), (_RESAMPLES, len(v)))].mean(axis=1) for v in values]
    centred = x - x.mean()
    weights = centred / (centred @ centred)
    drawn = weights @ np.log(np.maximum(resampled, 1e-12))
    estimate = weights @ np.log([max(v.mean(), 1e-12) for v in values])
    low, high = np.quantile(drawn, [0.025, 0.975])
    return Interval(float(estimate), float(low), float(high))
