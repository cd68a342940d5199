"""The robot's measurements, and the ground truth about them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from slam_gym.types._fields import (
    FLOAT,
    INTEGER,
    UNKNOWN_KIND,
    Array,
    IntArray,
    check_array,
    covariances_of,
    deviations,
    floats,
    in_radians,
    kinds_of,
    quick,
    sizes_of,
)

_NO_KINDS: IntArray = np.empty(0, np.int64)

SPURIOUS = -1
"""The source of a measurement that comes from no true feature."""

UNLABELLED = -2
"""The source of a measurement without a label (recordings only)."""

ScanArrays = tuple[Array, Array, Array, Array, IntArray]
"""Points, covariances, sizes, size variances and kinds of a scan, as compiled functions take them."""


@quick
@dataclass(frozen=True, slots=True)
class Odometry:
    """The motion of one tick, as measured by the wheels."""

    motion: Array  # (3,) [m, m, rad] pose at the end of the tick in the robot frame at its start
    covariance: Array  # (3, 3) [m², m·rad, rad²] of `motion`

    def __post_init__(self) -> None:
        """Raises ValueError where an array does not have the type and shape that compiled functions read."""
        check_array("Odometry.motion", self.motion, FLOAT, (3,))
        check_array("Odometry.covariance", self.covariance, FLOAT, (3, 3))

    @classmethod
    def from_motion(cls, motion: ArrayLike, sigmas: ArrayLike) -> Odometry:
        """Odometry of a motion (3,) [m, m, rad] with independent standard deviations (3,), or one number for all three.

        Raises ValueError naming the argument: for a shape that does not fit, a negative deviation, or an angle in
        degrees.
        """
        pose = floats("motion", motion, (3,))
        in_radians("motion[2]", pose[2:])
        return cls(pose, np.diag(deviations("sigmas", sigmas, (3,)) ** 2))


@quick
@dataclass(frozen=True, slots=True)
class Scan:
    """Point features measured at one instant, in Cartesian coordinates of R. Angles occur in the sensor only."""

    points: Array  # (m, 2) [m] in R
    covariances: Array  # (m, 2, 2) [m²] in R
    sizes: Array  # (m,) [m] measured intrinsic attribute, NaN where unknown
    size_variances: Array  # (m,) [m²], NaN where unknown
    # (m,) class reported by the detector, UNKNOWN_KIND where it reports none; default: none at all
    kinds: IntArray = field(default_factory=lambda: _NO_KINDS)

    def __post_init__(self) -> None:
        """Raises ValueError where an array does not have the type and shape that compiled functions read."""
        m = len(self.points)
        if self.kinds is _NO_KINDS:
            object.__setattr__(self, "kinds", np.full(m, UNKNOWN_KIND))
        check_array("Scan.points", self.points, FLOAT, (m, 2))
        check_array("Scan.covariances", self.covariances, FLOAT, (m, 2, 2))
        check_array("Scan.sizes", self.sizes, FLOAT, (m,))
        check_array("Scan.size_variances", self.size_variances, FLOAT, (m,))
        check_array("Scan.kinds", self.kinds, INTEGER, (m,))

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        return f"Scan of {len(self)} measurements"

    @property
    def arrays(self) -> ScanArrays:
        """The arrays for compiled functions, marked writeable as these are compiled for; they write to none of them."""
        arrays = self.points, self.covariances, self.sizes, self.size_variances, self.kinds
        if self.points.flags.writeable:
            return arrays
        return _views(arrays, writeable=True)

    def read_only(self) -> Scan:
        """The same measurements in arrays that cannot be written to."""
        return Scan(*_views(self.arrays, writeable=False))

    @classmethod
    def from_points(
        cls,
        points: ArrayLike,
        covariances: ArrayLike | None = None,
        *,
        sigma: ArrayLike | None = None,
        sizes: ArrayLike | None = None,
        size_sigma: ArrayLike | None = None,
        kinds: ArrayLike | None = None,
    ) -> Scan:
        """Scan of points (m, 2) [m] in R with either covariances or `sigma`.

        Arguments:
            covariances: (m, 2, 2) [m²], or (2, 2) for all measurements.
            sigma: [m] standard deviation in both directions, one number or (m,).
            sizes: (m,) [m] intrinsic attribute, NaN where unknown; requires `size_sigma` [m], one number or (m,).
            kinds: (m,) class of each measurement, UNKNOWN_KIND where unknown.

        Raises ValueError naming the argument for a shape that does not fit or a negative value, and unless exactly one
        of covariances and sigma is given.
        """
        positions = floats("points", points, (-1, 2))
        marginals = covariances_of("covariances", covariances, sigma, len(positions))
        return cls(positions, marginals, *sizes_of(sizes, size_sigma, len(positions)), kinds_of(kinds, len(positions)))

    @classmethod
    def from_polar(
        cls,
        ranges: ArrayLike,
        bearings: ArrayLike,
        range_sigma: ArrayLike,
        bearing_sigma: ArrayLike,
        *,
        sizes: ArrayLike | None = None,
        size_sigma: ArrayLike | None = None,
        kinds: ArrayLike | None = None,
    ) -> Scan:
        """Scan of ranges (m,) [m] and bearings (m,) [rad, 0 ahead, left positive] with independent standard deviations.

        With c, s = cos β, sin β a measurement lies at r (c, s); its covariance is σ_r² along the line of sight and (r
        σ_β)² across it. Other arguments and errors are those of `from_points`. Raises ValueError for bearings in
        degrees.
        """
        r = floats("ranges", ranges, (-1,))
        if (r < 0.0).any():
            raise ValueError(f"ranges: {r.min():g} m is negative")
        beta = in_radians("bearings", floats("bearings", bearings, (len(r),)))
        c, s = np.cos(beta), np.sin(beta)
        along = deviations("range_sigma", range_sigma, r.shape) ** 2
        across = (r * deviations("bearing_sigma", bearing_sigma, r.shape)) ** 2
        covariances = np.empty((len(r), 2, 2))
        covariances[:, 0, 0] = c * c * along + s * s * across
        covariances[:, 1, 1] = s * s * along + c * c * across
        covariances[:, 0, 1] = covariances[:, 1, 0] = c * s * (along - across)
        points = np.column_stack([r * c, r * s])
        return cls.from_points(points, covariances, sizes=sizes, size_sigma=size_sigma, kinds=kinds)


def _views(arrays: ScanArrays, *, writeable: bool) -> ScanArrays:
    """Views of the arrays of a scan, all of them writeable or all read-only."""
    points, covariances, sizes, size_variances, kinds = arrays
    views = points.view(), covariances.view(), sizes.view(), size_variances.view(), kinds.view()
    for view in views:
        view.flags.writeable = writeable
    return views


@quick
@dataclass(frozen=True, slots=True)
class Beams:
    """One sweep of the range finder: the only source of information on free space and walls."""

    bearings: Array  # (b,) [rad] in R
    ranges: Array  # (b,) [m], or (k, b) for k sweeps; `max_range` where nothing was hit
    max_range: float  # [m]

    def __post_init__(self) -> None:
        """Raises ValueError where an array does not have the type and shape that compiled functions read."""
        b = len(self.bearings)
        check_array("Beams.bearings", self.bearings, FLOAT, (b,))
        check_array("Beams.ranges", self.ranges, FLOAT, (*self.ranges.shape[:-1], b))


@quick
@dataclass(frozen=True, slots=True)
class Truth:
    """Ground truth of a scan, known to the simulator or a label file only."""

    pose: Array  # (3,) [m, m, rad] of the robot in W
    sources: IntArray  # (m,) true feature behind each measurement, SPURIOUS or UNLABELLED

    def __len__(self) -> int:
        return len(self.sources)
