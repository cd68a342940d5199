"""The logs of all robots of an MR.CLAM set, one after the other, for one map of them all."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from slam_gym.geometry import relative
from slam_gym.recordings.mrclam import ROBOTS, Noise, mrclam
from slam_gym.recordings.reading import starts_of
from slam_gym.recordings.recording import PER_MEASUREMENT, Recording, interpolate
from slam_gym.types import Array

_PAUSE = 10.0  # [s] between the log of one robot and that of the next


def mrclam_all(
    folder: str | Path, noise: Noise | None = None, link: tuple[float, float, float] = (0.05, 0.05, math.radians(2.0))
) -> Recording:
    """The logs of all robots of a set, one after the other, for one map of them all.

    It is as if a single robot were picked up at the end of each log and put down at the start of the next: that motion
    is the relative pose that the Vicon gives, with standard deviations `link` [m, m, rad]. Everything within a log is
    as in `mrclam`, but for the clock, which starts again ten seconds after the log before; of the reference, what was
    recorded from the first step of each log to its last stays. Raises as `mrclam`.
    """
    logs = [mrclam(folder, robot, noise) for robot in ROBOTS]
    begins = np.concatenate([[0.0], np.cumsum([log.times[-1] + _PAUSE for log in logs])[:-1]])
    rows = starts_of([len(log.points) for log in logs])
    times = [_reference_times(log) for log in logs]
    poses = [interpolate(log.reference_times, log.reference_poses, at) for log, at in zip(logs, times)]
    joined = ("motions", "motion_covariances", *PER_MEASUREMENT)
    together: dict[str, Any] = {name: np.concatenate([getattr(log, name) for log in logs]) for name in joined}
    for k, step in enumerate(np.cumsum([len(log) for log in logs])[:-1]):
        together["motions"][step] = relative(poses[k][-1], poses[k + 1][0])
        together["motion_covariances"][step] = np.diag(np.square(link))
    return replace(
        logs[0],
        name=f"mrclam/{Path(folder).name}/all",
        times=np.concatenate([log.times + begin for log, begin in zip(logs, begins)]),
        starts=np.concatenate([log.starts[:-1] + row for log, row in zip(logs, rows)] + [rows[-1:]]),
        reference_times=np.concatenate([at + begin for at, begin in zip(times, begins)]),
        reference_poses=np.concatenate(poses),
        **together,
    )


def _reference_times(log: Recording) -> Array:
    """[s] at which the Vicon saw the robot between the first and the last step of a log, and those two."""
    end = log.times[-1]
    during = (log.reference_times > 0.0) & (log.reference_times < end)
    return np.concatenate([[0.0], log.reference_times[during], [end]])
