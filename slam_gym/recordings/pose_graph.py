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

from slam_gym._files import content_of, lines_of
from slam_gym.recordings.reading import RecordingError, naming, starts_of
from slam_gym.recordings.recording import Recording
from slam_gym.types import Array

_MAX_BYTES = 1 << 25
_AT_START = 1e-12  # [m²], [rad²] of the first pose: it is where the log begins


class _Edge(NamedTuple):
    """A motion or a measurement, as it stands in the file."""

    line: int  # number
    mean: list[float]
    weight: list[float]  # upper triangle, by rows, of the information matrix or of its root


@dataclass
class _Graph:
    """What was read so far, by the numbers of poses and landmarks."""

    poses: dict[tuple[int], list[float]] = field(default_factory=dict)  # vertices x y θ
    landmarks: dict[tuple[int], list[float]] = field(default_factory=dict)  # vertices x y
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
    with naming(path):
        return _recording(Path(path), _read(Path(path), _G2O), root=False, reference=reference)


def isam(path: str | Path) -> Recording:
    """A log from a file in iSAM's text format. Raises FileNotFoundError, or RecordingError that names file and line."""
    with naming(path):
        return _recording(Path(path), _read(Path(path), _ISAM), root=True, reference=False)


def _read(path: Path, lines: dict[str, _Line]) -> _Graph:
    graph = _Graph()
    for number, text in lines_of(content_of(path, _MAX_BYTES)):
        tag, *words = text.split("#", 1)[0].split() or [""]
        try:
            if tag:
                _enter(graph, number, tag, words, lines)
        except ValueError as error:
            raise RecordingError(f"line {number}: {error}") from None
    return graph


def _enter(graph: _Graph, number: int, tag: str, words: Sequence[str], lines: dict[str, _Line]) -> None:
    if tag not in lines:
        raise ValueError(f"{tag[:40]!r} is none of {', '.join(lines)}")
    line = lines[tag]
    rest = [float(word) for word in words[line.indices :]]
    if len(words) != line.numbers or not all(map(math.isfinite, rest)):
        raise ValueError(f"{tag} takes {line.numbers} finite numbers")
    key = tuple(_index(word) for word in words[: line.indices])
    value: Any = rest if line.indices == 1 else _Edge(number, rest[: line.size], rest[line.size :])
    table = getattr(graph, line.table)
    if line.table == "measurements":
        table.append((key, value))
    elif line.table == "motions" and key in table:
        raise ValueError(f"the motion from {key[0]} to {key[1]} is there twice")
    else:
        table[key] = value


def _index(word: str) -> int:
    """The number of a pose or landmark, with all of its digits."""
    if not (word.isdecimal() and len(word) < 20 and int(word) < 1 << 63):
        raise ValueError(f"{word[:40]} is no index")
    return int(word)


def _covariances(edges: Sequence[_Edge], size: int, root: bool) -> Array:
    """(k, size, size) from the upper triangles of the information matrices or of their roots."""
    upper = np.zeros((len(edges), size, size))
    rows, columns = np.triu_indices(size)
    upper[:, rows, columns] = np.array([edge.weight for edge in edges]).reshape(len(edges), len(rows))
    turned = upper.transpose(0, 2, 1)
    information = turned @ upper if root else upper + turned - upper * np.eye(size)
    bad = ~np.isfinite(information).all(axis=(1, 2))
    information[bad] = np.eye(size)
    values = np.linalg.eigvalsh(information)
    bad |= ~(values[:, 0] > 1e-15 * values[:, -1])
    if bad.any():
        number = edges[int(bad.argmax())].line
        raise RecordingError(f"line {number}: the information matrix is not positive definite")
    covariances = np.linalg.inv(information)
    return np.asarray(0.5 * (covariances + covariances.transpose(0, 2, 1)))


def _recording(path: Path, graph: _Graph, root: bool, reference: bool) -> Recording:
    poses = sorted({i for pair in graph.motions for i in pair} | {pair[0] for pair, _ in graph.measurements})
    if not poses or not graph.measurements:
        raise RecordingError("no pose, or no measurement of a landmark")
    pairs = list(itertools.pairwise(poses))
    if further := sorted(set(graph.motions) - set(pairs)):
        raise RecordingError(f"edge {further[0]} joins poses that do not follow each other")
    if missing := [pair for pair in pairs if pair not in graph.motions]:
        raise RecordingError(f"pose {missing[0][1]} is not reached from pose {missing[0][0]}")
    motions = [graph.motions[pair] for pair in pairs]
    step = {pose: k for k, pose in enumerate(poses)}
    measured = sorted(graph.measurements, key=lambda entry: step[entry[0][0]])  # stable: as in the file within a scan
    points = np.array([edge.mean for _, edge in measured])
    times = np.arange(len(poses), dtype=np.float64)
    known = [pose for pose in poses if reference and (pose,) in graph.poses]
    seen = sorted({landmark for (_, landmark), _ in measured if reference and (landmark,) in graph.landmarks})
    return Recording(
        name=path.stem,
        source=path.name,
        terms="not stated in the file",
        times=times,
        motions=np.array([[0.0, 0.0, 0.0], *(edge.mean for edge in motions)]),
        motion_covariances=np.concatenate([_AT_START * np.eye(3)[None], _covariances(motions, 3, root)]),
        starts=starts_of(np.bincount([step[i] for (i, _), _ in measured], minlength=len(poses))),
        points=points,
        covariances=_covariances([edge for _, edge in measured], 2, root),
        sources=np.array([landmark for (_, landmark), _ in measured], dtype=np.int64),
        reference_times=times[[step[pose] for pose in known]],
        reference_poses=np.array([graph.poses[pose,] for pose in known]).reshape(-1, 3),
        landmark_ids=np.array(seen, dtype=np.int64),
        landmarks=np.array([graph.landmarks[landmark,] for landmark in seen]).reshape(-1, 2),
        range=float(np.hypot(*points.T).max()) + 1e-9,
        field_of_view=2.0 * math.pi,
    )
