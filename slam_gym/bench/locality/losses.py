"""What a locality is before any search: how large, how many hypotheses it leaves, and which true ones it loses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam_gym.bench.locality.hypothesis_count import hypotheses
from slam_gym.bench.records import Record
from slam_gym.mapping.locality import locality_sizes
from slam_gym.types import UNPAIRED, BoolArray, IntArray, Locality


def locality_figures(n: int, m: int, locality: Locality | None, truths: Sequence[IntArray]) -> Record:
    """Mean and largest |L(j)| of a map of n features, N_h of the unpruned tree, and losses over the true hypotheses."""
    sizes = locality_sizes(locality, n)
    figures = {"mean c": float(sizes.mean()), "max c": float(sizes.max()), "N_h": hypotheses(sizes, m)}
    return figures | losses(truths, locality)


def losses(truths: Sequence[IntArray], locality: Locality | None) -> dict[str, float]:
    """Fractions of what a locality loses before any test, from the feature (m,) behind each measurement of each scan.

    `pairs`: of two features seen in one scan, that are not local to each other. `pairings`: of the true pairings, that
    no hypothesis holds which takes the measurements in the order of the scan, so that its first one decides; `scans`:
    that have no such hypothesis with all of them; `anyhow`: nor if any of them may come first, as in random sampling.
    """
    local = [_local(truth[truth != UNPAIRED], locality) for truth in truths]
    pairs, true = sum(len(one) * (len(one) - 1) for one in local), sum(len(one) for one in local)
    return {
        "pairs": sum(int((~one).sum()) for one in local) / pairs,
        "pairings": 1.0 - sum(int(np.triu(one).sum(axis=1).max()) for one in local) / true,
        "scans": 1.0 - float(np.mean([one[0].all() for one in local])),
        "anyhow": 1.0 - float(np.mean([one.all(axis=1).any() for one in local])),
    }


def _local(features: IntArray, locality: Locality | None) -> BoolArray:
    """(k, k) which of the features are local to which."""
    if locality is None:
        return np.ones((len(features), len(features)), np.bool_)
    return np.array([np.isin(features, locality.of(feature)) for feature in features])
