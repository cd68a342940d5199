"""Errors of map and trajectory, from estimated and true points that the caller gives in one frame."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from slam_gym._jit import compiled
from slam_gym.geometry import transform
from slam_gym.metrics.point_assignment import Index, assign, indexed
from slam_gym.types import UNPAIRED, Array, IntArray
from slam_gym.types._fields import floats

_ROUNDS = 20  # most iterations of an alignment


@dataclass(frozen=True, slots=True)
class Gospa:
    """GOSPA (α = 2) and its parts, all in metres: total^p = localisation^p + missed^p + false^p."""

    total: float  # [m]
    localisation: float  # [m] part of the features that were paired
    missed: float  # [m] part of the true features without an estimate
    false: float  # [m] part of the estimates without a true feature, including duplicates


def gospa(estimated: Array, true: Array, *, p: float = 2.0, cutoff: float = 1.0) -> Gospa:
    """Generalised optimal sub-pattern assignment distance between estimated (e, 2) and true (N, 2) features [m].

    With α = 2, the only value for which it has the parts of `Gospa` (Rahmathullah, García-Fernández and Svensson,
    FUSION 2017, def. 1 and prop. 1), it is the minimum over partial assignments γ of

        [ Σ_{(i,j) ∈ γ} d_ij^p + ½ c^p (e + N − 2|γ|) ]^(1/p).

    Raises ValueError for points that are not finite, and for a p < 1 or a cutoff c ≤ 0, or one that is not finite.
    """
    estimated, true = floats("estimated", estimated, (-1, 2)), floats("true", true, (-1, 2))
    if not (1.0 <= p < math.inf and 0.0 < cutoff < math.inf):
        raise ValueError(f"GOSPA needs a finite p >= 1 and a positive cutoff, got p={p}, cutoff={cutoff}")
    _, localisation, pairs = assign(estimated, indexed(true, cutoff), p)
    penalty, root = 0.5 * cutoff**p, 1.0 / p
    missed, false = penalty * (len(true) - pairs), penalty * (len(estimated) - pairs)
    return Gospa((localisation + missed + false) ** root, localisation**root, missed**root, false**root)


def map_error(estimated: Array, true: Array, sigma0: float) -> float:
    """Error of a map relative to that of an empty map: E = GOSPA(p=1, α=2, c=2σ₀) / (σ₀ N).

    An empty map has error 1, a perfect map 0; every false feature adds 1/N, so that a bad map may exceed 1. Without
    true features, N counts as 1. `estimated` (e, 2) and `true` (N, 2) [m] are C-contiguous arrays, `sigma0` [m].

    Raises ValueError for points that are not finite, or a σ₀ that is not positive.
    """
    if not 0.0 < sigma0 < math.inf:
        raise ValueError(f"sigma0 must be positive, got {sigma0}")
    return error_of(estimated, indexed(true, 2.0 * sigma0))


@compiled
def error_of(estimated: Array, index: Index) -> float:
    """`map_error`, given the true features as the `index` that `indexed` computes with a cutoff of 2σ₀."""
    true, _, _, cutoff = index
    (_, cost, pairs), sigma0 = assign(estimated, index, 1.0), 0.5 * cutoff
    unpaired = len(estimated) + len(true) - 2 * pairs
    return float((cost + sigma0 * unpaired) / (sigma0 * max(len(true), 1)))


def map_error_aligned(estimated: Array, true: Array, sigma0: float, known: tuple[Array, Array] | None = None) -> float:
    """The least `map_error` over rigid motions of the map, by local search: its error independent of the frame.

    The orientation of the frame of the first pose is only known as well as the first scans determine it, and over 200 m
    an error of 0.01 rad alone uses up all of E. It cannot be a reward, as the best motion is only known at the end.

    The initial motions are the identity, the robust alignment of `known` correspondences (k points of the map, and the
    k true points), and the alignment by optimal assignment that follows from either; a local search refines the best.
    Without `known`, the frames must already agree within about `sigma0`.
    Raises ValueError as `map_error`, and as `align_se2` for `known`.
    """
    raw = map_error(estimated, true, sigma0)
    if not len(estimated) or not len(true):
        return raw
    index, centre = indexed(true, 2.0 * sigma0), estimated.mean(axis=0)

    def error(motion: Array) -> float:  # about the centre, where a turn moves the map least
        return error_of(transform(motion, estimated - centre), index)

    def about_centre(pose: Array) -> Array:
        return np.array([*transform(pose, centre[None])[0], pose[2]])

    starts = [np.zeros(3)]
    if known is not None and len(known[0]):
        starts.append(_trimmed(*known))
    starts += [_assigned(estimated, index, start) for start in starts]
    best = min(map(about_centre, starts), key=error)
    spread = max(float(np.hypot(*(estimated - centre).T).max()), sigma0)
    steps = np.vstack([np.zeros(3), np.diag([0.2 * sigma0, 0.2 * sigma0, 0.2 * sigma0 / spread])])
    options = {"initial_simplex": best + steps, "xatol": 1e-6, "fatol": 1e-6, "maxfev": 300}
    return min(raw, error(best), float(minimize(error, best, method="Nelder-Mead", options=options).fun))


def _trimmed(points: Array, true: Array) -> Array:
    """Pose (3,) that aligns points (k, 2) with the true points of the same rows, by the half that fits best."""
    chosen, pose = np.arange(len(points)), np.zeros(3)
    for _ in range(_ROUNDS):
        pose = align_se2(points[chosen], true[chosen])
        distances = np.hypot(*(transform(pose, points) - true).T)
        chosen = np.argsort(distances, kind="stable")[: max(len(distances) // 2, min(len(distances), 2))]
    return pose


def _assigned(points: Array, index: Index, pose: Array) -> Array:
    """Refine a pose (3,) by alternating assignment to the true points and alignment."""
    for _ in range(_ROUNDS):
        assigned = assign(transform(pose, points), index, 1.0)[0]
        paired = assigned != UNPAIRED
        aligned = align_se2(points[paired], index[0][assigned[paired]])
        if not paired.any() or np.array_equal(aligned, pose):
            break
        pose = aligned
    return pose


def landmark_rmse(estimated: Array, true: Array, *, aligned: bool = False) -> float:
    """Root mean square distance [m] of features (k, 2) from their true positions (k, 2), row by row.

    `aligned` first moves the map rigidly onto the truth (`align_se2`), so that only its shape error remains. NaN for
    k = 0. Raises ValueError where the shapes differ or a value is not finite.
    """
    estimated, true = _pairs(estimated, true)
    if aligned:
        estimated = transform(align_se2(estimated, true), estimated)
    return math.sqrt(((estimated - true) ** 2).sum(axis=1).mean()) if len(true) else math.nan


def ate(estimated: Array, true: Array, *, aligned: bool = False) -> float:
    """Absolute trajectory error [m]: root mean square distance of the estimated from the true positions.

    Both are poses (t, 3) or positions (t, 2), at the same instants; use `aligned` for estimates in another frame than
    the truth (Sturm et al., IROS 2012). NaN for t = 0. Raises as `landmark_rmse`.
    """
    first, second = (np.asarray(path)[:, :2] if len(path) else np.empty((0, 2)) for path in (estimated, true))
    return landmark_rmse(first, second, aligned=aligned)


def align_se2(source: Array, target: Array) -> Array:
    """Pose T (3,) that minimises Σ ‖T ⊕ source_i − target_i‖² over points (k, 2) and (k, 2) [m].

    Umeyama (PAMI 1991) without scale, in closed form for the plane. Where the heading is not determined (one point, or
    all at one place) it is 0; without points, T is the identity. Raises ValueError as `landmark_rmse`.
    """
    source, target = _pairs(source, target)
    if not len(source):
        return np.zeros(3)
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    a, b = source - source_mean, target - target_mean
    heading = math.atan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())
    if any(np.abs(d).max() <= 1e-12 * np.abs(points).max() for d, points in ((a, source), (b, target))):
        heading = 0.0  # nothing but rounding
    turned = transform(np.array([0.0, 0.0, heading]), source_mean[None])[0]
    return np.array([*(target_mean - turned), heading])


def cells_of(points: Array, shape: tuple[int, ...], origin: Array, resolution: float) -> IntArray:
    """(c,) flat index of the cell that contains each of `points` (c, 2) [m], −1 outside the grid.

    The grid of `shape` (h, w) has its lower left corner at `origin` (2,) [m], row 0 at the lowest y, and cells of side
    `resolution` [m].
    """
    columns, rows = np.floor((points - origin) / resolution).astype(np.int64).T
    inside = (rows >= 0) & (rows < shape[0]) & (columns >= 0) & (columns < shape[1])
    return np.where(inside, rows * shape[1] + columns, -1)


@compiled
def coverage(cells: NDArray[np.uint8], places: IntArray) -> float:
    """Fraction of `places` (c,), indices from `cells_of`, whose cell in `cells` (h, w) is not 0; NaN without places."""
    flat, known = cells.ravel(), 0
    for place in places:
        if place >= 0 and flat[place] != 0:
            known += 1
    return known / len(places) if len(places) else math.nan


def _pairs(a: Array, b: Array) -> tuple[Array, Array]:
    a, b = floats("estimated", a, (-1, 2)), floats("true", b, (-1, 2))
    if a.shape != b.shape:
        raise ValueError(f"paired points must have one shape, got {a.shape} and {b.shape}")
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise ValueError("paired points must be finite")
    return a, b
