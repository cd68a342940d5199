"""The trajectory and map that explain a whole log best, with its identities taken as given: the reference of a log.

Minimises χ² = Σ_t ‖u_t − (⊖x_{t−1}) ⊕ x_t‖²_{Q_t} + Σ_i ‖z_i − (⊖x_{t(i)}) ⊕ m_{s(i)}‖²_{R_i} over poses x and features
m by Gauss–Newton with Levenberg's damping; every step is one sparse least-squares solution of the normal equations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_array, identity
from scipy.sparse.linalg import splu

from slam_gym.geometry import compose
from slam_gym.recordings.recording import Recording
from slam_gym.types import Array, IntArray


@dataclass(frozen=True)
class Optimum:
    """The best fit of a log, in the frame in which it starts."""

    poses: Array  # (T, 3) [m, m, rad]
    ids: IntArray  # (L,) identities
    landmarks: Array  # (L, 2) [m]
    chi2: float
    iterations: int


def least_squares(
    log: Recording, initial: Array | None = None, tolerance: float = 1e-9, max_iterations: int = 100
) -> Optimum:
    """The least-squares optimum of a log, its first pose held where `motions[0]` puts it.

    `initial`: poses (T, 3) to start from, such as a filter's; by default those of dead reckoning, from which a long log
    ends in a local minimum. Landmarks start where they were first seen from there. Ends once an iteration gains less
    than `tolerance` of χ². Measurements without an identity are left out. Raises ValueError where there are no others,
    or the iterations run out.
    """
    problem = _Problem(log)
    x = problem.start(problem.dead_reckoning() if initial is None else initial)
    damping = 1e-3
    residuals, jacobian = problem.linearise(x)
    chi2 = float(residuals @ residuals)
    for iteration in range(1, max_iterations + 1):
        normal, gradient = (jacobian.T @ jacobian).tocsc(), jacobian.T @ residuals
        diagonal = identity(len(gradient), format="csc") * damping
        step = splu(csc_array(normal + diagonal), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        moved = problem.moved(x, -step.solve(gradient))
        further = problem.residuals(moved)
        gain = chi2 - float(further @ further)
        if gain < 0.0 and gain < -tolerance * chi2:
            damping *= 10.0
            continue
        x, damping = moved, 0.1 * damping
        residuals, jacobian = problem.linearise(x)
        chi2 = float(residuals @ residuals)
        if abs(gain) < tolerance * chi2:
            poses, landmarks = problem.split(x)
            return Optimum(poses, problem.ids, landmarks, chi2, iteration)
    raise ValueError(f"no optimum in {max_iterations} iterations: χ² is {chi2:.6g} and still falls")


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
        out[2 : 3 * self.steps : 3] = _wrapped(out[2 : 3 * self.steps : 3])
        return out

    def residuals(self, x: Array) -> Array:
        """Whitened residuals, motions before measurements; the first pose's three come last."""
        poses, landmarks = self.split(x)
        before, after = poses[:-1], poses[1:]
        motion = np.column_stack([_turned(-before[:, 2], after[:, :2] - before[:, :2]), after[:, 2] - before[:, 2]])
        off = motion - self.log.motions[1:]
        off[:, 2] = _wrapped(off[:, 2])
        at = poses[self.pose]
        seen = _turned(-at[:, 2], landmarks[self.landmark] - at[:, :2]) - self.points
        start = (poses[0] - self.log.motions[0]) * _HELD
        return np.concatenate([
            np.einsum("tij,tj->ti", self.whiten_motion, off).ravel(),
            np.einsum("kij,kj->ki", self.whiten_point, seen).ravel(),
            start,
        ])  # fmt: skip

    def linearise(self, x: Array) -> tuple[Array, csc_array]:
        """Residuals and their sparse Jacobian."""
        poses, landmarks = self.split(x)
        count, T = len(self.pose), self.steps
        to_before, to_after = _motion_jacobians(poses[:-1], poses[1:])
        at = poses[self.pose]
        to_pose, to_landmark = _point_jacobians(at, landmarks[self.landmark])
        blocks = [
            _block(self.whiten_motion @ to_before, 0, 3 * np.arange(T - 1)),
            _block(self.whiten_motion @ to_after, 0, 3 * np.arange(1, T)),
            _block(self.whiten_point @ to_pose, 3 * (T - 1), 3 * self.pose),
            _block(self.whiten_point @ to_landmark, 3 * (T - 1), 3 * T + 2 * self.landmark),
            _block(_HELD * np.eye(3)[None], 3 * (T - 1) + 2 * count, np.zeros(1, np.int64)),
        ]
        rows, columns, values = (np.concatenate(part) for part in zip(*blocks))
        shape = (3 * T + 2 * count, 3 * T + 2 * len(landmarks))
        return self.residuals(x), csc_array((values, (rows, columns)), shape=shape)


_HELD = 1e6  # weight of the first pose


def _roots(covariances: Array) -> Array:
    """W (k, d, d) with WᵀW = C⁻¹."""
    return np.linalg.inv(np.linalg.cholesky(covariances))


def _wrapped(angles: Array) -> Array:
    wrapped: Array = math.pi - np.remainder(math.pi - angles, 2.0 * math.pi)
    return wrapped


def _turned(headings: Array, vectors: Array) -> Array:
    """Vectors (k, 2), each turned by its heading."""
    c, s = np.cos(headings), np.sin(headings)
    return np.column_stack([c * vectors[:, 0] - s * vectors[:, 1], s * vectors[:, 0] + c * vectors[:, 1]])


def _motion_jacobians(before: Array, after: Array) -> tuple[Array, Array]:
    """Of (⊖x_{t−1}) ⊕ x_t, (k, 3, 3) each, to x_{t−1} and x_t."""
    c, s = np.cos(before[:, 2]), np.sin(before[:, 2])
    relative = _turned(-before[:, 2], after[:, :2] - before[:, :2])
    second = np.zeros((len(before), 3, 3))
    second[:, 0, 0], second[:, 0, 1], second[:, 1, 0], second[:, 1, 1], second[:, 2, 2] = c, s, -s, c, 1.0
    first = -second
    first[:, 0, 2], first[:, 1, 2] = relative[:, 1], -relative[:, 0]
    return first, second


def _point_jacobians(poses: Array, landmarks: Array) -> tuple[Array, Array]:
    """Of (⊖x) ⊕ m, (k, 2, 3) to x and (k, 2, 2) to m."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    seen = _turned(-poses[:, 2], landmarks - poses[:, :2])
    turn = np.empty((len(poses), 2, 2))
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1] = c, s, -s, c
    to_pose = np.empty((len(poses), 2, 3))
    to_pose[:, :, :2] = -turn
    to_pose[:, 0, 2], to_pose[:, 1, 2] = seen[:, 1], -seen[:, 0]
    return to_pose, turn


def _block(blocks: Array, first_row: int, columns: IntArray) -> tuple[IntArray, IntArray, Array]:
    """Rows, columns, values of blocks (k, r, c) stacked from `first_row` on, each at its first column."""
    count, height, width = blocks.shape
    rows = first_row + height * np.arange(count)[:, None, None] + np.arange(height)[None, :, None]
    across = columns[:, None, None] + np.arange(width)[None, None, :]
    return (
        np.broadcast_to(rows, blocks.shape).ravel(),
        np.broadcast_to(across, blocks.shape).ravel(),
        blocks.ravel(),
    )
