"""The one number per capability that the association suite is about, made from the results of worlds."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import pandas as pd

from agents.evaluation.pipeline import Results
from agents.evaluation.tables import Column, Rows, Table, Value, columns, estimate
from agents.suite.problems import OUTCOMES
from agents.suite.reliability import reliability_tables
from slam_gym.scenarios.suite import EXPERIMENTS, RELOCATION

SCORE = Column("score", "score", 3, "higher")
MISTAKES = columns("spoiled", "refused")
EFFORT = columns("nodes", "microseconds", "limits")


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


def scores(frame: pd.DataFrame) -> Rows:
    """Name → experiment → interquartile mean over worlds; `all` is that of their means. The best name first."""
    worlds = by_world(frame)
    return {name: _estimates(worlds.loc[name]) for name in ranked(frame)}


def leads(frame: pd.DataFrame) -> Rows:
    """Name → experiment → by how much its score is above that of the next in rank, paired over worlds."""
    worlds = by_world(frame)
    return {name: _estimates(worlds.loc[name] - worlds.loc[after]) for name, after in pairwise(ranked(frame))}


def _estimates(worlds: pd.DataFrame) -> dict[str, Value]:
    return {str(column): estimate(worlds[column]) for column in worlds}


def details(frame: pd.DataFrame, shown: Sequence[Column]) -> Rows:
    """Name → key of a column → interquartile mean over worlds of the mean over all levels. The best name first."""
    worlds = pd.DataFrame({column.key: by_world(frame, column.key)["all"] for column in shown})
    return {name: _estimates(worlds.loc[name]) for name in ranked(frame)}


def score_columns(frame: pd.DataFrame) -> list[Column]:
    """One an experiment, and their mean."""
    return [Column(name, name, 3, "higher") for name in (*experiments(frame), "all")]


def capabilities(frame: pd.DataFrame, title: str = "") -> Table:
    """The scores of associators in every experiment, and their mistakes, the best first."""
    mistakes = details(frame, MISTAKES)
    rows = {name: own | mistakes[name] for name, own in scores(frame).items()}
    return Table(title, "associator", [*score_columns(frame), *MISTAKES], rows)


def relocations(frame: pd.DataFrame, title: str = "") -> Table:
    """The scores of searches without a prior, the number of each outcome, and their effort, the best first."""
    counts = frame.groupby("name")[list(OUTCOMES)].sum()
    rows = {name: own | counts.loc[name].to_dict() for name, own in details(frame, [SCORE, *EFFORT]).items()}
    outcomes = [Column(outcome, outcome, 0) for outcome in OUTCOMES]
    return Table(title, "search", [SCORE, *outcomes, *EFFORT], rows)


def tables(results: Results) -> list[Table]:
    """The numbers of associators, best first, and those of searches without a prior."""
    association, relocation = by_role(results.frame)
    size, found = results.conditions, []
    about = f"{size['worlds']} worlds a level, up to {size['problems']} scans in each"
    if len(association):
        found.append(capabilities(association, f"association suite, {about}"))
        found += reliability_tables(association)
    if len(relocation):
        found.append(relocations(relocation, f"kidnapped: searches without a prior, {about}"))
    return found
