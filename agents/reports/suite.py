"""The page of the association suite: one number per capability, from the results of worlds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path

import pandas as pd

from agents.evaluation.pipeline import Results
from agents.evaluation.tables import Column, Rows, Table, columns, estimate
from agents.reports import figures
from agents.reports.page import Page, Part, Picture
from agents.suite import OUTCOMES
from slam_gym.metrics.statistics import Interval
from slam_gym.scenarios.suite import EXPERIMENTS, RELOCATION

MISTAKES = columns("spoiled", "refused")
EFFORT = columns("nodes", "microseconds", "limits")
DETAILS = [*columns("exact", "precision", "recall"), *MISTAKES, *columns("promised", "kept"), *EFFORT]


def suite_page(results: Results, folder: Path) -> Page:
    """The paired differences in the ranking, the scores, and a plot for each capability."""
    size, colour, parts = results.conditions, figures.colours(results.names), list[Part]()
    about = f"{size['worlds']} worlds a level, up to {size['problems']} scans in each"
    association = results.frame[results.frame["experiment"] != RELOCATION]
    if len(association):
        capability_scores = scores(association)
        if gaps := leads(association):
            ahead, caption = _scores_of(association), "paired over worlds; bold: the interval excludes 0"
            parts.append(Table("Ahead of the next", "ahead of the next by", ahead, gaps, caption, True, detail=True))
        parts.append(capabilities(association, f"Capabilities, {about}"))
        parts.append(Picture("Score per capability", partial(figures.capability_bars, capability_scores, colour)))
    for name, frame in results.frame.groupby("experiment", sort=False):
        experiment = EXPERIMENTS[str(name)]
        if name == RELOCATION:
            table = relocations(frame, f"Kidnapped: searches without a prior, {about}")
        else:
            table = Table(experiment.name.capitalize(), "associator", DETAILS, details(frame, DETAILS), "", detail=True)
        curves = {row: levels(frame[frame["name"] == row]) for row in table.rows}
        chart = partial(figures.level_chart, curves, experiment.axis, colour)
        parts += [table, f"{experiment.question} {experiment.why}", Picture(f"Score against {experiment.axis}", chart)]
    subtitle = f"{about}, of the {size['split']} split, the same for all: single scans against real SLAM maps"
    return Page("The association suite", subtitle, parts, "suite.html")


def capabilities(frame: pd.DataFrame, title: str = "") -> Table:
    """The scores of associators in every experiment, and their mistakes, best first."""
    mistakes = details(frame, MISTAKES)
    rows = {name: own | mistakes[name] for name, own in scores(frame).items()}
    return Table(title, "associator", [*_scores_of(frame), *MISTAKES], rows)


def relocations(frame: pd.DataFrame, title: str = "") -> Table:
    """The scores of searches without a prior, the number of each outcome, and their effort, best first."""
    counts, score = frame.groupby("name")[list(OUTCOMES)].sum(), columns("score")
    rows = {name: own | counts.loc[name].to_dict() for name, own in details(frame, [*score, *EFFORT]).items()}
    outcomes = [Column(outcome, outcome, 0) for outcome in OUTCOMES]
    return Table(title, "search", [*score, *outcomes, *EFFORT], rows)


# -- means over levels, then over worlds -------------------------------------------------------------------------------


def _experiments(frame: pd.DataFrame) -> list[str]:
    """The experiments among the results, in the order of the suite."""
    return [name for name in EXPERIMENTS if name in set(frame["experiment"])]


def _scores_of(frame: pd.DataFrame) -> list[Column]:
    """A column for each experiment, and one for their mean."""
    return [Column(name, name, 3, "higher") for name in (*_experiments(frame), "all")]


def by_world(frame: pd.DataFrame, key: str = "score") -> pd.DataFrame:
    """The mean of a number over the levels, with a row for each name and world and a column for each experiment; column
    `all` is the mean of these. NaN for a world that lacks the number in one level."""
    groups = frame.groupby(["experiment", "name", "episode"])[key]
    levels = frame.groupby("experiment")["setting"].nunique()
    counts = groups.count()
    complete = groups.mean().where(counts == counts.index.get_level_values("experiment").map(levels))
    table = complete.unstack("experiment")[_experiments(frame)]
    return table.assign(all=table.mean(axis=1, skipna=False))


def scores(frame: pd.DataFrame) -> dict[str, dict[str, Interval]]:
    """Name → experiment → interquartile mean over worlds; `all` is that of the means over experiments. Best first."""
    worlds = by_world(frame)
    by_name = {name: _estimates(worlds.loc[name]) for name in frame["name"].unique()}
    means = {name: estimates["all"].estimate for name, estimates in by_name.items()}
    return {name: by_name[name] for name in sorted(by_name, key=lambda name: (math.isnan(means[name]), -means[name]))}


def leads(frame: pd.DataFrame) -> Rows:
    """Name → experiment → paired difference over worlds between its score and that of the next in rank."""
    worlds = by_world(frame)
    return {name: {**_estimates(worlds.loc[name] - worlds.loc[after])} for name, after in pairwise(scores(frame))}


def details(frame: pd.DataFrame, shown: Sequence[Column]) -> Rows:
    """Name → key of a column → interquartile mean over worlds of the mean over all levels. Best first."""
    worlds = pd.DataFrame({column.key: by_world(frame, column.key)["all"] for column in shown})
    return {name: {**_estimates(worlds.loc[name])} for name in scores(frame)}


def levels(frame: pd.DataFrame) -> dict[float, Interval]:
    """Knob → score, for one name in one experiment."""
    return {float(knob): estimate(own) for knob, own in frame.groupby("knob", sort=False)["score"]}


def _estimates(worlds: pd.DataFrame) -> dict[str, Interval]:
    return {str(column): estimate(worlds[column]) for column in worlds}
