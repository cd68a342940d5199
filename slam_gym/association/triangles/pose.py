"""From a seed to a located hypothesis: pairings around a pose, weighted fit, joint test with 2k − 3 degrees of freedom.

A fit places the scan: p_i = t + R(θ)(z_i − o) with a point o of the scan for its centre, as an array (12,)
`[t_x, t_y, cos θ, sin θ, o_x, o_y, P_xx, P_xy, P_yy, P_xθ, P_yθ, P_θθ]`, P being the covariance of (t, θ). The error of
a pairing has covariance R R_i Rᵀ + C_j + J P Jᵀ, where C_j is that of the feature relative to those around it: the
error that near features share moves the pose along with them and is no error of a pairing.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.triangles.store import SIDE, WIDEST, Bits, Small
from slam_gym.types import UNPAIRED, Array, IntArray

FIT = 12
_ROUNDS = 6  # of fitting and pairing anew; pairings are as a rule settled after two


StoreArrays = tuple[Array, Array, Small, Small, Small, Small, Bits, Array]


class Store(NamedTuple):
    """The arrays of a `FeatureIndex`, as its kernels take them."""

    positions: Array  # (capacity, 2) [m]
    details: Array  # (capacity, 6) [m²] xx, xy, yy of C_j; size [m], its variance [m²], kind, NaN where unknown
    heads: Small  # (W, W) grid
    following: Small  # (capacity,)
    cells: Small  # (cells, 4)
    pool: Small  # (p, 4)
    bits: Bits  # the fine bitmap, then the coarse one, of cells and radius twice as large
    settings: Array  # (16 + 256,) as numbered in `index_store`, then the variances [m²] that codes stand for


class Look(NamedTuple):
    """The scan, and what is asked of a hypothesis."""

    points: Array  # (m, 2) [m]
    noise: Array  # (m, 3) [m²] xx, xy, yy
    attributes: Array  # (m, 3) size [m], its variance [m²], kind; NaN where unknown
    widest: Array  # (m,) [m²] largest variance of each in any direction
    gates: Array  # (m + 1,) χ²_1, χ²_2, then χ²_{2k−3} from k = 2
    local_starts: IntArray  # (n + 1,), or (0,)
    local: IntArray


@compiled
def alike(attributes: Array, i: int, details: Array, j: int, gate: float) -> bool:
    """Unary constraint: sizes within their gate and kinds equal, as far as both are known."""
    if attributes[i, 2] != details[j, 5] and not (math.isnan(attributes[i, 2]) or math.isnan(details[j, 5])):
        return False
    difference = attributes[i, 0] - details[j, 3]
    return not difference * difference >= gate * (attributes[i, 1] + details[j, 4])


@compiled
def is_local(starts: IntArray, members: IntArray, anchor: int, j: int) -> bool:
    """Whether feature j is in the locality of `anchor`; without localities, always."""
    if len(starts) == 0:
        return True
    low, high = starts[anchor], starts[anchor + 1]
    while low < high:
        middle = (low + high) >> 1
        if members[middle] < j:
            low = middle + 1
        else:
            high = middle
    return bool(low < starts[anchor + 1] and members[low] == j)


@compiled
def _predicted(points: Array, noise: Array, fit: Array, i: int) -> tuple[float, float, float, float, float]:
    """Where a fit puts measurement i [m], and the covariance xx, xy, yy [m²] of that place."""
    c, s = fit[2], fit[3]
    u, v = points[i, 0] - fit[4], points[i, 1] - fit[5]
    x, y = c * u - s * v, s * u + c * v
    a, b, d = noise[i, 0], noise[i, 1], noise[i, 2]
    xx = c * c * a - 2.0 * c * s * b + s * s * d + fit[6] - 2.0 * y * fit[9] + y * y * fit[11]
    yy = s * s * a + 2.0 * c * s * b + c * c * d + fit[8] + 2.0 * x * fit[10] + x * x * fit[11]
    xy = c * s * (a - d) + (c * c - s * s) * b + fit[7] + x * fit[9] - y * fit[10] - x * y * fit[11]
    return fit[0] + x, fit[1] + y, xx, xy, yy


@compiled
def _nearest(
    place: tuple[float, float, float, float, float],
    positions: Array,
    details: Array,
    heads: Small,
    following: Small,
    side: float,
    widest: float,
    gate: float,
    attributes: Array,
    i: int,
    sizes: float,
    starts: IntArray,
    members: IntArray,
    anchor: int,
) -> tuple[int, float]:
    """The feature of least D² within the gate of measurement i, and that D²; (UNPAIRED, gate) where there is none."""
    x, y, xx, xy, yy = place
    mask, reach = len(heads) - 1, math.sqrt(gate * (max(xx, yy) + abs(xy) + widest))
    bottom, left = math.floor((y - reach) / side), math.floor((x - reach) / side)
    rows = min(math.floor((y + reach) / side) - bottom, mask) + 1
    columns = min(math.floor((x + reach) / side) - left, mask) + 1
    chosen, least = UNPAIRED, gate
    for row in range(bottom, bottom + rows):
        for column in range(left, left + columns):
            j = int(heads[row & mask, column & mask])
            while j >= 0:
                dx, dy = positions[j, 0] - x, positions[j, 1] - y
                if abs(dx) <= reach and abs(dy) <= reach:
                    sxx, sxy, syy = xx + details[j, 0], xy + details[j, 1], yy + details[j, 2]
                    determinant = sxx * syy - sxy * sxy
                    square = syy * dx * dx - 2.0 * sxy * dx * dy + sxx * dy * dy
                    nearer = square < least * determinant and alike(attributes, i, details, j, sizes)
                    if nearer and is_local(starts, members, anchor, j):
                        chosen, least = j, square / determinant
                j = int(following[j])
    return chosen, least


@compiled
def pair_around(
    look: Look, store: Store, fit: Array, anchor: int, needed: int, features: IntArray, squares: Array
) -> int:
    """Pair each measurement with the nearest feature within its gate; of two that want one, the nearer has it.

    Writes `features` (m,) and their D² (m,); returns the number of pairings, or 0 once fewer than `needed` are left.
    """
    points, noise, attributes, gates = look.points, look.noise, look.attributes, look.gates
    positions, details, heads, following = store.positions, store.details, store.heads, store.following
    starts, members, side, widest = look.local_starts, look.local, store.settings[SIDE], store.settings[WIDEST]
    m, misses = len(features), 0
    for i in range(m):
        place = _predicted(points, noise, fit, i)
        features[i], squares[i] = _nearest(
            place, positions, details, heads, following, side, widest, gates[1], attributes, i, gates[0], starts,
            members, anchor,
        )  # fmt: skip
        misses += features[i] == UNPAIRED
        for k in range(i if features[i] != UNPAIRED else 0):
            if features[k] == features[i]:
                features[k if squares[k] > squares[i] else i] = UNPAIRED
                misses += 1
                break
        if misses > m - needed:
            return 0
    return m - misses


@compiled
def _weights(noise: Array, details: Array, fit: Array, i: int, j: int) -> tuple[float, float, float]:
    """Inverse of R R_i Rᵀ + C_j: xx, xy, yy."""
    c, s, a, b, d = fit[2], fit[3], noise[i, 0], noise[i, 1], noise[i, 2]
    xx = c * c * a - 2.0 * c * s * b + s * s * d + details[j, 0]
    yy = s * s * a + 2.0 * c * s * b + c * c * d + details[j, 2]
    xy = c * s * (a - d) + (c * c - s * s) * b + details[j, 1]
    determinant = xx * yy - xy * xy
    return yy / determinant, -xy / determinant, xx / determinant


@compiled
def improve(look: Look, store: Store, features: IntArray, fit: Array) -> float:
    """One Gauss-Newton step of the weighted fit of (t, θ) to the pairings; how far it moved, in units of its P.

    With the residual e = F_j − p_i and J = [I, ∂p_i/∂θ]: (Σ JᵀWJ) δ = Σ JᵀWe, and P = (Σ JᵀWJ)⁻¹.
    """
    points, noise, positions, details = look.points, look.noise, store.positions, store.details
    a = b = c = d = e = f = g = h = k = 0.0  # Σ JᵀWJ = [[a, b, d], [b, c, e], [d, e, f]], Σ JᵀWe = (g, h, k)
    for i in range(len(features)):
        j = features[i]
        if j == UNPAIRED:
            continue
        u, v = points[i, 0] - fit[4], points[i, 1] - fit[5]
        lx, ly = fit[2] * u - fit[3] * v, fit[3] * u + fit[2] * v
        ex, ey = positions[j, 0] - fit[0] - lx, positions[j, 1] - fit[1] - ly
        xx, xy, yy = _weights(noise, details, fit, i, j)
        wx, wy, jx, jy = xx * ex + xy * ey, xy * ex + yy * ey, xy * lx - xx * ly, yy * lx - xy * ly
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
    fit[6], fit[7], fit[8] = aa / determinant, bb / determinant, cc / determinant
    fit[9], fit[10], fit[11] = dd / determinant, ee / determinant, ff / determinant
    return g * x + h * y + k * turn


@compiled
def distance_of(look: Look, store: Store, features: IntArray, fit: Array) -> tuple[float, int]:
    """D² = Σ eᵀWe of the pairings at a fit, and the measurement that adds most to it."""
    points, noise, positions, details = look.points, look.noise, store.positions, store.details
    total, most, worst = 0.0, -1.0, UNPAIRED
    for i in range(len(features)):
        j = features[i]
        if j == UNPAIRED:
            continue
        u, v = points[i, 0] - fit[4], points[i, 1] - fit[5]
        ex = positions[j, 0] - fit[0] - fit[2] * u + fit[3] * v
        ey = positions[j, 1] - fit[1] - fit[3] * u - fit[2] * v
        xx, xy, yy = _weights(noise, details, fit, i, j)
        square = xx * ex * ex + 2.0 * xy * ex * ey + yy * ey * ey
        total += square
        if square > most:
            most, worst = square, i
    return total, worst


@compiled
def settle(
    look: Look, store: Store, anchor: int, needed: int, features: IntArray, fit: Array, spent: IntArray
) -> tuple[int, float]:
    """Fit and pair in turns until the pairings stay, then drop the worst until the rest is jointly compatible.

    Returns the number of pairings and D²; (0, 0) where fewer than `needed` are left.
    """
    m = len(features)
    others, squares, pairings = np.empty(m, np.int64), np.empty(m), 0
    for _ in range(_ROUNDS):
        if not improve(look, store, features, fit) < 1.0:
            improve(look, store, features, fit)
        pairings = pair_around(look, store, fit, anchor, needed, others, squares)
        if pairings == 0:
            return 0, 0.0
        same = True
        for i in range(m):
            same, features[i] = same and features[i] == others[i], others[i]
        if same:
            break
    while pairings >= max(needed, 2):
        for _ in range(_ROUNDS):
            if not improve(look, store, features, fit) > 1e-6:
                break
        square, worst = distance_of(look, store, features, fit)
        spent[4] += 1
        if square < look.gates[pairings]:
            return pairings, square
        features[worst], pairings = UNPAIRED, pairings - 1
    return 0, 0.0
