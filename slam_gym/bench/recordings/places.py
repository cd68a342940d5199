"""Real places to be lost in: a map, and scans that were not used to make it, each with where it was really taken."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from slam_gym.bench.answers import Tolerance
from slam_gym.types import Array, Landmarks, Locality, Scan

Item = TypeVar("Item")

LOCALITIES = ("covisibility", "two hops", "distance", "local maps", "everything")


@dataclass(frozen=True)
class PlacedScan:
    """A scan, and where it was taken."""

    scan: Scan
    pose: Array  # (3,) in the frame of the map
    inside: bool  # the place is in the map
    gps: Array = field(default_factory=lambda: np.full(2, np.nan))  # (2,) [m] likewise; NaN where there was no fix


@dataclass(frozen=True, eq=False)
class Place:
    """A map to be lost in."""

    name: str
    landmarks: Landmarks
    localities: Mapping[str, Locality | None]
    scans: Sequence[PlacedScan]
    near: Tolerance  # within which an answer is right


def spread(items: Sequence[Item], count: int) -> list[Item]:
    """At most `count` of the items, evenly spread."""
    if len(items) <= count:
        return list(items)
    return [items[i] for i in np.linspace(0, len(items) - 1, count).astype(int).tolist()]
