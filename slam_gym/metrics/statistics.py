"""Statistics for tables: interquartile means and bootstrap intervals (Agarwal et al., NeurIPS 2021)."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from slam_gym.types import Array

Statistic = Callable[[Array], Array]
"""A function from values (…, n) to one number per row (…,)."""


@dataclass(frozen=True, slots=True)
class Interval:
    """An estimate and its 95 % confidence interval."""

    estimate: float
    low: float
    high: float


def interquartile_mean(values: Array) -> Array:
    """(…,) mean of values (…, n) without the lowest and the highest ⌊n/4⌋ of each row.

    Raises ValueError for n = 0, and for NaN.
    """
    values = np.asarray(values, np.float64)
    n = values.shape[-1]
    if n == 0 or np.isnan(values).any():
        raise ValueError(f"the interquartile mean of {'NaN' if n else 'no values'}")
    cut = n // 4
    return np.asarray(np.sort(values, axis=-1)[..., cut : n - cut].mean(axis=-1))


def mean(values: Array) -> Array:
    """(…,) mean of values (…, n), including outliers."""
    return np.asarray(np.mean(values, axis=-1, dtype=np.float64))


def bootstrap_interval(
    values: Array,
    rng: np.random.Generator,
    *,
    statistic: Statistic = interquartile_mean,
    resamples: int = 5000,
) -> Interval:
    """The 95 % percentile bootstrap interval of a statistic of independent values (n,).

    Raises ValueError without values, or for values that are not finite.
    """
    values = np.asarray(values, np.float64)
    if values.ndim != 1 or not len(values) or not np.isfinite(values).all():
        raise ValueError(f"a bootstrap interval needs finite values (n,), n >= 1, got shape {values.shape}")
    drawn = values[rng.integers(0, len(values), (resamples, len(values)))]
    low, high = np.quantile(statistic(drawn), [0.025, 0.975])
    return Interval(float(statistic(values)), float(low), float(high))
