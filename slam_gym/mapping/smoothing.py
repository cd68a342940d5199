"""Batch least squares: the trajectory and map that best explain a whole run, for known pairings.

Minimises χ² = Σ_t ‖u_t − (⊖x_{t−1}) ⊕ x_t‖²_{Q_t} + Σ_i ‖z_i − (⊖x_{t(i)}) ⊕ m_{j(i)}‖²_{R_i} over poses x and
positions m by Gauss–Newton with Levenberg's damping (smoothing and mapping: Dellaert and Kaess, IJRR 2006). The
result is the maximum-likelihood estimate for these pairings.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import block_array, block_diag, bsr_array, csc_array, eye_array
from scipy.sparse.linalg import SuperLU, splu

from slam_gym.geometry import compose, relative, wrap_angles
from slam_gym.types import Array, IntArray, Odometry, Scan
from slam_gym.validation import indices

_DAMPING = 1e-8  # of the first iteration, as a fraction of the mean information: all σ may have any common factor
_ROUNDING = 1e-15  # of χ²
_TOLERANCE, _ITERATIONS = 1e-9, 1000  # stop where an iteration gains less than this fraction of χ²; most iterations


@dataclass(frozen=True, eq=False)
class Smoothed:
    """The least-squares estimate of a run, in the frame in which the run starts."""

    poses: Array  # (T, 3) [m, m, rad]; the first is held fixed
    ids: IntArray  # (L,) number by which the pairings identify each feature, ascending
    positions: Array  # (L, 2) [m]
    chi2: float
    information: csc_array  # (3(T − 1) + 2L, …) of poses 1 … T − 1, then positions: JᵀΛJ at the optimum
    iterations: int

    def covariance(self, poses: ArrayLike = (), ids: ArrayLike = ()) -> Array:
        """(3p + 2k, 3p + 2k) joint covariance [m², m·rad, rad²] of `poses` (p,), by step, and features (k,), by id.

        It takes one sparse factorisation, stored for the next call, and two triangular solves per column. The
        covariance of the first pose is zero. Raises ValueError where a pose or a feature does not exist.
        """
        steps = indices("poses", np.atleast_1d(poses), len(self.poses))
        features = indices("ids", np.atleast_1d(ids), np.iinfo(np.int64).max)
        if len(unknown := np.setdiff1d(features, self.ids)):
            raise ValueError(f"ids: no measurement is paired with {unknown[:5].tolist()}")
        rows = 3 * (len(self.poses) - 1) + 2 * np.searchsorted(self.ids, features)
        entries = [(3 * steps[:, None] + np.arange(-3, 0)).ravel(), (rows[:, None] + np.arange(2)).ravel()]
        at = np.concatenate(entries)
        free = np.flatnonzero(at >= 0)
        chosen, covariance = at[free], np.zeros((len(at), len(at)))
        columns = np.zeros((self.information.shape[0], len(free)))
        columns[chosen, np.arange(len(free))] = 1.0
        covariance[np.ix_(free, free)] = self._factor.solve(columns)[chosen]
        return 0.5 * (covariance + covariance.T)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_factor"}  # which cannot be pickled

    @cached_property
    def _factor(self) -> SuperLU:
        return _factor(self.information)


def smooth(
    odometry: Sequence[Odometry],
    scans: Sequence[Scan],
    pairings: Sequence[ArrayLike],
    initial: ArrayLike | None = None,
) -> Smoothed:
    """Compute the least-squares optimum of a run of T steps whose pairings are known.

    For a log with identities: `smooth(*zip(*recording.steps()))`.

    Arguments:
        odometry: the motion before each scan. The first pose is fixed where the first motion leads from the origin.
        scans: T scans.
        pairings: for each scan (m,) integers that name the features; a measurement with a negative number is left out.
        initial: (T, 3) initial poses, such as a filter's, in any frame. By default they are those of dead reckoning,
            from which a long run ends in a local minimum. Features start where the initial poses first see them.

    Raises ValueError, naming the argument, where lengths do not fit, nothing is paired, a number is not finite or a
    covariance not positive definite; and where the iterations run out.
    """
    T = len(odometry)
    if len(scans) != T or len(pairings) != T:
        raise ValueError(f"scans, pairings: {len(scans)} and {len(pairings)} of them for {T} of odometry")
    numbers = [_pairing(step, pairing, len(scan)) for step, (scan, pairing) in enumerate(zip(scans, pairings))]
    masks = [pairing >= 0 for pairing in numbers]
    pose = np.repeat(np.arange(T), [mask.sum() for mask in masks])
    if not len(pose):
        raise ValueError("pairings: no measurement is paired with a feature")
    ids, feature = np.unique(np.concatenate([n[mask] for n, mask in zip(numbers, masks)]), return_inverse=True)
    points = np.concatenate([scan.points[mask] for scan, mask in zip(scans, masks)])
    covariances = np.concatenate([scan.covariances[mask] for scan, mask in zip(scans, masks)])
    motions, noise = np.array([u.motion for u in odometry]), np.array([u.covariance for u in odometry])
    for name, values, steps in (("odometry", motions, np.arange(T)), ("scans", points, pose)):
        _refuse(name, steps, np.isfinite(values).all(axis=1), "is not finite")
    of_motions, of_points = _inverses("odometry", np.arange(1, T), noise[1:]), _inverses("scans", pose, covariances)
    information = block_diag([_diagonal(of_motions), _diagonal(of_points)], format="csc")
    graph = FactorGraph(motions[1:], points, pose, feature, information)
    start = dead_reckoning(motions)[1:] if initial is None else np.array(initial, np.float64)
    if start.shape != (T, 3) or not np.isfinite(start).all():
        raise ValueError(f"initial: shape {start.shape}, expected ({T}, 3) finite numbers")
    return graph.optimum(np.array([compose(motions[0], relative(start[0], pose)) for pose in start]), ids)


@dataclass(frozen=True, eq=False)
class FactorGraph:
    """Measurements of T poses and L positions: motions between consecutive poses, and points seen from poses."""

    motions: Array  # (T − 1, 3) [m, m, rad] each pose in the frame of the one before
    points: Array  # (M, 2) [m] in the frame of the pose that sees each
    pose: IntArray  # (M,) index of that pose
    feature: IntArray  # (M,) row of the feature that each point measures
    information: csc_array  # Λ (3(T − 1) + 2M, …) of the motions, then of the points

    def optimum(self, poses: Array, ids: IntArray) -> Smoothed:
        """The optimum reached from initial `poses` (T, 3), the first of which stays fixed; `ids` (L,) of the features.
        Positions start where these poses first see them.

        Raises ValueError where the iterations run out.
        """
        first = np.unique(self.feature, return_index=True)[1]  # the point by which each feature is first seen
        at, seen = poses[self.pose[first]], self.points[first]
        x = np.concatenate([poses[1:].ravel(), (at[:, :2] + _turned(at[:, 2], seen)).ravel()])
        damping = 0.0
        errors, jacobian = self.linearise(poses[0], x)
        chi2 = float(errors @ (self.information @ errors))
        for iteration in range(1, _ITERATIONS + 1):
            weighted = (self.information @ jacobian).T
            normal = csc_array(weighted @ jacobian)
            damping = damping or _DAMPING * normal.diagonal().mean()
            step = _factor(normal + damping * eye_array(len(x))).solve(weighted @ errors)
            x_new = x - step
            x_new[2 : self.motions.size : 3] = wrap_angles(x_new[2 : self.motions.size : 3])
            linearised = self.linearise(poses[0], x_new)
            chi2_before, chi2_after = chi2, float(linearised[0] @ (self.information @ linearised[0]))
            least_gain = max(_TOLERANCE * chi2_before, _ROUNDING)
            if not chi2_after <= chi2_before + least_gain:
                damping *= 10.0
                continue
            x, damping, (errors, jacobian), chi2 = x_new, 0.1 * damping, linearised, chi2_after
            if chi2_before - chi2 <= least_gain:
                optimal_poses, positions = self.split(poses[0], x)
                return Smoothed(optimal_poses, ids, positions, chi2, normal, iteration)
        raise ValueError(f"no optimum in {_ITERATIONS} iterations: χ² is {chi2:.6g} and still falls")

    def split(self, first: Array, x: Array) -> tuple[Array, Array]:
        """Split the unknowns x into poses (T, 3), after the `first` (3,), and positions (L, 2)."""
        unknown = self.motions.size
        return np.vstack([first, x[:unknown].reshape(-1, 3)]), x[unknown:].reshape(-1, 2)

    def linearise(self, first: Array, x: Array) -> tuple[Array, csc_array]:
        """Errors of the motions and points at x, (3(T − 1) + 2M,), and their sparse Jacobian with respect to x."""
        poses, positions = self.split(first, x)
        before, after = poses[:-1], poses[1:]
        predicted, by_before, by_after = np.zeros((len(before), 3)), *np.zeros((2, len(before), 3, 3))
        predicted[:, :2], by_before[:, :2], by_after[:, :2, :2] = _seen_from(before, after[:, :2])
        predicted[:, 2], by_before[:, 2, 2], by_after[:, 2, 2] = after[:, 2] - before[:, 2], -1.0, 1.0
        seen, by_pose, by_position = _seen_from(poses[self.pose], positions[self.feature])
        motion_errors = predicted - self.motions
        motion_errors[:, 2] = wrap_angles(motion_errors[:, 2])
        k, width = np.arange(len(before)), poses.size
        by_poses = [_blocks(by_before, k, width) + _blocks(by_after, k + 1, width), _blocks(by_pose, self.pose, width)]
        of_motions, of_points = (csc_array(blocks)[:, 3:] for blocks in by_poses)
        by_positions = _blocks(by_position, self.feature, positions.size)
        jacobian = block_array([[of_motions, None], [of_points, by_positions]], format="csc")
        return np.concatenate([motion_errors.ravel(), (seen - self.points).ravel()]), jacobian


def _factor(matrix: Any) -> SuperLU:
    """The sparse factorisation of a symmetric positive definite matrix. Raises ValueError for a singular one."""
    options = {"SymmetricMode": True}
    try:
        return splu(csc_array(matrix), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    except RuntimeError as error:
        raise ValueError(f"the run does not determine all poses and features ({error})") from None


def dead_reckoning(motions: ArrayLike) -> Array:
    """(k + 1, 3) poses by composing the motions (k, 3), the first pose at the origin."""
    return np.array(list(accumulate(np.asarray(motions), compose, initial=np.zeros(3))))


def _turned(headings: Array, vectors: Array) -> Array:
    """Vectors (k, 2), each rotated by its heading (k,) [rad]."""
    c, s = np.cos(headings), np.sin(headings)
    return np.column_stack([c * vectors[:, 0] - s * vectors[:, 1], s * vectors[:, 0] + c * vectors[:, 1]])


def _seen_from(poses: Array, points: Array) -> tuple[Array, Array, Array]:
    """(⊖x) ⊕ m (k, 2) for poses x (k, 3) and points m (k, 2), and its Jacobians by x (k, 2, 3) and by m (k, 2, 2)."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    seen = _turned(-poses[:, 2], points - poses[:, :2])
    by_point = np.array([[c, s], [-s, c]]).transpose(2, 0, 1)
    by_heading = np.column_stack([seen[:, 1], -seen[:, 0]])
    return seen, np.concatenate([-by_point, by_heading[:, :, None]], axis=2), by_point


def _blocks(blocks: Array, columns: IntArray, width: int) -> bsr_array:
    """A sparse array of `width` columns: blocks (k, r, c) one below the other, block i in block column columns[i]."""
    return bsr_array((blocks, columns, np.arange(len(blocks) + 1)), shape=(len(blocks) * blocks.shape[1], width))


def _diagonal(blocks: Array) -> bsr_array:
    """The block-diagonal sparse array of blocks (k, d, d)."""
    return _blocks(blocks, np.arange(len(blocks)), len(blocks) * blocks.shape[1])


# validation


def _pairing(step: int, pairing: ArrayLike, measurements: int) -> IntArray:
    numbers = np.asarray(pairing)
    if numbers.shape != (measurements,) or (numbers.size and numbers.dtype.kind not in "iu"):
        raise ValueError(
            f"pairings[{step}]: {numbers.dtype} of shape {numbers.shape}, expected ({measurements},) "
            "integers, one for each measurement"
        )
    return numbers.astype(np.int64)


def _inverses(name: str, steps: IntArray, covariances: Array) -> Array:
    """C⁻¹ of covariances (k, d, d). Raises ValueError where one is not finite, symmetric and positive definite."""
    finite = np.isfinite(covariances).all(axis=(1, 2))
    _refuse(name, steps, finite, "has a covariance that is not finite")
    definite = np.linalg.eigvalsh(covariances)[:, 0] > 0.0
    asymmetry = np.abs(covariances - covariances.transpose(0, 2, 1)).max(axis=(1, 2))
    symmetric = asymmetry <= _TOLERANCE * np.trace(covariances, axis1=1, axis2=2)
    _refuse(name, steps, definite & symmetric, "has a covariance that is not positive definite")
    return np.asarray(np.linalg.inv(covariances))


def _refuse(name: str, steps: IntArray, good: Any, fault: str) -> None:
    """Raise ValueError for the first entry that is not `good` (k,), naming its step."""
    if not good.all():
        raise ValueError(f"{name}[{steps[good.argmin()]}]: {fault}")
