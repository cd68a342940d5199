"""The features of a map, for searches without a prior on the robot's pose, and the locality of features."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from slam_gym.types._fields import INTEGER, Array, IntArray, check_array, covariances_of, floats, kinds_of, sizes_of


@dataclass(frozen=True, slots=True)
class Locality:
    """Which features of a map are local to which: L(j) for every feature j, in compressed rows.

    The relation is symmetric, and every feature is local to itself. Where all features are local to each other, use
    None instead: a `Locality` would have n² entries.
    """

    starts: IntArray  # (n + 1,) L(j) is members[starts[j]:starts[j + 1]]
    members: IntArray  # (e,) ascending within each row

    def __post_init__(self) -> None:
        """Raises ValueError where an array does not have the type and shape that compiled functions read."""
        check_array("Locality.starts", self.starts, INTEGER, (len(self.starts),))
        check_array("Locality.members", self.members, INTEGER, (len(self.members),))

    def __len__(self) -> int:
        return len(self.starts) - 1

    def of(self, feature: int) -> IntArray:
        """L(feature), ascending."""
        return self.members[self.starts[feature] : self.starts[feature + 1]]


@dataclass(frozen=True, slots=True)
class Landmarks:
    """The features of a map in B, for searches without a prior on the robot's pose.

    Cross-covariances are given in one of three ways: all of them (`covariance`), those of some pairs (`block_…`, as
    large maps store them), or none. Pairs without one are assumed independent.
    """

    positions: Array  # (n, 2) [m]
    covariances: Array  # (n, 2, 2) [m²] marginals
    sizes: Array  # (n,) [m] mapped intrinsic attribute, NaN where unknown
    size_variances: Array  # (n,) [m²]
    kinds: IntArray  # (n,) class, UNKNOWN_KIND where unknown
    covariance: Array  # (2n, 2n) [m²] of all features together, or (0, 0)
    block_starts: IntArray  # (n + 1,) the pairs (j, l) of j are entries block_starts[j]:block_starts[j + 1]; or (0,)
    block_columns: IntArray  # (e,) l, ascending for each j; both (j, l) and (l, j) are stored
    blocks: Array  # (e, 2, 2) [m²] P_jl

    def __len__(self) -> int:
        return len(self.positions)

    def __repr__(self) -> str:
        return f"Landmarks: {len(self)} features"

    @classmethod
    def from_points(
        cls,
        points: ArrayLike,
        covariances: ArrayLike | None = None,
        *,
        sigma: ArrayLike | None = None,
        covariance: ArrayLike | None = None,
        sizes: ArrayLike | None = None,
        size_sigma: ArrayLike | None = None,
        kinds: ArrayLike | None = None,
    ) -> Landmarks:
        """Landmarks at positions (n, 2) [m] in B, with exactly one of marginal `covariances`, `sigma` and `covariance`.

        `covariance` (2n, 2n) [m²] is the joint covariance of all features; with the other two, features are
        independent. The other arguments and the errors are those of `Scan.from_points`.
        """
        positions = floats("points", points, (-1, 2))
        n, joint = len(positions), np.empty((0, 0))
        if covariance is None:
            marginals = covariances_of("covariances", covariances, sigma, n)
        elif covariances is not None or sigma is not None:
            raise ValueError("covariance: given together with covariances or sigma; expected exactly one of the three")
        else:
            joint = floats("covariance", covariance, (2 * n, 2 * n))
            marginals = np.ascontiguousarray(joint.reshape(n, 2, n, 2)[np.arange(n), :, np.arange(n), :])
        empty = np.empty(0, np.int64)
        return cls(
            positions, marginals, *sizes_of(sizes, size_sigma, n), kinds_of(kinds, n), joint, empty, empty.copy(),
            np.empty((0, 2, 2)),
        )  # fmt: skip
