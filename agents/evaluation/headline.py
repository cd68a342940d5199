"""Whose map survives: mean map error by scenario, what it lies above that of the truth, and how often all was lost."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agents.evaluation.episodes import LOST_DUPLICATES, LOST_ERROR
from agents.evaluation.records import Record
from agents.evaluation.tables import Column, Rows, Table, by_name, by_setting, mean_difference, sample
from slam_gym.metrics.statistics import Interval, mean
from slam_gym.simulation.judged import CEILING

JOIN = " + "
"""Between an associator and the search that finds a lost robot for it, in the name of what was evaluated."""


LOST = Column("map_lost", "lost", 3, "lower", rare=True)
LOST_MEANS = (
    f"lost: fraction of episodes with a map error above {LOST_ERROR:g} "
    f"or more than {LOST_DUPLICATES:g} features mapped twice"
)


def subject(associator: str, relocation: str | None) -> str:
    """What an associator is called beside itself with another relocation."""
    return associator if relocation is None else f"{associator}{JOIN}{relocation}"


def headline(records: Sequence[Record]) -> list[Table]:
    """Two tables: map errors and lost maps, and paired differences to the truth with the same relocation."""
    settings = list(by_setting(records))
    columns = [Column(setting, setting, 3, "lower") for setting in settings]
    overall = (
        Column("mean", "mean", 3, "lower"),
        Column("median", "median", 3, "lower"),
        LOST,
    )
    groups = by_name(records, "associator")
    rows: Rows = {name: _errors(own) for name, own in groups.items()}
    caption = f"mean map error, 95 % bootstrap interval; {LOST_MEANS}"
    found = [Table("Map error", "associator", [*columns, *overall], rows, caption)]
    gaps = {name: _gaps(own, groups[truth]) for name, own in groups.items() if (truth := _truth(name, groups))}
    if gaps:
        caption = "mean over the same episodes, 95 % bootstrap interval"
        title = "Map error above that of true association with the same relocation"
        found.append(Table(title, "associator", [*columns, overall[0]], gaps, caption, differences=True))
    return found


def _errors(records: Sequence[Record]) -> dict[str, Interval | float]:
    """Scenario → mean map error; and of all scenarios the mean, the median and the fraction of lost maps."""
    by_scenario = {name: sample(own, "map_error").summary(mean) for name, own in by_setting(records).items()}
    errors, lost = sample(records, "map_error"), sample(records, "map_lost")
    middle = float(np.median(errors.values))
    return {**by_scenario, "mean": errors.summary(mean), "median": middle, "map_lost": lost.summary(mean)}


def _truth(name: str, groups: dict[str, list[Record]]) -> str | None:
    """The truth that a name is held against: that with the same relocation; none for the truth itself."""
    associator, join, relocation = name.partition(JOIN)
    truth = f"{CEILING}{join}{relocation}"
    return truth if associator != CEILING and truth in groups else None


def _gaps(records: Sequence[Record], truth: Sequence[Record]) -> dict[str, Interval | float]:
    of_truth = by_setting(truth)
    found = {name: mean_difference(own, of_truth[name], "map_error") for name, own in by_setting(records).items()}
    return {**found, "mean": mean_difference(records, truth, "map_error")}
