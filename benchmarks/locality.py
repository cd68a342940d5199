"""The effort that locality saves in relocation, compared with the bound of the source (Eq. 9.22), and its losses.

A square field of point features (0.02 per m²) is mapped in one lawn-mower pass, in lanes 12 m apart, by a robot with a
sensor of 15 m and 180°. Its odometry drifts between stations along the pass, and features seen again from the previous
lane link each station to its neighbour there: errors are large over the map and small between neighbours, as in a
stochastic map. Then the robot is lost, and scans once: m measurements, a quarter spurious, without sizes and kinds.

Tables: sizes of the localities, hypotheses of the unpruned tree and losses of each locality; effort of GCBB (also with
measurements ordered from the centre of the scan outwards) and of random sampling (RS) against n, with exponents;
answers by the required number of pairings, inside the map and outside. A pairing test is a unary or a binary one.

    python benchmarks/locality.py        # ten minutes
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from benchmarks.common import Record, Tolerance, attempt, clutter, count_answers, features_in_view, options, table
from slam_gym import UNPAIRED, Landmarks, Locality, Scan, gcbb, random_sampling
from slam_gym.association.relocation.location import locate
from slam_gym.geometry import observe
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.locality import (
    covisible,
    hypothesis_bound,
    hypothesis_count,
    locality_sizes,
    same_local_map,
    within,
)
from slam_gym.types import Array, IntArray, Relocator

LOCALITIES = ("covisibility", "two hops", "within 2r", "local maps", "joined maps", "everything")
NEAR = Tolerance(1.0, math.radians(5.0))  # around the pose by the true pairings
DENSITY = 0.02  # [1/m²]
REACH = 15.0  # [m] of the sensor, over the half plane ahead
LANE, STATION = 12.0, 20.0  # [m] between lanes, at most; between nodes of the network that carries the drift
ALONG, ACROSS, OWN = 0.15, 0.10, 0.05  # [m] σ from station to station, to the previous lane, of a feature itself
RANGE_SIGMA, BEARING_SIGMA = 0.05, math.radians(0.25)  # of the sensor
LARGEST = 3_200  # features of a map that is searched without a locality
LOCAL_MAP = 50  # features after which a new local map begins


@dataclass(frozen=True)
class SurveyedField:
    """A mapped field. Features are numbered in the order in which they were first seen."""

    side: float  # [m]
    features: Array  # (n, 2) [m] true, in W = B
    landmarks: Landmarks
    path: Array  # (k, 3) [m, m, rad] poses of the mapping pass
    in_scan: CovisibilityGraph  # seen in one scan
    in_map: CovisibilityGraph  # seen during one local map; each map has its own copies of features
    map_of: IntArray  # (n,) local map in which each feature was first seen

    def locality(self, name: str) -> Locality | None:
        """One of `LOCALITIES`. Local maps: features seen during the same one; joined: each belongs to the oldest."""
        return {
            "covisibility": lambda: covisible(self.in_scan),
            "two hops": lambda: covisible(self.in_scan, hops=2),
            "within 2r": lambda: within(self.landmarks.positions, 2.0 * REACH),
            "local maps": lambda: covisible(self.in_map),
            "joined maps": lambda: same_local_map(self.map_of),
            "everything": lambda: None,
        }[name]()


@dataclass(frozen=True)
class FieldScan:
    """One scan to be relocated, and the truth behind it."""

    scan: Scan
    truth: IntArray  # (m,) feature behind each measurement, UNPAIRED for spurious ones
    pose: Array  # (3,) [m, m, rad] true, in W; NaN where it lies outside the map


def surveyed_field(n: int, rng: np.random.Generator) -> SurveyedField:
    """Draw a field of n features and map it in one pass."""
    side = math.sqrt(n / DENSITY)
    features, (poses, arcs) = side * rng.random((n, 2)), lawn_mower_pass(side)
    seen = [features_in_view(features, pose, REACH, math.pi) for pose in poses]
    first = np.full(n, len(poses))
    for k in range(len(poses) - 1, -1, -1):
        first[seen[k]] = k
    order = np.argsort(first, kind="stable")
    number = np.argsort(order)
    features, first = features[order], first[order]
    in_scan, in_map = CovisibilityGraph(), CovisibilityGraph()
    in_scan.add(n)
    in_map.add(n)
    map_number, members = np.zeros(len(poses), np.int64), np.empty(0, np.int64)
    for k, rows in enumerate(seen):
        in_scan.see_together(np.sort(number[rows]))
        members = np.union1d(members, number[rows])
        map_number[k + 1 :] += len(members) >= LOCAL_MAP
        if len(members) >= LOCAL_MAP or k == len(seen) - 1:
            in_map.see_together(members)
            members = np.empty(0, np.int64)
    landmarks = drifted_map(features, poses, arcs, first, rng)
    return SurveyedField(side, features, landmarks, poses, in_scan, in_map, map_number[first])


def lawn_mower_pass(side: float) -> tuple[Array, Array]:
    """Poses (k, 3), a metre apart, in lanes over a square of `side` [m]; and the path length (k,) [m] to each."""
    count = max(1, math.ceil(side / LANE))
    heights = (np.arange(count) + 0.5) * side / count
    corners = [(x, y) for k, y in enumerate(heights) for x in ((0.0, side) if k % 2 == 0 else (side, 0.0))]
    poses, arcs, start = [], [], 0.0
    for (x0, y0), (x1, y1) in itertools.pairwise(corners):
        length, heading = math.hypot(x1 - x0, y1 - y0), math.atan2(y1 - y0, x1 - x0)
        along = np.arange(0.0, length, 1.0)
        leg = (x0 + along * math.cos(heading), y0 + along * math.sin(heading), np.full(len(along), heading))
        poses.append(np.column_stack(leg))
        arcs.append(start + along)
        start += length
    return np.concatenate(poses), np.concatenate(arcs)


def drifted_map(features: Array, poses: Array, arcs: Array, first: IntArray, rng: np.random.Generator) -> Landmarks:
    """The map of features (n, 2) first seen from poses `first` (n,), with exact cross-covariances.

    It contains only those of pairs that a scan can span: other pairs fail the distance test, and all take 5 GB for
    12 800 features.
    """
    K, n = station_covariance(poses, arcs), len(features)
    low = np.minimum((arcs[first] / STATION).astype(np.int64), len(K) - 2)  # the previous station
    weight = arcs[first] / STATION - low  # of the next station
    drift = np.linalg.cholesky(K) @ rng.standard_normal((len(K), 2))
    drift = (1.0 - weight)[:, None] * drift[low] + weight[:, None] * drift[low + 1]
    positions = features + drift + OWN * rng.standard_normal((n, 2))

    def between(j: IntArray, l: IntArray) -> Array:
        """Covariance [m²] per axis of the errors at the places from which features j and l were first seen."""
        a, b = weight[j], weight[l]
        before = (1 - a) * ((1 - b) * K[low[j], low[l]] + b * K[low[j], low[l] + 1])
        return np.asarray(before + a * ((1 - b) * K[low[j] + 1, low[l]] + b * K[low[j] + 1, low[l] + 1]))

    variances = between(np.arange(n), np.arange(n)) + OWN**2
    spanned = within(positions, 2.0 * REACH + 6.0 * math.sqrt(2.0 * variances.max()))
    row = np.repeat(np.arange(n), np.diff(spanned.starts))
    cross = np.where(row == spanned.members, variances[row], between(row, spanned.members))
    blocks = np.ascontiguousarray(cross[:, None, None] * np.eye(2))
    independent = Landmarks.from_points(positions, variances[:, None, None] * np.eye(2))
    return replace(independent, block_starts=spanned.starts, block_columns=spanned.members, blocks=blocks)


def station_covariance(poses: Array, arcs: Array) -> Array:
    """Covariance (s, s) [m²] per axis of the error at each station: the inverse of the network's precision.

    Odometry links each station to the next; features seen again link it to the nearest one of the previous lane.
    """
    count = math.ceil(arcs[-1] / STATION) + 1
    places = poses[np.minimum(np.searchsorted(arcs, STATION * np.arange(count)), len(poses) - 1), :2]
    links = [(k, k + 1, ALONG) for k in range(count - 1)]
    for k, near in enumerate(cKDTree(places).query_ball_point(places, 1.01 * math.hypot(LANE, 0.5 * STATION))):
        before = [l for l in near if l < k - 2]
        if before:
            gaps = np.hypot(*(places[before] - places[k]).T)
            links.append((k, before[int(gaps.argmin())], ACROSS))
    precision = np.zeros((count, count))
    precision[0, 0] = 1.0 / OWN**2  # the map's base is the start of the pass
    for k, l, sigma in links:
        precision[[k, l], [k, l]] += sigma**-2
        precision[[k, l], [l, k]] -= sigma**-2
    covariance = np.linalg.inv(precision)
    return np.asarray(0.5 * (covariance + covariance.T))


def inside(field: SurveyedField, m: int, spurious: int, rng: np.random.Generator) -> FieldScan:
    """A scan of m measurements in random order, `spurious` of them clutter, from a random pose inside the map."""
    seen = np.empty(0, np.int64)
    while len(seen) < m - spurious:
        pose = np.array([*(field.side * rng.random(2)), rng.uniform(-math.pi, math.pi)])
        seen = features_in_view(field.features, pose, REACH, math.pi)
    seen = rng.permutation(seen)[: m - spurious]
    points = np.concatenate([observe(pose, field.features[seen]), clutter(spurious, REACH, math.pi, rng)])
    truth, order = np.concatenate([seen, np.full(spurious, UNPAIRED)]), rng.permutation(m)
    return FieldScan(measured(points[order], rng), truth[order], pose)


def outside(m: int, rng: np.random.Generator) -> FieldScan:
    """A scan of m measurements from a place outside the map."""
    return FieldScan(measured(clutter(m, REACH, math.pi, rng), rng), np.full(m, UNPAIRED), np.full(3, np.nan))


def measured(points: Array, rng: np.random.Generator) -> Scan:
    ranges = np.abs(np.hypot(*points.T) + RANGE_SIGMA * rng.standard_normal(len(points)))
    bearings = np.arctan2(points[:, 1], points[:, 0]) + BEARING_SIGMA * rng.standard_normal(len(points))
    return Scan.from_polar(ranges, bearings, RANGE_SIGMA, BEARING_SIGMA)


def searches(confidence: float = 0.99, *, rivals: bool = False) -> dict[str, Relocator]:
    """GCBB, with or without the search for rivals, and RS, by their names in the tables."""
    return {
        "GCBB": functools.partial(gcbb, confidence=confidence, rivals=rivals),
        "GCBB, outwards": functools.partial(gcbb, confidence=confidence, rivals=rivals, outwards=True),
        "RS": functools.partial(random_sampling, confidence=confidence),
    }


def relocate(search: Relocator, area: SurveyedField, drawn: FieldScan, locality: Locality | None) -> Record:
    """Relocate one scan; returns its effort, and which of its pairings are right."""
    answer, record = attempt(search, drawn.scan, area.landmarks, locality)
    true, right = drawn.truth != UNPAIRED, False
    if true.sum() >= 2 and np.isfinite(answer.pose).all():
        right = NEAR.holds(answer.pose, locate(drawn.scan, area.landmarks, drawn.truth).pose)
    right_pairings = int((true & (answer.features == drawn.truth)).sum())
    record |= {"inside": bool(np.isfinite(drawn.pose).all()), "right": right}
    return record | {
        "pairings found": right_pairings / max(int(true.sum()), 1),
        "all found": right_pairings == true.sum(),
    }


def sweep(
    searched: Mapping[str, Relocator], names: Sequence[str], sizes: Sequence[int], m: int, scans: int, seed: int
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The results of all searches under the named localities in maps of each size: a row per scan, and a row per
    locality and size. Without a locality, where the time grows with n², maps have at most `LARGEST` features.
    """
    attempts, localities = [], []
    for n in sizes:
        for number in range(maps := min(max(3200 // n, 1), 5, scans)):
            rng = np.random.default_rng([seed, n, m, number])
            area = surveyed_field(n, rng)
            drawn = [inside(area, m, m // 4, rng) for _ in range(number, scans, maps)]
            for name in LOCALITIES:
                locality, key = area.locality(name), {"locality": name, "n": n, "m": m}
                localities.append(key | figures(n, m, locality, [scan.truth for scan in drawn]))
                if name in names and (locality is not None or n <= LARGEST):
                    attempts += [
                        {"search": search, **key, **relocate(searched[search], area, scan, locality)}
                        for search in searched for scan in drawn
                    ]  # fmt: skip
    means = pd.DataFrame(localities).groupby(["locality", "n", "m"], sort=False).mean().reset_index()
    return pd.DataFrame(attempts), means


def figures(n: int, m: int, locality: Locality | None, truths: Sequence[IntArray]) -> Record:
    """Mean and largest |L(j)| in a map of n features, N_h of the unpruned tree, the bound of Eq. 9.22, and losses."""
    sizes = locality_sizes(locality, n)
    counts = {"N_h": hypothesis_count(sizes, m), "9.22, max c": hypothesis_bound(n, m, int(sizes.max()))}
    return {"mean c": sizes.mean(), "max c": sizes.max(), **counts, **losses(truths, locality)}


def losses(truths: Sequence[IntArray], locality: Locality | None) -> dict[str, float]:
    """The fractions that a locality loses before any test, from the feature (m,) behind each measurement of each scan.

    `pairs`: pairs of features seen in one scan that are not local to each other. `pairings`: true pairings that are not
    in the best hypothesis that pairs measurements in the order of the scan, so that its first pairing determines the
    locality. `scans`: scans without such a hypothesis with all true pairings. `anyhow`: scans without one even if any
    measurement may be paired first, as in random sampling.
    """
    known = [truth[truth != UNPAIRED] for truth in truths]
    everything = np.concatenate(known)
    local = [np.array([np.isin(one, everything if locality is None else locality.of(j)) for j in one]) for one in known]
    pairs, true = sum(len(one) * (len(one) - 1) for one in local), sum(len(one) for one in local)
    return {
        "pairs": sum(int((~one).sum()) for one in local) / pairs,
        "pairings": 1.0 - sum(int(np.triu(one).sum(axis=1).max()) for one in local) / true,
        "scans": 1.0 - float(np.mean([one[0].all() for one in local])),
        "anyhow": 1.0 - float(np.mean([one.all(axis=1).any() for one in local])),
    }


def inside_and_outside(search: Relocator, name: str, n: int, m: int, scans: int, seed: int) -> pd.DataFrame:
    """Attempts at `scans` scans from inside and as many from outside the map, under a locality, over several maps."""
    rows, maps = [], min(10, scans)
    for number in range(maps):
        rng = np.random.default_rng([seed, n, m, number])
        area = surveyed_field(n, rng)
        locality = area.locality(name)
        for _ in range(number, scans, maps):
            rows.append(relocate(search, area, inside(area, m, m // 4, rng), locality))
            rows.append(relocate(search, area, outside(m, rng), locality))
    return pd.DataFrame(rows)


def power(attempts: pd.DataFrame, name: str, rng: np.random.Generator) -> tuple[float, float, float]:
    """Exponent p of means ∝ n^p, by least squares on logarithms; 95 % interval by resampling scans of each size."""
    groups = {n: group.to_numpy(float) for n, group in attempts.groupby("n")[name]}
    x = np.log(list(groups))
    resampled = [v[rng.integers(0, len(v), (2000, len(v)))].mean(axis=1) for v in groups.values()]
    drawn = np.polyfit(x, np.log(np.maximum(resampled, 1e-12)), 1)[0]
    estimate = np.polyfit(x, np.log([v.mean() for v in groups.values()]), 1)[0]
    return float(estimate), *np.quantile(drawn, [0.025, 0.975]).tolist()


def exponents(attempts: pd.DataFrame, fitted_from: int, seed: int) -> list[Record]:
    """Exponents in n of every series with at least two sizes from `fitted_from` features on."""
    rows = []
    for (search, name), group in attempts[attempts["n"] >= fitted_from].groupby(["search", "locality"], sort=False):
        if group["n"].nunique() > 1:
            fits = {of: power(group, of, np.random.default_rng(seed)) for of in ("nodes", "pairing tests", "ms")}
            cells = {of: "{:.2f} [{:.2f}, {:.2f}]".format(*fit) for of, fit in fits.items()}
            rows.append({"search": search, "locality": name, **cells})
    return rows


def main() -> None:
    a = options(__doc__, scans=30, judged=500, largest=12_800)
    scans, judged, largest = (2, 4, 100) if a.quick else (a.scans, a.judged, a.largest)
    sizes = [n for n in (50, 100, 200, 400, 800, 1600, 3200, 6400, 12_800) if n <= largest]
    names = [name for name in LOCALITIES if name != "joined maps"]  # only its losses are shown
    attempts, localities = sweep(searches(), names, sizes, 8, scans, a.seed)
    table("Localities; hypotheses of the unpruned tree (m = 8), fractions of the truth that are lost", localities)
    means = attempts.groupby(["search", "locality", "n"], sort=False).mean(numeric_only=True).reset_index()
    shown = ["nodes", "pairing tests", "ms", "pairings found", "all found", "right", "limit hit"]
    table("Effort against the size of the map; means per scan", means[["search", "locality", "n", *shown]])
    table("Exponents in n", exponents(attempts, sizes[0] if a.quick else 800, a.seed))
    rows = []
    for m, (name, search) in itertools.product((6, 8, 10), searches(rivals=True).items()):
        tried = inside_and_outside(search, "two hops", 100 if a.quick else 400, m, judged, a.seed)
        rows += [{"search": name, "m": m, **count_answers(tried, least)} for least in (None, *range(3, m + 1))]
    table("Answers by the required number of pairings, two hops", rows)


if __name__ == "__main__":
    main()
