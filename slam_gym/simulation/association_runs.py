"""The sources of scans for `Associate-v0`: a robot that a baseline drives through a scenario, or a log.

A run stops after every scan, before it is associated, and continues with the hypothesis that it is given.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from slam_gym.association.prediction import Prediction
from slam_gym.geometry import observe
from slam_gym.metrics import map_quality
from slam_gym.scenarios import Scenario
from slam_gym.simulation.driver import Command, commands
from slam_gym.simulation.episode import Episode, Site
from slam_gym.simulation.goals import FRONTIERS, LOOK, Goals, propose
from slam_gym.simulation.judged import JudgedSlam
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import Array, Hypothesis, Odometry, Scan, Truth
from slam_gym.world import corridor

Driver = Callable[[Goals, np.random.Generator], int]
"""Chooses the slot of one of the legal goals."""


def nearest_frontier(goals: Goals, rng: np.random.Generator) -> int:
    """The nearest frontier (Yamauchi, CIRA 1997); if there is none, a random revisit, so that loops are closed."""
    frontiers = np.flatnonzero(goals.legal[1 : 1 + FRONTIERS])
    if len(frontiers):
        return 1 + int(frontiers[0])
    revisits = np.flatnonzero(goals.legal[1 + FRONTIERS :])
    return 1 + FRONTIERS + int(rng.choice(revisits)) if len(revisits) else LOOK


def random_goal(goals: Goals, rng: np.random.Generator) -> int:
    """One of the legal goals at random."""
    return int(rng.choice(np.flatnonzero(goals.legal)))


DRIVERS: dict[str, Driver] = {"nearest_frontier": nearest_frontier, "random": random_goal}


def drive(episode: Episode, driver: Driver, rng: np.random.Generator) -> Iterator[Command]:
    """The commands that lead to one goal of a driver after the other, until the budget is spent.

    The caller must carry out each before it requests the next. Raises ValueError for a goal that is not legal.
    """
    while not episode.over:
        goals = propose(episode.scenario, episode.slam.map, episode.grid, episode.places, episode.tried)
        slot = driver(goals, rng)
        if not (isinstance(slot, int | np.integer) and slot in goals.legal.nonzero()[0]):
            raise ValueError(f"driver: {slot!r}, expected one of the legal goals {goals.legal.nonzero()[0].tolist()}")
        yield from commands(episode, slot, goals.positions[slot])


class DrivenRun(Episode):
    """A robot that explores a scenario, goal by goal of a driver, with hypotheses that come from outside."""

    prediction: Prediction  # of the current scan

    def __init__(self, scenario: Scenario, site: Site, driver: Driver, rng: np.random.Generator) -> None:
        choices = np.random.default_rng(rng.integers(2**63))  # they do not depend on the noise
        # nothing would relocate a robot that is carried away; at the first scan there is nothing to associate
        super().__init__(replace(scenario, kidnapping=None), site, "nearest_neighbour", rng)
        self._commands = drive(self, driver, choices)
        self.scans, self.length = 1, scenario.budget + 1  # so far, and in total, with the first one at the start

    def next_scan(self) -> None:
        """Drive for one tick, towards a new goal if the last one has ended, and take a scan."""
        self.prediction = self.begin_tick(*next(self._commands))
        self.scans += 1

    def associate(self, hypothesis: Hypothesis) -> None:
        """Complete the SLAM step with the `hypothesis` on the current scan."""
        self.end_tick(self.prediction, hypothesis)


@dataclass(frozen=True)
class ScanLog:
    """Scans that do not depend on their association: a recording, or a simulation with a fixed path."""

    name: str
    scans: Callable[[np.random.Generator], Iterator[tuple[Odometry, Scan, Truth]]]
    length: int  # total number of scans
    slam: SlamSpec
    targets: Array  # (N, 2) [m] true features, in the frame of the true poses; none where they are unknown
    prior_sigma: float = 0.5  # [m] σ₀: the error of a feature that has not been mapped

    def __post_init__(self) -> None:
        if self.length < 1:
            raise ValueError(f"ScanLog.length: {self.length} is less than 1")


class LoggedRun:
    """SLAM on a log, with hypotheses that come from outside."""

    prediction: Prediction  # of the current scan

    def __init__(self, log: ScanLog, rng: np.random.Generator) -> None:
        self.log = log
        self.slam = Slam(log.slam)
        self._judged = JudgedSlam(self.slam)
        self.identities = self._judged.identities
        self._scans = log.scans(rng)
        self.scans, self.length = 0, log.length
        self.poses: list[Array] = []  # (3,) true poses, in the frame of the log
        self.estimates: list[Array] = []  # (3,) in B
        self._error = 1.0

    @property
    def over(self) -> bool:
        """Whether the last scan has been associated."""
        return len(self.estimates) == self.length

    def next_scan(self) -> None:
        """Read the next scan. Raises ValueError if the log is shorter than its `length`."""
        entry = next(self._scans, None)
        if entry is None:
            raise ValueError(f"log {self.log.name!r}: ends after {self.scans} scans, not {self.length}")
        odometry, self.scan, self.truth = entry
        self.prediction = self.slam.predict(odometry, self.scan)
        self.scans += 1

    def associate(self, hypothesis: Hypothesis) -> None:
        """Complete the SLAM step with the `hypothesis` on the current scan."""
        self.last_step = self._judged.learn(self.scan, self.prediction, hypothesis, self.truth)
        self.poses.append(self.truth.pose)
        self.estimates.append(self.slam.map.pose)
        if len(self.log.targets):
            self._error = map_quality.map_error(self.slam.map.confirmed, self.targets, self.log.prior_sigma)

    @property
    def targets(self) -> Array:
        """(N, 2) [m] true features, in B."""
        start = self.poses[0] if self.poses else self.truth.pose
        return observe(start, self.log.targets)

    def map_error(self) -> float:
        """As `metrics.map_quality.map_error`; 1, as for an empty map, where the true features are unknown."""
        return self._error


AssociationRun = DrivenRun | LoggedRun
"""SLAM with hypotheses from outside: call `next_scan` and `associate` in turn, until it is `over`."""

CORRIDOR = ScanLog(
    "corridor", corridor.walk_round, corridor.STEPS + 1, SlamSpec(reach=corridor.RANGE), corridor.features()
)
"""The reference corridor; only its noise depends on the seed."""

LOGS: dict[str, ScanLog] = {CORRIDOR.name: CORRIDOR}
