"""A log made by hand, of a robot that goes round and round among posts; results without their times."""

import math

import numpy as np

from slam_gym.geometry import compose, observe
from slam_gym.mapping.stochastic_map import MapSpec
from slam_gym.recordings.recording import Recording
from slam_gym.slam.slam import SlamSpec
from slam_gym.types import SPURIOUS

SPEC = SlamSpec(MapSpec(unconfirmed_age=10), reach=8.0, new_confidence=1.0 - 1e-6)


def posts_log(steps: int = 120, seed: int = 0, clutter: float = 0.1, surveyed: bool = True) -> Recording:
    """Round and round among posts, with noise that the covariances tell; W is turned and moved against the start."""
    rng = np.random.default_rng(seed)
    posts = rng.uniform(-6.0, 6.0, (14, 2))
    true, poses, motions, points, sources, starts = np.array([2.0, -3.0, 0.7]), [], [], [], [], [0]
    motion_covariance, covariance = np.diag([4e-4, 1e-4, 1e-4]), 2.5e-3 * np.eye(2)
    for k in range(steps):
        step = np.array([0.25, 0.0, 0.07]) if k else np.zeros(3)
        true = compose(true, step + (rng.standard_normal(3) * np.sqrt(np.diag(motion_covariance)) if k else 0.0))
        poses.append(true)
        motions.append(step)
        seen = observe(true, posts)
        near = np.flatnonzero((np.hypot(*seen.T) < 5.0) & (rng.random(len(posts)) < 0.8))
        false = rng.random() < clutter
        points += [*(seen[near] + 0.05 * rng.standard_normal((len(near), 2))), *rng.uniform(-5, 5, (int(false), 2))]
        sources += [*near.tolist(), *[SPURIOUS] * int(false)]
        starts.append(len(points))
    unknown = np.full(len(points), np.nan)
    reference = np.array(poses)
    return Recording(
        name="drive", source="the test", terms="any", times=0.5 * np.arange(steps), motions=np.array(motions),
        motion_covariances=np.concatenate([1e-12 * np.eye(3)[None], np.tile(motion_covariance, (steps - 1, 1, 1))]),
        starts=np.array(starts), points=np.array(points), covariances=np.tile(covariance, (len(points), 1, 1)),
        sizes=unknown, size_variances=unknown.copy(), sources=np.array(sources),
        reference_times=0.5 * np.arange(steps),
        reference_poses=reference if surveyed else np.column_stack([reference[:, :2], np.full(steps, np.nan)]),
        landmark_ids=np.arange(14), landmarks=posts, range=8.0, field_of_view=2.0 * math.pi,
    )  # fmt: skip


def timeless(frame) -> str:
    """Results without what depends on how busy the machine is, made comparable."""
    drop = ["seconds", "ticks_per_second", "microseconds", "microseconds_p99", "step_microseconds"]
    return frame.drop(columns=drop, errors="ignore").to_csv(index=False)
