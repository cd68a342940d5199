"""What surrounds a decision: the frame of a run whose scan is still being associated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam_gym.geometry import observe, relative
from slam_gym.rendering.explore_view import Frame
from slam_gym.rendering.frames import frame_of
from slam_gym.simulation.association_runs import AssociationRun, DrivenRun, LoggedRun
from slam_gym.types import Array

_NO_POINTS, _NO_DECISIONS = np.empty((0, 2)), np.empty(0, np.int64)


def scene_of(run: AssociationRun) -> tuple[Array, Frame]:
    """Pose (3,) of B in the frame of the picture, and the picture without any measurement.

    A scenario is drawn in W; a log in B, where it has no walls, and where its true robot need not be known.
    """
    if isinstance(run, DrivenRun):
        frame = frame_of(run.episode, _NO_POINTS)
        frame = replace(frame, scan_points=_NO_POINTS, decisions=_NO_DECISIONS, paired_positions=_NO_POINTS)
        return run.episode.base, frame
    assert isinstance(run, LoggedRun)
    return np.zeros(3), _of_log(run)


def _of_log(run: LoggedRun) -> Frame:
    slam_map, targets = run.slam.map, run.targets
    pose = slam_map.pose
    poses = np.array([*run.poses, run.truth.pose])  # NaN where nobody knows them
    start = poses[0]
    trail = np.array([estimate[:2] for estimate in run.estimates] + [pose[:2]])
    return Frame(
        walls=np.empty((0, 4)),
        features=targets,
        kinds=np.zeros(len(targets), np.int64),
        furniture=np.empty((0, 5)),
        people=np.empty((0, 3)),
        robot_radius=0.2,
        true_pose=relative(start, run.truth.pose),
        true_trail=observe(start, poses[:, :2]) if np.isfinite(poses).all() else _NO_POINTS,
        pose=pose,
        pose_covariance=slam_map.pose_covariance,
        trail=trail,
        landmarks=slam_map.positions,
        landmark_covariances=slam_map.covariances,
        provisional=slam_map.provisional,
        scan_points=_NO_POINTS,
        decisions=_NO_DECISIONS,
        paired_positions=_NO_POINTS,
        path=_NO_POINTS,
        goals=_NO_POINTS,
    )
