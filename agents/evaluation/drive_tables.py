"""Tables of drives: of drivers, and of associators whose map survives or does not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd

from agents.drivers.clairvoyant import Clairvoyant
from agents.evaluation.associators import JOIN
from agents.evaluation.drives import world_of
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
    "map_error", "local_error", "coverage", "precision", "recall", "anees", "map_lost", "ticks", "ticks_per_second"
)
ASSOCIATOR_COLUMNS = columns(
    "precision", "recall", "f1", "exact", "duplicates", "nodes", "microseconds", "limits", "map_error", "local_error",
    "anees",
)  # fmt: skip
RELOCATION_COLUMNS = columns("recovered", "relocations_wrong", "ticks_astray")


def driver_tables(results: Results) -> list[Table]:
    """The table, of the agents in the order in which they were asked for; models of one agent are pooled."""
    title = f"{world_of(results.conditions)}, {counted(results.frame['episode'].nunique(), 'episode')}"
    table = drive_table(results.frame, "agent", DRIVER_COLUMNS, title)
    if Clairvoyant.name not in table.rows:
        return [table]
    return [replace(table, caption=f"{table.caption}; clairvoyant is shown the plan: the upper reference")]


def associator_tables(results: Results) -> list[Table]:
    """One table a scenario, with the associators in the order in which they were asked for; then the headline."""
    return [*scenario_tables(results), *headline(results.frame)]


def scenario_tables(results: Results) -> list[Table]:
    """One table a scenario."""
    conditions = results.conditions
    floor = f" on {Path(conditions['floor_plan']).name}" if conditions.get("floor_plan") else ""
    found = []
    for setting, own in by_setting(results.frame).items():
        title = f"{setting}{floor}, {counted(own['episode'].nunique(), 'episode')}, driven by {conditions['driver']}"
        found.append(drive_table(own, "associator", ASSOCIATOR_COLUMNS, title))
    return found


def drive_table(frame: pd.DataFrame, corner: str, shown: Sequence[Column], title: str) -> Table:
    """Estimates over the episodes of each name; where a robot was carried away, of relocation as well."""
    shown = [*shown, *(RELOCATION_COLUMNS if frame["kidnapped"].any() else [])]
    return Table(title, corner, shown, {name: estimates(own, shown) for name, own in by_name(frame).items()})


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
