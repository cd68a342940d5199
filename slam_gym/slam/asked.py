"""An associator as a SLAM step asks it: the package's own as they are, strangers with arrays they cannot change."""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass
from typing import Any, TypeVar

import numpy as np

from slam_gym.association import ASSOCIATORS, resolve_associator
from slam_gym.mapping.linear_algebra import read_only
from slam_gym.types import Associator, Hypothesis, Prediction, Scan

T = TypeVar("T")

_NAMES: dict[type, tuple[str, ...]] = {}  # fields of each dataclass that was locked so far


def asked(associator: str | Associator) -> Associator:
    """What is to be called with a scan and a prediction, from a name, `"module:function"` or a callable.

    What is none of the package's own is handed read-only arrays: what it writes to would be what others are scored on.
    The own ones need not be told, and are compiled for plain arrays. Raises ValueError for an unknown name.
    """
    found = resolve_associator(associator)
    own = any(found is known for known in ASSOCIATORS.values())
    return found if own or isinstance(found, _Guarded) else _Guarded(found)


def locked(value: T) -> T:
    """The same dataclass, its arrays and those of the dataclasses in it read-only."""
    kind: Any = type(value)
    if kind not in _NAMES:
        _NAMES[kind] = tuple(field.name for field in fields(kind))
    out: T = kind(*[_part(getattr(value, name)) for name in _NAMES[kind]])
    return out


def _part(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return read_only(value)
    return locked(value) if is_dataclass(value) else value


@dataclass(frozen=True, slots=True)
class _Guarded:
    associate: Associator

    def __call__(self, scan: Scan, prediction: Prediction) -> Hypothesis:
        return self.associate(locked(scan), locked(prediction))
