"""A virtual map: optimality criteria for exploration, computed without the truth.

Active-SLAM criteria are not comparable while features are being added, so they are computed over a fixed grid of
virtual landmarks instead, one in the centre of each cell (Wang and Englot 2020; Chen et al. 2020). Each has the
position covariance that a landmark would have there if it had been mapped at the best moment so far, and σ₀² I before.
Only position variances are used, so metres and radians are not mixed. The criteria trust the covariance of the filter:
an overconfident associator is rewarded for its overconfidence.
"""

from __future__ import annotations

import math

import numpy as np

from slam_gym.navigation.explored_grid import shape_of
from slam_gym.types import Array, Beams, BoolArray


class VirtualMap:
    """Virtual landmarks over fixed bounds, and the optimality criteria of their covariances.

    `bounds` (4,) [m] xmin, ymin, xmax, ymax in B; `cell` [m] side of a cell; `prior_sigma` σ₀ [m] until observed.
    Raises ValueError for bounds that are not finite or have no area, and for lengths that are not positive.
    """

    def __init__(self, bounds: Array, cell: float = 1.0, prior_sigma: float = 1.0) -> None:
        if not 0.0 < prior_sigma < math.inf:
            raise ValueError(f"prior_sigma: expected a finite length > 0 [m], got {prior_sigma}")
        shape = shape_of(bounds, cell)
        self.cell = float(cell)
        self.prior_sigma = float(prior_sigma)
        self.origin: Array = np.array(bounds[:2], dtype=np.float64)  # (2,) [m] in B
        self.covariances: Array = np.tile(np.eye(2) * prior_sigma**2, (*shape, 1, 1))  # (h, w, 2, 2) [m²] in B

    def observe(self, pose: Array, pose_covariance: Array, beams: Beams, sigma: float) -> int:
        """Map the virtual landmarks in view of `beams` from `pose` (3,) with `pose_covariance` (3, 3), both in B.

        A landmark at z = ⊖pose ⊕ p would have the covariance J Σ Jᵀ + σ² I, with J = ∂(pose ⊕ z)/∂pose and `sigma` [m]
        of the sensor; it replaces the present covariance if its trace is smaller. A landmark is in view if the nearest
        beam reaches it. Returns the number of landmarks that have improved, 0 for a covariance with NaN.
        """
        (h, w), reach = self.covariances.shape[:2], beams.max_range
        (left, low), (right, high) = (
            np.clip((pose[:2] + side * reach - self.origin) / self.cell, -1.0, max(h, w) + 1.0) for side in (-1.0, 1.0)
        )
        rows = slice(max(0, math.floor(low)), max(0, math.ceil(high)))
        columns = slice(max(0, math.floor(left)), max(0, math.ceil(right)))
        dy, dx = np.meshgrid(np.arange(h)[rows], np.arange(w)[columns], indexing="ij")
        dx = self.origin[0] + (dx + 0.5) * self.cell - pose[0]
        dy = self.origin[1] + (dy + 0.5) * self.cell - pose[1]
        P = pose_covariance
        xx = P[0, 0] - 2.0 * dy * P[0, 2] + dy * dy * P[2, 2] + sigma * sigma
        xy = P[0, 1] + dx * P[0, 2] - dy * P[1, 2] - dx * dy * P[2, 2]
        yy = P[1, 1] + 2.0 * dx * P[1, 2] + dx * dx * P[2, 2] + sigma * sigma
        current = self.covariances[rows, columns]
        better = (xx + yy < np.trace(current, axis1=2, axis2=3)) & _in_view(dx, dy, pose[2], beams)
        current[better] = np.stack([xx, xy, xy, yy], axis=-1)[better].reshape(-1, 2, 2)
        return int(np.count_nonzero(better))

    def a_opt(self) -> float:
        """A-optimality tr(P)/l [m²] of all l = 2hw coordinates together: the mean of λ, σ₀² before any observation."""
        return 0.5 * float(np.trace(self.covariances, axis1=2, axis2=3).mean())

    def d_opt(self) -> float:
        """D-optimality exp(mean log λ) [m²], σ₀² before any observation."""
        return math.exp(self._mean_log())

    def entropy(self) -> float:
        """Differential entropy per coordinate, mean over λ of ½ log(2πe λ) [nat]."""
        return 0.5 * (math.log(2.0 * math.pi * math.e) + self._mean_log())

    def _mean_log(self) -> float:
        """Mean of log λ over the eigenvalues of all covariances, from their determinants."""
        c = self.covariances
        return 0.5 * float(np.log(c[..., 0, 0] * c[..., 1, 1] - c[..., 0, 1] * c[..., 1, 0]).mean())


def _in_view(dx: Array, dy: Array, heading: float, beams: Beams) -> BoolArray:
    """Whether the beam nearest in direction reaches each point at (dx, dy) from the sensor.

    A beam covers half the angle between the first two beams on either side.
    """
    angles, spread = heading + beams.bearings, 1.0
    if len(angles) > 1:
        spread = math.cos(0.5 * (angles[1] - angles[0]))
    along = np.cos(angles) * dx[..., None] + np.sin(angles) * dy[..., None]
    nearest, distance = along.argmax(axis=-1), np.hypot(dx, dy)
    is_covered = along.max(axis=-1) >= spread * distance - 1e-9
    seen: BoolArray = is_covered & (distance <= np.minimum(beams.ranges, beams.max_range)[nearest])
    return seen
