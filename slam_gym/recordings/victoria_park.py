"""The Victoria Park log: a vehicle with a laser among some 300 trees, 4 km in 26 minutes.

Published by E. Nebot and J. Guivant, University of Sydney; cite Guivant and Nebot, "Optimization of the simultaneous
localization and map-building algorithm for real-time implementation", IEEE TRA 17(3), 2001. The identities of the
trunks were made by S. Huang, Z. Wang and G. Dissanayake (I-SLSJF): they come from a SLAM of theirs, not from a survey.

Needed in one folder: `aa3_dr.mat` (odometry), `VictoriaParkSinSincronizar.mat` (detections), `aa3_gpsx.mat` (GPS), and
`data_sensor_clean_clean.mat` (identities).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

from slam_gym._compile import compiled
from slam_gym.recordings.recording import Recording, RecordingError
from slam_gym.types import NONE, UNKNOWN, Array, IntArray

SOURCE = (
    "Victoria Park, E. Nebot and J. Guivant, University of Sydney. Cite: Guivant and Nebot, IEEE TRA 17(3), 2001; for "
    "the identities also Huang, Wang and Dissanayake, 'Iterated SLSJF: a sparse local submap joining algorithm', 2008."
)
TERMS = "No licence is published for the data: ask the authors before you pass it on."
_LENGTH, _HALF_WIDTH = 2.83, 0.76  # [m] wheel base; from the middle of the rear axle to the encoder's wheel
_AHEAD, _ASIDE = 3.78, 0.5  # [m] of the laser, from the middle of the rear axle
_RANGE = 80.0  # [m] of the laser
_AT_REST = 1e-4  # [m], [rad] σ of a step without motion


@dataclass(frozen=True)
class Noise:
    """What the log does not say. Variances of the motion add up with time; those of a trunk with its range."""

    speed: float = 0.3  # [m/√s] along the way, while it moves
    lateral: float = 0.1  # [m/√s] across it
    turn: float = math.radians(2.0)  # [rad/√s]
    range: float = 0.3  # [m] between a trunk seen from one side and from another
    bearing: float = math.radians(1.0)  # [rad]
    size: float = 0.05  # [m] of a trunk's diameter
    size_per_metre: float = 0.005  # [m/m] of the range, added in quadrature


def victoria_park(folder: str | Path, noise: Noise | None = None) -> Recording:
    """The whole log from the published files in `folder`: one step a laser scan, trunk diameters as sizes.

    Identities are NONE for the detections that the label file leaves out of a scan, and UNKNOWN in the scans that it
    leaves out. The reference is the position of the GPS antenna, near the laser. Its stamps fit as they are: the error
    of a good trajectory is least when they are shifted by 0.1 s.
    Raises FileNotFoundError, or RecordingError that names file and variable.
    """
    noise = noise or Noise()
    folder = Path(folder)
    wheels = _variables(folder / "aa3_dr.mat", ("time", "speed", "steering"))
    laser = _variables(folder / "VictoriaParkSinSincronizar.mat", ("TLsr", "zt"))
    gps = _variables(folder / "aa3_gpsx.mat", ("timeGps", "Lo_m", "La_m"))
    labels = _variables(folder / "data_sensor_clean_clean.mat", ("data_sensor_clean_clean",))
    times = np.ascontiguousarray(laser["TLsr"].ravel(), dtype=np.float64)
    commands = [np.ascontiguousarray(wheels[name].ravel(), np.float64) for name in ("time", "speed", "steering")]
    motions, covariances = _integrate(
        times, 1e-3 * commands[0], commands[1], commands[2], noise.speed, noise.lateral, noise.turn
    )
    detections = [np.asarray(scan, np.float64).reshape(3, -1).T for scan in laser["zt"].ravel()]
    starts = np.concatenate([[0], np.cumsum([len(scan) for scan in detections])]).astype(np.int64)
    polar = np.concatenate(detections)
    points, point_covariances = _cartesian(polar, noise)
    return Recording(
        name="victoria_park",
        source=SOURCE,
        terms=TERMS,
        times=times,
        motions=motions,
        motion_covariances=covariances,
        starts=starts,
        points=points,
        covariances=point_covariances,
        sizes=polar[:, 2].copy(),
        size_variances=noise.size**2 + (noise.size_per_metre * polar[:, 0]) ** 2,
        sources=_identities(folder, labels["data_sensor_clean_clean"], times, starts, polar),
        reference_times=1e-3 * gps["timeGps"].ravel(),
        reference_poses=np.column_stack([gps["Lo_m"], gps["La_m"], np.full(len(gps["Lo_m"]), np.nan)]),
        landmark_ids=np.empty(0, np.int64),
        landmarks=np.empty((0, 2)),
        range=_RANGE,
        field_of_view=math.pi,
    )


def victoria_park_clean(path: str | Path) -> Recording:
    """The log as Huang, Wang and Dissanayake cleaned it (`VicPark_clean_data.mat`): motions and labelled points.

    Its least-squares optimum is known: χ² = 9012.7193. Steps are numbered, not timed. Raises as `victoria_park`.
    """
    rows = _variables(Path(path), ("VicPark_clean_data",))["VicPark_clean_data"]
    moves, looks = rows[rows[:, 0] == 1.0], rows[rows[:, 0] == 0.0]
    steps = len(moves) + 1
    if not np.array_equal(moves[:, 2], np.arange(1, steps)) or not np.array_equal(moves[:, 1], np.arange(steps - 1)):
        raise RecordingError(f"{path}: the motions do not join pose after pose")
    looks = looks[np.argsort(looks[:, 1], kind="stable")]
    motions, covariances = np.zeros((steps, 3)), np.tile(_AT_REST**2 * np.eye(3), (steps, 1, 1))
    motions[1:] = moves[:, 3:6]
    covariances[1:] = moves[:, [6, 7, 8, 7, 9, 10, 8, 10, 11]].reshape(-1, 3, 3)
    unknown = np.full(len(looks), math.nan)
    return Recording(
        name="victoria_park_clean",
        source=SOURCE,
        terms=TERMS,
        times=np.arange(steps, dtype=np.float64),
        motions=motions,
        motion_covariances=covariances,
        starts=np.concatenate([[0], np.cumsum(np.bincount(looks[:, 1].astype(np.int64), minlength=steps))]),
        points=looks[:, 3:5].copy(),
        covariances=looks[:, [5, 6, 6, 7]].reshape(-1, 2, 2).copy(),
        sizes=unknown,
        size_variances=unknown.copy(),
        sources=looks[:, 2].astype(np.int64),
        reference_times=np.empty(0),
        reference_poses=np.empty((0, 3)),
        landmark_ids=np.empty(0, np.int64),
        landmarks=np.empty((0, 2)),
        range=_RANGE,
        field_of_view=math.pi,
    )


def _variables(path: Path, names: tuple[str, ...]) -> dict[str, Any]:
    """The variables of a MATLAB file. FileNotFoundError, or RecordingError for what is missing or unreadable."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: not there. {SOURCE}")
    try:
        content = loadmat(path)
    except Exception as error:  # scipy raises whatever the damage leads to
        raise RecordingError(f"{path}: no readable MATLAB file: {error}") from error
    for name in names:
        if name not in content:
            raise RecordingError(f"{path}: variable {name!r} is missing")
    return {name: content[name] for name in names}


@compiled
def _integrate(
    scans: Array, times: Array, speeds: Array, steerings: Array, along: float, across: float, turn: float
) -> tuple[Array, Array]:
    """Motion (T, 3) of the laser from scan to scan, and its covariance (T, 3, 3), by the vehicle's kinematics.

    With the speed v_c = v / (1 − tan α · H / L) of the middle of the rear axle and κ = tan α / L,
    ẋ = v_c (cos θ − κ (a sin θ + b cos θ)), ẏ = v_c (sin θ + κ (a cos θ − b sin θ)), θ̇ = v_c κ
    (Guivant and Nebot 2001). A command holds until the next one.
    """
    motions, covariances = np.zeros((len(scans), 3)), np.zeros((len(scans), 3, 3))
    at = 0
    for k in range(len(scans)):
        now = scans[k - 1] if k > 0 else scans[0]
        x, y, theta, moving = 0.0, 0.0, 0.0, 0.0
        while now < scans[k]:
            while at + 1 < len(times) and times[at + 1] <= now:
                at += 1
            end = min(scans[k], times[at + 1]) if at + 1 < len(times) else scans[k]
            dt = end - now if times[at] <= now else 0.0
            v = speeds[at] / (1.0 - math.tan(steerings[at]) * _HALF_WIDTH / _LENGTH)
            curvature = math.tan(steerings[at]) / _LENGTH
            c, s = math.cos(theta), math.sin(theta)
            x += dt * v * (c - curvature * (_AHEAD * s + _ASIDE * c))
            y += dt * v * (s + curvature * (_AHEAD * c - _ASIDE * s))
            theta += dt * v * curvature
            moving += dt if v != 0.0 else 0.0
            now = end
        motions[k, 0], motions[k, 1], motions[k, 2] = x, y, theta
        covariances[k, 0, 0] = along**2 * moving + _AT_REST**2
        covariances[k, 1, 1] = across**2 * moving + _AT_REST**2
        covariances[k, 2, 2] = turn**2 * moving + _AT_REST**2
    return motions, covariances


def _cartesian(polar: Array, noise: Noise) -> tuple[Array, Array]:
    """Points (M, 2) and covariances (M, 2, 2) in R of detections (M, 3): range, bearing from the right, diameter."""
    ranges, bearings = polar[:, 0], polar[:, 1] - 0.5 * math.pi
    ahead = np.column_stack([np.cos(bearings), np.sin(bearings)])
    aside = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    covariances = noise.range**2 * ahead[:, :, None] * ahead[:, None, :]
    covariances += ((noise.bearing * ranges) ** 2)[:, None, None] * aside[:, :, None] * aside[:, None, :]
    return ranges[:, None] * ahead, covariances


def _identities(folder: Path, labels: Array, times: Array, starts: IntArray, polar: Array) -> IntArray:
    """(M,) identity of each detection, joined with the labels by time, bearing and range."""
    keys = {(round(t), round(b, 6), round(r, 6)): int(source) for t, r, b, _, _, source in labels.tolist()}
    stamps = np.repeat(np.round(1000.0 * times).astype(np.int64), np.diff(starts))
    sources = np.array(
        [
            keys.pop((t, round(b, 6), round(r, 6)), NONE)
            for t, (r, b, _) in zip(stamps.tolist(), polar.tolist(), strict=True)
        ],
        dtype=np.int64,
    )
    if keys:
        time = next(iter(keys))[0]
        raise RecordingError(f"{folder}: {len(keys)} labels fit no detection, the first at {time} ms")
    labelled = np.isin(stamps, labels[:, 0].astype(np.int64))
    sources[~labelled] = UNKNOWN
    return sources
