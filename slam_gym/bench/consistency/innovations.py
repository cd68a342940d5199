"""Does the filter know how wrong it is, at every level of drift? NEES, NIS and whiteness, over many episodes.

A robot goes through `office-small` where chance has it, into walls too, and knows which feature each measurement comes
from. NEES of the pose and NIS of each scan, per degree of freedom, are 1 where the filter is consistent; the
correlation of a feature's innovation with its last one is 0 where innovations are white. While the robot touches
something it slips the same way tick after tick, which the filter takes for a new slip each time: figures free and in
contact stand apart. Intervals are 95 % bootstrap intervals over episodes, of ratios of sums.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from slam_gym.association import true_association
from slam_gym.association.compatibility import joint_distance
from slam_gym.bench.records import Record
from slam_gym.bench.report import Report
from slam_gym.metrics.statistics import Interval, bootstrap_interval
from slam_gym.scenarios import Scenario, get_scenario, world_generator
from slam_gym.scenarios.registry import DRIFT
from slam_gym.simulation.episode import Episode, survey
from slam_gym.types import UNPAIRED, Array, IntArray

LEVELS = (0, 1, 2, 3)
_DOF = 3  # of a pose


class Innovations(NamedTuple):
    """Sums over an episode; the two columns are while the robot is free, and while it touches something."""

    nis: Array  # (2, 2) NIS, and its degrees of freedom
    lag: Array  # (2, 2) products of a feature's whitened innovation with its last one, and how many
    nees: Array  # (2,) NEES of the pose, and its degrees of freedom


def at_level(level: int, ticks: int) -> Scenario:
    """`office-small` with the wheels of a level of drift; level 0 has its own."""
    office = get_scenario("office-small")
    return replace(office, odometry=DRIFT[level] if level else office.odometry, budget=ticks)


def innovations(scenario: Scenario, world: int) -> Innovations:
    """Of one episode, in a train world."""
    site, rng = survey(scenario.generator(world_generator("train", world)), scenario), np.random.default_rng(world)
    episode = Episode(scenario, site, "nearest_neighbour", np.random.default_rng([1, world]))
    found, last, turn = Innovations(np.zeros((2, 2)), np.zeros((2, 2)), np.zeros(2)), dict[int, Array](), 0.0
    while not episode.over:
        turn = 0.9 * turn + 0.3 * rng.standard_normal()
        prediction, scan, m = episode.begin_tick(0.8, float(np.clip(turn, -1.0, 1.0))), episode.scan, episode.slam.map
        known = episode.identities.source_of(m.ids)
        hypothesis = true_association(scan, prediction, sources=episode.truth.sources, identities=known)
        measured = np.flatnonzero(hypothesis.features != UNPAIRED)
        rows = np.searchsorted(prediction.features, hypothesis.features[measured])
        touching = int(episode.odometry.covariance[1, 1] > 0.004**2 + scenario.odometry.lateral**2 * 0.1)
        if len(rows):
            joint = joint_distance(scan, prediction, _rows_of(len(scan), measured, rows)).squared
            found.nis[:, touching] += np.array([joint, 2.0 * len(rows)])
        now: dict[int, Array] = {}
        for i, row in zip(measured, rows):
            root = np.linalg.cholesky(prediction.covariances[row] + scan.covariances[i])
            apart = scan.points[i] - prediction.positions[row]
            now[int(m.ids[prediction.features[row]])] = np.linalg.solve(root, apart)
        for feature in now.keys() & last.keys():
            found.lag[:, touching] += np.array([now[feature] @ last[feature], 2.0])
        last = now
        episode.end_tick(hypothesis)
        found.nees[:] += np.array([episode.nees[-1], _DOF])
    return found


def _rows_of(count: int, measured: IntArray, rows: IntArray) -> IntArray:
    out = np.full(count, UNPAIRED)
    out[measured] = rows
    return out


def ratio(sums: Array) -> Interval:
    """Ratio of the sums of two columns (r, 2), with its 95 % bootstrap interval over the r episodes."""
    if not sums[:, 1].sum() > 0.0:
        return Interval(np.nan, np.nan, np.nan)

    def of(episodes: Array) -> Array:
        totals = sums[episodes.astype(np.int64)].sum(axis=-2)
        ratios: Array = totals[..., 0] / np.maximum(totals[..., 1], 1e-300)
        return ratios

    return bootstrap_interval(np.arange(float(len(sums))), np.random.default_rng(0), statistic=of, resamples=2000)


def row(level: int, found: list[Innovations]) -> Record:
    """A row of the table."""
    nis, lag = np.array([f.nis for f in found]), np.array([f.lag for f in found])
    return {
        "level": level,
        "episodes": len(found),
        "NEES": ratio(np.array([f.nees for f in found])),
        "NIS, free": ratio(nis[:, :, 0]),
        "NIS, in contact": ratio(nis[:, :, 1]),
        "correlation, free": ratio(lag[:, :, 0]),
        "correlation, in contact": ratio(lag[:, :, 1]),
    }


def run(report: Report, *, episodes: int = 60, ticks: int = 300) -> None:
    """One table, a row for each level of drift.

    Arguments:
        episodes: a level
        ticks: an episode
    """
    rows = []
    for level in LEVELS:
        with report.part(f"level {level}"):
            rows.append(row(level, [innovations(at_level(level, ticks), world) for world in range(episodes)]))
    report.table("NEES, NIS and the correlation of innovations, by level of drift", rows, "innovations")
