"""The iterated joint EKF update with all pairings of a scan, with an ordinary or a right-invariant error. Compiled.

State x and P (upper triangle) are those of `ekf`. Measurement function: h_j(x) = (⊖R) ⊕ F_j = Cᵀ(F_j − t), with C
the robot's rotation and t its position. Its Jacobian is

    H_j = Cᵀ [−I  −JΔ  0 … I … 0],  Δ = F_j − t,  JΔ = (−Δ_y, Δ_x)ᵀ.

Cᵀ is common to all features, so the kernels take innovations in axes parallel to B and turn only the results into R.

**A right-invariant filter** (Barrau and Bonnabel 2015; Zhang et al., IEEE RA-L 2(2), 2017) uses the error of the group
of motions, δθ, δt − J t δθ and δF_j − J F_j δθ. In these coordinates neither F (the identity) nor C H depends on the
estimate, so the unobservable directions, position and orientation of the whole map in B, never gain information. P is
stored in ordinary coordinates nevertheless, because prediction and adding are the same in both. The update differs in
three ways. H takes Δ from the prior in every iteration, and only C from the latest iterate. The correction δ moves the
state along the group, x ← x + V(δθ) δ with V(φ) = ∫₀¹ Rot(sφ) ds. And P is expressed at the resulting estimate:
P ← M P Mᵀ, with M = I + J(x⁺ − x) e_θᵀ, where J turns the position of the robot and of each feature.
"""

import math

import numpy as np

from slam_gym._jit import compiled, inlined
from slam_gym.geometry import wrap_angle
from slam_gym.mapping.ekf import check_measurement, turned
from slam_gym.mapping.linear_algebra import LANES, ROUNDING, cholesky, subtract_squares, whiten
from slam_gym.types import UNPAIRED, Array, IntArray

_TURNS, _SETTLED = 30, 1e-9  # most iterations, and [rad] the change of δθ after which no more follow


@compiled
def update(
    x: Array,
    P: Array,
    n: int,
    scan: tuple[Array, Array],
    features: IntArray,
    passes: tuple[int, float],
    invariant: bool,
) -> None:
    """Joint EKF update with all pairings (measurement i, feature features[i] ≠ UNPAIRED), in place.

    ν = z − h(x), S = H P Hᵀ + R = L Lᵀ, W = L⁻¹ H P; x ← x + Wᵀ L⁻¹ ν (= x + K ν), P ← P − Wᵀ W (= P − K S Kᵀ).
    With more than one iteration, H and ν are recomputed at x_i+1 = x + K_i (z − h(x_i) − H_i (x − x_i)) until another
    iteration would move the state by less than `settled` of its own σ. This is Gauss–Newton from the prior x, which
    minimises the cost of prior and measurements together (Bell and Cathey, IEEE TAC 38(2), 1993): exactly for ordinary
    errors, nearly for right-invariant ones, whose H is that of a small correction of the heading.

    Arguments:
        scan: points (m, 2) and their covariances (m, 2, 2).
        passes: most iterations; and `settled` [σ of the state].
        invariant: whether the error is right-invariant.

    Raises ValueError, with nothing changed, for a feature that does not exist, for a paired measurement that is not
    finite or whose R is no covariance, and where S is singular.
    """
    d = 3 + 2 * n
    passes_left, settled = passes
    z, R, paired = _pairings(scan, features, n)
    x_old, x_lin = x, x  # x_lin: the state at which H is evaluated
    change = np.zeros((d + LANES - 1) // LANES * LANES)  # as long as the rows of P
    while True:
        nu, W, S = _innovation(x_old, x_lin, change, P, d, (z, R, paired))
        if not cholesky(S):
            raise ValueError("the innovation covariance is singular to working precision")
        whiten(S, W, nu)
        previous, passes_left = change, passes_left - 1
        change, x_new = corrected(x, W, nu, d, invariant)
        if passes_left <= 0 or _step_error(x_old, x_new, x_lin, change - previous, R, paired) <= settled * settled:
            break
        x_old, x_lin = x_new, x_new
        if invariant:
            x_lin = x.copy()
            x_lin[2] = x_new[2]
    subtract_squares(P, W)
    if invariant:
        express_at(P, d, x, x_new)
    for j in range(d):
        x[j] = x_new[j]
    x[2] = wrap_angle(x[2])


@compiled
def _pairings(scan: tuple[Array, Array], features: IntArray, n: int) -> tuple[Array, Array, IntArray]:
    """Points (k, 2), covariances (k, 2, 2) and features (k,) of the pairings, all valid; else ValueError."""
    points, covariances = scan
    measured, k = np.empty(len(features), np.int64), 0
    for i in range(len(features)):
        if features[i] == UNPAIRED:
            continue
        if not 0 <= features[i] < n:
            raise ValueError(f"features: measurement {i} is paired with feature {features[i]} of {n}")
        check_measurement(points, covariances, i)
        measured[k] = i
        k += 1
    measured = measured[:k]
    return points[measured], covariances[measured], features[measured]


@compiled
def _innovation(
    x: Array, x_lin: Array, change: Array, P: Array, d: int, pairings: tuple[Array, Array, IntArray]
) -> tuple[Array, Array, Array]:
    """ν (2k,), H P (2k, padded d) and S = H P Hᵀ + R (2k, 2k, lower triangle), in axes parallel to B.

    The k pairings are points (k, 2), their covariances (k, 2, 2) and features (k,). H is evaluated at the state
    `x_lin`, and ν = z − h(x) + H `change`, where `change` is the correction that has led from the prior to x.
    """
    points, covariances, paired = pairings
    k = len(paired)
    nu, HP, S = np.empty(2 * k), np.zeros((2 * k, len(change))), np.zeros((2 * k, 2 * k))
    robot = np.empty((3, d))
    for i in range(3):
        for j in range(d):
            robot[i, j] = P[min(i, j), max(i, j)]
    c, s = math.cos(x[2]), math.sin(x[2])
    ca, sa = math.cos(x_lin[2]), math.sin(x_lin[2])
    for i in range(k):
        f, a, b = 3 + 2 * paired[i], 2 * i, 2 * i + 1
        # z − h(x), turned by the heading at which H is evaluated
        hx, hy = x[f] - x[0], x[f + 1] - x[1]
        ex, ey = points[i, 0] - (c * hx + s * hy), points[i, 1] - (-s * hx + c * hy)
        dx, dy = x_lin[f] - x_lin[0], x_lin[f + 1] - x_lin[1]
        nu[a] = ca * ex - sa * ey + (change[f] - change[0] + dy * change[2])
        nu[b] = sa * ex + ca * ey + (change[f + 1] - change[1] - dx * change[2])
        _rows_of_HP(x_lin, P, d, f, robot, HP[a], HP[b])
        S[a, a], S[b, a], S[b, b] = turned(ca, sa, covariances[i, 0, 0], covariances[i, 0, 1], covariances[i, 1, 1])
    for i in range(k):
        f, a, b = 3 + 2 * paired[i], 2 * i, 2 * i + 1
        dx, dy = x_lin[f] - x_lin[0], x_lin[f + 1] - x_lin[1]
        S[a, a] += ROUNDING * (P[f, f] + P[0, 0] + dy * dy * P[2, 2])
        S[b, b] += ROUNDING * (P[f + 1, f + 1] + P[1, 1] + dx * dx * P[2, 2])
        for row in range(a, 2 * k):
            S[row, a] += HP[row, f] - HP[row, 0] + dy * HP[row, 2]
            S[row, b] += HP[row, f + 1] - HP[row, 1] - dx * HP[row, 2]
    return nu, HP, S


@inlined
def _rows_of_HP(x_lin: Array, P: Array, d: int, f: int, robot: Array, out_x: Array, out_y: Array) -> None:
    """[−I −JΔ 0 … I … 0] P for the feature that starts at f; `robot` (3, d) are the robot's rows of P in full."""
    dx, dy = x_lin[f] - x_lin[0], x_lin[f + 1] - x_lin[1]
    for j in range(f):
        out_x[j], out_y[j] = P[j, f], P[j, f + 1]
    out_x[f], out_x[f + 1] = P[f, f], P[f, f + 1]
    out_y[f], out_y[f + 1] = P[f, f + 1], P[f + 1, f + 1]
    for j in range(f + 2, d):
        out_x[j], out_y[j] = P[f, j], P[f + 1, j]
    rx, ry, rt = robot[0], robot[1], robot[2]
    for j in range(len(rt)):
        out_x[j] += dy * rt[j] - rx[j]
        out_y[j] -= dx * rt[j] + ry[j]


@compiled
def corrected(x: Array, W: Array, nu: Array, d: int, invariant: bool) -> tuple[Array, Array]:
    """The correction K ν = Wᵀ L⁻¹ ν, from W and ν as `whiten` leaves them; and x + K ν, or x + V(δθ) K ν."""
    change, out = np.zeros(W.shape[1]), x.copy()
    for i in range(len(nu)):
        row = W[i]
        for j in range(len(change)):
            change[j] += row[j] * nu[i]
    turn = change[2]
    a, b = left_jacobian(turn) if invariant else (1.0, 0.0)
    out[0] += a * change[0] - b * change[1]
    out[1] += b * change[0] + a * change[1]
    out[2] += turn
    for f in range(3, d, 2):
        out[f] += a * change[f] - b * change[f + 1]
        out[f + 1] += b * change[f] + a * change[f + 1]
    return change, out


@compiled
def left_jacobian(turn: float) -> tuple[float, float]:
    """a and b of the left Jacobian V(φ) = ∫₀¹ Rot(sφ) ds = [a −b; b a] for a turn φ [rad]."""
    if abs(turn) < 1e-4:
        return 1.0 - turn * turn / 6.0, 0.5 * turn
    return math.sin(turn) / turn, (1.0 - math.cos(turn)) / turn


@compiled
def left_jacobian_inverse(nu: Array, turn: float) -> Array:
    """V(φ)⁻¹ ν for each row of ν (k, 2); φ [rad] is limited to half a turn."""
    a, b = left_jacobian(min(max(turn, -math.pi), math.pi))
    out, squared = np.empty_like(nu), a * a + b * b
    for k in range(len(nu)):
        out[k, 0], out[k, 1] = (a * nu[k, 0] + b * nu[k, 1]) / squared, (a * nu[k, 1] - b * nu[k, 0]) / squared
    return out


@compiled
def heading_correction(nu: Array, gain: Array) -> float:
    """The correction δθ [rad] of right-invariant errors that makes F_a = F_b for k pairs of features.

    ν = F_b − F_a (k, 2). A correction δ moves each feature by V(δθ) δF, so that F_a = F_b afterwards if δF_a − δF_b =
    V(δθ)⁻¹ ν, which is linear in δ: V(δθ)⁻¹ ν is the innovation, and δθ = K_θ V(δθ)⁻¹ ν is found by iteration. `gain`
    (2k,) is the row K_θ of the Kalman gain.
    """
    turn = 0.0
    for _ in range(_TURNS):
        before, turn = turn, float((gain * left_jacobian_inverse(nu, turn).ravel()).sum())
        if abs(turn - before) < _SETTLED:
            break
    return turn


@compiled
def _step_error(x_old: Array, x_new: Array, x_lin: Array, change: Array, covariances: Array, paired: IntArray) -> float:
    """The squared error of the linearisation in the step from `x_old` to `x_new`, in units of the measurements' σ.

    It is the sum of r_iᵀ R_i⁻¹ r_i over the pairings, r_i = h_i(x_new) − h_i(x_old) − H_i `change`. The next iteration
    of Gauss–Newton moves the state by P⁺ Hᵀ R⁻¹ r, in units of the state's own σ after the update (Mahalanobis) by no
    more than the root of this sum, since Hᵀ R⁻¹ H ≤ (P⁺)⁻¹. The change of H moves the state much less.
    """
    c, s, total = math.cos(x_lin[2]), math.sin(x_lin[2]), 0.0
    ch, sh = math.cos(x_lin[2] - x_old[2]), math.sin(x_lin[2] - x_old[2])
    ct, st = math.cos(x_lin[2] - x_new[2]), math.sin(x_lin[2] - x_new[2])
    for i in range(len(paired)):
        f = 3 + 2 * paired[i]
        hx, hy = x_old[f] - x_old[0], x_old[f + 1] - x_old[1]
        tx, ty = x_new[f] - x_new[0], x_new[f + 1] - x_new[1]
        dx, dy = x_lin[f] - x_lin[0], x_lin[f + 1] - x_lin[1]
        # h(x_new) − h(x_old) − H change, in the axes of `_innovation`, then in R
        rx = ct * tx - st * ty - (ch * hx - sh * hy) - (change[f] - change[0] + dy * change[2])
        ry = st * tx + ct * ty - (sh * hx + ch * hy) - (change[f + 1] - change[1] - dx * change[2])
        u, v = c * rx + s * ry, c * ry - s * rx
        xx, xy, yy = covariances[i, 0, 0], covariances[i, 0, 1], covariances[i, 1, 1]
        squared, determinant = yy * u * u - 2.0 * xy * u * v + xx * v * v, xx * yy - xy * xy
        if squared > 0.0:
            total += squared / determinant if determinant > 0.0 else math.inf
    return total


@compiled
def express_at(P: Array, d: int, x: Array, x_new: Array) -> None:
    """P ← M P Mᵀ, M = I + a e_θᵀ with a = J(x_new − x); with b = P e_θ + ½ a P_θθ, this is P + a bᵀ + b aᵀ."""
    a, b = np.zeros(d), np.empty(d)
    a[0], a[1] = x[1] - x_new[1], x_new[0] - x[0]
    for f in range(3, d, 2):
        a[f], a[f + 1] = x[f + 1] - x_new[f + 1], x_new[f] - x[f]
    for j in range(d):
        b[j] = P[min(j, 2), max(j, 2)] + 0.5 * P[2, 2] * a[j]
    for i in range(d):
        row, right, above = P[i, i:d], a[i:], b[i:]
        for j in range(len(row)):
            row[j] += a[i] * above[j] + b[i] * right[j]
