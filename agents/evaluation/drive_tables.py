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
    counted,
    difference,
    estimate_of,
    estimates,
)
from slam_gym.metrics.statistics import mean
from slam_gym.simulation.judged import CEILING

LOST = Column("map_lost", "lost", 3, "lower", rare=True)
DRIVER_COLUMNS = (
    Column("map_error", "map error", 3, "lower"),
    Column("local_error", "local error", 3, "lower"),
    Column("coverage", "coverage", 3, "higher"),
    Column("precision", "precision", 3, "higher"),
    Column("recall", "recall", 3, "higher"),
    Column("anees", "ANEES", 2),
    LOST,
    Column("ticks", "ticks", 0),
    Column("ticks_per_second", "ticks/s", 0),
)
ASSOCIATOR_COLUMNS = (
    Column("precision", "precision", 3, "higher"),
    Column("recall", "recall", 3, "higher"),
    Column("f1", "F1", 3, "higher"),
    Column("exact", "exact", 3, "higher"),
    Column("duplicates", "dupl.", 1, "lower"),
    Column("nodes", "nodes", 0),
    Column("microseconds", "µs/scan", 0, "lower"),
    Column("limits", "limit met", 1, "lower", rare=True),
    Column("map_error", "map error", 3, "lower"),
    Column("local_error", "local error", 3, "lower"),
    Column("anees", "ANEES", 2),
)
RELOCATION_COLUMNS = (
    Column("recovered", "recovered", 2, "higher"),
    Column("relocations_wrong", "wrong reloc.", 1, "lower"),
    Column("ticks_astray", "ticks astray", 0, "lower"),
)


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


def drive_table(frame: pd.DataFrame, corner: str, columns: Sequence[Column], title: str) -> Table:
    """Estimates over the episodes of each name; where a robot was carried away, of relocation as well."""
    columns = (*columns, *RELOCATION_COLUMNS) if frame["kidnapped"].any() else columns
    return Table(title, corner, columns, {name: estimates(own, columns) for name, own in by_name(frame).items()})


# -- whose map survives ----------------------------------------------------------------------------------------------


def headline(frame: pd.DataFrame) -> list[Table]:
    """Two tables: mean map errors and lost maps, and paired differences to the truth with the same relocation."""
    columns = [
        *(Column(setting, setting, 3, "lower") for setting in by_setting(frame)),
        Column("mean", "mean", 3, "lower"),
    ]
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
    found = [
        Table("Map error", "associator", [*columns, Column("median", "median", 3, "lower"), LOST], errors, caption)
    ]
    if gaps:
        caption = "mean over the same episodes, 95 % bootstrap interval"
        title = "Map error above that of true association with the same relocation"
        found.append(Table(title, "associator", columns, gaps, caption, differences=True))
    return found
