"""Associators on recordings: EKF-SLAM over every log with every associator."""

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
from slam_gym.recordings import open_recordings
from slam_gym.recordings.recording import Recording
from slam_gym.scenarios.registry import slam_for
from slam_gym.simulation.judged import CEILING


def logs_of(options: Recorded, recording: str) -> list[Recording]:
    """All logs of a recording, prepared for mapping by the options.

    Raises as `open_recordings` does, and ValueError for --robots with another recording than mrclam.
    """
    if options.robots and recording != "mrclam":
        raise ValueError(f"--robots is for mrclam, not for {recording}")
    logs = open_recordings(recording, options.data, options.robots, reference=options.reference)
    return [surveyed(log.every(options.every) if options.every > 1 else log) for log in logs]


def surveyed(log: Recording) -> Recording:
    """The log with the batch solution for its identities as its landmarks and reference, where it has none.

    Maps are then compared with the best map that the log allows.
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
    """Map one log with an associator and a relocation search, and write trajectory and map to a folder."""
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
    """The evaluation of every associator with every relocation on every log; files go to a folder in `out`.

    Raises ValueError for an unknown associator or relocator.
    """
    tasks = [
        Task([Key(name, log.name, 0)], partial(map_and_measure, log, name, *searches, out / FOLDER))
        for log in logs
        for name, searches in contenders(associators, relocations).items()
    ]
    settings = {log.name: asdict(slam_for(log)) for log in logs}
    return Evaluation("recordings", tasks, conditions | {"relocation": list(relocations)}, {"settings": settings})
