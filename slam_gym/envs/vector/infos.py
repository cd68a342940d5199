"""Infos of many worlds as arrays, in Gymnasium's convention: beside every `key`, `_key` tells which worlds have it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

Infos = dict[str, Any]


def enter(infos: Infos, info: dict[str, Any], world: int, count: int) -> None:
    """Enter the info of one of `count` worlds. The first world that has a key decides its type and shape."""
    for key, value in info.items():
        mask = infos.get(f"_{key}")
        if isinstance(value, dict) and key != "final_obs":
            array = infos.setdefault(key, {})
            enter(array, value, world, count)
        else:
            array = infos.get(key)
            if array is None:
                array = infos[key] = _empty("object" if key == "final_obs" else value, count)
            array[world] = value
        if mask is None:
            mask = infos[f"_{key}"] = np.zeros(count, np.bool_)
        mask[world] = True


def _empty(value: Any, count: int) -> Any:
    """An array (count, …) for values like this one."""
    if type(value) in (int, float, bool) or isinstance(value, np.number):
        return np.zeros(count, type(value))
    if isinstance(value, np.ndarray):
        return np.zeros((count, *value.shape), value.dtype)
    return np.full(count, None, object)


def joined(parts: Sequence[Infos], rows: Sequence[range], count: int) -> Infos:
    """One for all `count` worlds, from those of groups of worlds, which have the given rows."""
    if len(parts) == 1:
        return parts[0]
    infos: Infos = {}
    for part, of_part in zip(parts, rows):
        _enter_group(infos, part, slice(of_part.start, of_part.stop), count)
    return infos


def _enter_group(infos: Infos, part: Infos, rows: slice, count: int) -> None:
    for key, values in part.items():
        if isinstance(values, dict):
            _enter_group(infos.setdefault(key, {}), values, rows, count)
            continue
        array = infos.get(key)
        if array is None:
            empty = None if values.dtype == object else 0
            array = infos[key] = np.full((count, *values.shape[1:]), empty, values.dtype)
        array[rows] = values
