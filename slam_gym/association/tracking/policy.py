"""A policy of the interpretation tree as an associator like any other."""

from __future__ import annotations

from dataclasses import dataclass

from slam_gym.association.prediction import Associator, Prediction
from slam_gym.association.tracking.walk import Compatibility, Walk, check_arguments
from slam_gym.association.walks import Observation, Order, Policy, play
from slam_gym.types import BoolArray, Hypothesis, Scan


def from_policy(
    policy: Policy,
    *,
    candidates: int = 5,
    order: Order = "as_scanned",
    compatibility: Compatibility = "joint",
) -> Associator:
    """The associator that walks the tree by `policy`, with the arguments of `Walk`. It pickles if the policy does.

    Raises ValueError for arguments that no `Walk` can have; the associator raises it for an action that is not legal.
    """
    check_arguments(candidates, order, compatibility)
    return _PolicyAssociator(policy, candidates, order, compatibility)


def greedy(observation: Observation, mask: BoolArray) -> int:
    """The policy that always takes the nearest legal candidate: sequential compatibility nearest neighbour."""
    return 0 if mask[0] else len(mask) - 1


@dataclass(frozen=True, slots=True)
class _PolicyAssociator:
    policy: Policy
    candidates: int
    order: Order
    compatibility: Compatibility

    def __call__(self, scan: Scan, prediction: Prediction) -> Hypothesis:
        walk = Walk(scan, prediction, candidates=self.candidates, order=self.order, compatibility=self.compatibility)
        play(walk, self.policy, walk.observation)
        return walk.hypothesis()
