"""What the robot senses: a `Scan` of point features with the `Truth` behind it, `Beams`, and `Odometry`.

Noise is drawn in range and bearing; what leaves this module is Cartesian, in the robot frame R, with the covariance
J diag(σ_r², σ_β²) Jᵀ of the polar-to-Cartesian map at the measured range and bearing.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from slam_gym.types import SPURIOUS, UNKNOWN_KIND, Array, Beams, IntArray, Odometry, Scan, Truth
from slam_gym.world.detection import PackedSettings, in_sight, measure, noisy_ranges
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
        _check(self, positive=("bearing_sigma", "size_sigma"), probabilities=("detection", "person_detection"))
        if not 0.0 < self.min_range < self.range:
            raise ValueError(f"SensorSpec.min_range must be in (0, range), not {self.min_range} m")
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
        _check(self, positive=("count", "range"))


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
        _check(self, positive=("floor",))


def _check(spec: object, positive: tuple[str, ...] = (), probabilities: tuple[str, ...] = ()) -> None:
    """ValueError naming the first field of a spec that is not finite, is negative, or is out of its range."""
    for field in fields(spec):  # type: ignore[arg-type]
        value, name = getattr(spec, field.name), f"{type(spec).__name__}.{field.name}"
        if not (math.isfinite(value) and value >= 0.0):
            raise ValueError(f"{name} must be finite and not negative, not {value}")
        if value == 0.0 and field.name in positive:
            raise ValueError(f"{name} must be positive")
        if value > 1.0 and field.name in probabilities:
            raise ValueError(f"{name} must be a probability, not {value}")
        if field.name == "field_of_view" and not 0.0 < value <= 2.0 * math.pi:
            raise ValueError(f"{name} must be in (0, 2π] rad, not {value}")


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
        self._walls = index.packed
        self._features = plan.features
        self._pull_back = pull_back(plan.features)
        self._no_kinds = np.full(self.spec.max_features, UNKNOWN_KIND)
        self._sizes = plan.features.sizes if len(plan.features) else np.array([0.2, 0.5, 1.0])
        part = self.beam_spec.field_of_view / self.beam_spec.count
        self._bearings = part * (np.arange(self.beam_spec.count, dtype=np.float64) + 0.5 * (1 - self.beam_spec.count))

    def scan(
        self, pose: Array, rng: np.random.Generator, people: Array = NO_DISCS, furniture: Array = NO_SEGMENTS
    ) -> tuple[Scan, Truth]:
        """One look from `pose`: a sweep of measurements by rising bearing, spurious ones among them.

        Furniture and people hide features, and a person is now and then taken for one (at their near side). Neither
        order nor attributes tell which measurements are spurious: their sizes are those of features of the plan.
        """
        walls, moving, settings = self._walls, (people, furniture), self._settings
        polar, sources = in_sight(walls, pose, self._features.positions, self._pull_back, moving, settings)
        clutter = int(rng.poisson(self.spec.clutter))
        noise = np.empty((2, len(sources) + clutter, 3))
        rng.random(out=noise[0])
        rng.standard_normal(out=noise[1])
        points, covariances, sizes, size_variances, sources = measure(
            walls, pose, polar, sources, self._sizes, moving, noise, settings
        )
        kinds = self._kinds(sources, rng) if self.spec.kinds else self._no_kinds[: len(sources)].copy()
        return Scan(points, covariances, sizes, size_variances, kinds), Truth(pose.copy(), sources)

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
        spec = self.beam_spec
        noise = rng.standard_normal(spec.count)
        ranges = noisy_ranges(self._walls, pose, self._bearings, spec.range, (people, furniture), spec.sigma, noise)
        return Beams(self._bearings.copy(), ranges, spec.range)

    def odometry(self, motion: Motion, rng: np.random.Generator) -> Odometry:
        """The wheels' report of one tick. Its covariance grows with the motion, and more so in contact."""
        spec, (dx, dy, turn) = self.odometry_spec, motion.wheels.tolist()
        distance = math.hypot(dx, dy)
        forward = spec.floor**2 + spec.forward**2 * distance
        lateral = spec.floor**2 + spec.lateral**2 * distance
        heading = spec.floor**2 + spec.turn_per_radian**2 * abs(turn) + spec.turn_per_metre**2 * distance
        noise = rng.standard_normal(3).tolist()
        dx += math.sqrt(forward) * noise[0]
        dy += math.sqrt(lateral) * noise[1]
        turn += math.sqrt(heading) * noise[2]
        if motion.contact:  # what may have slipped is in `motion.wheels` already
            forward += (spec.slip_forward * distance) ** 2 + spec.slip_floor**2
            lateral += (spec.slip_lateral * distance) ** 2 + spec.slip_floor**2
            heading += (spec.slip_turn * distance) ** 2 + spec.slip_floor**2
        covariance = np.zeros((3, 3))
        covariance[0, 0], covariance[1, 1], covariance[2, 2] = forward, lateral, heading
        return Odometry(np.array([dx, dy, turn]), covariance)
