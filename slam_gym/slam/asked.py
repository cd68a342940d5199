"""An associator as a SLAM step asks it: the package's own by name, a stranger's with arrays that it cannot change."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, TypeVar

import numpy as np

from slam_gym.association import ASSOCIATORS, resolve_associator
from slam_gym.mapping.linear_algebra import read_only
from slam_gym.types import Associator, Hypothesis, Prediction, Scan

T = TypeVar("T", Scan, Prediction)

_NAMES: dict[type, tuple[str, ...]] = {each: tuple(f.name for f in fields(each)) for each in (Scan, Prediction)}


def asked(associator: str | Associator) -> Associator:
    """What is to be called with a scan and a prediction, from a name, `"module:function"` or a callable.

    What is not one of the package's own, by name, is handed read-only views: what it writes to would be what others
    are scored on. Raises ValueError for an unknown name.
    """
    found = resolve_associator(associator)
    own = isinstance(associator, str) and associator in ASSOCIATORS
    return found if own or isinstance(found, _Guarded) else _Guarded(found)


@dataclass(frozen=True, slots=True)
class _Guarded:
    associate: Associator

    def __call__(self, scan: Scan, prediction: Prediction) -> Hypothesis:
        return self.associate(_locked(scan), _locked(prediction))


def _locked(value: T) -> T:
    """The same, its arrays read-only."""
    parts = [getattr(value, name) for name in _NAMES[type(value)]]
    make: Any = type(value)
    locked: T = make(*[read_only(part) if isinstance(part, np.ndarray) else part for part in parts])
    return locked
