"""The frozen protocol: on which worlds an entry is judged, by what, and the hashes that say so.

What an entry loses is a number in an episode, 0 at best: the map's error where something is driven, 1 − score in the
suite, 1 − F1 over a recording. A column is an experiment or a scenario; the mean over the columns that need no data
ranks.
"""

from __future__ import annotations

import functools
import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, is_dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from agents.evaluation.episodes import ExploreArguments
from agents.evaluation.records import PROTOCOL
from agents.ranking.served import Role
from slam_gym.recordings.catalogue import DATA
from slam_gym.scenarios import get_scenario, world_generator
from slam_gym.scenarios.suite import EXPERIMENTS, RELOCATION
from slam_gym.world.floor_plan import FloorPlan

VERSION = 2
"""Of the protocol: raised with any change of what follows, or of how an episode is run."""

SPLIT = "test"
FIRST = 1000  # of its worlds: those before it are looked at while somebody develops, and tell less
PROBLEMS = 12  # of a world of the suite, at most
DRIVER = "information_gain"  # where the entry does not drive


@dataclass(frozen=True)
class Part:
    """Some episodes of one setting."""

    kind: Literal["drive", "suite", "floor", "log"]
    setting: str  # scenario, level of the suite, file of a floor or name of a recording
    count: int  # of its worlds, from `FIRST` of the split on

    @property
    def worlds(self) -> range:
        """Their numbers in the split."""
        return range(FIRST, FIRST + self.count)

    @property
    def column(self) -> str:
        """What it is counted under."""
        return self.setting.partition("/")[0] if self.kind in ("drive", "suite") else Path(self.setting).name[:8]

    @property
    def needs_data(self) -> bool:
        """It is no part of the mean that ranks."""
        return self.kind in ("floor", "log")

    def arguments(self) -> ExploreArguments:
        """Of the environment, where something is driven."""
        if self.kind == "drive":
            return ExploreArguments(self.setting, split=SPLIT)
        return ExploreArguments("building", split=SPLIT, floor_plan=str(_data() / self.setting), resolution=0.1)


def _data() -> Path:
    return Path(os.environ.get(DATA, ""))


def _suite(experiments: Sequence[str], worlds: int) -> tuple[Part, ...]:
    return tuple(Part("suite", level.id, worlds) for name in experiments for level in EXPERIMENTS[name].levels)


def _drives(worlds: int, *scenarios: str) -> tuple[Part, ...]:
    return tuple(Part("drive", name, worlds) for name in scenarios)


_FLOORS = tuple(Part("floor", f"kth_floorplans/{name}_occ_map.npy.gz", 1) for name in ("50052748", "50052750"))
_CALM = ("office-small", "office", "aliased", "hall", "crowd")
_DRIFT = ("drift-1", "drift-2", "drift-3", "aliased-drift", "hall-drift", "crowd-drift")

PARTS: dict[str, tuple[Part, ...]] = {
    "agent": (*_drives(8, *_CALM, "drift-1", "drift-2", "drift-3"), *_FLOORS),
    "associator": (
        *_suite([name for name in EXPERIMENTS if name != RELOCATION], 4),
        *_drives(6, *_DRIFT),
        *_FLOORS,
        Part("log", "victoria_park", 1),
    ),
    "relocator": (*_suite([RELOCATION], 8), *_drives(6, "kidnapped", "drift-2", "drift-3", "aliased-drift")),
}  # fmt: skip
QUICK: dict[str, tuple[Part, ...]] = {
    "agent": _drives(1, "office-small"),
    "associator": (Part("suite", "clutter/1", 1), *_drives(1, "office-small")),
    "relocator": (Part("suite", "kidnapped/0", 1), *_drives(1, "office-small")),
}
"""For tests: ranked among themselves only."""


class Protocol(NamedTuple):
    """What an entry of a role is put through."""

    role: Role
    quick: bool
    parts: tuple[Part, ...]  # those that there are data for

    @property
    def about(self) -> dict[str, object]:
        """Which protocol it is, for records and entries."""
        return {"version": VERSION, "role": self.role, "quick": self.quick, "hash": self.hash}

    @property
    def hash(self) -> str:
        """Of everything that is frozen, whether there are data for it or not."""
        parts = [asdict(part) for part in _all(self.role, self.quick)]
        frozen = {
            "version": VERSION,
            "split": SPLIT,
            "first": FIRST,
            "problems": PROBLEMS,
            "driver": DRIVER,
            "parts": parts,
        }
        return _digest(json.dumps(frozen, sort_keys=True).encode())

    def worlds_hash(self) -> str:
        """Of the floors, to a micrometre, of the parts that need no data, and of robot, sensors, filter and budget."""
        parts = [part for part in self.parts if not part.needs_data]
        plans = [_plan_hash(part.setting, world) for part in parts for world in part.worlds]
        return _digest("".join([str(PROTOCOL), *(_settings(part.setting) for part in parts), *plans]).encode())


def protocol(role: Role, quick: bool = False) -> Protocol:
    """The protocol of a role; without the parts whose data are not there."""
    return Protocol(role, quick, tuple(part for part in _all(role, quick) if not part.needs_data or _is_there(part)))


def _all(role: Role, quick: bool) -> tuple[Part, ...]:
    return (QUICK if quick else PARTS)[role]


def _is_there(part: Part) -> bool:
    return bool(os.environ.get(DATA)) and (_data() / part.setting).exists()


def _settings(setting: str) -> str:
    """Everything in a scenario but its floors."""
    return _said(get_scenario(setting), without="generator")


def _said(value: object, without: str = "") -> str:
    """A value, however deep; what a scenario does not ask for says nothing: a new option changes no hash."""
    if not is_dataclass(value):
        return repr(value)
    held = {f.name: getattr(value, f.name) for f in fields(value) if f.name != without}
    said = {n: v for n, v in held.items() if v is not False}
    return f"{type(value).__name__}({', '.join(f'{n}={_said(v)}' for n, v in said.items())})"


@functools.cache
def _plan_hash(setting: str, world: int) -> str:
    plan: FloorPlan = get_scenario(setting).generator(world_generator(SPLIT, world))
    parts = (plan.walls, plan.features.positions, plan.features.sizes, plan.furniture)
    return _digest(b"".join(np.round(np.asarray(part, np.float64) * 1e6).astype(np.int64).tobytes() for part in parts))


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]
