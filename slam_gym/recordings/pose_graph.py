"""Landmark logs in text formats of pose graphs: that of g2o (`EDGE_SE2_XY`) and that of iSAM (`LANDMARK`).

    g2o   VERTEX_SE2 i x y θ                          VERTEX_XY l x y
          EDGE_SE2 i j dx dy dθ I11 I12 I13 I22 I23 I33      information matrix, upper triangle by rows
          EDGE_SE2_XY i l x y I11 I12 I22                    landmark l in the frame of pose i
          FIX i                                              is ignored
    iSAM  ODOMETRY i j dx dy dθ R11 R12 R13 R22 R23 R33      square root information, RᵀR = I
          EDGE2 …                                              the same under another name
          LANDMARK i l x y R11 R12 R22

Poses are read in the order of their numbers; an edge must lead to each from the one before it. There are no time
stamps, so a step counts as one second. Identities are the numbers of the landmarks.
"""

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from slam_gym._files import content_of
from slam_gym.recordings.recording import Recording, RecordingError, naming
from slam_gym.types import Array

_MAX_BYTES = 1 << 25
_AT_START = 1e-12  # [m²], [rad²] variances of the first pose, which is the start of the log
_G2O = {"VERTEX_SE2": (1, 3, 0), "VERTEX_XY": (1, 2, 0), "EDGE_SE2": (2, 3, 6), "EDGE_SE2_XY": (2, 2, 3)}
_ISAM = {"ODOMETRY": (2, 3, 6), "EDGE2": (2, 3, 6), "LANDMARK": (2, 2, 3)}
"""For each tag, how many numbers are the key of an entry, its mean and its weight."""


class _Entry(NamedTuple):
    """A vertex, a motion or a measurement, as in the file."""

    line: int  # number of the line
    key: tuple[int, ...]  # the number of a vertex, or the numbers of both ends of an edge
    mean: list[float]
    weight: list[float]  # upper triangle, by rows, of the information matrix of an edge or of its root


def g2o(path: str | Path, *, reference: bool = False) -> Recording:
    """Read a log from a g2o file with landmarks. With `reference`, its vertices are taken as the truth.

    Raises FileNotFoundError, or RecordingError that names file and line.
    """
    with naming(path):
        entries = _read(Path(path), _G2O)
        vertices: dict[str, dict[int, list[float]]] = {"VERTEX_SE2": {}, "VERTEX_XY": {}}
        for tag, known in vertices.items() if reference else ():
            for vertex in entries[tag]:
                if vertex.key[0] in known:
                    raise RecordingError(f"line {vertex.line}: vertex {vertex.key[0]} is there twice")
                known[vertex.key[0]] = vertex.mean
        return _recording(Path(path), entries["EDGE_SE2"], entries["EDGE_SE2_XY"], False, *vertices.values())


def isam(path: str | Path) -> Recording:
    """Read a log in iSAM's text format. Raises FileNotFoundError, or RecordingError that names file and line."""
    with naming(path):
        entries = _read(Path(path), _ISAM)
        return _recording(Path(path), entries["ODOMETRY"] + entries["EDGE2"], entries["LANDMARK"], True, {}, {})


def _read(path: Path, sizes: dict[str, tuple[int, int, int]]) -> dict[str, list[_Entry]]:
    """The entries of a file, by tag."""
    entries: dict[str, list[_Entry]] = {tag: [] for tag in sizes}
    for number, line in enumerate(content_of(path, _MAX_BYTES).decode("utf-8-sig", errors="replace").split("\n"), 1):
        tag, *words = line.split("#", 1)[0].split() or [""]
        if not tag or (tag == "FIX" and "VERTEX_SE2" in sizes):  # a vertex that an optimiser holds fixed
            continue
        with naming(f"line {number}"):
            if tag not in sizes:
                raise ValueError(f"{tag[:40]!r} is none of {', '.join(sizes)}")
            entries[tag].append(_entry(number, tag, words, *sizes[tag]))
    return entries


def _entry(line: int, tag: str, words: Sequence[str], keys: int, mean: int, weight: int) -> _Entry:
    numbers = [float(word) for word in words[keys:]]
    if len(numbers) != mean + weight or not all(map(math.isfinite, numbers)):
        raise ValueError(f"{tag} takes {keys + mean + weight} finite numbers")
    for word in words[:keys]:
        if not (word.isdecimal() and len(word) < 20 and int(word) < 1 << 63):
            raise ValueError(f"{word[:40]} is no index")
    return _Entry(line, tuple(map(int, words[:keys])), numbers[:mean], numbers[mean:])


def _covariances(edges: Sequence[_Entry], size: int, root: bool) -> Array:
    """(k, size, size) covariances from the upper triangles of the information matrices, or of their roots."""
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


def _recording(
    path: Path,
    motions: Sequence[_Entry],
    measurements: Sequence[_Entry],
    root: bool,
    known: dict[int, list[float]],
    places: dict[int, list[float]],
) -> Recording:
    """The log of motions and measurements, whose weights are information matrices or, with `root`, their roots.

    `known` and `places` are the poses and landmarks of the reference, by number.
    """
    by_pair: dict[tuple[int, ...], _Entry] = {}
    for edge in motions:
        if edge.key in by_pair:
            raise RecordingError(f"line {edge.line}: the motion from {edge.key[0]} to {edge.key[1]} is there twice")
        by_pair[edge.key] = edge
    poses = sorted({i for pair in by_pair for i in pair} | {edge.key[0] for edge in measurements})
    if not poses or not measurements:
        raise RecordingError("no pose, or no measurement of a landmark")
    pairs = list(itertools.pairwise(poses))
    if further := sorted(set(by_pair) - set(pairs)):
        raise RecordingError(f"edge {further[0]} joins poses that are not consecutive")
    if missing := [pair for pair in pairs if pair not in by_pair]:
        raise RecordingError(f"pose {missing[0][1]} is not reached from pose {missing[0][0]}")
    moved = [by_pair[pair] for pair in pairs]
    measured = sorted(measurements, key=lambda edge: edge.key[0])  # stable: as in the file within a scan
    points = np.array([edge.mean for edge in measured])
    reference = [step for step, pose in enumerate(poses) if pose in known]
    seen = sorted({edge.key[1] for edge in measured} & set(places))
    return Recording(
        name=path.name,
        source=path.name,
        terms="not stated in the file",
        times=np.arange(len(poses), dtype=np.float64),
        motions=np.array([[0.0, 0.0, 0.0], *(edge.mean for edge in moved)]),
        motion_covariances=np.concatenate([_AT_START * np.eye(3)[None], _covariances(moved, 3, root)]),
        starts=np.append(np.searchsorted([edge.key[0] for edge in measured], poses), len(measured)),
        points=points,
        covariances=_covariances(measured, 2, root),
        sources=np.array([edge.key[1] for edge in measured], dtype=np.int64),
        reference_times=np.array(reference, dtype=np.float64),
        reference_poses=np.array([known[poses[step]] for step in reference]).reshape(-1, 3),
        landmark_ids=np.array(seen, dtype=np.int64),
        landmarks=np.array([places[landmark] for landmark in seen]).reshape(-1, 2),
        range=float(np.hypot(*points.T).max()) + 1e-9,
        field_of_view=2.0 * math.pi,
    )
