"""Problems for walks of the tree without a prior, and walks of them."""

import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from slam_gym.association.relocation.walk import RelocationWalk, WalkSpec
from slam_gym.association.walks import Observation
from slam_gym.types import Array, BoolArray, Landmarks, Locality, Scan
from tests.oracles import relocation

LOCALITIES = ["everything", "distance", "covisibility"]
ALL = WalkSpec(candidates=100, order="as_scanned", node_limit=10**6)
Planted = tuple[Scan, Landmarks, Array, dict[str, Locality | None], np.random.Generator]


def plant(seed: int, m: int = 4, n: int = 7, **changes: Any) -> Planted:
    """Scan, map, its joint covariance, localities and the generator that they are from."""
    rng = np.random.default_rng(seed)
    scan, landmarks, P = relocation.problem(rng, m, n, keep=("dense", "blocks", "none")[seed % 3], **changes)
    return scan, landmarks, P, relocation.localities(rng, landmarks), rng


def easy(seed: int, m: int = 8, n: int = 25) -> Planted:
    """A scan that is plain to relocate: a wide map with small errors."""
    return plant(seed, m, n, spread=8.0, sigma=0.02)


def pairs_of(walk: RelocationWalk) -> list[tuple[int, int]]:
    """(measurement, feature) of the path."""
    return [(int(i), int(j)) for i, j in zip(walk.node.path.measurements, walk.node.path.features)]


def walk_randomly(walk: RelocationWalk, rng: np.random.Generator) -> Iterator[None]:
    """Yields at every decision, then takes a legal branch at random, until a leaf."""
    while not walk.at_leaf:
        yield
        walk.take(int(rng.choice(np.flatnonzero(walk.mask[:-1]))))


def by_chance(observation: Observation, mask: BoolArray) -> int:
    """A policy: any legal action, the same for the same observation."""
    drawn = zlib.crc32(b"".join(part.tobytes() for part in observation.values()))
    return int(np.random.default_rng(drawn).choice(np.flatnonzero(mask)))
