"""A policy of the interpretation tree as an associator or a relocator like any other; and a plain policy."""

import functools
from typing import Any

from slam_gym.association.prediction import Associator, Prediction
from slam_gym.association.relocation.walk import RelocationWalk, WalkSpec, observe_walk
from slam_gym.association.tracking.walk import Compatibility, Walk, check_arguments
from slam_gym.association.walks import Observation, Order, Policy
from slam_gym.types import BoolArray, Hypothesis, Landmarks, Locality, Relocation, Relocator, Scan
from slam_gym.validation import check_count


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
    return functools.partial(_associate, policy=policy, candidates=candidates, order=order, compatibility=compatibility)


def relocator_from_policy(policy: Policy, *, measurements: int = 20, **settings: Any) -> Relocator:
    """The relocator that walks the tree by `policy`, with the settings of `WalkSpec`. It pickles if the policy does.

    `measurements` rows of a scan are shown. Raises TypeError for an unknown setting, and ValueError for a bad one; the
    relocator raises it for bad scans and maps, and for an action that is not legal.
    """
    check_count("measurements", measurements)
    return functools.partial(_relocate, policy=policy, spec=WalkSpec(**settings), shown=measurements)


def greedy(observation: Observation, mask: BoolArray) -> int:
    """The policy that takes the first on offer, else `*`.

    With a prior that is the nearest legal candidate: sequential compatibility nearest neighbour. Without one it is the
    candidate with most support, and the first leaf ends the walk.
    """
    return int(mask.argmax())


def _associate(scan: Scan, prediction: Prediction, *, policy: Policy, **arguments: Any) -> Hypothesis:
    walk = Walk(scan, prediction, **arguments)
    while not walk.done:
        walk.take(int(policy(walk.observation(), walk.mask.copy())))
    return walk.hypothesis()


def _relocate(
    scan: Scan, landmarks: Landmarks, locality: Locality | None = None, *, policy: Policy, spec: WalkSpec, shown: int
) -> Relocation:
    walk = RelocationWalk(spec, scan, landmarks, locality)
    while not walk.done:
        walk.take(int(policy(observe_walk(walk, shown), walk.mask.copy())))
    return walk.answer()
