"""What the robot senses: a `Scan` of point features with the `Truth` behind it, `Beams`, and `Odometry`.

Noise is drawn in range and bearing; what leaves this module is Cartesian, in the robot frame R, with the covariance
J diag(σ_r², σ_β²) Jᵀ of the polar-to-Cartesian map at the measured range and bearing.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from slam_gym.types import SPURIOUS, UNKNOWN_KIND, Array, Beams, IntArray, Odometry, Scan, Truth
from slam_gym.validation import check_settings
from slam_gym.world.detection import (
    PackedSettings,
    PackedWheels,
    in_sight,
    measure,
    noisy_ranges,
    report,
    report_and_in_sight,
    room_for,
)
from slam_gym.world.floor_plan import FloorPlan
from slam_gym.world.ray_casting import NO_DISCS, NO_SEGMENTS, WallIndex, pull_back

if TYPE_CHECKING:
    from slam_gym.world.physics import Motion


@dataclass(frozen=True)
class SensorSpec:
    """The detector of point features."""

    range: float = 6.0  # [m] farthest feature that is seen
    min_range: float = 0.1  # [m] nearest feature that is seen; no range is measured below it
    field_of_view: float = 1.5 * math.pi  # [rad] centred on the heading
    range_sigma: float = 0.03  # [m]
    range_sigma_ratio: float = 0.005  # [m/m] of the range, added in quadrature
    bearing_sigma: float = 0.01  # [rad]
    size_sigma: float = 0.05  # [m]
    detection: float = 0.9  # probability that a feature in sight is measured
    clutter: float = 0.3  # mean number of spurious measurements a scan (Poisson), anywhere in sight
    person_detection: float = 0.5  # probability that a person in sight yields a spurious measurement
    max_features: int = 20  # measurements in a scan; the nearest are kept
    kinds: bool = False  # the detector tells corners from door jambs and pillars

    @property
    def sigma_halfway(self) -> float:
        """[m] what a measurement at half the range is off by, along and across the view together."""
        return math.hypot(self.range_sigma, self.bearing_sigma * self.range / 2.0)

    def __post_init__(self) -> None:
        check_settings(self)
        if not self.min_range < self.range:
            raise ValueError(f"SensorSpec.min_range={self.min_range}: expected less than the range, {self.range} m")
        if self.range_sigma == 0.0 and self.range_sigma_ratio == 0.0:
            raise ValueError("SensorSpec.range_sigma and range_sigma_ratio must not both be 0")


@dataclass(frozen=True)
class BeamSpec:
    """The range finder: the only source of what is free and what is wall."""

    count: int = 40
    field_of_view: float = 2.0 * math.pi  # [rad] centred on the heading, cut into `count` parts with a beam in each
    range: float = 6.0  # [m]
    sigma: float = 0.03  # [m]

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class OdometrySpec:
    """Noise of the wheels' report. Variances add up along the way, however it is cut into ticks."""

    forward: float = 0.03  # [m/√m] along the heading
    lateral: float = 0.01  # [m/√m] across it
    turn_per_radian: float = 0.03  # [rad/√rad]
    turn_per_metre: float = 0.02  # [rad/√m]
    floor: float = 1e-4  # [m] and [rad] a tick, even at rest
    slip_forward: float = 0.8  # [m/m] of the way that the wheels turn, while the robot touches something
    slip_lateral: float = 0.4  # [m/m]
    slip_turn: float = 0.7  # [rad/m]
    slip_floor: float = 0.005  # [m] and [rad] a tick then

    def __post_init__(self) -> None:
        check_settings(self)


class Senses(NamedTuple):
    """What a tick has to tell, and the truth behind the scan."""

    odometry: Odometry
    scan: Scan
    truth: Truth
    beams: Beams


class Sensor:
    """All senses of a robot in one floor plan. Holds no state but the plan: all noise comes from the given generator.

    `index` holds the plan's walls. Poses (3,) are true poses in W. What moves is given at each call: `people` (p, 3)
    [m] as discs `x y radius`, `furniture` (o, 4) [m] as segments `x1 y1 x2 y2`.
    """

    def __init__(
        self,
        plan: FloorPlan,
        index: WallIndex,
        sensor: SensorSpec | None = None,
        beams: BeamSpec | None = None,
        odometry: OdometrySpec | None = None,
    ) -> None:
        self.spec = sensor or SensorSpec()
        self.beam_spec = beams or BeamSpec()
        self.odometry_spec = odometry or OdometrySpec()
        *reals, max_features, _ = astuple(self.spec)
        self._settings: PackedSettings = (*map(float, reals), int(max_features))  # type: ignore[assignment]
        self._finder = (float(self.beam_spec.range), float(self.beam_spec.sigma))
        self._wheels: PackedWheels = tuple(map(float, astuple(self.odometry_spec)))  # type: ignore[assignment]
        self._walls = index.packed
        self._features = plan.features
        self._targets = plan.features.positions, pull_back(plan.features)
        self._unknown_kinds = np.full(self.spec.max_features, UNKNOWN_KIND)
        self._sizes = plan.features.sizes if len(plan.features) else np.array([0.2, 0.5, 1.0])
        part = self.beam_spec.field_of_view / self.beam_spec.count
        self._bearings = part * (np.arange(self.beam_spec.count, dtype=np.float64) + 0.5 * (1 - self.beam_spec.count))

    def sense(
        self,
        motion: Motion,
        pose: Array,
        rng: np.random.Generator,
        people: Array = NO_DISCS,
        furniture: Array = NO_SEGMENTS,
    ) -> Senses:
        """All that a tick has to tell, from the random numbers that `odometry`, `scan` and `beams` would draw; but the
        kinds of measurements are drawn last."""
        moving, out, room = (people, furniture), np.empty((4, 3)), self._room_in_sight(people)
        wheels = (self._wheels, motion.wheels, motion.contact, rng.standard_normal(3), out)
        k = report_and_in_sight(wheels, self._walls, pose, self._targets, moving, self._settings, room)
        scan, truth, ranges = self._measured(pose, (k, *room), moving, self._bearings, rng)
        swept = Beams(self._bearings.copy(), ranges, self.beam_spec.range)
        return Senses(Odometry(out[0], out[1:]), scan, truth, swept)

    def scan(
        self, pose: Array, rng: np.random.Generator, people: Array = NO_DISCS, furniture: Array = NO_SEGMENTS
    ) -> tuple[Scan, Truth]:
        """One look from `pose`: a sweep of measurements by rising bearing, spurious ones among them.

        Furniture and people hide features, and a person is now and then taken for one (at their near side). Neither
        order nor attributes tell which measurements are spurious: their sizes are those of features of the plan.
        """
        moving, room = (people, furniture), self._room_in_sight(people)
        k = in_sight(self._walls, pose, self._targets, moving, self._settings, room)
        return self._measured(pose, (k, *room), moving, self._bearings[:0], rng)[:2]

    def _measured(
        self,
        pose: Array,
        seen: tuple[int, Array, IntArray],
        moving: tuple[Array, Array],
        bearings: Array,
        rng: np.random.Generator,
    ) -> tuple[Scan, Truth, Array]:
        """The scan of what is `seen` (see `in_sight`), the truth behind it, and the ranges (b,) of beams."""
        n, beams = seen[0] + rng.poisson(self.spec.clutter), len(bearings)  # measurements that there may be
        noise, room, ranges = (rng.random(3 * n), rng.standard_normal(3 * n + beams)), room_for(n), np.empty(beams)
        out = room, (bearings, self._finder, ranges)
        m = measure(self._walls, pose, seen, self._sizes, moving, noise, self._settings, out)
        points, covariances, sizes, size_variances, sources = room
        kinds = self._kinds(sources[:m], rng) if self.spec.kinds else self._unknown_kinds[:m].copy()
        scan = Scan(points[:m], covariances[:m], sizes[:m], size_variances[:m], kinds)
        return scan, Truth(pose.copy(), sources[:m]), ranges

    def _room_in_sight(self, people: Array) -> tuple[Array, IntArray]:
        """For what `in_sight` finds."""
        most = len(self._features) + len(people)
        return np.empty((most, 2)), np.empty(most, np.int64)

    def _kinds(self, sources: IntArray, rng: np.random.Generator) -> IntArray:
        """Kind (m,) of each measurement; those of spurious ones are drawn from the plan, if it has any."""
        known = self._features.kinds
        if len(known) == 0:
            return np.full(len(sources), UNKNOWN_KIND)
        return np.where(sources == SPURIOUS, known[rng.integers(len(known), size=len(sources))], known[sources])

    def beams(
        self, pose: Array, rng: np.random.Generator, people: Array = NO_DISCS, furniture: Array = NO_SEGMENTS
    ) -> Beams:
        """One sweep of the range finder from `pose`: noisy ranges to what comes first, the full range for nothing."""
        noise, ranges = rng.standard_normal(self.beam_spec.count), np.empty(self.beam_spec.count)
        noisy_ranges(self._walls, pose, self._bearings, self._finder, (people, furniture), noise, ranges)
        return Beams(self._bearings.copy(), ranges, self.beam_spec.range)

    def odometry(self, motion: Motion, rng: np.random.Generator) -> Odometry:
        """The wheels' report of one tick. Its covariance grows with the motion, and more so in contact."""
        out = np.empty((4, 3))
        report(self._wheels, motion.wheels, motion.contact, rng.standard_normal(3), out)
        return Odometry(out[0], out[1:])
