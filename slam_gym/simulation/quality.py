"""All measures of an episode: the map, the trajectory, the associations, the consistency of the filter."""

import numpy as np

from slam_gym.geometry import transform
from slam_gym.metrics.consistency import anees
from slam_gym.metrics.map_quality import ate, gospa, landmark_rmse, map_error_aligned
from slam_gym.simulation.episode import Episode

_CUTOFF = 1.0  # [m] of the reported GOSPA


def quality(episode: Episode) -> dict[str, float]:
    """Compute all measures of the episode so far.

    Provisional features (seen too seldom to be confirmed) are not counted. Features of inactive maps are counted.

    `map_error_aligned` is the error after rigid alignment with the truth, that of the shape of the map.
    `landmark_rmse_…` [m] compare each mapped feature with the real one that most of its measurements came from. Further
    mapped features of the same real one count in `duplicates`, and as false in GOSPA (p = 2, c = 1 m). `ate` [m] is the
    error of the positions, without alignment, since both start from one known pose. `missed_loop` is 1 if the robot
    seems to have mapped a place twice (`Slam.missed_loop`). `anees` is the pose NEES divided by its 3 degrees of
    freedom, averaged over the ticks. `recovered` is 1 if the pose was right again after a kidnapping; `ticks_astray` is
    the number of ticks until then.
    """
    nees = np.array(episode.nees[1:])
    kidnapping = episode.kidnapping
    maps, tally = episode.slam.maps, episode.identities.total
    right_again = episode.ticks if kidnapping.recovered is None else kidnapping.recovered
    sources = episode.identities.majority_of(np.concatenate([m.ids[~m.provisional] for m in maps]))
    real, first = np.unique(sources, return_index=True)
    first, real = first[real >= 0], real[real >= 0]
    landmarks, targets = episode.landmarks, episode.targets
    mapped, true = landmarks[first], episode.site.plan.features.positions[real]
    parts = gospa(landmarks, targets, p=2.0, cutoff=_CUTOFF)
    return {
        "map_error": episode.map_error(),
        "map_error_aligned": map_error_aligned(landmarks, targets, episode.scenario.prior_sigma, (mapped, true)),
        "coverage": episode.coverage(),
        "landmark_rmse_raw": landmark_rmse(mapped, true),
        "landmark_rmse_aligned": landmark_rmse(mapped, true, aligned=True),
        "gospa": parts.total,
        "gospa_localisation": parts.localisation,
        "gospa_missed": parts.missed,
        "gospa_false": parts.false,
        "precision": tally.precision,
        "recall": tally.recall,
        "duplicates": float((sources >= 0).sum() - len(real)),
        "features": float(len(landmarks)),
        "missed_loop": float(episode.slam.missed_loop),
        "anees": anees(nees[np.isfinite(nees)], 3),
        "ate": ate(transform(episode.base, np.array(episode.estimates)[:, :2]), np.array(episode.poses)[:, :2]),
        "ticks": float(episode.ticks),
        "kidnapped": float(kidnapping.happened is not None),
        "recovered": float(kidnapping.recovered is not None),
        "ticks_astray": 0.0 if kidnapping.happened is None else float(right_again - kidnapping.happened),
        "relocations_right": float(kidnapping.right),
        "relocations_wrong": float(kidnapping.wrong),
    }
