"""Tables of drives: of drivers, and of associators whose map survives or does not."""

from __future__ import annotations

from dataclasses import replace

import pandas as pd

from agents.drivers.clairvoyant import Clairvoyant
from agents.evaluation.associators import JOIN
from agents.evaluation.episodes import LOST_MEANS
from agents.evaluation.pipeline import Results
from agents.evaluation.tables import (
    Column,
    Rows,
    Table,
    by_name,
    by_setting,
    columns,
    counted,
    difference,
    estimate_of,
    estimates,
)
from slam_gym.metrics.statistics import mean
from slam_gym.simulation.judged import CEILING

(LOST,) = columns("map_lost")
DRIVER_COLUMNS = columns(
    "map_error", "map_error_aligned", "coverage", "precision", "recall", "anees", "map_lost", "ticks",
    "ticks_per_second",
)  # fmt: skip
ASSOCIATOR_COLUMNS = columns(
    "precision", "recall", "f1", "exact", "duplicates", "nodes", "microseconds", "limits", "map_error",
    "map_error_aligned", "anees",
)  # fmt: skip
RELOCATION_COLUMNS = columns("recovered", "relocations_wrong", "ticks_astray")


def drive_tables(results: Results) -> list[Table]:
    """One table a scenario, of those who were evaluated in the order in which they were asked for.

    Models of one agent are pooled. Where a robot was carried away, there are columns about relocation.
    """
    drivers, found = results.metadata["kind"] == "drivers", []
    for setting, own in by_setting(results.frame).items():
        shown = [*(DRIVER_COLUMNS if drivers else ASSOCIATOR_COLUMNS)]
        shown += RELOCATION_COLUMNS if own["kidnapped"].any() else []
        title = f"{setting}, {counted(own['episode'].nunique(), 'episode')}"
        title += "" if drivers else f", driven by {results.conditions['driver']}"
        rows = {name: estimates(episodes, shown) for name, episodes in by_name(own).items()}
        table = Table(title, "agent" if drivers else "associator", shown, rows)
        if Clairvoyant.name in rows:
            table = replace(table, caption=f"{table.caption}; clairvoyant is shown the plan: the upper reference")
        found.append(table)
    return found


def associator_tables(results: Results) -> list[Table]:
    """One table a scenario; then the headline."""
    return [*drive_tables(results), *headline(results.frame)]


# -- whose map survives ----------------------------------------------------------------------------------------------


def headline(frame: pd.DataFrame) -> list[Table]:
    """Two tables: mean map errors and lost maps, and paired differences to the truth with the same relocation."""
    means = [Column(setting, setting, 3, "lower") for setting in (*by_setting(frame), "mean")]
    groups = by_name(frame)
    errors: Rows = {}
    gaps: Rows = {}
    for name, own in groups.items():
        settings = by_setting(own) | {"mean": own}
        errors[name] = {setting: estimate_of(some, "map_error", mean) for setting, some in settings.items()}
        errors[name] |= {"median": float(own["map_error"].median()), LOST.key: estimate_of(own, LOST.key, mean)}
        associator, join, relocation = name.partition(JOIN)
        truth = f"{CEILING}{join}{relocation}"
        if associator != CEILING and truth in groups:
            of_truth = by_setting(groups[truth]) | {"mean": groups[truth]}
            gaps[name] = {
                setting: difference(some, of_truth[setting], "map_error", mean) for setting, some in settings.items()
            }
    caption = f"mean map error, 95 % bootstrap interval; {LOST_MEANS}"
    shown = [*means, Column("median", "median", 3, "lower"), LOST]
    found = [Table("Map error", "associator", shown, errors, caption)]
    if gaps:
        caption = "mean over the same episodes, 95 % bootstrap interval"
        title = "Map error above that of true association with the same relocation"
        found.append(Table(title, "associator", means, gaps, caption, differences=True))
    return found
