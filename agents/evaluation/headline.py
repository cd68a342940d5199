"""Whose map survives: mean map error by scenario, what it lies above that of the truth, and how often all was lost."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agents.evaluation.records import Record
from agents.evaluation.tables import Column, Rows, Table, by_name, by_setting, mean_difference, sample
from slam_gym.metrics.statistics import Interval, mean
from slam_gym.simulation.judged import CEILING

LOST_ERROR, LOST_DUPLICATES = 0.8, 10.0
"""A map with a greater error, or with more features mapped twice, is a catastrophe: the building was drawn again."""

JOIN = " + "
"""Between an associator and the search that finds a lost robot for it, in the name of what was evaluated."""


def subject(associator: str, relocation: str | None) -> str:
    """What an associator is called beside itself with another relocation."""
    return associator if relocation is None else f"{associator}{JOIN}{relocation}"


def catastrophe(record: Record) -> float:
    """1 where the map of the episode is a catastrophe, else 0."""
    return float(record["map_error"] > LOST_ERROR or record["duplicates"] > LOST_DUPLICATES)


def headline(records: Sequence[Record]) -> list[Table]:
    """Two tables: map errors and catastrophes, and paired differences to the truth with the same relocation."""
    settings = list(by_setting(records))
    columns = [Column(setting, setting, 3, "lower") for setting in settings]
    overall = (
        Column("mean", "mean", 3, "lower"),
        Column("median", "median", 3, "lower"),
        Column("catastrophes", "lost", 3, "lower"),
    )
    groups = by_name(records, "associator")
    rows: Rows = {name: _errors(own) for name, own in groups.items()}
    caption = (
        "mean map error, 95 % bootstrap interval; lost: share of episodes with a map error above "
        f"{LOST_ERROR:g} or more than {LOST_DUPLICATES:g} features mapped twice"
    )
    found = [Table("Map error", "associator", [*columns, *overall], rows, caption)]
    gaps = {name: _gaps(own, groups[truth]) for name, own in groups.items() if (truth := _truth(name, groups))}
    if gaps:
        caption = "mean over the same episodes, 95 % bootstrap interval"
        title = "Map error above that of true association with the same relocation"
        found.append(Table(title, "associator", [*columns, overall[0]], gaps, caption, differences=True))
    return found


def _errors(records: Sequence[Record]) -> dict[str, Interval | float]:
    """Scenario → mean map error; and of all scenarios the mean, the median and the share of catastrophes."""
    by_scenario = {name: sample(own, "map_error").summary(mean) for name, own in by_setting(records).items()}
    lost = sample([record | {"lost": catastrophe(record)} for record in records], "lost")
    errors = sample(records, "map_error")
    middle = float(np.median(errors.values))
    return {**by_scenario, "mean": errors.summary(mean), "median": middle, "catastrophes": lost.summary(mean)}


def _truth(name: str, groups: dict[str, list[Record]]) -> str | None:
    """The truth that a name is held against: that with the same relocation; none for the truth itself."""
    associator, join, relocation = name.partition(JOIN)
    truth = f"{CEILING}{join}{relocation}"
    return truth if associator != CEILING and truth in groups else None


def _gaps(records: Sequence[Record], truth: Sequence[Record]) -> dict[str, Interval | float]:
    of_truth = by_setting(truth)
    found = {name: mean_difference(own, of_truth[name], "map_error") for name, own in by_setting(records).items()}
    return {**found, "mean": mean_difference(records, truth, "map_error")}
