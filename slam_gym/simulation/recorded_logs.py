"""Recordings as scenarios of `Associate-v0`: the log drives, the agent associates, identities give the reward.

    recording:victoria_park     recording:mrclam/3     recording:dlr     recording:FILE (.npz, .csv, .g2o, .txt)
    recording:victoria_park?every=5    recording:mine.npz?looks=200&every=2

An episode is a window of `looks` steps (default: 500, or the whole log if it is shorter) with a random start. The robot
maps it from scratch: earlier steps are unknown, and its first pose is the base of the map. Windows for training lie in
the first 70 % of the log, windows for testing in the rest. With `every` = k the robot uses every k-th scan only, and
its odometry is compounded in between, which makes a log with a fast sensor a test of association.

Published logs are read from the folder that `SLAM_GYM_DATA` names. For MR.CLAM, the logs are those of robot 1 … 5 of
set 6, or of the first set in the folder.
"""

import math
from collections.abc import Iterator
from functools import partial
from urllib.parse import parse_qsl

import numpy as np

from slam_gym.recordings import open_recordings
from slam_gym.recordings.mrclam import ROBOTS
from slam_gym.recordings.recording import Recording, interpolate
from slam_gym.scenarios import SPLITS, slam_for
from slam_gym.simulation.association_runs import ScanLog
from slam_gym.types import Array, Odometry, Scan, Truth
from slam_gym.validation import one_of

PREFIX = "recording:"
LOOKS = 500
_TRAINING = 0.7  # fraction of a log used for training
_SET = "/MRCLAM_Dataset6/"


def recorded_log(scenario: str, split: str) -> ScanLog:
    """The log for the name of a scenario, "recording:…".

    Raises ValueError for an unknown name or option; FileNotFoundError, which says where to get the data and what to
    cite; RecordingError for invalid files.
    """
    name, question, query = scenario.removeprefix(PREFIX).partition("?")
    options = _options(scenario, query) if question else {}
    return windows(_open(name), split, options.get("looks", LOOKS), options.get("every", 1))


def windows(recording: Recording, split: str, looks: int = LOOKS, every: int = 1) -> ScanLog:
    """A log whose episodes are windows of a `split` of a recording, with every `every`-th step.

    See the module's docstring. True positions of features, which `reward="map_error"` needs, are known if the recording
    has landmarks and the pose of every step. Raises ValueError for an unknown split, numbers below 1, and recordings
    too short to split.
    """
    one_of("split", split, SPLITS)
    if looks < 1:
        raise ValueError(f"looks={looks}: expected at least 1")
    log = recording.every(every)
    if len(log) < 2:
        raise ValueError(f"recording {recording.name!r}: {len(log)} steps are too few to be split")
    cut = min(max(round(_TRAINING * len(log)), 1), len(log) - 1)
    log = log.part(0, cut) if split == "train" else log.part(cut)
    length, poses = min(looks, len(log)), reference_poses(log)
    targets = log.landmarks if np.isfinite(poses).all() else log.landmarks[:0]
    return ScanLog(log.name, partial(_window, log, poses, length), length, slam_for(log), targets)


def reference_poses(recording: Recording) -> Array:
    """(T, 3) reference poses interpolated at the times of the steps; NaN outside the times of the reference."""
    times, known = recording.times, recording.reference_times
    if len(known) == 0:
        return np.full((len(times), 3), math.nan)
    poses = interpolate(known, recording.reference_poses, times)
    poses[(times < known[0]) | (times > known[-1])] = math.nan
    return poses


def _window(
    log: Recording, poses: Array, length: int, rng: np.random.Generator
) -> Iterator[tuple[Odometry, Scan, Truth]]:
    first = int(rng.integers(len(log) - length + 1))
    for step in range(first, first + length):
        odometry = log.odometry(step) if step > first else Odometry(np.zeros(3), np.zeros((3, 3)))
        yield odometry, log.scan(step), Truth(poses[step], log.sources_of(step))


def _open(name: str) -> Recording:
    published, _, robot = name.partition("/")
    if published == "mrclam" and "." not in name:
        if robot not in map(str, ROBOTS):
            raise ValueError(f"recording {name!r}; known: {', '.join(f'mrclam/{number}' for number in ROBOTS)}")
        logs = open_recordings(published, robots=[int(robot)])
        return next((log for log in logs if _SET in log.name), logs[0])
    return open_recordings(name)[0]


def _options(scenario: str, query: str) -> dict[str, int]:
    """The options after the question mark in the name of a scenario."""
    try:
        options = {name: int(value) for name, value in parse_qsl(query, keep_blank_values=True, strict_parsing=True)}
    except ValueError:
        options = {}
    if not options or not set(options) <= {"looks", "every"}:
        raise ValueError(f"scenario={scenario!r}: expected ?looks=NUMBER, ?every=NUMBER or both, joined by &")
    return options
