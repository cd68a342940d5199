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
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from slam_gym.recordings.recording import Recording, RecordingError
from slam_gym.types import Array

_AT_START = 1e-12  # [m²], [rad²] of the first pose: it is where the log begins


@dataclass
class _Graph:
    """What was read so far."""

    poses: dict[int, Array] = field(default_factory=dict)  # number -> (3,) vertices
    landmarks: dict[int, Array] = field(default_factory=dict)  # number -> (2,) vertices
    motions: dict[tuple[int, int], tuple[Array, Array]] = field(default_factory=dict)  # mean and covariance
    measurements: list[tuple[int, int, Array, Array]] = field(default_factory=list)  # pose, landmark, mean, covariance


def g2o(path: str | Path, *, reference: bool = False) -> Recording:
    """A log from a g2o file with landmarks. With `reference`, its vertices are taken for the truth.

    Raises FileNotFoundError, or RecordingError that names file and line.
    """
    readers = {
        "VERTEX_SE2": (4, _pose_vertex),
        "VERTEX_XY": (3, _landmark_vertex),
        "EDGE_SE2": (11, _with_information(_motion, 3)),
        "EDGE_SE2_XY": (7, _with_information(_measurement, 2)),
    }
    return _recording(path, _read(path, readers), reference)


def isam(path: str | Path) -> Recording:
    """A log from a file in iSAM's text format. Raises FileNotFoundError, or RecordingError that names file and line."""
    readers = {
        "ODOMETRY": (11, _with_root(_motion, 3)),
        "LANDMARK": (7, _with_root(_measurement, 2)),
    }
    return _recording(path, _read(path, readers), False)


_Reader = Callable[[_Graph, Sequence[float]], None]


def _read(path: str | Path, readers: dict[str, tuple[int, _Reader]]) -> _Graph:
    graph = _Graph()
    for number, line in enumerate(Path(path).read_text(encoding="utf-8", errors="replace").splitlines(), 1):
        tag, *words = line.split("#", 1)[0].split() or [""]
        if not tag:
            continue
        if tag not in readers:
            raise RecordingError(f"{path}: line {number}: {tag!r} is none of {', '.join(readers)}")
        count, reader = readers[tag]
        try:
            numbers = [float(word) for word in words]
            if len(numbers) != count or not all(map(math.isfinite, numbers)):
                raise ValueError(f"{tag} takes {count} finite numbers")
            reader(graph, numbers)
        except ValueError as error:
            raise RecordingError(f"{path}: line {number}: {error}") from None
    return graph


def _pose_vertex(graph: _Graph, numbers: Sequence[float]) -> None:
    graph.poses[_index(numbers[0])] = np.array(numbers[1:])


def _landmark_vertex(graph: _Graph, numbers: Sequence[float]) -> None:
    graph.landmarks[_index(numbers[0])] = np.array(numbers[1:])


_Edge = Callable[[_Graph, int, int, Array, Array], None]


def _motion(graph: _Graph, i: int, j: int, mean: Array, covariance: Array) -> None:
    if (i, j) in graph.motions:
        raise ValueError(f"the motion from {i} to {j} is there twice")
    graph.motions[i, j] = mean, covariance


def _measurement(graph: _Graph, i: int, landmark: int, mean: Array, covariance: Array) -> None:
    graph.measurements.append((i, landmark, mean, covariance))


def _with_information(edge: _Edge, size: int) -> _Reader:
    def read(graph: _Graph, numbers: Sequence[float]) -> None:
        upper = _upper(numbers[2 + size :], size)
        information = upper + upper.T - np.diag(np.diag(upper))
        edge(graph, _index(numbers[0]), _index(numbers[1]), np.array(numbers[2 : 2 + size]), _inverse(information))

    return read


def _with_root(edge: _Edge, size: int) -> _Reader:
    def read(graph: _Graph, numbers: Sequence[float]) -> None:
        root = _upper(numbers[2 + size :], size)
        edge(graph, _index(numbers[0]), _index(numbers[1]), np.array(numbers[2 : 2 + size]), _inverse(root.T @ root))

    return read


def _index(number: float) -> int:
    if number != int(number) or number < 0:
        raise ValueError(f"{number} is no index")
    return int(number)


def _upper(numbers: Sequence[float], size: int) -> Array:
    upper = np.zeros((size, size))
    upper[np.triu_indices(size)] = numbers
    return upper


def _inverse(information: Array) -> Array:
    if np.linalg.eigvalsh(information).min() <= 0.0:
        raise ValueError("the information matrix is not positive definite")
    covariance = np.linalg.inv(information)
    symmetric: Array = 0.5 * (covariance + covariance.T)
    return symmetric


def _recording(path: str | Path, graph: _Graph, reference: bool) -> Recording:
    poses = sorted({i for pair in graph.motions for i in pair} | {i for i, *_ in graph.measurements})
    if not poses or not graph.measurements:
        raise RecordingError(f"{path}: no pose, or no measurement of a landmark")
    if further := sorted(set(graph.motions) - set(itertools.pairwise(poses))):
        raise RecordingError(f"{path}: edge {further[0]} joins poses that do not follow each other")
    motions, covariances = [np.zeros(3)], [_AT_START * np.eye(3)]
    for i, j in itertools.pairwise(poses):
        if (i, j) not in graph.motions:
            raise RecordingError(f"{path}: pose {j} is not reached from pose {i}")
        mean, covariance = graph.motions[i, j]
        motions.append(mean)
        covariances.append(covariance)
    step = {pose: k for k, pose in enumerate(poses)}
    measured = sorted(graph.measurements, key=lambda entry: step[entry[0]])  # stable: as in the file within a scan
    counts = np.bincount([step[i] for i, *_ in measured], minlength=len(poses))
    points = np.array([mean for _, _, mean, _ in measured])
    unknown = np.full(len(points), math.nan)
    times = np.arange(len(poses), dtype=np.float64)
    known = [pose for pose in poses if reference and pose in graph.poses]
    seen = sorted({landmark for _, landmark, _, _ in measured if reference and landmark in graph.landmarks})
    return Recording(
        name=Path(path).stem,
        source=str(Path(path).name),
        terms="not stated in the file",
        times=times,
        motions=np.array(motions),
        motion_covariances=np.array(covariances),
        starts=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        points=points,
        covariances=np.array([covariance for *_, covariance in measured]),
        sizes=unknown,
        size_variances=unknown.copy(),
        sources=np.array([landmark for _, landmark, _, _ in measured], dtype=np.int64),
        reference_times=times[[step[pose] for pose in known]],
        reference_poses=np.array([graph.poses[pose] for pose in known]).reshape(-1, 3),
        landmark_ids=np.array(seen, dtype=np.int64),
        landmarks=np.array([graph.landmarks[landmark] for landmark in seen]).reshape(-1, 2),
        range=float(np.hypot(*points.T).max()) + 1e-9,
        field_of_view=2.0 * math.pi,
    )
