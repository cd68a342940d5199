"""Scans of known origin: where was the robot that measured this? For searches without a prior on its pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam_gym.recordings.reading import RecordingError, check_finite, check_shapes, check_starts
from slam_gym.types import SPURIOUS, UNLABELLED, UNPAIRED, Array, IntArray, Landmarks, Scan


@dataclass(frozen=True)
class RelocationCases:
    """Scans in a surveyed map, the identity behind each measurement, and the pose that each scan was taken from.

    Raises RecordingError, naming the field, where arrays do not fit together or hold what they may not.
    """

    name: str
    source: str  # where it is published and what to cite
    terms: str  # under which it may be used
    landmark_ids: IntArray  # (L,) identities, none twice
    landmarks: Array  # (L, 2) [m] in W
    starts: IntArray  # (C + 1,) the measurements of case k are rows starts[k]:starts[k + 1] of the arrays (M, …)
    points: Array  # (M, 2) [m] in R
    covariances: Array  # (M, 2, 2) [m²] in R
    sources: IntArray  # (M,) identity behind each measurement, −1 spurious, −2 unknown
    poses: Array  # (C, 3) [m, m, rad] true poses in W

    def __post_init__(self) -> None:
        L, C, M = len(self.landmark_ids), len(self.poses), len(self.points)
        shapes = {"landmarks": (L, 2), "starts": (C + 1,), "points": (M, 2), "covariances": (M, 2, 2)}
        check_shapes(self, {**shapes, "sources": (M,), "poses": (C, 3)})
        check_finite(self, ("landmarks", "points", "covariances", "poses"))
        check_starts(self.starts, M)
        if len(np.unique(self.landmark_ids)) != L:
            raise RecordingError("field 'landmark_ids' names a landmark twice")
        if not np.isin(self.sources, [SPURIOUS, UNLABELLED, *self.landmark_ids]).all():
            raise RecordingError("field 'sources' names a landmark that is not there")

    def __len__(self) -> int:
        return len(self.poses)

    def scan(self, case: int) -> Scan:
        """What was measured. Sizes are unknown."""
        rows = slice(self.starts[case], self.starts[case + 1])
        return Scan.from_points(self.points[rows], self.covariances[rows])

    def features_of(self, case: int) -> IntArray:
        """(m,) row of `landmarks` behind each measurement, UNPAIRED where there is none: the true hypothesis."""
        rows = {identity: row for row, identity in enumerate(self.landmark_ids.tolist())}
        sources = self.sources[self.starts[case] : self.starts[case + 1]]
        return np.array([rows.get(source, UNPAIRED) for source in sources.tolist()], dtype=np.int64)

    def map(self, sigma: float = 0.01) -> Landmarks:
        """The surveyed landmarks, each off by `sigma` [m] per axis, independently of the others."""
        return Landmarks.from_points(self.landmarks, sigma=sigma)
