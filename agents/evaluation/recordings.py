"""Associators on recordings: EKF-SLAM over every log with each associator in turn."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from agents.evaluation.associators import contenders
from agents.evaluation.mapped_log import FOLDER, map_log, measure, smoothed, write_mapped_log
from agents.evaluation.pipeline import Evaluation, Key, Task
from agents.evaluation.records import Record
from agents.options import Recorded
from slam_gym.recordings.catalogue import open_recordings
from slam_gym.recordings.recording import Recording
from slam_gym.scenarios.registry import slam_for
from slam_gym.simulation.judged import CEILING


def logs_of(options: Recorded, recording: str) -> list[Recording]:
    """All logs that a recording's name stands for, as they are to be mapped.

    Raises as `open_recordings`; ValueError for robots of another recording than mrclam.
    """
    if options.robots and recording != "mrclam":
        raise ValueError(f"--robots is for mrclam, not for {recording}")
    logs = open_recordings(recording, options.data, options.robots, reference=options.reference)
    return [surveyed(log.every(options.every) if options.every > 1 else log) for log in logs]


def surveyed(log: Recording) -> Recording:
    """The log with the batch solution of its identities for a survey of landmarks, and of the robot, where it has none.

    What the filter and others make of the log is then held against the best that could be made of it.
    """
    if len(log.landmarks) or not (log.sources >= 0).any():
        return log
    best = smoothed(map_log(log, CEILING, slam_for(log)))
    if best is None:
        return log
    known = best.features[best.features["identity"] >= 0]
    ids, places = known["identity"].to_numpy(), np.ascontiguousarray(known[["x", "y"]].to_numpy())
    log = replace(log, landmark_ids=ids, landmarks=places)
    if len(log.reference_times):
        return log
    return replace(log, reference_times=log.times, reference_poses=best.poses * [1.0, 1.0, math.nan])


def map_and_measure(log: Recording, name: str, associator: str, relocation: str | None, folder: Path) -> list[Record]:
    """One log with an associator, and the search that finds a lost robot; trajectory and map go into a folder."""
    mapped = map_log(log, associator, slam_for(log), relocation)
    write_mapped_log(folder, name, mapped)
    return [{"source": log.source} | measure(mapped)]


def recording_evaluation(
    associators: Sequence[str],
    logs: Sequence[Recording],
    conditions: dict[str, Any],
    out: Path,
    relocations: Sequence[str | None],
) -> Evaluation:
    """Every associator with every relocation on every log, checked; files go into a folder of `out`.

    ValueError for an associator or a relocator that nobody knows.
    """
    tasks = [
        Task([Key(name, log.name, 0)], partial(map_and_measure, log, name, *searches, out / FOLDER))
        for log in logs
        for name, searches in contenders(associators, relocations).items()
    ]
    settings = {log.name: asdict(slam_for(log)) for log in logs}
    return Evaluation("recordings", tasks, conditions | {"relocation": list(relocations)}, {"settings": settings})
