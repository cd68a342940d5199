"""Looks that repeat others: a feature that is seen again from the same place tells nothing new.

The filter takes the errors of measurements for independent. Those of a camera that looks at the same mark from the same
place are not: what the first of a hundred frames is off by, the hundredth is as well. Counted a hundred times, it makes
the map certain of a pose that is wrong, and its gates turn away what is right. A pairing with a feature that the map
has learned from a moment ago is therefore no part of the update until the robot has driven or turned enough.
"""

from __future__ import annotations

import math

import numpy as np

from slam_gym.types import NO_ID, UNPAIRED, BoolArray, IntArray, Odometry, SlamStep


class Looks:
    """Where the robot was, along its way, when the map last learned from each feature.

    Arguments:
        travel: [m] that it must have driven since, or
        turn: [rad] turned, for the feature to be learned from again.
    """

    def __init__(self, travel: float, turn: float) -> None:
        self._enough = np.array([travel, turn])
        self._way = np.zeros(2)  # [m] driven and [rad] turned so far
        self._learned_at = np.full((64, 2), -math.inf)  # by id: the way so far when the feature was last learned from

    def move(self, odometry: Odometry) -> None:
        """Go on by the motion."""
        x, y, turn = odometry.motion.tolist()
        self._way += (math.hypot(x, y), abs(turn))

    def fresh(self, features: IntArray, ids: IntArray) -> IntArray:
        """The pairings (m,) that tell something: `features` (m,) with UNPAIRED for those that repeat others.

        `ids` (n,) are those of the map's features.
        """
        paired = np.flatnonzero(features != UNPAIRED)
        out: IntArray = features.copy()
        out[paired[self._repeated(ids[features[paired]])]] = UNPAIRED
        return out

    def learned(self, step: SlamStep) -> None:
        """Remember the features that a step has updated or started, but for those that it has seen again."""
        ids = step.ids[step.ids != NO_ID]
        fresh = ids[~self._repeated(ids)]
        while len(fresh) and fresh.max() >= len(self._learned_at):
            self._learned_at = np.concatenate([self._learned_at, np.full_like(self._learned_at, -math.inf)])
        self._learned_at[fresh] = self._way

    def _repeated(self, ids: IntArray) -> BoolArray:
        """(k,) which of the features the map has learned from too short a while ago."""
        at = np.full((len(ids), 2), -math.inf)
        known = ids < len(self._learned_at)
        at[known] = self._learned_at[ids[known]]
        near: BoolArray = (self._way - at < self._enough).all(axis=1)
        return near
