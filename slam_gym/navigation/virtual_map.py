"""A virtual map: how well the places of the plan could be known, without any truth.

Active-SLAM criteria are not comparable while features are being added, so they are taken over a fixed grid of virtual
landmarks instead, one in the middle of each cell (Wang and Englot 2020; Chen et al. 2020). Each holds the position
covariance that a landmark would have there if it had been mapped at the best moment so far, and σ₀² I before. Position
variances only, so no metres are mixed with radians. The criteria believe the filter: an overconfident associator is
paid for its overconfidence.
"""

from __future__ import annotations

import math

import numpy as np

from slam_gym._jit import compiled
from slam_gym.navigation.explored_grid import shape_of
from slam_gym.types import Array, Beams


class VirtualMap:
    """Virtual landmarks over fixed bounds, and the optimality criteria of their covariances.

    `bounds` (4,) [m] xmin, ymin, xmax, ymax in B; `cell` [m] side of a cell; `prior_sigma` σ₀ [m] until observed.
    Raises ValueError for bounds that are not finite or enclose nothing, and for lengths that are not positive.
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

        One at z = ⊖pose ⊕ p would get the covariance J Σ Jᵀ + σ² I, with J = ∂(pose ⊕ z)/∂pose and `sigma` [m] the
        sensor's; it is kept where its trace is the smaller. In view is what the nearest beam reaches. Returns how many
        landmarks became better known; a covariance with NaN makes none so.
        """
        seen = beams.bearings, beams.ranges, beams.max_range
        return _observe(self.covariances, self.origin, self.cell, pose, pose_covariance, sigma * sigma, seen)

    def a_opt(self) -> float:
        """A-optimality tr(P)/l [m²] of all l = 2hw coordinates together: the mean λ, σ₀² before any observation."""
        return _mean_eigenvalues(self.covariances)[0]

    def d_opt(self) -> float:
        """D-optimality exp(mean log λ) [m²], σ₀² before any observation."""
        return math.exp(_mean_eigenvalues(self.covariances)[1])

    def entropy(self) -> float:
        """Differential entropy per coordinate, mean over λ of ½ log(2πe λ) [nat]."""
        return 0.5 * (math.log(2.0 * math.pi * math.e) + _mean_eigenvalues(self.covariances)[1])


@compiled
def _observe(
    covariances: Array, origin: Array, cell: float, pose: Array, P: Array, variance: float,
    beams: tuple[Array, Array, float],
) -> int:  # fmt: skip
    bearings, ranges, max_range = beams
    h, w = covariances.shape[0], covariances.shape[1]
    directions = np.empty((bearings.shape[0], 2))
    for b in range(bearings.shape[0]):
        directions[b, 0], directions[b, 1] = math.cos(pose[2] + bearings[b]), math.sin(pose[2] + bearings[b])
    # a beam speaks for half the gap between the first two on either side
    spread = math.cos(0.5 * (bearings[1] - bearings[0])) if bearings.shape[0] > 1 else 1.0
    improved = 0
    left, right = (pose[0] - origin[0] - max_range) / cell, (pose[0] - origin[0] + max_range) / cell
    low, high = (pose[1] - origin[1] - max_range) / cell, (pose[1] - origin[1] + max_range) / cell
    for row in range(max(0, math.floor(low)), min(h, math.ceil(high))):
        for column in range(max(0, math.floor(left)), min(w, math.ceil(right))):
            dx, dy = origin[0] + (column + 0.5) * cell - pose[0], origin[1] + (row + 0.5) * cell - pose[1]
            xx = P[0, 0] - 2.0 * dy * P[0, 2] + dy * dy * P[2, 2] + variance
            xy = P[0, 1] + dx * P[0, 2] - dy * P[1, 2] - dx * dy * P[2, 2]
            yy = P[1, 1] + 2.0 * dx * P[1, 2] + dx * dx * P[2, 2] + variance
            kept = covariances[row, column]
            if xx + yy < kept[0, 0] + kept[1, 1] and _in_view(dx, dy, directions, ranges, max_range, spread):
                kept[0, 0], kept[0, 1], kept[1, 0], kept[1, 1] = xx, xy, xy, yy
                improved += 1
    return improved


@compiled
def _in_view(dx: float, dy: float, directions: Array, ranges: Array, max_range: float, spread: float) -> bool:
    """The beam nearest in direction to a point at (dx, dy) from the sensor speaks for it, and reaches as far."""
    distance = math.hypot(dx, dy)
    nearest, best = -1, -math.inf
    for b in range(directions.shape[0]):
        along = directions[b, 0] * dx + directions[b, 1] * dy
        if along > best:
            nearest, best = b, along
    return nearest >= 0 and best >= spread * distance - 1e-9 and distance <= min(ranges[nearest], max_range)


@compiled
def _mean_eigenvalues(covariances: Array) -> tuple[float, float]:
    """Means of λ [m²] and of log λ over the eigenvalues of all covariances, from traces and determinants."""
    h, w = covariances.shape[0], covariances.shape[1]
    traces, logs = 0.0, 0.0
    for row in range(h):
        for column in range(w):
            c = covariances[row, column]
            traces += c[0, 0] + c[1, 1]
            logs += math.log(c[0, 0] * c[1, 1] - c[0, 1] * c[1, 0])
    return traces / (2 * h * w), logs / (2 * h * w)
