"""Associators: walks of the interpretation tree, from a `Scan` and a `Prediction` to a `Hypothesis`."""

from __future__ import annotations

import importlib
from collections.abc import Callable

from slam_gym.association.ground_truth import true_association
from slam_gym.association.jcbb import jcbb
from slam_gym.association.nearest import nearest_neighbour, singles
from slam_gym.types import Hypothesis

__all__ = ["ASSOCIATORS", "jcbb", "nearest_neighbour", "resolve", "singles", "true_association"]

ASSOCIATORS: dict[str, Callable[..., Hypothesis]] = {
    "jcbb": jcbb,
    "nearest_neighbour": nearest_neighbour,
    "singles": singles,
    "true_association": true_association,
}
"""Associators by name, called with (scan, prediction); only `true_association` also needs the truth of the scan."""


def resolve(associator: str | Callable[..., Hypothesis]) -> Callable[..., Hypothesis]:
    """An associator from its name, `"module:function"`, or itself.

    Raises ValueError, listing the known names, where there is none such.
    """
    if callable(associator):
        return associator
    if associator in ASSOCIATORS:
        return ASSOCIATORS[associator]
    known = f"known: {', '.join(ASSOCIATORS)}, or 'module:function'"
    module, colon, name = str(associator).partition(":")
    if not colon:
        raise ValueError(f"unknown associator {associator!r}; {known}")
    try:
        found = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"associator {associator!r}: {error}; {known}") from error
    if not callable(found):
        raise ValueError(f"associator {associator!r} is not callable; {known}")
    resolved: Callable[..., Hypothesis] = found
    return resolved
