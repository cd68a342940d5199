"""A stochastic map taken apart into plain arrays, and put together from them."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from slam_gym.mapping import ekf
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.types import UNKNOWN_KIND, Array, IntArray


@dataclass(frozen=True, slots=True)
class Columns:
    """What a `StochasticMap` remembers of each of its n features besides its position."""

    ids: IntArray  # (n,)
    seen: IntArray  # (n,) steps
    first_seen: IntArray  # (n,) step
    last_seen: IntArray  # (n,) step
    sizes: Array  # (n,) [m], NaN where unknown
    size_variances: Array  # (n,) [m²], NaN where unknown
    kinds: IntArray  # (n,) UNKNOWN_KIND where there is none

    def __len__(self) -> int:
        return len(self.ids)

    def followed_by(self, other: Columns) -> Columns:
        """These features, then those of `other`."""
        names = (field.name for field in fields(self))
        return Columns(*(np.concatenate([getattr(self, name), getattr(other, name)]) for name in names))

    def fused(self, kept: IntArray, dropped: IntArray) -> Columns:
        """Feature kept[i] takes over what was known of its duplicate dropped[i], both (k,); nothing is deleted.

        Sightings add up, sizes are averaged by their variances, and an unknown kind gives way to a known one.
        """
        out = Columns(*(getattr(self, field.name).copy() for field in fields(self)))
        for a, b in zip(kept.tolist(), dropped.tolist()):
            out.seen[a] += out.seen[b]
            out.first_seen[a] = min(out.first_seen[a], out.first_seen[b])
            out.last_seen[a] = max(out.last_seen[a], out.last_seen[b])
            out.kinds[a] = out.kinds[b] if out.kinds[a] == UNKNOWN_KIND else out.kinds[a]
            if np.isfinite(out.sizes[a]) and np.isfinite(out.sizes[b]):
                total = out.size_variances[a] + out.size_variances[b]
                gain = out.size_variances[a] / total if total > 0.0 else 0.0
                out.sizes[a] += gain * (out.sizes[b] - out.sizes[a])
                out.size_variances[a] *= 1.0 - gain
            elif np.isfinite(out.sizes[b]):
                out.sizes[a], out.size_variances[a] = out.sizes[b], out.size_variances[b]
        return out


@dataclass(frozen=True, slots=True)
class MapState:
    """All that a `StochasticMap` knows, but for its settings."""

    mean: Array  # (3 + 2n,) robot [m, m, rad], features [m], in B
    covariance: Array  # (3 + 2n, 3 + 2n)
    columns: Columns  # of its n features
    step: int  # steps ended so far
    next_id: int  # of the next feature


_ROWS = {
    "ids": ("_counted", ekf.IDS),
    "seen": ("_counted", ekf.SEEN),
    "first_seen": ("_counted", ekf.FIRST_SEEN),
    "last_seen": ("_counted", ekf.LAST_SEEN),
    "kinds": ("_counted", ekf.KINDS),
    "sizes": ("_sized", ekf.SIZES),
    "size_variances": ("_sized", ekf.VARIANCES),
}  # where a map keeps the fields of `Columns`


def state_of(m: StochasticMap) -> MapState:
    """The state of a map, as copies."""
    columns = Columns(m.ids, m.seen, m.first_seen, m.last_seen, m.sizes, m.size_variances, m.kinds)
    return MapState(m.mean, m.covariance, columns, m.step, m.next_id)


def map_of_state(spec: MapSpec, state: MapState) -> StochasticMap:
    """The map of a state.

    Raises ValueError where lengths do not agree, numbers are not finite or the robot's covariance is none.
    """
    n = len(state.columns)
    d = 3 + 2 * n
    if state.mean.shape != (d,) or state.covariance.shape != (d, d):
        raise ValueError(f"mean, covariance: shapes {state.mean.shape}, {state.covariance.shape} for {n} features")
    if not (np.isfinite(state.mean).all() and np.isfinite(state.covariance).all()):
        raise ValueError("mean, covariance: not finite")
    m = StochasticMap(spec, state.mean[:3], state.covariance[:3, :3], capacity=max(n, 1))
    m._x[3:d] = state.mean[3:]
    m._P[:d, :d] = state.covariance
    for field in fields(state.columns):
        rows, row = _ROWS[field.name]
        getattr(m, rows)[row, :n] = getattr(state.columns, field.name)
    m.n, m.step, m.next_id = n, state.step, state.next_id
    return m


def successor(m: StochasticMap) -> StochasticMap:
    """An empty map whose base is where the robot of m stands now; ids and steps go on from m's."""
    fresh = StochasticMap(m.spec)
    fresh.step, fresh.next_id = m.step, m.next_id
    return fresh
