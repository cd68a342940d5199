"""Tables of drives: of drivers, and of associators whose map survives or does not."""

from __future__ import annotations

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
    Value,
    by_name,
    by_setting,
    counted,
    difference,
    display_name,
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
    Column("f1", "F1", 3, "higher", optional=True),
    Column("exact", "exact", 3, "higher"),
    Column("duplicates", "dupl.", 1, "lower"),
    Column("nodes", "nodes", 0),
    Column("microseconds", "µs/scan", 0, "lower"),
    Column("map_error", "map error", 3, "lower"),
    Column("local_error", "local error", 3, "lower", optional=True),
    Column("anees", "ANEES", 2),
)
RELOCATION_COLUMNS = (
    Column("recovered", "recovered", 2, "higher"),
    Column("relocations_wrong", "wrong reloc.", 1, "lower", optional=True),
    Column("ticks_astray", "ticks astray", 0, "lower", optional=True),
)
BEFORE_RELOCATION = tuple(column for column in ASSOCIATOR_COLUMNS if column.key not in ("f1", "nodes", "duplicates"))


def driver_tables(results: Results) -> list[Table]:
    """The table, of the agents in the order in which they were asked for; models of one agent are pooled."""
    title = f"{world_of(results.conditions)}, {counted(results.frame['episode'].nunique(), 'episode')}"
    rows = {agent: estimates(own, DRIVER_COLUMNS) for agent, own in by_name(results.frame).items()}
    table = Table(title, "agent", DRIVER_COLUMNS, rows)
    if Clairvoyant.name not in rows:
        return [table]
    return [replace(table, caption=f"{table.caption}; clairvoyant is shown the plan: the upper reference")]


def kidnappings(results: Results) -> list[str]:
    """What became of the robots that were carried away, a line an agent; nothing of agents whose robot was not."""
    lines = []
    for agent, episodes in by_name(results.frame).items():
        own = episodes[episodes["kidnapped"] > 0.0]
        if own.empty:
            continue
        found = own[own["recovered"] > 0.0]
        line = f"{display_name(agent)}: carried away {len(own)}, recovered {len(found)}, never {len(own) - len(found)}"
        line += f", wrong relocations {own['relocations_wrong'].sum():.0f}"
        astray = f"; ticks astray {found['ticks_astray'].median():.0f} (median of the recovered)"
        lines.append(line + (astray if len(found) else ""))
    return lines


def associator_tables(results: Results) -> list[Table]:
    """One table a scenario, with the associators in the order in which they were asked for; then the headline."""
    return [*scenario_tables(results), *headline(results.frame)]


def scenario_tables(results: Results) -> list[Table]:
    """One table a scenario; where a robot was carried away, some columns are about relocation."""
    conditions = results.conditions
    floor = f" on {Path(conditions['floor_plan']).name}" if conditions.get("floor_plan") else ""
    found = []
    for setting, own in by_setting(results.frame).items():
        columns = BEFORE_RELOCATION + RELOCATION_COLUMNS if own["kidnapped"].any() else ASSOCIATOR_COLUMNS
        rows = {name: estimates(episodes, columns) for name, episodes in by_name(own).items()}
        count = counted(own["episode"].nunique(), "episode")
        found.append(Table(f"{setting}{floor}, {count}, driven by {conditions['driver']}", "associator", columns, rows))
    return found


# -- whose map survives ----------------------------------------------------------------------------------------------


def headline(frame: pd.DataFrame) -> list[Table]:
    """Two tables: mean map errors and lost maps, and paired differences to the truth with the same relocation."""
    columns = [Column(setting, setting, 3, "lower") for setting in by_setting(frame)]
    overall = Column("mean", "mean", 3, "lower")
    groups = by_name(frame)
    rows: Rows = {name: _errors(own) for name, own in groups.items()}
    caption = f"mean map error, 95 % bootstrap interval; {LOST_MEANS}"
    all_columns = [*columns, overall, Column("median", "median", 3, "lower"), LOST]
    found = [Table("Map error", "associator", all_columns, rows, caption)]
    gaps = {name: _gaps(own, groups[truth]) for name, own in groups.items() if (truth := _truth_for(name)) in groups}
    if gaps:
        caption = "mean over the same episodes, 95 % bootstrap interval"
        title = "Map error above that of true association with the same relocation"
        found.append(Table(title, "associator", [*columns, overall], gaps, caption, differences=True))
    return found


def _errors(frame: pd.DataFrame) -> dict[str, Value]:
    """Scenario → mean map error; and of all scenarios the mean, the median and the fraction of lost maps."""
    by_scenario = {name: estimate_of(own, "map_error", mean) for name, own in by_setting(frame).items()}
    errors, lost = estimate_of(frame, "map_error", mean), estimate_of(frame, "map_lost", mean)
    return {**by_scenario, "mean": errors, "median": float(frame["map_error"].median()), "map_lost": lost}


def _truth_for(name: str) -> str:
    """The truth that a name is held against: that with the same relocation; none for the truth itself."""
    associator, join, relocation = name.partition(JOIN)
    return f"{CEILING}{join}{relocation}" if associator != CEILING else ""


def _gaps(frame: pd.DataFrame, truth: pd.DataFrame) -> dict[str, Value]:
    of_truth = by_setting(truth)
    found = {name: difference(own, of_truth[name], "map_error", mean) for name, own in by_setting(frame).items()}
    return {**found, "mean": difference(frame, truth, "map_error", mean)}
