"""The one number per capability that the association suite is about, made from the results of worlds."""

from __future__ import annotations

from itertools import pairwise

import pandas as pd

from agents.evaluation.pipeline import Results
from agents.evaluation.tables import Column, Rows, Table, Value, estimate
from agents.suite.problems import OUTCOMES
from agents.suite.reliability import reliability_tables
from slam_gym.scenarios.suite import EXPERIMENTS, RELOCATION

RELOCATION_COLUMNS = (
    Column(RELOCATION, "score", 3, "higher"), *(Column(outcome, outcome, 0) for outcome in OUTCOMES),
)  # fmt: skip


def by_role(frame: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The results of associators, and those of the experiment that asks relocators."""
    relocation = frame["experiment"] == RELOCATION
    return frame[~relocation], frame[relocation]


def experiments(frame: pd.DataFrame) -> list[str]:
    """Those among the results, in the order of the suite."""
    found = set(frame["experiment"])
    return [name for name in EXPERIMENTS if name in found]


def by_world(frame: pd.DataFrame, key: str = "score") -> pd.DataFrame:
    """A row for each name and world, a column for each experiment: the mean of a number over the levels; and `all`, the
    mean of these. NaN for a world that lacks the number in one of them."""
    groups = frame.groupby(["experiment", "name", "episode"])[key]
    levels = frame.groupby("experiment")["setting"].nunique()
    counts = groups.count()
    complete = groups.mean().where(counts == counts.index.get_level_values("experiment").map(levels))
    found = complete.unstack("experiment")[experiments(frame)]
    return found.assign(all=found.mean(axis=1, skipna=False))


def ranked(frame: pd.DataFrame) -> list[str]:
    """Who was asked, by their score over all experiments, best first."""
    worlds = by_world(frame)["all"]
    means = {name: estimate(worlds[name]).estimate for name in frame["name"].unique()}
    return sorted(means, key=lambda name: (pd.isna(means[name]), -means[name]))


def scores(frame: pd.DataFrame, key: str = "score") -> Rows:
    """Name → experiment → interquartile mean over worlds; `all` is that of their means. The best name first."""
    worlds = by_world(frame, key)
    return {name: _estimates(worlds.loc[name]) for name in ranked(frame)}


def leads(frame: pd.DataFrame) -> Rows:
    """Name → experiment → by how much its score is above that of the next in rank, paired over worlds."""
    worlds = by_world(frame)
    return {name: _estimates(worlds.loc[name] - worlds.loc[after]) for name, after in pairwise(ranked(frame))}


def _estimates(worlds: pd.DataFrame) -> dict[str, Value]:
    return {str(column): estimate(worlds[column]) for column in worlds}


def relocation_rows(frame: pd.DataFrame) -> Rows:
    """Search → `kidnapped`, its score, and the number of each outcome; the best score first."""
    found: Rows = {}
    for name, score in scores(frame).items():
        counts = frame[frame["name"] == name][list(OUTCOMES)].sum()
        found[name] = {RELOCATION: score["all"], **{outcome: int(counts[outcome]) for outcome in OUTCOMES}}
    return found


def score_columns(frame: pd.DataFrame) -> list[Column]:
    """One an experiment, and their mean."""
    return [Column(name, name, 3, "higher") for name in (*experiments(frame), "all")]


def tables(results: Results) -> list[Table]:
    """The numbers of associators, best first, and those of searches without a prior."""
    association, relocation = by_role(results.frame)
    size, found = results.conditions, []
    about = f"{size['worlds']} worlds a level, up to {size['problems']} scans in each"
    if len(association):
        columns = score_columns(association)
        found.append(Table(f"association suite, {about}", "associator", columns, scores(association)))
        found += reliability_tables(association)
    if len(relocation):
        title = f"kidnapped: searches without a prior, {about}"
        found.append(Table(title, "search", RELOCATION_COLUMNS, relocation_rows(relocation)))
    return found
