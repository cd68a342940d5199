"""A policy of the tree without a prior as a relocator like any other; and two plain policies to compare with."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from slam_gym.association.relocation.observation import (
    CANDIDATE_FIELDS,
    COUNT_SCALE,
    PATH_FIELDS,
    SEARCH_FIELDS,
    observe_walk,
    unsquash,
)
from slam_gym.association.relocation.walk import RelocationOrder, RelocationWalk, WalkSpec
from slam_gym.association.walks import Observation, Policy, play
from slam_gym.types import BoolArray, Landmarks, Locality, Relocation, Relocator, Scan


def relocator_from_policy(
    policy: Policy,
    *,
    candidates: int = 8,
    order: RelocationOrder = "fewest_candidates",
    node_limit: int = 300,
    sizes: bool = True,
    confidence: float = 0.99,
    measurements: int = 20,
    seed: int = 0,
) -> Relocator:
    """The relocator that walks the tree by `policy`, with the settings of `WalkSpec`. It pickles if the policy does.

    `measurements` rows of a scan are shown; `seed` deals the levels with `order="random"`. Raises ValueError for
    settings that are none; the relocator raises it for bad scans and maps, and for an action that is not legal.
    """
    if measurements < 1:
        raise ValueError(f"measurements: {measurements} is less than 1")
    return _PolicyRelocator(policy, WalkSpec(candidates, order, node_limit, sizes, confidence), measurements, seed)


@dataclass(frozen=True, slots=True)
class _PolicyRelocator:
    policy: Policy
    spec: WalkSpec
    measurements: int
    seed: int

    def __call__(self, scan: Scan, landmarks: Landmarks, locality: Locality | None = None) -> Relocation:
        walk = RelocationWalk(self.spec, scan, landmarks, locality, np.random.default_rng(self.seed))
        play(walk, self.policy, lambda: observe_walk(walk, self.measurements))
        return walk.answer()


def greedy_relocation(observation: Observation, mask: BoolArray) -> int:
    """One try: always the candidate with most support; stops at the first leaf."""
    return 0 if mask[0] else len(mask) - 2


class SampledRelocation:
    """Random sampling by restarts: try after try takes branches at random, until a hypothesis is believed.

    A branch's chance is exp(β / `temperature`), β being the share of the scan that the hypothesis could then come to
    pair. Where a try can no longer beat the best, or reach what it takes to be believed, it is given up. Stops after
    `tries`. Chance is drawn from `seed` and what is observed, so that the same walk goes the same way again.
    """

    def __init__(self, tries: int = 20, temperature: float = 0.05, seed: int = 0) -> None:
        if tries < 1 or not temperature > 0.0:
            raise ValueError(f"tries, temperature: {tries}, {temperature}: expected >= 1 and > 0")
        self.tries, self.temperature, self.seed = tries, temperature, seed

    def __call__(self, observation: Observation, mask: BoolArray) -> int:
        path = dict(zip(PATH_FIELDS, observation["path"].tolist()))
        search = dict(zip(SEARCH_FIELDS, observation["search"].tolist()))
        again = mask[-1] and not search["accepted"] and unsquash(search["tries"], COUNT_SCALE) + 1.5 < self.tries
        hopeless = path["bound"] <= search["best"] or path["bound"] < search["needed"]
        if again and (path["leaf"] or hopeless):
            return len(mask) - 1
        legal = np.flatnonzero(mask[:-1])
        if len(legal) == 1:
            return int(legal[0])
        rows = observation["candidates"].reshape(len(mask) - 2, -1)
        bounds = np.append(rows[:, CANDIDATE_FIELDS.index("bound")], path["without"])[legal].astype(np.float64)
        weights = np.exp((bounds - bounds.max()) / self.temperature)
        return int(self._rng(observation).choice(legal, p=weights / weights.sum()))

    def _rng(self, observation: Observation) -> np.random.Generator:
        return np.random.default_rng([self.seed, *(zlib.crc32(part.tobytes()) for part in observation.values())])
