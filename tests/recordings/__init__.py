"""Logs made by hand, of a robot that drives on an arc."""

import math
from dataclasses import replace

import numpy as np

from slam_gym.geometry import compose, observe
from slam_gym.recordings import Recording
from slam_gym.types import SPURIOUS, UNLABELLED, Odometry, Scan, Truth


def drive(seed: int = 0, steps: int = 60, headings: bool = True, noise: float = 1.0, **changes) -> Recording:
    """A robot on an arc among 40 features in a frame W of its own, with spurious measurements and unknown sources."""
    rng = np.random.default_rng(seed)
    world, poses = rng.uniform(-12.0, 12.0, (40, 2)), [np.array([-8.0, 3.0, 2.0])]
    motions, points, sources, starts = [np.array([0.1, 0.0, 0.0])], [], [], [0]
    for step in range(steps):
        if step:
            motion = np.array([0.4, 0.0, 0.1])
            poses.append(compose(poses[-1], motion))
            motions.append(motion + 0.01 * noise * rng.standard_normal(3))
        local = observe(poses[-1], world)
        seen = np.flatnonzero(np.hypot(*local.T) < 8.0)
        points.append(local[seen] + 0.05 * noise * rng.standard_normal((len(seen), 2)))
        points.append(rng.uniform(-8.0, 8.0, (1, 2)))
        sources += [*np.where(rng.random(len(seen)) < 0.1, UNLABELLED, seen), SPURIOUS]
        starts.append(len(sources))
    unknown = np.full(len(sources), math.nan)
    reference = np.array(poses) if headings else np.column_stack([np.array(poses)[:, :2], np.full(steps, math.nan)])
    log = Recording(
        name="arc", source="made", terms="none", times=np.arange(steps) + 5.0, motions=np.array(motions),
        motion_covariances=np.tile(1e-4 * np.eye(3), (steps, 1, 1)), starts=np.array(starts),
        points=np.concatenate(points), covariances=np.tile(0.0025 * np.eye(2), (len(sources), 1, 1)), sizes=unknown,
        size_variances=unknown.copy(), sources=np.array(sources), reference_times=np.arange(steps) + 5.0,
        reference_poses=reference, landmark_ids=np.arange(40), landmarks=world, range=9.0, field_of_view=2.0 * math.pi,
    )  # fmt: skip
    return replace(log, **changes)


def looks(seed: int, steps: int, noise: float = 1.0) -> list[tuple[Odometry, Scan, Truth]]:
    """Odometry, scan and truth of each step of such a drive."""
    log = drive(seed, steps, noise=noise)
    return [(*now, Truth(pose, sources)) for (*now, sources), pose in zip(log.steps(), log.reference_poses)]
