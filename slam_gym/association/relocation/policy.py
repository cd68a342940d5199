"""A policy of the tree without a prior as a relocator like any other; and a plain policy to compare with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from slam_gym.association.relocation.observation import observe_walk
from slam_gym.association.relocation.walk import RelocationWalk, WalkSpec
from slam_gym.association.walks import Observation, Policy, play
from slam_gym.types import BoolArray, Landmarks, Locality, Relocation, Relocator, Scan


def relocator_from_policy(policy: Policy, *, measurements: int = 20, **settings: Any) -> Relocator:
    """The relocator that walks the tree by `policy`, with the settings of `WalkSpec`. It pickles if the policy does.

    `measurements` rows of a scan are shown. Raises ValueError for settings that are none; the relocator raises it for
    bad scans and maps, and for an action that is not legal.
    """
    if measurements < 1:
        raise ValueError(f"measurements: {measurements} is less than 1")
    return _PolicyRelocator(policy, WalkSpec(**settings), measurements)


@dataclass(frozen=True, slots=True)
class _PolicyRelocator:
    policy: Policy
    spec: WalkSpec
    measurements: int

    def __call__(self, scan: Scan, landmarks: Landmarks, locality: Locality | None = None) -> Relocation:
        walk = RelocationWalk(self.spec, scan, landmarks, locality)
        play(walk, self.policy, lambda: observe_walk(walk, self.measurements))
        return walk.answer()


def greedy_relocation(observation: Observation, mask: BoolArray) -> int:
    """One try: always the candidate with most support; stops at the first leaf."""
    return 0 if mask[0] else len(mask) - 2
