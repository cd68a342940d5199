"""Location-independent constraints: which pairings are possible, whatever the robot's pose; and checked scans and maps
in the types for which the searches without a prior are compiled.

Unary constraints compare the attributes of a measurement with those of a feature. Binary constraints compare the
distance between two measurements with that between two features. Orientation constraints compare the sense of rotation
of three of each, because distances alone cannot reject a mirror image. Cross-covariances of the map are used: features
that were mapped together share most of their errors, so that gates from their marginals alone would be far too wide.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from slam_gym._jit import compiled, inlined
from slam_gym.association.compatibility import chi2_gate
from slam_gym.types import UNKNOWN_KIND, Array, BoolArray, IntArray, Landmarks, Locality, Scan, ScanArrays
from slam_gym.types._fields import compact
from slam_gym.validation import check_scan

_CLOSE = 16.0  # points are close when less than √16 = 4 σ apart
_TOLERANCE = 1e-9  # of a negative determinant, relative to the product of the variances
_NEAREST = 24  # neighbours relative to which the error of a feature is taken, every other one of them
_FLOOR = 1e-10  # [m²] added to every relative variance, so that maps without errors have gates too

Attributes = tuple[Array, Array, IntArray]
"""Sizes [m] and their variances [m²], NaN where unknown, and kinds, of all measurements or features."""


class Measured(NamedTuple):
    """A scan and quantities derived from it, as the compiled constraints take it, at one confidence."""

    points: Array  # (m, 2) [m] in R
    noise: Array  # (m, 2, 2) [m²]
    sizes: Array  # (m,) [m], NaN where unknown
    size_variances: Array  # (m,) [m²]
    kinds: IntArray  # (m,)
    distances: Array  # (m, m) [m] between measurements
    variances: Array  # (m, m) [m²] of those, uᵀ(R_i + R_k)u
    spreads: Array  # (m, m) [m²] largest eigenvalue of R_i + R_k
    gate_one: float  # χ²_1: distances, areas, sizes
    gate_two: float  # χ²_2: distances between close points


class Mapped(NamedTuple):
    """The arrays of a map."""

    positions: Array  # (n, 2) [m] in B
    covariances: Array  # (n, 2, 2) [m²]
    sizes: Array  # (n,) [m], NaN where unknown
    size_variances: Array  # (n,) [m²]
    kinds: IntArray  # (n,)
    covariance: Array  # (2n, 2n) [m²] or (0, 0)
    block_starts: IntArray  # (n + 1,) or (0,)
    block_columns: IntArray  # (e,)
    blocks: Array  # (e, 2, 2) [m²]


class Path(NamedTuple):
    """Pairings, with room for more: the first p entries of a path with p pairings are valid."""

    measurements: IntArray  # in order of pairing
    features: IntArray  # feature paired with each


def scan_arrays(scan: Scan) -> ScanArrays:
    """The arrays of a scan. Raises ValueError naming a field and measurement not finite or not a covariance."""
    check_scan(scan)
    if np.any(scan.size_variances < 0.0):
        raise ValueError(f"Scan.size_variances: measurement {int(np.argmax(scan.size_variances < 0.0))}: negative")
    return scan.arrays


def map_arrays(landmarks: Landmarks) -> Mapped:
    """The arrays of a map. Raises ValueError naming a field of the wrong shape, not finite, or not a covariance.

    The entries of the joint covariance are not checked: with 1 000 features this would cost more than the search.
    """
    n, e = len(landmarks.positions), len(landmarks.blocks)
    of_feature = {"positions": (2,), "covariances": (2, 2), "sizes": (), "size_variances": (), "kinds": ()}
    shapes = {name: (n, *shape) for name, shape in of_feature.items()} | {"blocks": (e, 2, 2), "block_columns": (e,)}
    for name, shape in shapes.items():
        if getattr(landmarks, name).shape != shape:
            raise ValueError(f"Landmarks.{name}: shape {getattr(landmarks, name).shape}, expected {shape}")
    if landmarks.covariance.shape not in ((2 * n, 2 * n), (0, 0)):
        raise ValueError(f"Landmarks.covariance: shape {landmarks.covariance.shape}, expected {(2 * n, 2 * n)}")
    starts = landmarks.block_starts
    if len(starts) not in (0, n + 1) or (len(starts) and starts[-1] != e):
        raise ValueError(f"Landmarks.block_starts: does not delimit {e} blocks of {n} features")
    (a, b), (_, d) = landmarks.covariances.transpose(1, 2, 0)
    with np.errstate(invalid="ignore"):
        psd = (a >= 0.0) & (d >= 0.0) & (a * d - b * b >= -_TOLERANCE * a * d) & np.isfinite(a + d)
    for name, is_fault, fault in (
        ("positions", ~np.isfinite(landmarks.positions).all(axis=1), "not finite"),
        ("covariances", ~psd, "not PSD"),
        ("size_variances", landmarks.size_variances < 0.0, "negative"),
    ):
        if is_fault.any():
            raise ValueError(f"Landmarks.{name}[{is_fault.argmax()}] is {fault}")
    return unchecked_map(landmarks)


def unchecked_map(landmarks: Landmarks) -> Mapped:
    """The arrays of a map, unchecked."""
    fields: list[Any] = [getattr(landmarks, name) for name in Mapped._fields]
    types = (np.int64 if field.dtype.kind == "i" else np.float64 for field in fields)
    return Mapped(*[compact(field.astype(dtype, copy=False)) for field, dtype in zip(fields, types)])


def locality_arrays(locality: Locality | None, n: int) -> tuple[IntArray, IntArray]:
    """Starts and members; both empty for None. Raises ValueError unless the locality is one of n features."""
    if locality is None:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    starts, members = compact(locality.starts), compact(locality.members)
    if len(starts) != n + 1 or starts[0] != 0 or starts[-1] != len(members) or np.any(starts[1:] < starts[:-1]):
        raise ValueError(f"Locality.starts: does not delimit {len(members)} members of {n} features")
    if len(members) and not (members.min() >= 0 and members.max() < n):
        raise ValueError(f"Locality.members: {members.min()} to {members.max()} for {n} features")
    return starts, members


def measured(scan: ScanArrays, confidence: float) -> Measured:
    """A scan with the distances between all measurements and the variances of these distances.

    Raises ValueError unless 0 < confidence < 1.
    """
    gate_one, gate_two, (points, noise, *_) = chi2_gate(1, confidence), chi2_gate(2, confidence), scan
    x, y = (points[None] - points[:, None]).transpose(2, 0, 1)
    (xx, xy), (_, yy) = (noise[:, None] + noise[None]).transpose(2, 3, 0, 1)
    with np.errstate(over="ignore", invalid="ignore"):
        square, spreads = x * x + y * y, 0.5 * (xx + yy) + np.sqrt((0.5 * (xx - yy)) ** 2 + xy * xy)
        along = (x * x * xx + 2.0 * x * y * xy + y * y * yy) / np.where(square > 0.0, square, 1.0)
    variances = np.where(square > 0.0, along, spreads)
    return Measured(*scan, np.sqrt(square), variances, spreads, gate_one, gate_two)


@compiled
def cross_covariance(mapped: Mapped, j: int, l: int) -> tuple[float, float, float, float]:
    """P_jl: xx, xy, yx, yy [m²]; zero where the map stores none."""
    if j == l:
        P = mapped.covariances
        return P[j, 0, 0], P[j, 0, 1], P[j, 1, 0], P[j, 1, 1]
    if len(mapped.covariance) > 0:
        P, a, b = mapped.covariance, 2 * j, 2 * l
        return P[a, b], P[a, b + 1], P[a + 1, b], P[a + 1, b + 1]
    if len(mapped.block_starts) > 0:
        first, end = mapped.block_starts[j], mapped.block_starts[j + 1]
        at = first + np.searchsorted(mapped.block_columns[first:end], l)
        if at < end and mapped.block_columns[at] == l:
            P = mapped.blocks
            return P[at, 0, 0], P[at, 0, 1], P[at, 1, 0], P[at, 1, 1]
    return 0.0, 0.0, 0.0, 0.0


@compiled
def difference_covariance(mapped: Mapped, j: int, l: int) -> tuple[float, float, float]:
    """P_jj + P_ll − P_jl − P_lj, the covariance of F_l − F_j: xx, xy, yy [m²]."""
    P = mapped.covariances
    xx, xy, yx, yy = cross_covariance(mapped, j, l)
    return (
        P[j, 0, 0] + P[l, 0, 0] - 2.0 * xx,
        P[j, 0, 1] + P[l, 0, 1] - xy - yx,
        P[j, 1, 1] + P[l, 1, 1] - 2.0 * yy,
    )


@compiled
def difference_covariances(mapped: Mapped, first: IntArray, second: IntArray) -> Array:
    """`difference_covariance` (k, 2, 2) [m²] of each feature of `first` (k,) and that of `second` (k,)."""
    out = np.empty((len(first), 2, 2))
    for k in range(len(first)):
        xx, xy, yy = difference_covariance(mapped, first[k], second[k])
        out[k, 0, 0], out[k, 0, 1], out[k, 1, 0], out[k, 1, 1] = xx, xy, xy, yy
    return out


def relative_to_neighbours(mapped: Mapped) -> Mapped:
    """The map with covariances relative to neighbours in place of cross-covariances: the error of the whole map, which
    moves all poses alike, is left out."""
    relative = relative_covariances(mapped) + _FLOOR * np.eye(2)
    return mapped._replace(covariances=relative, covariance=np.empty((0, 0)), block_starts=np.empty(0, np.int64))


def relative_covariances(mapped: Mapped) -> Array:
    """Covariance of each feature relative to its neighbours, (n, 2, 2) [m²].

    The vector between features j and l has covariance D_jl = P_jj + P_ll − P_jl − P_lj, in which their common error
    cancels. C_j is defined by D_jl ≈ C_j + C_l, averaged over nearby features l. Without cross-covariances it is P_jj.
    """
    n = len(mapped.positions)
    if n < 2 or (len(mapped.covariance) == 0 and len(mapped.blocks) == 0):
        return mapped.covariances.copy()
    near: IntArray = cKDTree(mapped.positions).query(mapped.positions, k=min(_NEAREST + 1, n))[1][:, 1::2]
    each = np.repeat(np.arange(n), near.shape[1])
    half = 0.5 * difference_covariances(mapped, each, near.astype(np.int64).ravel()).reshape(n, -1, 2, 2).mean(axis=1)
    relative = 2.0 * half - half[near].mean(axis=1)
    # Where the neighbours are much less certain, C_j becomes too small or indefinite. Half of the mean over D_jl is
    # used instead, as if j and its neighbours were equally certain.
    valid = (relative[:, 0, 0] > 0.5 * half[:, 0, 0]) & (relative[:, 1, 1] > 0.5 * half[:, 1, 1])
    valid &= np.linalg.det(relative) > 0.0
    out: Array = np.where(valid[:, None, None], relative, half)
    out[:, [0, 1], [0, 1]] = np.maximum(out[:, [0, 1], [0, 1]], 0.0)
    return out


@inlined
def far_apart(error: float, spread: float, trace: float, of_other: float, gate: float) -> bool:
    """Whether two distances differ by more than any cross-covariance can explain: this settles most binary tests.

    The covariance of a difference is at most twice the sum of the marginals. `trace` and `of_other` are the traces of
    the two; gate χ²_2.
    """
    return bool(error * error >= gate * (spread + 2.0 * (trace + of_other)))


@compiled
def binary_test(scan: Measured, mapped: Mapped, i: int, j: int, k: int, l: int) -> bool:
    """Whether pairings (i, j) and (k, l) agree: the distance of their measurements fits that of their features.

    With g the distance, (g_scan − g_map)² < χ²_{1,conf} (σ²_scan + σ²_map), where σ²_scan = uᵀ(R_i + R_k)u and σ²_map =
    uᵀ(P_jj + P_ll − P_jl − P_lj)u, with the unit vector u from one point to the other. Points closer than 4 σ define no
    such direction. There the error |g_scan − g_map|, which never exceeds the length of the error e of the difference
    vector, is compared with χ²_{2,conf} times the largest variance of e in any direction.
    """
    x, y = mapped.positions[l, 0] - mapped.positions[j, 0], mapped.positions[l, 1] - mapped.positions[j, 1]
    square, spread = x * x + y * y, scan.spreads[i, k]
    error = scan.distances[i, k] - math.sqrt(square)
    P = mapped.covariances
    if far_apart(error, spread, P[j, 0, 0] + P[j, 1, 1], P[l, 0, 0] + P[l, 1, 1], scan.gate_two):
        return False
    xx, xy, yy = difference_covariance(mapped, j, l)
    largest = 0.5 * (xx + yy) + math.sqrt((0.5 * (xx - yy)) ** 2 + xy * xy)  # the eigenvalue
    widest = spread + max(largest, 0.0)
    if min(square, scan.distances[i, k] ** 2) < _CLOSE * widest:
        return bool(error * error < scan.gate_two * widest)
    variance = (x * x * xx + 2.0 * x * y * xy + y * y * yy) / square
    return bool(error * error < scan.gate_one * (scan.variances[i, k] + max(variance, 0.0)))


@compiled
def orientation_test(scan: Measured, mapped: Mapped, ikp: tuple[int, int, int], jlq: tuple[int, int, int]) -> bool:
    """Whether three pairings (i, j), (k, l), (p, q) have the same sense of rotation in scan and map, as far as noise
    can tell.

    The signed areas of the two triangles must have the same sign, unless (A_scan − A_map)² < χ²_{1,conf} (σ²_scan +
    σ²_map), by linearisation with full cross-covariances.
    """
    (i, k, p), (j, l, q), z, F = ikp, jlq, scan.points, mapped.positions
    # twice the signed areas
    area_scan = (z[k, 0] - z[i, 0]) * (z[p, 1] - z[i, 1]) - (z[k, 1] - z[i, 1]) * (z[p, 0] - z[i, 0])
    area_map = (F[l, 0] - F[j, 0]) * (F[q, 1] - F[j, 1]) - (F[l, 1] - F[j, 1]) * (F[q, 0] - F[j, 0])
    if area_scan * area_map >= 0.0:
        return True
    variance = 0.0
    for a, b, c in ((i, k, p), (k, p, i), (p, i, k)):
        gx, gy = z[b, 1] - z[c, 1], z[c, 0] - z[b, 0]
        R = scan.noise[a]
        variance += gx * gx * R[0, 0] + 2.0 * gx * gy * R[0, 1] + gy * gy * R[1, 1]
    map_variance = 0.0
    for a, b, c in ((j, l, q), (l, q, j), (q, j, l)):
        gx, gy = F[b, 1] - F[c, 1], F[c, 0] - F[b, 0]
        hx, hy = F[c, 1] - F[a, 1], F[a, 0] - F[c, 0]
        P = mapped.covariances[a]
        xx, xy, yx, yy = cross_covariance(mapped, a, b)
        map_variance += gx * gx * P[0, 0] + 2.0 * gx * gy * P[0, 1] + gy * gy * P[1, 1]
        map_variance += 2.0 * (gx * (xx * hx + xy * hy) + gy * (yx * hx + yy * hy))
    return bool((area_scan - area_map) ** 2 < scan.gate_one * (variance + max(map_variance, 0.0)))


def unary_table(of_scan: Attributes, of_map: Attributes, gate: float) -> BoolArray:
    """Which measurement may come from which feature by size and kind alone, (m, n).

    Sizes agree when (a_i − a_j)² ≤ χ²_{1,conf} (σ²_i + σ²_j), and kinds when they are equal. A size that is NaN and a
    kind that is UNKNOWN_KIND agree with all. Gate χ²_1.
    """
    (sizes, variances, kinds), (mapped_sizes, mapped_variances, mapped_kinds) = of_scan, of_map
    may_be_same = (kinds[:, None] == mapped_kinds) | (kinds[:, None] == UNKNOWN_KIND) | (mapped_kinds == UNKNOWN_KIND)
    with np.errstate(over="ignore", invalid="ignore"):
        differences = sizes[:, None] - mapped_sizes
        differ = differences * differences > gate * (variances[:, None] + mapped_variances)  # False for NaN
    return np.asarray(may_be_same & ~differ)
