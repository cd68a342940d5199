"""The trajectory and map that explain a whole log best, with its identities taken as given: the reference of a log.

Minimises χ² = Σ_t ‖u_t − (⊖x_{t−1}) ⊕ x_t‖²_{Q_t} + Σ_i ‖z_i − (⊖x_{t(i)}) ⊕ m_{s(i)}‖²_{R_i} over poses x and features
m by Gauss–Newton with Levenberg's damping; every step is one sparse least-squares solution of the normal equations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import block_array, bsr_array, csc_array, eye_array
from scipy.sparse.linalg import splu

from slam_gym.geometry import compose
from slam_gym.recordings.reading import wrapped
from slam_gym.recordings.recording import Recording
from slam_gym.types import Array, IntArray

_HELD = 1e6  # weight of the first pose
_TOLERANCE, _ITERATIONS = 1e-9, 100  # an iteration that gains less of χ² is the last


@dataclass(frozen=True)
class Optimum:
    """The best fit of a log, in the frame in which it starts."""

    poses: Array  # (T, 3) [m, m, rad]
    ids: IntArray  # (L,) identities
    landmarks: Array  # (L, 2) [m]
    chi2: float
    iterations: int


def least_squares(log: Recording, initial: Array | None = None) -> Optimum:
    """The least-squares optimum of a log, its first pose held where `motions[0]` puts it.

    `initial`: poses (T, 3) to start from, such as a filter's; by default those of dead reckoning, from which a long log
    ends in a local minimum. Landmarks start where they were first seen from there. Ends once an iteration hardly gains
    anything. Measurements without an identity are left out. Raises ValueError where there are no others,
    or the iterations run out.
    """
    problem = _Problem(log)
    x = problem.start(problem.dead_reckoning() if initial is None else initial)
    damping = 1e-3
    residuals, jacobian = problem.linearise(x)
    chi2 = float(residuals @ residuals)
    for iteration in range(1, _ITERATIONS + 1):
        gradient = jacobian.T @ residuals
        normal = csc_array(jacobian.T @ jacobian + damping * eye_array(len(gradient)))
        step = splu(normal, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        moved = problem.moved(x, -step.solve(gradient))
        further = problem.linearise(moved)
        gain = chi2 - float(further[0] @ further[0])
        if gain < -_TOLERANCE * chi2:
            damping *= 10.0
            continue
        x, damping, (residuals, jacobian) = moved, 0.1 * damping, further
        chi2 = float(residuals @ residuals)
        if abs(gain) < _TOLERANCE * chi2:
            poses, landmarks = problem.split(x)
            return Optimum(poses, problem.ids, landmarks, chi2, iteration)
    raise ValueError(f"no optimum in {_ITERATIONS} iterations: χ² is {chi2:.6g} and still falls")


class _Problem:
    """Residuals of a log, whitened, and their Jacobian. Unknowns: poses (T, 3), then landmarks (L, 2)."""

    def __init__(self, log: Recording) -> None:
        known = np.flatnonzero(log.sources >= 0)
        if len(known) == 0:
            raise ValueError(f"recording {log.name!r}: no measurement has an identity")
        self.log, self.steps = log, len(log)
        self.ids, self.landmark = np.unique(log.sources[known], return_inverse=True)
        self.pose = np.repeat(np.arange(self.steps), np.diff(log.starts))[known]
        self.points = log.points[known]
        self.whiten_motion = _roots(log.motion_covariances[1:])
        self.whiten_point = _roots(log.covariances[known])

    def dead_reckoning(self) -> Array:
        """(T, 3) poses by odometry alone."""
        poses, pose = np.empty((self.steps, 3)), np.zeros(3)
        for t, motion in enumerate(self.log.motions):
            pose = poses[t] = compose(pose, motion)
        return poses

    def start(self, poses: Array) -> Array:
        """Unknowns with these poses, and each landmark where it was first seen from them."""
        first = np.unique(self.landmark, return_index=True)[1]
        at, seen = poses[self.pose[first]], self.points[first]
        return np.concatenate([poses.ravel(), (at[:, :2] + _turned(at[:, 2], seen)).ravel()])

    def split(self, x: Array) -> tuple[Array, Array]:
        """Poses (T, 3) and landmarks (L, 2) of the unknowns."""
        poses = x[: 3 * self.steps].reshape(-1, 3)
        return poses, x[3 * self.steps :].reshape(-1, 2)

    def moved(self, x: Array, step: Array) -> Array:
        """x + step, headings wrapped."""
        out: Array = x + step
        out[2 : 3 * self.steps : 3] = wrapped(out[2 : 3 * self.steps : 3])
        return out

    def linearise(self, x: Array) -> tuple[Array, csc_array]:
        """Whitened residuals, motions before measurements and the first pose's three last; their sparse Jacobian."""
        poses, landmarks = self.split(x)
        before, after, at = poses[:-1], poses[1:], poses[self.pose]
        moved, moved_by_before, moved_by_after = _seen_from(before, after[:, :2])
        motion = np.column_stack([moved, after[:, 2] - before[:, 2]]) - self.log.motions[1:]
        motion[:, 2] = wrapped(motion[:, 2])
        by_before, by_after = np.zeros((2, len(before), 3, 3))
        by_before[:, :2], by_before[:, 2, 2] = moved_by_before, -1.0
        by_after[:, :2, :2], by_after[:, 2, 2] = moved_by_after, 1.0
        seen, by_pose, by_landmark = _seen_from(at, landmarks[self.landmark])
        residuals = np.concatenate([
            np.einsum("tij,tj->ti", self.whiten_motion, motion).ravel(),
            np.einsum("kij,kj->ki", self.whiten_point, seen - self.points).ravel(),
            (poses[0] - self.log.motions[0]) * _HELD,
        ])  # fmt: skip
        step, width = np.arange(self.steps), poses.size
        jacobian = block_array([
            [_blocks(self.whiten_motion @ by_before, step[:-1], width)
             + _blocks(self.whiten_motion @ by_after, step[1:], width), None],
            [_blocks(self.whiten_point @ by_pose, self.pose, width),
             _blocks(self.whiten_point @ by_landmark, self.landmark, landmarks.size)],
            [_blocks(_HELD * np.eye(3)[None], step[:1], width), None],
        ], format="csc")  # fmt: skip
        return residuals, jacobian


def _roots(covariances: Array) -> Array:
    """W (k, d, d) with WᵀW = C⁻¹."""
    return np.linalg.inv(np.linalg.cholesky(covariances))


def _turned(headings: Array, vectors: Array) -> Array:
    """Vectors (k, 2), each turned by its heading."""
    c, s = np.cos(headings), np.sin(headings)
    return np.column_stack([c * vectors[:, 0] - s * vectors[:, 1], s * vectors[:, 0] + c * vectors[:, 1]])


def _seen_from(poses: Array, points: Array) -> tuple[Array, Array, Array]:
    """(⊖x) ⊕ m (k, 2) for poses x (k, 3) and points m (k, 2), and its Jacobians (k, 2, 3) to x and (k, 2, 2) to m."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    seen = _turned(-poses[:, 2], points - poses[:, :2])
    by_point = np.array([[c, s], [-s, c]]).transpose(2, 0, 1)
    aside = np.column_stack([seen[:, 1], -seen[:, 0]])
    return seen, np.concatenate([-by_point, aside[:, :, None]], axis=2), by_point


def _blocks(blocks: Array, columns: IntArray, width: int) -> bsr_array:
    """Blocks (k, r, c), one below the other, each in its column of blocks, in a sparse array of so many columns."""
    return bsr_array((blocks, columns, np.arange(len(blocks) + 1)), shape=(len(blocks) * blocks.shape[1], width))
