"""Search in a hash of triangles: which triples of measurements are looked up, and how the implied poses are verified.

Completeness follows from the pigeonhole principle: if the measurements are divided into g groups, any 2g + 1 of them
include three of one group. So once all triples within the groups have been looked up, no pose that explains more than
2g measurements is missed (except by triples wider than the reach of the hash, which does not contain them). Groups are
compact, since small triangles have few similar ones: their number is n times a factor proportional to the radius of
their circumcircle.

Each pose that a triangle implies is tested against the whole scan: first by the distance from each measurement to the
nearest feature, then by pairing, location and joint test.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_gym._jit import compiled, inlined
from slam_gym.association.relocation.constraints import Measured, Path
from slam_gym.association.relocation.location import locate_pairings, place_of
from slam_gym.association.relocation.problem import INDEX, Best, Problem, fewest, keep
from slam_gym.types import UNKNOWN_KIND, UNPAIRED, Array, IntArray

FAR = 255  # in the raster of distances: beyond its range
_TURNS = 16  # rotations of a scan that are tried, to find narrower groups
_ROUNDS = 6  # of locating and pairing again; two are usually enough
_LOCATING = 30  # nodes that a location counts as: it takes as long as testing this many poses against the raster

Integers32 = NDArray[np.int32]


class FeatureCells(NamedTuple):
    """Features grouped by square cells."""

    starts: IntArray  # (rows · columns + 1,) the features of cell c are members[starts[c]:starts[c + 1]]
    members: IntArray  # (n,)
    shape: tuple[int, int]  # rows, columns
    origin: tuple[float, float, float]  # [m] left and lower edge, side of a cell


class Raster(NamedTuple):
    """Distances to the nearest feature, reduced by what its own covariance explains."""

    steps: NDArray[np.uint8]  # (rows, columns) √(d² − γλ) / step, down; d from the nearest point of the cell; or FAR
    origin: tuple[float, float, float]  # [m] left and lower edge, side of a cell
    step: float  # [m]


class TriangleHash(NamedTuple):
    """Triangles of nearby features, hashed by their sides, and features by position."""

    starts: IntArray  # (cells + 1,) the triangles of cell c are starts[c] … starts[c + 1] − 1
    corners: Integers32  # (t, 3) A, B, C counterclockwise, AB the longest side
    sides: NDArray[np.float32]  # (t, 4) [m] AB, BC, CA, and the largest variance [m²] of the three
    grid: FeatureCells
    raster: Raster
    reach: float  # [m] longest side of the triangles
    quantum: float  # [m] width of a hash cell in each side
    widest: float  # [m²] largest variance of a feature in any direction, at most that of 4 σ of the usual feature


class _Seed(NamedTuple):
    """A triple of measurements, and the other measurements relative to its centroid.

    With error variance v per pairing and inertia I about the centroid, a pose fitted to the triple has variance v/3 at
    the centroid and v/I in heading. So a measurement at distance d has variance v/3 + d²v/I from the pose.
    """

    offsets: Array  # (m − 3, 2) [m] of the other measurements from the centroid
    limits: IntArray  # (m − 3,) raster steps beyond which no feature is within their gates
    centroid: tuple[float, float]  # [m] in R
    variances: tuple[float, float]  # [m², rad²] v/3 and v/I
    margin: float  # [m] gate of a side, for any features


class _Placed(NamedTuple):
    """A pose, and the pairings made at it; all of them are overwritten as they improve."""

    pose: Array  # (3,) [m, m, rad] in B
    covariance: Array  # (3, 3)
    features: IntArray  # (m,) or UNPAIRED
    squares: Array  # (m,) D² of the pairings


@compiled
def search(table: TriangleHash, problem: Problem, needed: int, node_limit: int, best: Best) -> None:
    """Enter in `best` all hypotheses with the most pairings, at least one less than `needed`.

    The search ends with one pairing more than needed, once triples of the paired measurements have shown no other
    similar place. With exactly as many as needed, only hypotheses that the gates reject can be missing.
    """
    scan = problem.scan
    best.state[0] = max(needed - 1, 3) - 1
    if len(scan.points) < max(needed, 3):
        return
    for triple in _triples(scan, np.arange(len(scan.points)), max((needed - 1) // 2, 1), table.reach):
        _try_triple(table, problem, node_limit, best, triple)
        if problem.effort[INDEX.limit_hit] > 0 or best.state[0] > needed:
            break
    pairings = needed
    while pairings < best.state[0]:
        pairings, fresh = best.state[0], np.ones(len(scan.points), np.bool_)
        paired = np.flatnonzero(best.features[best.state[2]] != UNPAIRED)
        for triple in _triples(scan, paired, pairings // 3, table.reach):
            if fresh[triple].all() and problem.effort[INDEX.limit_hit] == 0:
                fresh[triple] = False
                _try_triple(table, problem, node_limit, best, triple)


@compiled
def _triples(scan: Measured, measurements: IntArray, groups: int, reach: float) -> IntArray:
    """Triples (t, 3) within compact groups of measurements, counterclockwise, by ascending circumradius."""
    m, z, count = len(measurements), scan.points, 0
    triples, radii = np.empty((m * m * m // 6 + 1, 3), np.int64), np.empty(m * m * m // 6 + 1)
    group = _near_groups(scan, measurements, groups, reach)
    for i in measurements:
        for k in measurements:
            for l in measurements:
                if not (l < k < i and group[i] == group[k] and group[i] == group[l]):
                    continue
                area = (z[k, 0] - z[i, 0]) * (z[l, 1] - z[i, 1]) - (z[k, 1] - z[i, 1]) * (z[l, 0] - z[i, 0])
                triples[count, 0] = i
                triples[count, 1], triples[count, 2] = (k, l) if area >= 0.0 else (l, k)
                sides = scan.distances[i, k] * scan.distances[k, l] * scan.distances[l, i]
                radii[count] = sides / (2.0 * abs(area) + 1e-9)
                count += 1
    return triples[:count][np.argsort(radii[:count], kind="mergesort")]


@compiled
def _near_groups(scan: Measured, members: IntArray, groups: int, reach: float) -> IntArray:
    """`_groups` of the scan, rotated so that few pairs within a group are farther apart than the hash reaches."""
    least, best = len(members) ** 2, np.empty(0, np.int64)
    for turn in range(_TURNS):
        c, s, wide = math.cos(0.5 * math.pi * turn / _TURNS), math.sin(0.5 * math.pi * turn / _TURNS), 0
        group = _groups(scan.points @ np.array([[c, -s], [s, c]]), members, groups)
        for i in members:
            for k in members:
                wide += group[i] == group[k] and scan.distances[i, k] > reach
        if wide < least:
            least, best = wide, group
        if wide == 0:
            break
    return best


@compiled
def _groups(points: Array, members: IntArray, groups: int) -> IntArray:
    """Group (m,) of each member: compact and nearly equal, by recursive splits across the longer extent."""
    group, uncut = np.empty(len(points), np.int64), [(members, 0, groups)]
    while len(uncut) > 0:
        part, first, count = uncut.pop()
        group[part] = first
        if count > 1 and len(part) > 0:
            x, y, left = points[part, 0], points[part, 1], count // 2
            part = part[np.argsort(x if x.max() - x.min() >= y.max() - y.min() else y, kind="mergesort")]
            cut = (len(part) * left + count // 2) // count
            uncut.append((part[:cut], first, left))
            uncut.append((part[cut:], first + left, count - left))
    return group


@compiled
def _seed(table: TriangleHash, scan: Measured, triple: IntArray) -> _Seed:
    """The seed of a triple of measurements."""
    points, noise, inertia = scan.points, 0.0, 1e-12
    x, y = points[triple, 0].mean(), points[triple, 1].mean()
    for i in triple:
        inertia += (points[i, 0] - x) ** 2 + (points[i, 1] - y) ** 2
        noise = max(noise, 0.5 * scan.spreads[i, i])
    at_centroid, of_heading = (table.widest + noise) / 3.0, (table.widest + noise) / inertia
    others = np.array([i for i in range(len(points)) if i != triple[0] and i != triple[1] and i != triple[2]], np.int64)
    offsets, limits = np.empty((len(others), 2)), np.empty(len(others), np.int64)
    for p in range(len(others)):
        u, v = points[others[p], 0] - x, points[others[p], 1] - y
        variance = 0.5 * scan.spreads[others[p], others[p]] + at_centroid + (u * u + v * v) * of_heading
        offsets[p, 0], offsets[p, 1] = u, v
        limits[p] = min(int(math.sqrt(scan.gate_two * variance) / table.raster.step), FAR)
    i, k, l = triple
    of_sides = max(scan.variances[i, k], scan.variances[k, l], scan.variances[l, i])
    margin = math.sqrt(scan.gate_one * (2.0 * table.widest + of_sides))
    return _Seed(offsets, limits, (x, y), (at_centroid, of_heading), margin)


@compiled
def _try_triple(table: TriangleHash, problem: Problem, node_limit: int, best: Best, triple: IntArray) -> None:
    """Verify the poses implied by triangles similar to a triple of measurements, in all rotations of its corners."""
    problem.effort[INDEX.tries] += 1
    distances, points, (i, k, l) = problem.scan.distances, problem.scan.points, triple
    longest = max(distances[i, k], distances[k, l], distances[l, i])
    if longest == 0.0:
        return
    seed = _seed(table, problem.scan, triple)
    a, b, c = points[i], points[k], points[l]
    height = abs((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])) / longest
    for turn in range(6 if height < 2.0 * seed.margin else 3):  # one that is nearly straight has either orientation
        onwards = 1 if turn < 3 else 2
        corners = np.array([triple[turn % 3], triple[(turn + onwards) % 3], triple[(turn + 2 * onwards) % 3]])
        if distances[corners[0], corners[1]] + 2.0 * seed.margin >= longest:
            _verify(table, problem, node_limit, best, seed, corners)


@compiled
def _similar_triangles(table: TriangleHash, problem: Problem, corners: IntArray) -> Integers32:
    """Corners (t, 3) of the triangles whose sides match those between three measurements, within the gate."""
    scan, gate = problem.scan, problem.scan.gate_one
    sides, variances, low, high = np.empty(3), np.empty(3), np.empty(3, np.int64), np.empty(3, np.int64)
    for k in range(3):
        i, l = corners[k], corners[(k + 1) % 3]
        sides[k], variances[k] = scan.distances[i, l], scan.variances[i, l] + (1e-7 * table.reach) ** 2
        margin = math.sqrt(gate * (variances[k] + 2.0 * table.widest))
        low[k] = max(0, math.floor((sides[k] - margin) / table.quantum))
        high[k] = math.floor(min(sides[k] + margin, table.reach) / table.quantum)
    chosen, count = np.empty((64, 3), np.int32), 0
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
                problem.effort[INDEX.binary_tests] += end - start
                for t in range(start, end):
                    x, y, z = table.sides[t, 0] - first, table.sides[t, 1] - second, table.sides[t, 2] - third
                    of_map = table.sides[t, 3]
                    near = (x * x <= gate * (u + of_map)) & (y * y <= gate * (v + of_map))
                    for k in range(3):
                        chosen[count, k] = table.corners[t, k]
                    count += near & (z * z <= gate * (w + of_map))  # branch-free: a branch would be mispredicted
    return chosen[:count]


@compiled
def cell_number(c: int, a: int, b: int) -> int:
    """Number of the cell of sides c ≥ a, b in quanta; cells are ordered by c."""
    return c * (c + 1) * (2 * c + 1) // 6 + a * (c + 1) + b


@compiled
def _verify(table: TriangleHash, problem: Problem, node_limit: int, best: Best, seed: _Seed, corners: IntArray) -> None:
    """Test the poses that similar triangles imply for three measurements against the scan, first by the raster."""
    triangles = _similar_triangles(table, problem, corners)
    problem.effort[INDEX.nodes] += len(triangles)
    poses = _implied_poses(problem.mapped.positions, problem.scan.points[corners], triangles)
    unmatched, m = _count_unmatched(table.raster, seed, poses), len(problem.scan.points)
    placed = _Placed(np.empty(3), np.empty((3, 3)), np.empty(m, np.int64), np.empty(m))
    pose, P, (x, y), (v, w) = placed.pose, placed.covariance, seed.centroid, seed.variances
    for t in np.flatnonzero(unmatched <= m - fewest(best, True)):
        if problem.effort[INDEX.nodes] > node_limit:
            break
        c, s = poses[2, t], poses[3, t]
        lx, ly = c * x - s * y, s * x + c * y
        pose[0], pose[1], pose[2] = poses[0, t] - lx, poses[1, t] - ly, math.atan2(s, c)  # of the robot
        P[0, 0], P[1, 1], P[2, 2], P[0, 1] = v + ly * ly * w, v + lx * lx * w, w, -lx * ly * w
        P[0, 2], P[1, 2], P[1, 0], P[2, 0], P[2, 1] = ly * w, -lx * w, P[0, 1], ly * w, -lx * w
        k = _pair_at(table, problem, placed, triangles[t, 0], fewest(best, True))
        is_new = k > 0
        for corner in range(3):
            is_new = is_new and _may_pair(problem, corners[corner], triangles[t, corner], triangles[t, 0])
        for r in range(best.state[1] if is_new else 0):  # a hypothesis kept may contain all three pairings already
            if (best.features[r][corners] == triangles[t]).all():
                is_new = False
        if is_new:
            problem.effort[INDEX.leaves] += 1
            _examine(table, problem, best, triangles[t, 0], placed, k)
    if problem.effort[INDEX.nodes] > node_limit:
        problem.effort[INDEX.limit_hit] = 1


@compiled
def _count_unmatched(raster: Raster, seed: _Seed, poses: Array) -> IntArray:
    """Number (t,) of the other measurements without a feature within their gates, at poses (4, t)."""
    (left, bottom, side), (rows, columns), flat = raster.origin, raster.steps.shape, raster.steps.ravel()
    x, y, cosine, sine, scale = poses[0], poses[1], poses[2], poses[3], 1.0 / side
    cells, unmatched = np.empty(len(x), np.int64), np.zeros(len(x), np.int64)
    # all cells are computed before any is read, and no pose is abandoned early: loops without branches are faster
    for p in range(len(seed.limits)):
        u, v, limit = seed.offsets[p, 0], seed.offsets[p, 1], seed.limits[p]
        for t in range(len(x)):
            column = min(max(int((x[t] + cosine[t] * u - sine[t] * v - left) * scale), 0), columns - 1)
            row = min(max(int((y[t] + sine[t] * u + cosine[t] * v - bottom) * scale), 0), rows - 1)
            cells[t] = row * columns + column
        for t in range(len(x)):
            unmatched[t] += flat[cells[t]] > limit
    return unmatched


@compiled
def _implied_poses(positions: Array, points: Array, triangles: Integers32) -> Array:
    """Least-squares fits of three points to triangles (t, 3): x, y of the centroid, cos θ, sin θ, (4, t)."""
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
def _examine(table: TriangleHash, problem: Problem, best: Best, anchor: int, placed: _Placed, paired: int) -> None:
    """Locate and pair in turn, starting from the pairings (m,) at a pose, until the pairings no longer change.

    Then drop the worst pairings until the rest is jointly compatible, and keep the result if it is at least as good as
    the best. `placed` is overwritten.
    """
    scan, needed = problem.scan, fewest(best, True)
    pose, covariance, features, squares = placed
    path, before = Path(np.empty(len(features), np.int64), np.empty(len(features), np.int64)), features.copy()
    k, distance = paired, math.inf
    for _ in range(_ROUNDS):
        k = paired
        path.measurements[:k] = np.flatnonzero(features != UNPAIRED)
        path.features[:k] = features[path.measurements[:k]]
        problem.effort[INDEX.nodes] += _LOCATING
        distance = locate_pairings(scan.points, scan.noise, problem.mapped, path, k, pose, covariance)
        before[:] = features
        paired = _pair_at(table, problem, placed, anchor, needed) if distance < math.inf else 0
        if paired == 0:
            return
        if (features == before).all():
            break
    problem.effort[INDEX.joint_tests] += 1
    while k >= needed and not distance < problem.joint_gates[k]:
        worst = np.argmax(squares[path.measurements[:k]])
        for a in range(worst, k - 1):
            path.measurements[a], path.features[a] = path.measurements[a + 1], path.features[a + 1]
        k -= 1
        problem.effort[INDEX.joint_tests] += 1
        distance = locate_pairings(scan.points, scan.noise, problem.mapped, path, k, pose, covariance)
    if k >= needed:
        keep(best, path, k, pose, covariance, distance)


@inlined
def _may_pair(problem: Problem, i: int, j: int, anchor: int) -> bool:
    """Whether a pairing satisfies the unary constraints and the locality of feature `anchor`."""
    scan, mapped = problem.scan, problem.mapped
    kind, of_feature, difference = scan.kinds[i], mapped.kinds[j], scan.sizes[i] - mapped.sizes[j]
    if kind != of_feature and kind != UNKNOWN_KIND and of_feature != UNKNOWN_KIND:
        return False
    if difference * difference > scan.gate_one * (scan.size_variances[i] + mapped.size_variances[j]):  # NaN passes
        return False
    if len(problem.starts) == 0:
        return True
    low, high = problem.starts[anchor], problem.starts[anchor + 1]
    at = low + np.searchsorted(problem.members[low:high], j)
    return bool(at < high and problem.members[at] == j)


@inlined
def _pair_at(table: TriangleHash, problem: Problem, placed: _Placed, anchor: int, needed: int) -> int:
    """Pair each measurement with the feature of least D² within its gate. Of two that claim one feature, the nearer
    wins.

    Writes the features and their D² in `placed`. Returns the number of pairings, or 0 once it must be less than
    `needed`.
    """
    scan, positions, spreads = problem.scan, problem.mapped.positions, problem.mapped.covariances
    grid, gate, misses, (pose, P, features, squares) = table.grid, problem.scan.gate_two, 0, placed
    (rows, columns), (left, bottom, side) = grid.shape, grid.origin
    for i in range(len(features)):
        x, y, xx, xy, yy = place_of(scan.points, scan.noise, i, pose, P)
        features[i], squares[i] = UNPAIRED, gate
        radius = math.sqrt(gate * (max(xx, yy) + abs(xy) + table.widest))
        first = max(math.floor((x - radius - left) / side), 0)
        last = min(math.floor((x + radius - left) / side), columns - 1)
        top = min(math.floor((y + radius - bottom) / side), rows - 1) if first <= last else -1
        for row in range(max(math.floor((y - radius - bottom) / side), 0), top + 1):
            for at in range(grid.starts[row * columns + first], grid.starts[row * columns + last + 1]):
                j = grid.members[at]
                dx, dy = positions[j, 0] - x, positions[j, 1] - y
                if abs(dx) > radius or abs(dy) > radius:
                    continue
                sxx, sxy, syy = xx + spreads[j, 0, 0], xy + spreads[j, 0, 1], yy + spreads[j, 1, 1]
                determinant = sxx * syy - sxy * sxy
                square = syy * dx * dx - 2.0 * sxy * dx * dy + sxx * dy * dy
                if square < squares[i] * determinant and _may_pair(problem, i, j, anchor):
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
