"""Active SLAM: how much a scan from another place would improve the map, and criteria of how well space is known.

The expected gain of a scan is that of a simulated EKF update (`expected_reduction`).

Optimality criteria are not comparable while features are being added, so they are computed over a virtual map: a fixed
grid of virtual landmarks, one in the centre of each cell (Wang and Englot 2020; Chen et al. 2020). Each has the
position covariance that a landmark would have there if it had been mapped at the best moment so far, and σ₀² I before.
Only position variances are used, so metres and radians are not mixed. The criteria do not use the truth, and trust the
covariance of the filter: an overconfident associator is rewarded for its overconfidence.
"""

import math

import numpy as np

from slam_gym._jit import compiled
from slam_gym.navigation.explored_grid import ExploredCells, ExploredGrid, shape_of
from slam_gym.navigation.visibility import passage
from slam_gym.types import Array, Beams, BoolArray, IntArray

MAX_FEATURES = 12  # nearest features in view that the simulated update uses


def expected_reduction(
    mean: Array, covariance: Array, grid: ExploredGrid, places: Array, *, reach: float, sigma: float, drift: Array
) -> Array:
    """(q,) [m²] decrease of Σ_j tr P_jj over all mapped features, by one full-circle scan from each place (q, 2) in B.

    The robot moves to the place along a known path, P_RR → F P_RR Fᵀ + diag(`drift`²) [m, m, rad], (3,) for all or
    (q, 3), and measures the nearest mapped features within `reach` [m] and in line of sight over the explored `grid`,
    each with a standard deviation of `sigma` [m]. With W = L⁻¹ H P and S = L Lᵀ = H P Hᵀ + R the covariance falls by
    Wᵀ W, so the result is the sum of the squares in the feature columns of W: through the cross-covariances, a loop
    closure reduces the variances of all features.

    `mean` (3 + 2n,), `covariance` (3 + 2n, 3 + 2n) of the stochastic map.
    """
    drifts = np.broadcast_to(np.square(drift), (len(places), 3))
    nearest = _in_sight(mean, grid.explored, places, reach, MAX_FEATURES)
    gains = [
        _reduction(mean, covariance, place, features[features >= 0], sigma**2, variances)
        for place, features, variances in zip(places, nearest, drifts)
    ]
    return np.array(gains)


def features_in_sight(mean: Array, grid: ExploredGrid, places: Array, reach: float) -> IntArray:
    """(q,) number of features of `mean` (3 + 2n,) within `reach` [m] and in line of sight of each of `places` (q, 2).

    Only known walls block the line of sight; unknown space does not.
    """
    seen = _in_sight(mean, grid.explored, places, reach, len(mean) // 2 - 1)
    return np.asarray(np.count_nonzero(seen >= 0, axis=1))


@compiled
def _in_sight(x: Array, explored: ExploredCells, places: Array, reach: float, most: int) -> IntArray:
    """(q, most) the nearest features within reach of each of `places` (q, 2) and in line of sight, padded with −1."""
    n, side, out = (len(x) - 3) // 2, explored.resolution, np.full((len(places), most), -1)
    near, distances = np.empty(n, np.int64), np.empty(n)
    for q in range(len(places)):
        px, py, k, count = places[q, 0], places[q, 1], 0, 0
        for j in range(n):
            dx, dy = x[3 + 2 * j] - px, x[4 + 2 * j] - py
            if abs(dx) > reach or abs(dy) > reach:  # rejects most features, without a root
                continue
            distance = math.hypot(dx, dy)
            if distance <= reach:
                near[k], distances[k] = j, distance
                k += 1
        from_x, from_y = (px - explored.origin[0]) / side, (py - explored.origin[1]) / side
        for j in near[np.argsort(distances[:k], kind="mergesort")]:
            dx, dy = (x[3 + 2 * j] - px) / side, (x[4 + 2 * j] - py) / side
            if count < most and passage(explored.cells, from_x, from_y, dx, dy, 1.0) > 0.0:  # the unknown never blocks
                out[q, count] = j
                count += 1
    return out


def _reduction(x: Array, P: Array, place: Array, features: IntArray, r: float, drift: Array) -> float:
    """Σ of squares of the feature columns of L⁻¹ H P after the robot has moved to the place; `r`, `drift`: variances.

    H is in axes parallel to B, because the heading of the robot at the place does not change the sum.
    """
    k = len(features)
    if k == 0:
        return 0.0
    F, H = np.eye(3), np.zeros((2 * k, 3))
    F[0, 2], F[1, 2] = x[1] - place[1], place[0] - x[0]
    robot = F @ P[:3]  # rows of the robot, after the motion
    robot[:, :3] = robot[:, :3] @ F.T + np.diag(drift)
    rows = (3 + 2 * features[:, None] + [0, 1]).ravel()
    offsets = x[rows].reshape(k, 2) - place
    H[0::2, 0] = H[1::2, 1] = -1.0
    H[0::2, 2], H[1::2, 2] = offsets[:, 1], -offsets[:, 0]
    HP = H @ robot + np.hstack([robot[:, rows].T, P[rows, 3:]])
    S = HP[:, :3] @ H.T + HP[:, rows] + r * np.eye(2 * k)
    try:
        whitened = np.linalg.solve(np.linalg.cholesky(S), HP[:, 3:])
    except np.linalg.LinAlgError:  # not positive definite
        return 0.0
    return float(np.square(whitened).sum())


class VirtualMap:
    """Virtual landmarks over fixed bounds, and the optimality criteria of their covariances.

    `bounds` (4,) [m] xmin, ymin, xmax, ymax in B; `cell` [m] side of a cell; `prior_sigma` σ₀ [m] until observed.
    Raises ValueError for bounds that are not finite or have no area, and for a cell without a finite, positive side.
    """

    def __init__(self, bounds: Array, cell: float = 1.0, prior_sigma: float = 1.0) -> None:
        if not 0.0 < prior_sigma < math.inf:
            raise ValueError(f"prior_sigma: expected a finite length > 0 [m], got {prior_sigma}")
        h, w = shape_of(bounds, cell)
        self.cell = float(cell)
        self.prior_sigma = float(prior_sigma)
        self.origin: Array = np.array(bounds[:2], dtype=np.float64)  # (2,) [m] in B
        self.covariances: Array = np.tile(np.eye(2) * prior_sigma**2, (h, w, 1, 1))  # (h, w, 2, 2) [m²] in B
        rows, columns = np.indices((h, w)).reshape(2, -1)
        self._centres = self.origin + (np.column_stack([columns, rows]) + 0.5) * self.cell  # (h · w, 2) [m] in B

    def observe(self, pose: Array, pose_covariance: Array, beams: Beams, sigma: float) -> int:
        """Map the virtual landmarks in view of `beams` from `pose` (3,) with `pose_covariance` (3, 3), both in B.

        A landmark at z = ⊖pose ⊕ p would have the covariance J Σ Jᵀ + σ² I, with J = ∂(pose ⊕ z)/∂pose and `sigma` [m]
        of the sensor; it replaces the present covariance if its trace is smaller. A landmark is in view if the nearest
        beam reaches it. Returns the number of landmarks that have improved, 0 for a covariance with NaN.
        """
        offsets = self._centres - pose[:2]
        near = np.flatnonzero(np.abs(offsets).max(axis=1) <= beams.max_range)
        dx, dy = offsets[near].T
        P = pose_covariance
        xx = P[0, 0] - 2.0 * dy * P[0, 2] + dy * dy * P[2, 2] + sigma * sigma
        xy = P[0, 1] + dx * P[0, 2] - dy * P[1, 2] - dx * dy * P[2, 2]
        yy = P[1, 1] + 2.0 * dx * P[1, 2] + dx * dx * P[2, 2] + sigma * sigma
        covariances = self.covariances.reshape(-1, 2, 2)
        better = (xx + yy < np.trace(covariances[near], axis1=1, axis2=2)) & _in_view(dx, dy, pose[2], beams)
        covariances[near[better]] = np.stack([xx, xy, xy, yy], axis=-1)[better].reshape(-1, 2, 2)
        return int(np.count_nonzero(better))

    def a_opt(self) -> float:
        """A-optimality tr(P)/l of all l = 2hw coordinates together, in units of σ₀²: 1 before any observation."""
        return 0.5 * float(np.trace(self.covariances, axis1=2, axis2=3).mean()) / self.prior_sigma**2

    def d_opt(self) -> float:
        """D-optimality exp(mean log λ), in units of σ₀²: 1 before any observation."""
        return math.exp(self._mean_log()) / self.prior_sigma**2

    def entropy(self) -> float:
        """Differential entropy per coordinate, mean over λ of ½ log(2πe λ) [nat], less that before any observation."""
        return 0.5 * (self._mean_log() - math.log(self.prior_sigma**2))  # the constant 2πe cancels

    def _mean_log(self) -> float:
        """Mean of log λ over the eigenvalues of all covariances, from their determinants."""
        return 0.5 * float(np.log(np.linalg.det(self.covariances)).mean())


def _in_view(dx: Array, dy: Array, heading: float, beams: Beams) -> BoolArray:
    """Whether the beam nearest in direction reaches each point at (dx, dy) from the sensor.

    A beam covers half the angle between the first two beams on either side.
    """
    angles = heading + beams.bearings
    spread = math.cos(0.5 * (angles[1] - angles[0])) if len(angles) > 1 else 1.0
    along = np.cos(angles) * dx[..., None] + np.sin(angles) * dy[..., None]
    nearest, distance = along.argmax(axis=-1), np.hypot(dx, dy)
    is_covered = along.max(axis=-1) >= spread * distance - 1e-9
    seen: BoolArray = is_covered & (distance <= np.minimum(beams.ranges, beams.max_range)[nearest])
    return seen
