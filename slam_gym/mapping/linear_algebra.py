"""The linear algebra of an EKF update, compiled: simple loops, laid out so that the compiler vectorises them.

Matrices are C-contiguous. Loops over long rows run over whole cache lines (`padded`), so that no remainder is left.
"""

import math
from typing import Any

import numpy as np
from numba import config, float64
from numba.extending import intrinsic

from slam_gym._jit import compiled, inlined
from slam_gym.types import Array

_NUMBA: Any = config
LANES = 8  # doubles in a cache line
ROUNDING = 1e-13  # fraction of the cancelling terms that is added to the diagonals of S and P, to keep both definite
_SLACK = 1e-9  # a covariance may miss symmetry and positive semi-definiteness by this fraction of its trace


def padded(d: int) -> int:
    """d rounded up to whole cache lines: the least length of x and side of P."""
    return (d + LANES - 1) // LANES * LANES


def aligned_zeros(*shape: int) -> Array:
    """An array of zeros that starts at a cache line, on which the update runs a third faster."""
    size = math.prod(shape)
    room = np.zeros(size + LANES)
    start = -room.ctypes.data // room.itemsize % LANES
    return room[start : start + size].reshape(shape)


@compiled
def cholesky(A: Array) -> bool:
    """A ← its Cholesky factor L, in place; only the lower triangle is used. False where A is not positive definite."""
    for j in range(A.shape[0]):
        pivot = A[j, j]
        for k in range(j):
            pivot -= A[j, k] * A[j, k]
        if not (0.0 < pivot < math.inf):
            return False
        A[j, j] = math.sqrt(pivot)
        for i in range(j + 1, A.shape[0]):
            total = A[i, j]
            for k in range(j):
                total -= A[i, k] * A[j, k]
            A[i, j] = total / A[j, j]
    return True


@compiled
def is_covariance(A: Array) -> bool:
    """Whether A is finite, symmetric and positive semi-definite, within 1e-9 of its trace."""
    slack, factor = 0.0, np.empty(A.shape)
    for i in range(A.shape[0]):
        slack += _SLACK * abs(A[i, i])
    for i in range(A.shape[0]):
        for j in range(i):
            factor[i, j] = A[i, j]
            if not (abs(A[i, j] - A[j, i]) <= slack):
                return False
        factor[i, i] = A[i, i] + slack + 1e-300
    return cholesky(factor)


@compiled
def whiten(L: Array, B: Array, nu: Array) -> None:
    """B ← L⁻¹ B (2k, padded d) and ν ← L⁻¹ ν (2k,): forward substitution, two rows at a time."""
    for i in range(L.shape[0]):
        for k in range(i):
            nu[i] -= L[i, k] * nu[k]
        nu[i] /= L[i, i]
    for k in range(0, L.shape[0], 2):
        w, v = B[k], B[k + 1]
        first, below, second = 1.0 / L[k, k], L[k + 1, k], 1.0 / L[k + 1, k + 1]
        for j in range(len(w)):
            w[j] *= first
            v[j] = (v[j] - below * w[j]) * second
        for i in range(k + 2, L.shape[0], 2):
            _eliminate(B[i], B[i + 1], w, v, L[i, k : k + 2], L[i + 1, k : k + 2])


@inlined
def _eliminate(p: Array, q: Array, w: Array, v: Array, by_p: Array, by_q: Array) -> None:
    """Rows p and q −= rows w and v, times `by_p` (2,) and `by_q` (2,)."""
    pw, pv, qw, qv = by_p[0], by_p[1], by_q[0], by_q[1]
    for j in range(len(w)):
        p[j] -= pw * w[j] + pv * v[j]
        q[j] -= qw * w[j] + qv * v[j]


def _fused(context: Any, a: Any, b: Any, c: Any) -> Any:
    """a·b + c, rounded once: the same result on every machine, in one instruction instead of two."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return float64(float64, float64, float64), generate


def _rounded_twice(a: float, b: float, c: float) -> float:
    """a·b + c, rounded twice: replaces `_fused` where nothing is compiled (NUMBA_DISABLE_JIT=1, for debugging)."""
    return a * b + c


_fma: Any = _rounded_twice if _NUMBA.DISABLE_JIT else intrinsic(_fused)


@compiled
def subtract_squares(P: Array, W: Array) -> None:
    """Upper triangle of P −= Wᵀ W for W (2k, padded d): four rows of P and one pairing at a time, by whole cache lines.

    Most time of an update is spent here; blocked like this it is as fast as BLAS's dsyrk, and faster in small maps. The
    diagonal is raised by `ROUNDING`, to make up for rounding errors.
    """
    rows, d = W.shape
    lost = np.zeros(d)
    for k in range(rows):
        row = W[k]
        for j in range(d):
            lost[j] += row[j] * row[j]
    for i in range(0, d, 4):
        left = i - i % LANES
        length = (d - left) // LANES * LANES
        block = P[i, left:], P[i + 1, left:], P[i + 2, left:], P[i + 3, left:]
        for k in range(0, rows, 2):
            _subtract_from(*block, W[k, left:], W[k + 1, left:], W[k : k + 2, i : i + 4], length)
    for j in range(d):
        P[j, j] += ROUNDING * lost[j]


@inlined
def _subtract_from(p: Array, q: Array, r: Array, s: Array, w: Array, v: Array, by: Array, length: int) -> None:
    """Rows p to s (`length`,) −= `by` (2, 4), its rows times rows w and v."""
    pw, qw, rw, sw = -by[0, 0], -by[0, 1], -by[0, 2], -by[0, 3]
    pv, qv, rv, sv = -by[1, 0], -by[1, 1], -by[1, 2], -by[1, 3]
    for j in range(length):
        p[j] = _fma(pw, w[j], _fma(pv, v[j], p[j]))
        q[j] = _fma(qw, w[j], _fma(qv, v[j], q[j]))
        r[j] = _fma(rw, w[j], _fma(rv, v[j], r[j]))
        s[j] = _fma(sw, w[j], _fma(sv, v[j], s[j]))
