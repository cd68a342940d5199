"""Records of what benchmarks measure: one dict per scan, run or call, which is also a row of a CSV file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from slam_gym.types import Array

Record = dict[str, Any]
"""Figures by their headings."""


class Group(NamedTuple):
    """Records that agree in some of their entries."""

    key: Record  # these entries
    records: list[Record]


def grouped(records: Iterable[Record], *names: str) -> list[Group]:
    """Records by their entries `names`; values of each come in the order in which they first appear."""
    groups: dict[tuple[Any, ...], list[Record]] = {}
    for record in records:
        groups.setdefault(tuple(record[name] for name in names), []).append(record)
    ranks: list[dict[Any, int]] = [{} for _ in names]
    for key in groups:
        for rank, value in zip(ranks, key):
            rank.setdefault(value, len(rank))
    in_order = sorted(groups, key=lambda key: [rank[value] for rank, value in zip(ranks, key)])
    return [Group(dict(zip(names, key)), groups[key]) for key in in_order]


def column(records: Sequence[Record], name: str) -> Array:
    """(r,) one entry of every record, as a number."""
    return np.array([record[name] for record in records], dtype=np.float64)


def means(records: Sequence[Record], *names: str) -> Record:
    """Mean of each entry; NaN without records."""
    return {name: float(column(records, name).mean()) if records else np.nan for name in names}


def medians(records: Sequence[Record], *names: str) -> Record:
    """Median of each entry; NaN without records."""
    return {name: float(np.median(column(records, name))) if records else np.nan for name in names}
