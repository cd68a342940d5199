"""Every measure of an episode at once: the map, the trajectory, the associations, the consistency of the filter."""

from __future__ import annotations

import numpy as np

from slam_gym.geometry import transform
from slam_gym.metrics.consistency import anees
from slam_gym.metrics.map_quality import ate, gospa, landmark_rmse, local_error, map_error_aligned
from slam_gym.simulation.episode import Episode
from slam_gym.types import IntArray

_CUTOFF = 1.0  # [m] of the GOSPA that is reported


def quality(episode: Episode) -> dict[str, float]:
    """Measures of the episode so far; provisional features (seen too seldom to be confirmed) count nowhere, and those
    of maps that a lost robot has left count as long as they are not joined with the current one.

    `map_error_aligned` is that of the map laid rigidly onto the truth: what is wrong with its shape.
    `landmark_rmse_…` [m] are over the mapped features whose creator was a real feature, each against that feature;
    duplicates count in `duplicates` and as false in GOSPA (p = 2, c = 1 m). `local_error` [m] is by how much distances
    between those of them that were seen together are wrong, on average. `ate` [m] is that of the positions, without
    alignment, since both start from one known pose. `anees` is the pose NEES over its 3 degrees of freedom, averaged
    over the ticks. `recovered`: after a kidnapping, the pose was right again; `ticks_astray` until then.
    """
    nees = np.array(episode.nees[1:])
    kidnapping = episode.kidnapping
    maps, tally = episode.slam.maps, episode.identities.total
    sources = episode.identities.source_of(np.concatenate([m.ids[~m.provisional] for m in maps]))
    real, first = np.unique(sources, return_index=True)
    first, real = first[real >= 0], real[real >= 0]
    landmarks = episode.landmarks
    mapped, true = landmarks[first], episode.site.plan.features.positions[real]
    parts = gospa(landmarks, episode.targets, p=2.0, cutoff=_CUTOFF)
    return {
        "map_error": episode.map_error(),
        "map_error_aligned": map_error_aligned(
            landmarks, episode.targets, episode.scenario.prior_sigma, (mapped, true)
        ),
        "coverage": episode.coverage(),
        "landmark_rmse_raw": landmark_rmse(mapped, true),
        "landmark_rmse_aligned": landmark_rmse(mapped, true, aligned=True),
        "local_error": local_error(mapped, true, _seen_together(episode, first)),
        "gospa": parts.total,
        "gospa_localisation": parts.localisation,
        "gospa_missed": parts.missed,
        "gospa_false": parts.false,
        "precision": tally.precision,
        "recall": tally.recall,
        "duplicates": float((sources >= 0).sum() - len(real)),
        "features": float(len(landmarks)),
        "anees": anees(nees[np.isfinite(nees)], 3),
        "ate": ate(transform(episode.base, np.array(episode.estimates)[:, :2]), np.array(episode.poses)[:, :2]),
        "ticks": float(episode.ticks),
        "kidnapped": float(kidnapping.happened is not None),
        "recovered": float(kidnapping.recovered is not None),
        "ticks_astray": _ticks_astray(episode),
        "relocations_right": float(kidnapping.right),
        "relocations_wrong": float(kidnapping.wrong),
    }


def _seen_together(episode: Episode, chosen: IntArray) -> IntArray:
    """Pairs (e, 2) of the `chosen` (k,) of all confirmed features, by position, that the current map saw together."""
    confirmed = np.flatnonzero(~episode.slam.map.provisional)
    rows = np.full(episode.slam.map.n, -1)
    current = np.flatnonzero(chosen < len(confirmed))
    rows[confirmed[chosen[current]]] = current
    pairs = rows[episode.slam.covisibility.edges().pairs]
    together: IntArray = pairs[(pairs >= 0).all(axis=1)]
    return together


def _ticks_astray(episode: Episode) -> float:
    """From the kidnapping until the pose was right again, or until now."""
    kidnapping = episode.kidnapping
    if kidnapping.happened is None:
        return 0.0
    return float((episode.ticks if kidnapping.recovered is None else kidnapping.recovered) - kidnapping.happened)
