"""The robot's senses: a `Scan` of point features with the `Truth` behind it, `Beams`, and `Odometry`.

Noise is drawn in range and bearing. Measurements leave this module in Cartesian form, in the robot frame R, with the
covariance J diag(σ_r², σ_β²) Jᵀ of the polar-to-Cartesian map at the measured range and bearing.
"""

from __future__ import annotations

import math
from collections import namedtuple
from dataclasses import astuple, dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from slam_gym._jit import compiled
from slam_gym.geometry import wrap_angle
from slam_gym.types import SPURIOUS, UNKNOWN_KIND, Array, Beams, IntArray, Odometry, Scan, Truth
from slam_gym.validation import Checked
from slam_gym.world.floor_plan import FloorPlan
from slam_gym.world.ray_casting import NOTHING, Moving, Packed, WallGrid, cast, pull_back, sees

if TYPE_CHECKING:
    from slam_gym.world.physics import Motion

_MOST_ELONGATED = 1e5  # ratio of the axes of an ellipse of uncertainty
_SURFACE = 1e-3  # [m] a line of sight to a person ends this far before the person's surface


@dataclass(frozen=True)
class SensorSpec(Checked):
    """The detector of point features."""

    range: float = 6.0  # [m] farthest feature that is seen
    min_range: float = 0.1  # [m] nearest feature that is seen; no range is measured below it
    field_of_view: float = 1.5 * math.pi  # [rad] centred on the heading
    range_sigma: float = 0.03  # [m]
    range_sigma_ratio: float = 0.005  # [m/m] of the range, added in quadrature
    bearing_sigma: float = 0.01  # [rad]; scans give covariances of first order, which hold up to about 0.05
    size_sigma: float = 0.05  # [m]
    detection: float = 0.9  # probability that a feature in sight is measured
    clutter: float = 0.3  # mean number of spurious measurements per scan (Poisson), anywhere in sight
    person_detection: float = 0.5  # probability that a person in sight yields a spurious measurement
    max_features: int = 20  # measurements in a scan; the nearest are kept
    kinds: bool = False  # the detector tells corners from door jambs and pillars

    @property
    def sigma_halfway(self) -> float:
        """[m] standard deviation of a measurement at half the range, along and across the view together,
        without `range_sigma_ratio`."""
        return math.hypot(self.range_sigma, self.bearing_sigma * self.range / 2.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.min_range < self.range:
            raise ValueError(f"SensorSpec.min_range={self.min_range}: expected less than the range, {self.range} m")
        for r in (self.min_range, self.range):
            along, across = math.hypot(self.range_sigma, self.range_sigma_ratio * r), self.bearing_sigma * r
            if max(along, across) > _MOST_ELONGATED * min(along, across):
                raise ValueError(
                    f"SensorSpec.range_sigma, range_sigma_ratio, bearing_sigma: at {r:g} m they are {along:.3g} m "
                    f"along the view and {across:.3g} m across it, too different for a covariance"
                )


@dataclass(frozen=True)
class BeamSpec(Checked):
    """The range finder, the only source of information on free space and walls."""

    count: int = 40
    field_of_view: float = 2.0 * math.pi  # [rad] centred on the heading; `count` equal parts with a beam in each
    range: float = 6.0  # [m]
    sigma: float = 0.03  # [m]


@dataclass(frozen=True)
class OdometrySpec(Checked):
    """Noise of the odometry. Without slip and floor, variances add up along the path, however divided into ticks."""

    forward: float = 0.03  # [m/√m] along the heading
    lateral: float = 0.01  # [m/√m] across it
    turn_per_radian: float = 0.03  # [rad/√rad]
    turn_per_metre: float = 0.02  # [rad/√m]
    floor: float = 1e-4  # [m] and [rad] per tick, even at rest
    slip_forward: float = 0.8  # [m/m] of the wheels' distance, while the robot touches something or its wheels slip
    slip_lateral: float = 0.4  # [m/m]
    slip_turn: float = 0.7  # [rad/m]
    slip_floor: float = 0.005  # [m] and [rad] per tick, likewise


class Sensor:
    """All senses of a robot in one floor plan. It has no state but the plan; noise comes from the generator passed in.

    `walls` are the plan's, as `wall_index` returns them. Poses (3,) are true poses in W. What is `moving`, people as
    discs and furniture as segments, is passed to each call.
    """

    def __init__(
        self, plan: FloorPlan, walls: Packed, sensor: SensorSpec, beams: BeamSpec, odometry: OdometrySpec
    ) -> None:
        self.spec, self.beam_spec = sensor, beams
        self._settings = tuple(map(float, astuple(sensor)))
        self._finder = (float(beams.range), float(beams.sigma))
        self._wheels = tuple(map(float, astuple(odometry)))
        self._walls = walls
        self._kinds = plan.features.kinds
        self._targets = plan.features.positions, pull_back(plan.features)
        self._sizes = plan.features.sizes if len(plan.features) else np.array([0.2, 0.5, 1.0])
        part = beams.field_of_view / beams.count
        self._bearings = part * (np.arange(beams.count, dtype=np.float64) + 0.5 * (1 - beams.count))

    def scan(self, pose: Array, rng: np.random.Generator, moving: Moving = NOTHING) -> tuple[Scan, Truth]:
        """One scan from `pose`: measurements by rising bearing, including spurious ones.

        Furniture and people hide features, and a person is sometimes measured as a feature, at the near side. Neither
        order nor size reveals a spurious measurement, since its size is that of a random feature of the plan.
        """
        seen = _in_sight(self._walls, pose, self._targets, moving, self._settings)
        n = len(seen[1]) + rng.poisson(self.spec.clutter)  # most measurements that are possible
        noise = rng.random((n, 3)), rng.standard_normal((n, 3))
        points, covariances, sizes, size_variances, sources = _measure(
            self._walls, pose, seen, self._sizes, moving, noise, self._settings
        )
        kinds = np.full(len(sources), UNKNOWN_KIND)
        if self.spec.kinds and len(self._kinds):  # the kinds of spurious measurements are those of random features
            drawn = self._kinds[rng.integers(len(self._kinds), size=len(sources))]
            kinds = np.where(sources == SPURIOUS, drawn, self._kinds[sources])
        return Scan(points, covariances, sizes, size_variances, kinds), Truth(pose.copy(), sources)

    def beams(self, pose: Array, rng: np.random.Generator, moving: Moving = NOTHING) -> Beams:
        """One sweep of the range finder from `pose`: noisy ranges to the first surface, or the full range."""
        noise = rng.standard_normal(self.beam_spec.count)
        ranges = _sweep(self._walls, pose, self._bearings, moving, noise, self._finder)
        return Beams(self._bearings.copy(), ranges, self.beam_spec.range)

    def odometry(self, motion: Motion, rng: np.random.Generator) -> Odometry:
        """The odometry of one tick. Its covariance grows with the motion, and faster in contact."""
        out = np.empty((4, 3))
        _report(self._wheels, motion.wheels, motion.contact, rng.standard_normal(3), out)
        return Odometry(out[0], out[1:])


def _by_name(name: str, specification: type[Any]) -> Any:
    """The named tuple as which compiled functions read the values of a specification."""
    return namedtuple(name, [field.name for field in fields(specification)])


_Settings = _by_name("_Settings", SensorSpec)
_Wheels = _by_name("_Wheels", OdometrySpec)
_Values = tuple[float, ...]
"""The values of a specification, as a plain tuple, which crosses from Python to compiled functions faster."""

_Seen = tuple[Array, IntArray]
"""True ranges and bearings (k, 2) [m, rad] of what is in sight, and its sources (k,)."""

_Measured = tuple[Array, Array, Array, Array, IntArray]
"""Points (m, 2) [m] in R, covariances (m, 2, 2) [m²], sizes (m,) [m], their variances (m,) [m²], sources (m,)."""


@compiled
def _in_sight(walls: Packed, pose: Array, features: tuple[Array, Array], moving: Moving, packed: _Values) -> _Seen:
    """The features (positions and pull-backs) and people (at their near side) that are in sight."""
    grid, settings, (positions, pull_backs) = WallGrid(*walls), _Settings(*packed), features
    x, y = pose[0], pose[1]
    people = moving[0]
    k, most = 0, positions.shape[0] + people.shape[0]
    polar, sources = np.empty((most, 2)), np.empty(most, np.int64)
    for i in range(most):
        person = i - positions.shape[0]
        if person < 0:
            dx, dy, surface = positions[i, 0] - x, positions[i, 1] - y, 0.0
            short = pull_backs[i]
        else:
            dx, dy, surface = people[person, 0] - x, people[person, 1] - y, people[person, 2]
            short = surface + _SURFACE
        if abs(dx) > settings.range + surface or abs(dy) > settings.range + surface:
            continue
        distance = math.hypot(dx, dy) - surface
        if not settings.min_range <= distance <= settings.range:
            continue
        bearing = wrap_angle(math.atan2(dy, dx) - pose[2])
        if abs(bearing) > 0.5 * settings.field_of_view:
            continue
        if not sees(grid, moving, x, y, dx, dy, short):
            continue
        polar[k, 0], polar[k, 1] = distance, bearing
        sources[k] = i if person < 0 else SPURIOUS
        k += 1
    return polar[:k], sources[:k]


@compiled
def _measure(
    walls: Packed, pose: Array, seen: _Seen, sizes: Array, moving: Moving, noise: tuple[Array, Array], packed: _Values
) -> _Measured:
    """A scan of what is `seen`, and of clutter.

    `sizes` are the sizes of all features, from which sizes of spurious measurements are drawn. `noise` are uniform and
    normal random numbers (n, 3), a row of each for everything in sight and for each piece of clutter.
    """
    settings, (polar, sources), (uniform, normal) = _Settings(*packed), seen, noise
    draws = len(uniform)
    measured, origins = np.empty((3, draws)), np.empty(draws, np.int64)  # range, bearing, size; source
    n = 0
    for i in range(draws):
        size = sizes[int(uniform[i, 2] * len(sizes))]
        source = sources[i] if i < len(sources) else SPURIOUS
        if i < len(sources):
            if uniform[i, 0] >= (settings.detection if source >= 0 else settings.person_detection):
                continue
            sigma = math.hypot(settings.range_sigma, settings.range_sigma_ratio * polar[i, 0])
            distance = max(polar[i, 0] + sigma * normal[i, 0], settings.min_range)
            bearing = wrap_angle(polar[i, 1] + settings.bearing_sigma * normal[i, 1])
            if source >= 0:
                size = sizes[source]
        else:  # uniform over the thin sector from the nearest range to the first surface
            bearing = settings.field_of_view * (uniform[i, 0] - 0.5)
            free = cast(walls, pose, np.array([pose[2] + bearing]), settings.range, moving)[0]
            low = settings.min_range**2
            distance = math.sqrt(low + uniform[i, 1] * max(free * free - low, 0.0))
        measured[0, n], measured[1, n] = distance, bearing
        measured[2, n] = max(size + settings.size_sigma * normal[i, 2], 0.0)
        origins[n] = source
        n += 1
    return _nearest(measured, origins, int(n), settings)  # int: not the literal 0 as well


@compiled
def _nearest(measured: Array, origins: IntArray, count: int, settings: Any) -> _Measured:
    """By rising bearing, the nearest `max_features` of the first `count` columns of `measured`."""
    nearest = np.argsort(measured[0, :count], kind="mergesort")[: int(settings.max_features)]
    order = nearest[np.argsort(measured[1][nearest], kind="mergesort")]
    points, covariances = np.empty((len(order), 2)), np.empty((len(order), 2, 2))
    for i in range(len(order)):
        r, bearing = measured[0, order[i]], measured[1, order[i]]
        c, s = math.cos(bearing), math.sin(bearing)
        along = settings.range_sigma**2 + (settings.range_sigma_ratio * r) ** 2
        across = (settings.bearing_sigma * r) ** 2
        points[i, 0], points[i, 1] = r * c, r * s
        covariances[i, 0, 0] = c * c * along + s * s * across
        covariances[i, 1, 1] = s * s * along + c * c * across
        covariances[i, 0, 1] = covariances[i, 1, 0] = c * s * (along - across)
    size_variances = np.full(len(order), settings.size_sigma**2)
    return points, covariances, measured[2][order], size_variances, origins[order]


@compiled
def _sweep(
    walls: Packed, pose: Array, bearings: Array, moving: Moving, noise: Array, range_and_sigma: tuple[float, float]
) -> Array:
    """Ranges (b,) [m] of beams, clipped to [0, reach], with noise where something was hit."""
    reach, sigma = range_and_sigma
    ranges = cast(walls, pose, pose[2] + bearings, reach, moving)
    for b in range(len(ranges)):
        if ranges[b] < reach:
            ranges[b] = min(max(ranges[b] + sigma * noise[b], 0.0), reach)
    return ranges


@compiled
def _report(packed: _Values, wheels: Array, contact: bool, noise: Array, out: Array) -> None:
    """Write the odometry of one tick to `out` (4, 3): the motion and the rows of its covariance."""
    spec, dx, dy, turn = _Wheels(*packed), wheels[0], wheels[1], wheels[2]
    distance = math.hypot(dx, dy)
    forward = spec.floor**2 + spec.forward**2 * distance
    lateral = spec.floor**2 + spec.lateral**2 * distance
    heading = spec.floor**2 + spec.turn_per_radian**2 * abs(turn) + spec.turn_per_metre**2 * distance
    out[0, 0] = dx + math.sqrt(forward) * noise[0]
    out[0, 1] = dy + math.sqrt(lateral) * noise[1]
    out[0, 2] = turn + math.sqrt(heading) * noise[2]
    if contact:  # the slip itself is in the motion of the wheels already
        forward += (spec.slip_forward * distance) ** 2 + spec.slip_floor**2
        lateral += (spec.slip_lateral * distance) ** 2 + spec.slip_floor**2
        heading += (spec.slip_turn * distance) ** 2 + spec.slip_floor**2
    out[1:] = 0.0
    out[1, 0], out[2, 1], out[3, 2] = forward, lateral, heading
