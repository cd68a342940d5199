"""Landmark logs that come as text pose graphs: the g2o dialect (`EDGE_SE2_XY`) and that of iSAM (`LANDMARK`).

    g2o   VERTEX_SE2 i x y θ                          VERTEX_XY l x y
          EDGE_SE2 i j dx dy dθ I11 I12 I13 I22 I23 I33      information matrix, upper triangle by rows
          EDGE_SE2_XY i l x y I11 I12 I22                    landmark l in the frame of pose i
    iSAM  ODOMETRY i j dx dy dθ R11 R12 R13 R22 R23 R33      square root information, RᵀR = I
          LANDMARK i l x y R11 R12 R22

Poses are taken in the order of their numbers; each must be reached from the one before it. There are no time stamps, so
that a step counts as a second. Identities are the numbers of the landmarks.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from slam_gym.recordings.reading import RecordingError, starts_of
from slam_gym.recordings.recording import Recording
from slam_gym.types import Array

_AT_START = 1e-12  # [m²], [rad²] of the first pose: it is where the log begins


class _Edge(NamedTuple):
    """A motion or a measurement."""

    mean: Array
    covariance: Array


@dataclass
class _Graph:
    """What was read so far, by the numbers of poses and landmarks."""

    poses: dict[tuple[int], Array] = field(default_factory=dict)  # (3,) vertices
    landmarks: dict[tuple[int], Array] = field(default_factory=dict)  # (2,) vertices
    motions: dict[tuple[int, int], _Edge] = field(default_factory=dict)  # from pose to pose
    measurements: list[tuple[tuple[int, int], _Edge]] = field(default_factory=list)  # from pose to landmark


class _Line(NamedTuple):
    """What follows a tag: one number of a vertex or two of an edge, the mean, and the weight of an edge."""

    table: str  # field of `_Graph`
    size: int  # of the mean
    root: bool = False  # the weight is a square root information matrix

    @property
    def indices(self) -> int:
        return 1 if self.table in ("poses", "landmarks") else 2

    @property
    def numbers(self) -> int:
        """How many there are in all."""
        return self.indices + self.size + (self.indices == 2) * self.size * (self.size + 1) // 2


_G2O = {
    "VERTEX_SE2": _Line("poses", 3),
    "VERTEX_XY": _Line("landmarks", 2),
    "EDGE_SE2": _Line("motions", 3),
    "EDGE_SE2_XY": _Line("measurements", 2),
}
_ISAM = {"ODOMETRY": _Line("motions", 3, root=True), "LANDMARK": _Line("measurements", 2, root=True)}


def g2o(path: str | Path, *, reference: bool = False) -> Recording:
    """A log from a g2o file with landmarks. With `reference`, its vertices are taken for the truth.

    Raises FileNotFoundError, or RecordingError that names file and line.
    """
    return _recording(path, _read(path, _G2O), reference)


def isam(path: str | Path) -> Recording:
    """A log from a file in iSAM's text format. Raises FileNotFoundError, or RecordingError that names file and line."""
    return _recording(path, _read(path, _ISAM), False)


def _read(path: str | Path, lines: dict[str, _Line]) -> _Graph:
    graph = _Graph()
    for number, text in enumerate(Path(path).read_text(encoding="utf-8", errors="replace").splitlines(), 1):
        tag, *words = text.split("#", 1)[0].split() or [""]
        try:
            if tag:
                _enter(graph, tag, words, lines)
        except ValueError as error:
            raise RecordingError(f"{path}: line {number}: {error}") from None
    return graph


def _enter(graph: _Graph, tag: str, words: Sequence[str], lines: dict[str, _Line]) -> None:
    if tag not in lines:
        raise ValueError(f"{tag!r} is none of {', '.join(lines)}")
    line, numbers = lines[tag], [float(word) for word in words]
    if len(numbers) != line.numbers or not all(map(math.isfinite, numbers)):
        raise ValueError(f"{tag} takes {line.numbers} finite numbers")
    key, rest = tuple(_index(number) for number in numbers[: line.indices]), numbers[line.indices :]
    value: Any = np.array(rest[: line.size])
    if line.indices == 2:
        value = _Edge(value, _covariance(rest[line.size :], line))
    table = getattr(graph, line.table)
    if line.table == "measurements":
        table.append((key, value))
    elif line.table == "motions" and key in table:
        raise ValueError(f"the motion from {key[0]} to {key[1]} is there twice")
    else:
        table[key] = value


def _index(number: float) -> int:
    if number != int(number) or number < 0:
        raise ValueError(f"{number} is no index")
    return int(number)


def _covariance(numbers: Sequence[float], line: _Line) -> Array:
    """From the upper triangle of the information matrix or its root."""
    upper = np.zeros((line.size, line.size))
    upper[np.triu_indices(line.size)] = numbers
    information = upper.T @ upper if line.root else upper + upper.T - np.diag(np.diag(upper))
    if np.linalg.eigvalsh(information).min() <= 0.0:
        raise ValueError("the information matrix is not positive definite")
    covariance = np.linalg.inv(information)
    return np.asarray(0.5 * (covariance + covariance.T))


def _recording(path: str | Path, graph: _Graph, reference: bool) -> Recording:
    poses = sorted({i for pair in graph.motions for i in pair} | {pair[0] for pair, _ in graph.measurements})
    if not poses or not graph.measurements:
        raise RecordingError(f"{path}: no pose, or no measurement of a landmark")
    if further := sorted(set(graph.motions) - set(itertools.pairwise(poses))):
        raise RecordingError(f"{path}: edge {further[0]} joins poses that do not follow each other")
    if missing := [pair for pair in itertools.pairwise(poses) if pair not in graph.motions]:
        raise RecordingError(f"{path}: pose {missing[0][1]} is not reached from pose {missing[0][0]}")
    motions = [_Edge(np.zeros(3), _AT_START * np.eye(3)), *(graph.motions[pair] for pair in itertools.pairwise(poses))]
    step = {pose: k for k, pose in enumerate(poses)}
    measured = sorted(graph.measurements, key=lambda entry: step[entry[0][0]])  # stable: as in the file within a scan
    points = np.array([edge.mean for _, edge in measured])
    times = np.arange(len(poses), dtype=np.float64)
    known = [pose for pose in poses if reference and (pose,) in graph.poses]
    seen = sorted({landmark for (_, landmark), _ in measured if reference and (landmark,) in graph.landmarks})
    return Recording(
        name=Path(path).stem,
        source=str(Path(path).name),
        terms="not stated in the file",
        times=times,
        motions=np.array([edge.mean for edge in motions]),
        motion_covariances=np.array([edge.covariance for edge in motions]),
        starts=starts_of(np.bincount([step[i] for (i, _), _ in measured], minlength=len(poses))),
        points=points,
        covariances=np.array([edge.covariance for _, edge in measured]),
        sources=np.array([landmark for (_, landmark), _ in measured], dtype=np.int64),
        reference_times=times[[step[pose] for pose in known]],
        reference_poses=np.array([graph.poses[pose,] for pose in known]).reshape(-1, 3),
        landmark_ids=np.array(seen, dtype=np.int64),
        landmarks=np.array([graph.landmarks[landmark,] for landmark in seen]).reshape(-1, 2),
        range=float(np.hypot(*points.T).max()) + 1e-9,
        field_of_view=2.0 * math.pi,
    )
