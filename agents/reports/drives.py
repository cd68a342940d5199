"""The page of drives: an evaluation of drivers, or of associators in the loop."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import pandas as pd

from agents.drivers.clairvoyant import Clairvoyant
from agents.evaluation.associators import JOIN
from agents.evaluation.drives import map_path
from agents.evaluation.episodes import LOST_MEANS
from agents.evaluation.pipeline import Results
from agents.evaluation.tables import (
    INTERVALS,
    Column,
    Rows,
    Table,
    by_name,
    by_setting,
    columns,
    counted,
    difference,
    display_name,
    estimate_of,
    estimates,
)
from agents.reports import figures
from agents.reports.film import BESIDE, film_path
from agents.reports.page import Film, Page, Part, Picture
from slam_gym.metrics.statistics import mean
from slam_gym.simulation.judged import CEILING

COLUMNS = {
    "drivers": columns(
        "map_error", "map_error_aligned", "coverage", "precision", "recall", "anees", "map_lost", "ticks",
        "ticks_per_second",
    ),
    "associators": columns(
        "precision", "recall", "f1", "exact", "duplicates", "nodes", "microseconds", "limits", "map_error_aligned",
        "map_error", "anees",
    ),
}  # fmt: skip
RELOCATION_COLUMNS = columns("recovered", "relocations_wrong", "ticks_astray")
PANELS = {
    "drivers": columns("map_error", "coverage"),
    "associators": columns("precision", "recall", "map_error_aligned", "microseconds"),
}
MEAN = "mean"  # over all scenarios
PAIRED = "paired over the episodes of all scenarios; negative: the row makes the better map; bold: not 0 by chance"


def drives_page(results: Results, folder: Path) -> Page:
    """First paired differences, for associators with map errors and lost maps; a table for each scenario with its
    episodes; for drivers curves over time, for associators final maps; and the films in `folder`."""
    kind, groups, colour = results.metadata["kind"], by_name(results.frame), figures.colours(results.names)
    drivers, parts, first = kind == "drivers", list[Part](), [] if kind == "drivers" else headline(results.frame)
    for table, (setting, frame) in zip(drive_tables(results), by_setting(results.frame).items()):
        dots = partial(figures.dot_chart, by_name(frame), PANELS[kind], colour)
        parts += [table, Picture(f"Each episode of {table.title}", dots)]
        if drawn := {name: path for name in groups if (path := map_path(folder, setting, name)).exists()}:
            final = partial(figures.side_by_side, drawn)
            parts.append(Picture(f"Maps at the end of the first episode of {table.title}", final))
    if drivers:
        curves = partial(figures.curve_chart, groups, PANELS[kind], colour)
        parts += [Picture("Over time: interquartile mean over episodes, 95 % bootstrap band", curves)]
    if len(groups) > 1:
        error = "map_error" if drivers else "map_error_aligned"  # drivers are rewarded by the former
        gaps: Rows = {
            name: {other: difference(own, groups[other], error) for other in groups if other != name}
            for name, own in groups.items()
        }
        others = [Column(name, display_name(name)) for name in groups]
        corner = f"{'' if drivers else 'aligned '}map error of … minus that of"
        against = Table("Against each other", corner, others, gaps, PAIRED, differences=True, detail=True)
        (parts if any(table.differences for table in first) else first).insert(0, against)
    if (beside := film_path(folder, BESIDE)).with_suffix(".png").exists():
        parts.append(Film("Side by side", beside, None))
    for agent, own in groups.items():
        if (path := film_path(folder, agent)).with_suffix(".png").exists():
            parts.append(Film(agent, path, own.loc[own["episode"].idxmin(), "map_error"]))
    title = "Drivers" if drivers else "Associators in the loop"
    subtitle = f"slam_gym/Explore-v0: the same {results.conditions['split']} worlds and seeds for all"
    return Page(title, subtitle, parts, "drives.html", first)


def drive_tables(results: Results) -> list[Table]:
    """One table per scenario, with rows in the order of the command.

    Models of one agent are pooled. Where a robot was carried away, there are columns on relocation.
    """
    kind, tables = results.metadata["kind"], []
    for setting, frame in by_setting(results.frame).items():
        shown = COLUMNS[kind] + (RELOCATION_COLUMNS if frame["kidnapped"].any() else [])
        title = f"{setting}, {counted(frame['episode'].nunique(), 'episode')}"
        title += "" if kind == "drivers" else f", driven by {results.conditions['driver']}"
        rows = {name: estimates(episodes, shown) for name, episodes in by_name(frame).items()}
        table = Table(title, kind.removesuffix("s"), shown, rows)
        if Clairvoyant.name in rows:
            table = replace(table, caption=f"{table.caption}; clairvoyant is shown the plan: the upper reference")
        missed = int(frame["missed_loop"].sum()) if "missed_loop" in frame else 0
        if missed:
            warning = f"in {missed} of {counted(len(frame), 'drive')} the robot says that it has mapped a place twice"
            table = replace(table, caption=f"{table.caption}; {warning}")
        tables.append(table)
    return tables


def headline(frame: pd.DataFrame) -> list[Table]:
    """Two tables: paired differences to true association with the same relocation, where there are any, and aligned map
    errors with errors that are not aligned and lost maps."""
    groups, (error, raw, lost) = by_name(frame), columns("map_error_aligned", "map_error", "map_lost")
    settings = list(by_setting(frame))
    means = [
        Column(setting, setting, 3, "lower") for setting in (settings if len(settings) == 1 else [*settings, MEAN])
    ]
    errors: Rows = {}
    gaps: Rows = {}
    for name, own in groups.items():
        parts = by_setting(own) | {MEAN: own}
        errors[name] = {setting: estimate_of(some, error.key, mean) for setting, some in parts.items()}
        errors[name] |= {column.key: estimate_of(own, column.key, mean) for column in (raw, lost)}
        associator, join, relocation = name.partition(JOIN)
        truth = f"{CEILING}{join}{relocation}"
        if associator != CEILING and truth in groups:
            of_truth = by_setting(groups[truth]) | {MEAN: groups[truth]}
            gaps[name] = {
                setting: difference(some, of_truth[setting], error.key, mean) for setting, some in parts.items()
            }
    caption = f"mean map error after rigid alignment{INTERVALS}; {raw.title}: without it; {LOST_MEANS}"
    tables = [Table("Aligned map error", "associator", [*means, raw, lost], errors, caption)]
    if gaps:
        caption = f"mean over the same episodes{INTERVALS}"
        title = "Aligned map error above that of true association with the same relocation"
        tables.insert(0, Table(title, "associator", means, gaps, caption, differences=True))
    return tables
