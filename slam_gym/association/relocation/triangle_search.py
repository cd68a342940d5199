"""The search in a hash of triangles: which triples of measurements are looked up, and what is made of the poses.

Completeness by pigeonhole: with the measurements in g groups, any 2g + 1 of them have three in one group. So once all
triples within the groups have been looked up, no pose is unseen that explains more than 2g measurements (but for
triples wider than the hash reaches, which are left out). Groups are compact, since small triangles have few likes: they
number n in proportion to the radius of their circumcircle.

The triangles of the map that look like a triple imply poses. Each is held against the whole scan, first by the
distance to the nearest feature where a measurement would lie, then by pairing, fit and joint test. A fit places the
scan: p_i = t + R(θ)(z_i − o), o being the mean of the scan. The error of a pairing has covariance R R_i Rᵀ + C_j, where
C_j is that of the feature relative to those around it, and J P Jᵀ besides before the fit has used it: the error that
near features share moves the pose along with them, and is no error of a pairing.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_gym._jit import compiled
from slam_gym.association.relocation.arrays import ScanArrays
from slam_gym.association.relocation.constraints import Gates, Measured, measured, unary_test
from slam_gym.association.relocation.tree import BINARY, JOINT, LEAVES, LIMIT, NODES, TRIES
from slam_gym.types import UNPAIRED, Array, BoolArray, IntArray

WORK = 8  # of the effort, after the entries that all searches count: in poses held against the scan
FAR = 255  # in the raster of distances: farther than it reaches
_HYPOTHESES = 16  # remembered: the best and those that tie with it
_FIT = 10  # numbers of a fit: t [m], cos θ, sin θ, and the covariance xx, xy, yy, xθ, yθ, θθ of t and θ
_TURNS = 16  # of a scan, for groups that are less wide
_ROUNDS = 6  # of fitting and pairing again; as a rule two are enough
_COMPARISON, _FITTING = (
    0.02,
    30.0,
)  # poses that take as long as comparing a triangle of the hash, as fitting a hypothesis

Integers32 = NDArray[np.int32]
Floats32 = NDArray[np.float32]
Bytes = NDArray[np.uint8]


class Grid(NamedTuple):
    """Features by the square cells that they lie in."""

    starts: IntArray  # (rows · columns + 1,) cell c holds members[starts[c]:starts[c + 1]]
    members: IntArray  # (n,)
    shape: tuple[int, int]  # rows, columns
    origin: tuple[float, float, float]  # [m] left and lower edge, side of a cell


class Raster(NamedTuple):
    """How far it is to the nearest feature, as far as its own covariance does not explain it."""

    steps: Bytes  # (rows, columns) √(d² − γλ) / step rounded down, d from the nearest point of the cell; or FAR
    origin: tuple[float, float, float]  # [m] left and lower edge, side of a cell
    step: float  # [m]


class TriangleHash(NamedTuple):
    """A map as the search takes it: triangles of near features by their sides, features by where they lie."""

    positions: Array  # (n, 2) [m]
    spreads: Array  # (n, 3) [m²] xx, xy, yy of C_j
    sizes: Array  # (n,) [m], NaN where unknown
    size_variances: Array  # (n,) [m²]
    kinds: IntArray  # (n,)
    starts: IntArray  # (cells + 1,) cell c holds the triangles starts[c] … starts[c + 1] − 1
    corners: Integers32  # (t, 3) A, B, C counterclockwise, AB the longest side
    sides: Floats32  # (t, 4) [m] AB, BC, CA, and the largest variance [m²] of the three
    grid: Grid
    raster: Raster
    reach: float  # [m] longest side of the triangles
    quantum: float  # [m] of the sides, between cells
    widest: float  # [m²] largest variance of a feature in any direction


class Look(NamedTuple):
    """A scan, and what is asked of a hypothesis."""

    scan: Measured  # points from their mean
    sizes: Array  # (m,) [m], NaN where unknown
    size_variances: Array  # (m,) [m²]
    kinds: IntArray  # (m,)
    joint_gates: Array  # (m + 2,) χ²_{2k−3} of k pairings
    local_starts: IntArray  # (n + 1,), or (0,) where all is local to all
    local_members: IntArray
    needed: int  # pairings
    decisive: int  # pairings that chance need not be feared for
    work_limit: int


class Found(NamedTuple):
    """The best hypotheses so far, and what they cost."""

    features: IntArray  # (h, m) map feature paired with each measurement, UNPAIRED for `*`
    fits: Array  # (h, 10)
    squares: Array  # (h,) D²
    state: IntArray  # (3,) pairings of the best, or one less than what is worth keeping; hypotheses; looking for likes
    effort: IntArray  # (9,)


class _Seed(NamedTuple):
    """A triple of measurements, and the others as seen from its centroid."""

    triple: IntArray  # (3,) counterclockwise
    others: IntArray  # (m − 3,)
    offsets: Array  # (2, m − 3) [m] of the others from the centroid
    gates: Array  # (2, m − 3) [m²] of those along the line of sight from the centroid and across it
    limits: IntArray  # (m − 3,) steps of the raster beyond which no feature is within their gate
    margin: float  # [m] gate of a side, whatever the features


@compiled
def search(
    table: TriangleHash,
    scan: ScanArrays,
    gates: Gates,
    joint_gates: Array,
    locality: tuple[IntArray, IntArray],
    limits: tuple[int, int, int],
) -> Found:
    """All hypotheses with most pairings, one less than needed at least.

    `limits` are pairings needed, pairings that decide, and most work. With as many pairings as needed or more, there
    are no others with as many but what the gates turn away; with decisive ones, no others that explain all but
    (pairings / 3 − 1) of the same measurements: places that look alike.
    """
    points, m = np.empty_like(scan.points), len(scan.points)
    for axis in range(2 if m > 0 else 0):
        points[:, axis] = scan.points[:, axis] - scan.points[:, axis].mean()
    of_scan = measured(points, scan.noise, gates)
    look = Look(of_scan, scan.sizes, scan.size_variances, scan.kinds, joint_gates, *locality, *limits)
    found = Found(
        np.full((_HYPOTHESES, m), UNPAIRED),
        np.full((_HYPOTHESES, _FIT), math.nan),
        np.zeros(_HYPOTHESES),
        np.array([max(look.needed - 1, 3) - 1, 0, 0]),
        np.zeros(WORK + 1, np.int64),
    )
    done = np.zeros(m * (m - 1) * (m - 2) // 6, np.bool_)
    groups, complete, beyond = max(m // 5, 1), m, m  # no pose is unseen that explains more than `beyond`
    while m > 2 and beyond >= _wanted(look, found) and found.effort[LIMIT] == 0 and not _decided(look, found):
        groups = min(max(groups, _most_groups(look, found)), complete - 1)
        if _try_groups(table, look, found, groups, done):
            complete, beyond = groups, 2 * groups
        groups = (7 * groups) // 10 if found.state[1] == 0 else 1
    if _decided(look, found):
        _try_likes(table, look, found, done)
    return found


@compiled
def _decided(look: Look, found: Found) -> bool:
    return bool(found.state[1] > 0 and found.state[0] >= look.decisive)


@compiled
def _wanted(look: Look, found: Found) -> int:
    """Pairings of which no pose may be left unseen."""
    return int(max(look.needed, found.state[0] if found.state[1] > 0 else 0))


@compiled
def _most_groups(look: Look, found: Found) -> int:
    """The most groups whose triples leave no better pose unseen, nor another as good."""
    return max((_wanted(look, found) - 1) // 2, 1)


@compiled
def _try_groups(table: TriangleHash, look: Look, found: Found, groups: int, done: BoolArray) -> bool:
    """Look up all triples within groups; False if that was cut short, since a better hypothesis needs fewer of them."""
    order, starts = _near_groups(table, look, groups)
    for triple in _triples(table, look, order, starts, done):
        _try_triple(table, look, found, triple)
        done[_number(triple)] = True
        if found.effort[LIMIT] > 0 or _decided(look, found) or _most_groups(look, found) > groups:
            return False
    return True


@compiled
def _near_groups(table: TriangleHash, look: Look, groups: int) -> tuple[IntArray, IntArray]:
    """`_groups`, the scan turned so that few pairs within them are too wide for the hash."""
    least, best, best_starts = math.inf, np.empty(0, np.int64), np.empty(0, np.int64)
    for turn in range(_TURNS):
        c, s = math.cos(0.5 * math.pi * turn / _TURNS), math.sin(0.5 * math.pi * turn / _TURNS)
        order, starts = _groups(look.scan.points @ np.array([[c, -s], [s, c]]), groups)
        wide = 0
        for g in range(groups):
            for p in range(starts[g], starts[g + 1]):
                for q in range(starts[g], p):
                    wide += not _is_hashed(table, look, order[p], order[q], order[q])
        if wide < least:
            least, best, best_starts = wide, order, starts
        if wide == 0:
            break
    return best, best_starts


@compiled
def _groups(points: Array, groups: int) -> tuple[IntArray, IntArray]:
    """Measurements in order of compact groups of nearly equal size, and where each group starts, (groups + 1,).

    The points are cut in two across their longer extent, in proportion to the groups wanted on either side, and so on.
    """
    order, starts, parts = np.arange(len(points)), np.zeros(groups + 1, np.int64), np.ones(groups, np.int64)
    starts[1], parts[0], count, at = len(points), groups, 1, 0
    while at < count:
        if parts[at] == 1:
            at += 1
            continue
        low, high = starts[at], starts[at + 1]
        members = order[low:high].copy()
        x, y = points[members, 0], points[members, 1]
        wide = x.max() - x.min() >= y.max() - y.min()
        order[low:high] = members[np.argsort(x if wide else y, kind="mergesort")]
        for p in range(count, at, -1):
            starts[p + 1] = starts[p]
        for p in range(count - 1, at, -1):
            parts[p + 1] = parts[p]
        both, left = parts[at], parts[at] // 2
        parts[at], parts[at + 1] = left, both - left
        starts[at + 1] = low + ((high - low) * left + both // 2) // both
        count += 1
    return order, starts


@compiled
def _triples(table: TriangleHash, look: Look, order: IntArray, starts: IntArray, done: BoolArray) -> IntArray:
    """Triples of measurements within groups that are hashed and not yet `done`, (t, 3), small circumcircles first."""
    room = 0
    for g in range(len(starts) - 1):
        size = starts[g + 1] - starts[g]
        room += size * (size - 1) * (size - 2) // 6
    triples, radii, count = np.empty((room + 1, 3), np.int64), np.empty(room), 0
    for g in range(len(starts) - 1):
        for p in range(starts[g], starts[g + 1]):
            for q in range(starts[g], p):
                for r in range(starts[g], q):
                    triple = triples[count]
                    triple[0], triple[1], triple[2] = order[p], order[q], order[r]
                    if not done[_number(triple)] and _is_hashed(table, look, order[p], order[q], order[r]):
                        radii[count] = _turn(look.scan, triple)
                        count += 1
    return triples[:count][np.argsort(radii[:count], kind="mergesort")]


@compiled
def _try_likes(table: TriangleHash, look: Look, found: Found, done: BoolArray) -> None:
    """Look up disjoint triples of what the best explains, until it stays: a place like its own explains one of them."""
    pairings, found.state[2] = 0, 1
    while pairings < found.state[0] and found.effort[LIMIT] == 0:
        pairings = found.state[0]
        paired = np.flatnonzero(found.features[0] != UNPAIRED)
        order, starts = _groups(look.scan.points[paired], pairings // 3)
        for g in range(pairings // 3):
            triple = paired[order[starts[g] : starts[g] + 3]]
            _turn(look.scan, triple)
            if not done[_number(triple)] and _is_hashed(table, look, triple[0], triple[1], triple[2]):
                done[_number(triple)] = True
                _try_triple(table, look, found, triple)


@compiled
def _number(triple: IntArray) -> int:
    """A number of its own for each set of three measurements."""
    low, high = min(triple[0], triple[1], triple[2]), max(triple[0], triple[1], triple[2])
    middle = triple[0] + triple[1] + triple[2] - low - high
    return int(high * (high - 1) * (high - 2) // 6 + middle * (middle - 1) // 2 + low)


@compiled
def _turn(scan: Measured, triple: IntArray) -> float:
    """Turn a triple so that it runs counterclockwise; the radius [m] of its circumcircle."""
    a, b, c = scan.points[triple[0]], scan.points[triple[1]], scan.points[triple[2]]
    area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    if area < 0.0:
        triple[1], triple[2] = triple[2], triple[1]
    sides = scan.distances[triple[0], triple[1]] * scan.distances[triple[1], triple[2]]
    return float(sides * scan.distances[triple[2], triple[0]] / (2.0 * abs(area) + 1e-9))


@compiled
def _is_hashed(table: TriangleHash, look: Look, i: int, k: int, l: int) -> bool:
    """Whether the triangles like three measurements, as far as its gates reach, are all short enough for the hash."""
    distances, variances = look.scan.distances, look.scan.variances
    longest = max(distances[i, k], distances[k, l], distances[l, i])
    widest = max(variances[i, k], variances[k, l], variances[l, i])
    return bool(longest + math.sqrt(look.scan.gates.one * (2.0 * table.widest + widest)) <= table.reach)


@compiled
def _seed(table: TriangleHash, look: Look, triple: IntArray) -> _Seed:
    """The seed of a triple. With error variance v per pairing and inertia I about the centroid, a pose fitted to it has
    variance v/3 at the centroid and v/I in heading, so that a measurement at distance d has v/3 + d²v/I from the pose.
    """
    scan, points, m, widest, inertia = look.scan, look.scan.points, len(look.scan.points), 0.0, 1e-12
    x, y = points[triple, 0].mean(), points[triple, 1].mean()
    for i in triple:
        inertia += (points[i, 0] - x) ** 2 + (points[i, 1] - y) ** 2
        widest = max(widest, 0.5 * scan.spreads[i, i])
    worst, count = table.widest + widest, 0
    others, offsets = np.empty(m, np.int64), np.empty((2, m))
    gates, limits = np.empty((2, m)), np.empty(m, np.int64)
    for i in range(m):
        if i != triple[0] and i != triple[1] and i != triple[2]:
            u, v = points[i, 0] - x, points[i, 1] - y
            along = 0.5 * scan.spreads[i, i] + worst / 3.0
            across = along + (u * u + v * v) * worst / inertia
            others[count], offsets[0, count], offsets[1, count] = i, u, v
            gates[0, count] = look.scan.gates.two * (along + table.widest)
            gates[1, count] = look.scan.gates.two * (across + table.widest)
            limits[count] = min(int(math.sqrt(look.scan.gates.two * across) / table.raster.step), FAR)
            count += 1
    i, k, l = triple
    of_sides = max(scan.variances[i, k], scan.variances[k, l], scan.variances[l, i])
    margin = math.sqrt(look.scan.gates.one * (2.0 * table.widest + of_sides))
    return _Seed(triple, others[:count], offsets[:, :count], gates[:, :count], limits[:count], margin)


@compiled
def _try_triple(table: TriangleHash, look: Look, found: Found, triple: IntArray) -> None:
    """Look up the triangles like a triple of measurements, however turned, and verify the poses that they imply.

    A triple that is nearly straight may run either way round.
    """
    found.effort[TRIES] += 1
    distances, points, (i, k, l) = look.scan.distances, look.scan.points, triple
    longest = max(distances[i, k], distances[k, l], distances[l, i])
    if longest == 0.0:
        return
    seed = _seed(table, look, triple)
    a, b, c = points[i], points[k], points[l]
    height = abs((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])) / longest
    for turn in range(6 if height < 2.0 * seed.margin else 3):
        onwards = 1 if turn < 3 else 2
        corners = np.array([triple[turn % 3], triple[(turn + onwards) % 3], triple[(turn + 2 * onwards) % 3]])
        if distances[corners[0], corners[1]] + 2.0 * seed.margin >= longest:
            _verify(table, look, found, seed, corners, _like(table, look, found, corners))


@compiled
def _like(table: TriangleHash, look: Look, found: Found, corners: IntArray) -> Integers32:
    """Corners (t, 3) of the triangles whose sides are those between three measurements, within the gate."""
    sides, variances, low, high = np.empty(3), np.empty(3), np.empty(3, np.int64), np.empty(3, np.int64)
    for k in range(3):
        i, l = corners[k], corners[(k + 1) % 3]
        sides[k], variances[k] = look.scan.distances[i, l], look.scan.variances[i, l] + (1e-7 * table.reach) ** 2
        margin = math.sqrt(look.scan.gates.one * (variances[k] + 2.0 * table.widest))
        low[k] = max(0, math.floor((sides[k] - margin) / table.quantum))
        high[k] = math.floor(min(sides[k] + margin, table.reach) / table.quantum)
    chosen, count, compared, gate = np.empty((64, 3), np.int32), 0, 0, look.scan.gates.one
    (first, second, third), (u, v, w) = sides, variances
    for c in range(low[0], high[0] + 1):
        for a in range(low[1], min(c, high[1]) + 1):
            for b in range(max(low[2], c - a - 1), min(c, high[2]) + 1):
                cell = cell_number(c, a, b)
                start, end = table.starts[cell], table.starts[cell + 1]
                if count + end - start > len(chosen) - 1:
                    longer = np.empty((2 * len(chosen) + end - start, 3), np.int32)
                    longer[:count] = chosen[:count]
                    chosen = longer
                compared += end - start
                for t in range(start, end):
                    x, y, z = table.sides[t, 0] - first, table.sides[t, 1] - second, table.sides[t, 2] - third
                    of_map = table.sides[t, 3]
                    near = (x * x <= gate * (u + of_map)) & (y * y <= gate * (v + of_map))
                    for k in range(3):
                        chosen[count, k] = table.corners[t, k]
                    count += near & (z * z <= gate * (w + of_map))  # a branch could not be foretold
    _spend(look, found, BINARY, compared, _COMPARISON * compared)
    return chosen[:count]


@compiled
def cell_number(c: int, a: int, b: int) -> int:
    """Number of the cell of sides c ≥ a, b in quanta: those of smaller c come first."""
    return c * (c + 1) * (2 * c + 1) // 6 + a * (c + 1) + b


@compiled
def _spend(look: Look, found: Found, what: int, amount: int, work: float) -> None:
    """Count an effort, and the work in poses; too much of it in all, and the limit is hit."""
    found.effort[what] += amount
    found.effort[WORK] += int(work)
    if found.effort[WORK] > look.work_limit:
        found.effort[LIMIT] = 1


@compiled
def _verify(
    table: TriangleHash, look: Look, found: Found, seed: _Seed, corners: IntArray, triangles: Integers32
) -> None:
    """Hold the poses that triangles (t, 3) imply for the measurements `corners` against the whole scan.

    By the raster first, which settles most. There all places are worked out before any is looked up, and none is given
    up early: loops without branches take less time than it takes to foresee their end.
    """
    _spend(look, found, NODES, len(triangles), len(triangles))
    points, steps, (left, bottom, side) = look.scan.points, table.raster.steps, table.raster.origin
    counts, allowed = np.ones(len(seed.others), np.bool_), len(points) - found.state[0] - (found.state[1] == 0)
    if found.state[2] > 0:
        counts[:] = found.features[0][seed.others] != UNPAIRED
        allowed = max(found.state[0] // 3 - 1, 0)
    rows, columns = steps.shape
    poses = _implied_poses(table.positions, points[corners], triangles)
    flat, scale, missed = steps.ravel(), 1.0 / side, np.zeros(len(triangles), np.int64)
    x, y, cosine, sine, places = poses[0], poses[1], poses[2], poses[3], np.empty(len(triangles), np.int64)
    for p in np.flatnonzero(counts):
        u, v, limit = seed.offsets[0, p], seed.offsets[1, p], seed.limits[p]
        for t in range(len(triangles)):
            column = min(max(int((x[t] + cosine[t] * u - sine[t] * v - left) * scale), 0), columns - 1)
            row = min(max(int((y[t] + sine[t] * u + cosine[t] * v - bottom) * scale), 0), rows - 1)
            places[t] = row * columns + column
        for t in range(len(triangles)):
            missed[t] += flat[places[t]] > limit
    for passed in np.flatnonzero(missed <= allowed):
        t = int(passed)
        if found.effort[LIMIT] == 0 and _misses(table, seed, counts, poses[:, t], allowed) <= allowed:
            _examine(table, look, found, corners, triangles[t], poses[:, t])


@compiled
def _misses(table: TriangleHash, seed: _Seed, counts: BoolArray, pose: Array, allowed: int) -> int:
    """How many of the measurements that count miss every feature at a pose, in gates that are ellipses here.

    They are long across the line of sight from the seed, since its heading is what is least known. No more than one
    above `allowed` are counted.
    """
    grid, positions, missed = table.grid, table.positions, 0
    for p in np.flatnonzero(counts):
        u = pose[2] * seed.offsets[0, p] - pose[3] * seed.offsets[1, p]
        v = pose[3] * seed.offsets[0, p] + pose[2] * seed.offsets[1, p]
        square, met = u * u + v * v + 1e-12, False
        bottom, top, left, right = _cells_around(grid, pose[0] + u, pose[1] + v, math.sqrt(seed.gates[1, p]))
        for row in range(bottom, top):
            start = row * grid.shape[1]
            for at in range(grid.starts[start + left], grid.starts[start + right]):
                j = grid.members[at]
                dx, dy = positions[j, 0] - pose[0] - u, positions[j, 1] - pose[1] - v
                along, across = dx * u + dy * v, dy * u - dx * v
                met |= along * along / seed.gates[0, p] + across * across / seed.gates[1, p] < square
        missed += not met
        if missed > allowed:
            break
    return missed


@compiled
def _cells_around(grid: Grid, x: float, y: float, radius: float) -> tuple[int, int, int, int]:
    """First row and column of what a square of `radius` [m] around a point touches, and one past the last of each.

    There are no rows where it touches no column.
    """
    (rows, columns), (left, bottom, side) = grid.shape, grid.origin
    first = max(math.floor((x - radius - left) / side), 0)
    end = min(math.floor((x + radius - left) / side) + 1, columns)
    top = min(math.floor((y + radius - bottom) / side) + 1, rows) if first < end else 0
    return max(math.floor((y - radius - bottom) / side), 0), top, first, end


@compiled
def _implied_poses(positions: Array, points: Array, triangles: Integers32) -> Array:
    """Least-squares fits of three points to triangles (t, 3): x, y of their centroid, cos θ, sin θ, (4, t)."""
    poses, z = np.empty((4, len(triangles))), points - np.array([points[:, 0].mean(), points[:, 1].mean()])
    for t in range(len(triangles)):
        a, b, c = positions[triangles[t, 0]], positions[triangles[t, 1]], positions[triangles[t, 2]]
        cosine = a[0] * z[0, 0] + a[1] * z[0, 1] + b[0] * z[1, 0] + b[1] * z[1, 1] + c[0] * z[2, 0] + c[1] * z[2, 1]
        sine = a[1] * z[0, 0] - a[0] * z[0, 1] + b[1] * z[1, 0] - b[0] * z[1, 1] + c[1] * z[2, 0] - c[0] * z[2, 1]
        scale = 1.0 / math.sqrt(cosine * cosine + sine * sine)
        poses[0, t], poses[1, t] = (a[0] + b[0] + c[0]) / 3.0, (a[1] + b[1] + c[1]) / 3.0
        poses[2, t], poses[3, t] = cosine * scale, sine * scale
    return poses


@compiled
def _examine(
    table: TriangleHash, look: Look, found: Found, corners: IntArray, features: Integers32, pose: Array
) -> None:
    """Pair and fit in turns around a pose that the raster lets pass, until the pairings stay.

    Then drop the worst until the rest is jointly compatible, and keep what is as good as the best or better.
    """
    points, m, wanted = look.scan.points, len(look.scan.points), found.state[0] + (found.state[1] == 0)
    for k in range(3):
        if not _may_pair(table, look, corners[k], features[k], features[0]):
            return
    for h in range(found.state[1]):
        best = found.features[h]
        if best[corners[0]] == features[0] and best[corners[1]] == features[1] and best[corners[2]] == features[2]:
            return
    fit, decisions, others, squares = np.zeros(_FIT), np.full(m, UNPAIRED), np.empty(m, np.int64), np.empty(m)
    x, y = points[corners, 0].mean(), points[corners, 1].mean()
    fit[0], fit[1] = pose[0] - pose[2] * x + pose[3] * y, pose[1] - pose[3] * x - pose[2] * y
    fit[2], fit[3] = pose[2], pose[3]
    for k in range(3):
        decisions[corners[k]] = features[k]
    pairings = 3
    for turn in range(_ROUNDS + 1):
        if not _improve(table, look, decisions, fit, squares) < 1.0:
            _improve(table, look, decisions, fit, squares)
        pairings = _pair_around(table, look, fit, features[0], wanted, others, squares)
        if pairings == 0:
            return
        if turn == 0:
            _spend(look, found, LEAVES, 1, _FITTING)
        same = (decisions == others).all()
        decisions[:] = others
        if same:
            break
    while pairings >= max(wanted, 2):
        for _ in range(_ROUNDS):
            if not _improve(table, look, decisions, fit, squares) > 1e-6:
                break
        found.effort[JOINT] += 1
        if squares.sum() < look.joint_gates[pairings]:
            _keep(found, decisions, fit, squares.sum(), pairings)
            return
        decisions[np.argmax(squares)] = UNPAIRED
        pairings -= 1


@compiled
def _may_pair(table: TriangleHash, look: Look, i: int, j: int, anchor: int) -> bool:
    """The unary constraints, as far as sizes and kinds are known, and the locality of feature `anchor`."""
    size, variance, kind = look.sizes[i], look.size_variances[i], look.kinds[i]
    of_feature = table.sizes[j], table.size_variances[j], table.kinds[j]
    if not unary_test(size, variance, kind, *of_feature, look.scan.gates.one):
        return False
    if len(look.local_starts) == 0:
        return True
    low, high = look.local_starts[anchor], look.local_starts[anchor + 1]
    at = low + np.searchsorted(look.local_members[low:high], j)
    return bool(at < high and look.local_members[at] == j)


@compiled
def _turned(noise: Array, fit: Array) -> tuple[float, float, float]:
    """R R_i Rᵀ [m²] of a noise (2, 2): xx, xy, yy."""
    c, s, a, b, d = fit[2], fit[3], noise[0, 0], noise[0, 1], noise[1, 1]
    return (
        c * c * a - 2.0 * c * s * b + s * s * d,
        c * s * (a - d) + (c * c - s * s) * b,
        s * s * a + 2.0 * c * s * b + c * c * d,
    )


@compiled
def _pair_around(
    table: TriangleHash, look: Look, fit: Array, anchor: int, needed: int, features: IntArray, squares: Array
) -> int:
    """Pair each measurement with the feature of least D² within its gate; of two that want one, the nearer has it.

    Writes `features` (m,) and their D² (m,); returns the number of pairings, or 0 once fewer than `needed` are left.
    """
    grid, positions, spreads, misses = table.grid, table.positions, table.spreads, 0
    for i in range(len(features)):
        lx = fit[2] * look.scan.points[i, 0] - fit[3] * look.scan.points[i, 1]
        ly = fit[3] * look.scan.points[i, 0] + fit[2] * look.scan.points[i, 1]
        x, y, (xx, xy, yy) = fit[0] + lx, fit[1] + ly, _turned(look.scan.noise[i], fit)
        xx, yy = xx + fit[4] - 2.0 * ly * fit[7] + ly * ly * fit[9], yy + fit[6] + 2.0 * lx * fit[8] + lx * lx * fit[9]
        xy += fit[5] + lx * fit[7] - ly * fit[8] - lx * ly * fit[9]
        features[i], squares[i] = UNPAIRED, look.scan.gates.two
        radius = math.sqrt(look.scan.gates.two * (max(xx, yy) + abs(xy) + table.widest))
        bottom, top, left, right = _cells_around(grid, x, y, radius)
        for row in range(bottom, top):
            start = row * grid.shape[1]
            for at in range(grid.starts[start + left], grid.starts[start + right]):
                j = grid.members[at]
                dx, dy = positions[j, 0] - x, positions[j, 1] - y
                if abs(dx) > radius or abs(dy) > radius:
                    continue
                sxx, sxy, syy = xx + spreads[j, 0], xy + spreads[j, 1], yy + spreads[j, 2]
                determinant = sxx * syy - sxy * sxy
                square = syy * dx * dx - 2.0 * sxy * dx * dy + sxx * dy * dy
                if square < squares[i] * determinant and _may_pair(table, look, i, j, anchor):
                    features[i], squares[i] = j, square / determinant
        misses += features[i] == UNPAIRED
        for k in range(i if features[i] != UNPAIRED else 0):
            if features[k] == features[i]:
                features[k if squares[k] > squares[i] else i] = UNPAIRED
                misses += 1
                break
        if misses > len(features) - needed:
            return 0
    return len(features) - misses


@compiled
def _improve(table: TriangleHash, look: Look, features: IntArray, fit: Array, squares: Array) -> float:
    """One Gauss–Newton step of the weighted fit to the pairings; how far it moved, in units of its covariance.

    With the residual e = F_j − p_i, its weight W = (R R_i Rᵀ + C_j)⁻¹ and J = [I, ∂p_i/∂θ]: (Σ JᵀWJ) δ = Σ JᵀWe, and
    (Σ JᵀWJ)⁻¹ is the covariance of the fit. `squares` (m,) become eᵀWe before the step, 0 for `*`.
    """
    a = b = c = d = e = f = g = h = k = 0.0  # Σ JᵀWJ = [[a, b, d], [b, c, e], [d, e, f]], Σ JᵀWe = (g, h, k)
    for i in range(len(features)):
        j, squares[i] = features[i], 0.0
        if j == UNPAIRED:
            continue
        lx = fit[2] * look.scan.points[i, 0] - fit[3] * look.scan.points[i, 1]
        ly = fit[3] * look.scan.points[i, 0] + fit[2] * look.scan.points[i, 1]
        ex, ey = table.positions[j, 0] - fit[0] - lx, table.positions[j, 1] - fit[1] - ly
        sxx, sxy, syy = _turned(look.scan.noise[i], fit)
        sxx, sxy, syy = sxx + table.spreads[j, 0], sxy + table.spreads[j, 1], syy + table.spreads[j, 2]
        determinant = sxx * syy - sxy * sxy
        xx, xy, yy = syy / determinant, -sxy / determinant, sxx / determinant
        wx, wy, jx, jy = xx * ex + xy * ey, xy * ex + yy * ey, xy * lx - xx * ly, yy * lx - xy * ly
        squares[i] = ex * wx + ey * wy
        a, b, c, d, e = a + xx, b + xy, c + yy, d + jx, e + jy
        f, g, h, k = f + jy * lx - jx * ly, g + wx, h + wy, k + wy * lx - wx * ly
    aa, bb, dd = c * f - e * e, d * e - b * f, b * e - c * d
    cc, ee, ff = a * f - d * d, b * d - a * e, a * c - b * b
    determinant = a * aa + b * bb + d * dd
    if not determinant > 0.0:
        return math.nan
    x, y = (aa * g + bb * h + dd * k) / determinant, (bb * g + cc * h + ee * k) / determinant
    turn = (dd * g + ee * h + ff * k) / determinant
    fit[0], fit[1] = fit[0] + x, fit[1] + y
    cosine, sine = math.cos(turn), math.sin(turn)
    fit[2], fit[3] = fit[2] * cosine - fit[3] * sine, fit[3] * cosine + fit[2] * sine
    fit[4], fit[5], fit[6] = aa / determinant, bb / determinant, cc / determinant
    fit[7], fit[8], fit[9] = dd / determinant, ee / determinant, ff / determinant
    return g * x + h * y + k * turn


@compiled
def _keep(found: Found, decisions: IntArray, fit: Array, square: float, pairings: int) -> None:
    """Keep a hypothesis that beats the best, or ties with it at another pose: one that shares at most one pairing."""
    count = 0 if pairings > found.state[0] else found.state[1]
    at = count
    for h in range(count):
        if ((decisions != UNPAIRED) & (decisions == found.features[h])).sum() >= 2:
            if square >= found.squares[h]:
                return
            at = h
            break
    if at < len(found.squares):
        found.features[at], found.fits[at], found.squares[at] = decisions, fit, square
        found.state[0], found.state[1] = pairings, max(count, at + 1)
