"""What the report of each kind of evaluation shows: tables, figures and sentences, for the template of that kind."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from agents.evaluation import recordings
from agents.evaluation.drive_tables import drive_tables, headline
from agents.evaluation.episodes import LOST_MEANS
from agents.evaluation.pipeline import Results
from agents.evaluation.records import stem
from agents.evaluation.tables import (
    Column,
    Rows,
    Table,
    by_name,
    by_setting,
    columns,
    counted,
    difference,
    display_name,
    estimate,
)
from agents.reports import figures
from agents.reports.figures import Colours, colours
from agents.reports.film import film_path
from agents.suite import numbers as suite
from agents.suite.reliability import reliability, reliability_tables
from slam_gym.scenarios.suite import EXPERIMENTS, RELOCATION

Content = dict[str, Any]
"""What a template is filled with."""


# -- drives ------------------------------------------------------------------------------------------------------------


_PANELS = {
    "drivers": columns("map_error", "coverage"),
    "associators": columns("precision", "recall", "map_error", "microseconds"),
}


def of_drives(results: Results, folder: Path) -> Content:
    """Per scenario the table and the episodes behind it; all against all. Of drivers, their course over time, and the
    films that `folder` may hold; of associators, whose map survives."""
    groups, colour, kind = by_name(results.frame), colours(results.names), results.metadata["kind"]
    drivers, panels = kind == "drivers", _PANELS[kind]
    scenarios = [
        {"table": table, "dots": figures.dot_chart(by_name(own), panels, colour)}
        for table, own in zip(drive_tables(results), by_setting(results.frame).values())
    ]
    others = [Column(name, display_name(name), 3) for name in groups]
    gaps: Rows = {
        name: {other: difference(own, groups[other], "map_error") for other in groups if other != name}
        for name, own in groups.items()
    }
    return {
        "title": "Drivers" if drivers else "Associators in the loop",
        "subtitle": f"slam_gym/Explore-v0: the same {results.conditions['split']} worlds and seeds for all",
        "headline": [] if drivers else headline(results.frame),
        "scenarios": scenarios,
        "lost_means": LOST_MEANS,
        "curves": figures.curve_chart(groups, panels, colour) if drivers else None,
        "comparison": Table("", "map error of … minus that of", others, gaps, differences=True),
        "films": _films(groups, folder),
    }


def _films(groups: Mapping[str, pd.DataFrame], folder: Path) -> list[Content]:
    """Of each agent that was filmed, in its first episode: the last picture, the film, and the error of the map."""
    found = []
    for agent, own in groups.items():
        film = film_path(folder, agent)
        if (picture := film.with_suffix(".png")).exists():
            error = own.loc[own["episode"].idxmin(), "map_error"]
            found.append({"agent": agent, "picture": picture, "file": film.name, "error": error})
    return found


# -- the suite ---------------------------------------------------------------------------------------------------------

_DETAILS = [*columns("exact", "precision", "recall", "spoiled", "refused", "promised", "kept"), *suite.EFFORT]


def of_suite(results: Results, folder: Path) -> Content:
    """The numbers, who is ahead of whom, and a plot per capability."""
    size, frame, colour = results.conditions, results.frame, colours(results.names)
    association, relocation = suite.by_role(frame)
    bins = reliability(association)
    sweeps = []
    for name, own in association.groupby("experiment", sort=False):
        sweeps.append(_sweep(own, name, Table("", "associator", _DETAILS, suite.details(own, _DETAILS)), colour))
    return {
        "title": "The association suite",
        "subtitle": f"{size['worlds']} {size['split']} worlds a level, up to {size['problems']} scans in each, the "
        "same for all: single scans against real SLAM maps",
        "capabilities": _capabilities(association, colour) if len(association) else None,
        "reliability": figures.reliability_chart(bins, colour) if bins else None,
        "reliability_tables": reliability_tables(association),
        "experiments": sweeps,
        "relocation": _sweep(relocation, RELOCATION, suite.relocations(relocation), colour)
        if len(relocation)
        else None,
    }


def _capabilities(frame: pd.DataFrame, colour: Colours) -> Content:
    """The numbers of all associators, as a table and as a picture, and how far each is ahead."""
    return {
        "table": suite.capabilities(frame),
        "bars": figures.capability_bars(suite.scores(frame), colour),
        "leads": Table("", "ahead of the next by", suite.score_columns(frame), suite.leads(frame), differences=True),
    }


def _sweep(frame: pd.DataFrame, name: str, table: Table, colour: Colours) -> Content:
    """An experiment: the question, its table, and the score of each name of the table level by level."""
    groups = {who: frame[frame["name"] == who].groupby("knob", sort=False)["score"] for who in table.rows}
    curves = {who: {float(knob): estimate(own) for knob, own in group} for who, group in groups.items()}
    experiment = EXPERIMENTS[name]
    return {"experiment": experiment, "table": table, "chart": figures.level_chart(curves, experiment.axis, colour)}


# -- recordings --------------------------------------------------------------------------------------------------------


def of_recordings(results: Results, folder: Path) -> Content:
    """Per log its tables, the maps over the reference, the errors over time."""
    files, colour = folder / recordings.FOLDER, colours(results.names)
    logs = [_log(name, own, files, colour) for name, own in by_setting(results.frame).items()]
    return {
        "title": "Associators on recordings",
        "subtitle": f"EKF-SLAM over real logs, {counted(len(results.names), 'associator')}",
        "logs": logs,
        "means": _log_tables(recordings.means(results.frame)) if len(logs) > 1 else [],
    }


def _log_tables(frame: pd.DataFrame) -> list[Table]:
    return [recordings.table(frame, shown) for shown in (recordings.COLUMNS, recordings.FURTHER_COLUMNS)]


def _log(name: str, frame: pd.DataFrame, folder: Path, colour: Colours) -> Content:
    """The files of an associator are drawn where they are there, and the log has a reference."""
    errors, features = {}, {}
    for associator in frame["name"]:
        files = [folder / f"{stem(name, associator)}.{kind}.csv" for kind in ("errors", "map")]
        if all(file.exists() for file in files) and len(found := pd.read_csv(files[0])):
            errors[associator], features[associator] = found, pd.read_csv(files[1])
    landmarks = folder / f"{stem(name)}.landmarks.csv"
    points = pd.read_csv(landmarks).to_numpy() if landmarks.exists() else np.empty((0, 2))
    return {
        "name": name,
        "about": frame.iloc[0],
        "tables": _log_tables(frame),
        "maps": figures.maps(errors, features, points, colour) if errors else None,
        "errors": figures.errors_over_time(errors, colour) if errors else None,
    }


CONTENTS: dict[str, tuple[str, Callable[[Results, Path], Content]]] = {
    "drivers": ("drives.html", of_drives),
    "associators": ("drives.html", of_drives),
    "suite": ("suite.html", of_suite),
    "recordings": ("recordings.html", of_recordings),
}
"""By the kind of evaluation: the template, and what fills it."""
