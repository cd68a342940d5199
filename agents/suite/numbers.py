"""The one number per capability that the association suite is about, made from the results of worlds."""

from __future__ import annotations

import pandas as pd

from agents.evaluation.pipeline import Results
from agents.evaluation.tables import Column, Rows, Table, estimate
from agents.suite.problems import OUTCOMES
from agents.suite.reliability import promise_tables, reliability_tables
from slam_gym.metrics.statistics import Interval
from slam_gym.scenarios.suite import EXPERIMENTS, RELOCATION

RELOCATION_COLUMNS = (
    Column(RELOCATION, "score", 3, "higher"), *(Column(outcome, outcome, 0) for outcome in OUTCOMES),
)  # fmt: skip


def of_associators(frame: pd.DataFrame) -> pd.DataFrame:
    """The results of all experiments but that of relocators."""
    return frame[frame["experiment"] != RELOCATION]


def of_relocators(frame: pd.DataFrame) -> pd.DataFrame:
    """The results of the experiment that asks relocators."""
    return frame[frame["experiment"] == RELOCATION]


def experiments(frame: pd.DataFrame) -> list[str]:
    """Those among the results, in the order of the suite."""
    found = set(frame["experiment"])
    return [name for name in EXPERIMENTS if name in found]


def by_world(frame: pd.DataFrame, key: str = "score") -> pd.Series:
    """(experiment, name, world) → mean of a number over the levels, for the worlds that have it in all of them."""
    groups = frame.groupby(["experiment", "name", "episode"])[key]
    levels = frame.groupby("experiment")["setting"].nunique()
    means, counts = groups.mean(), groups.count()
    return means[counts == counts.index.get_level_values("experiment").map(levels)]


def overall(frame: pd.DataFrame, key: str = "score") -> pd.Series:
    """(name, world) → mean of a number over all experiments, for the worlds that have it in all of them."""
    return by_world(frame, key).unstack("experiment").dropna().mean(axis=1)


def ranked(frame: pd.DataFrame) -> list[str]:
    """Who was asked, by their score over all experiments, best first."""
    worlds = overall(frame)
    means = {name: _interval(worlds, name).estimate for name in frame["name"].unique()}
    return sorted(means, key=lambda name: (pd.isna(means[name]), -means[name]))


def scores(frame: pd.DataFrame, key: str = "score") -> Rows:
    """Name → experiment → interquartile mean over worlds; `all` is that of their means. The best name first."""
    worlds, everywhere = by_world(frame, key), overall(frame, key)
    found: Rows = {}
    for name in ranked(frame):
        each = {experiment: _interval(worlds, experiment, name) for experiment in experiments(frame)}
        found[name] = {**each, "all": _interval(everywhere, name)}
    return found


def _interval(numbers: pd.Series, *labels: str) -> Interval:
    """Of the worlds under some labels of the index."""
    known = labels if len(labels) > 1 else labels[0]
    return estimate(numbers.loc[known] if known in numbers.index.droplevel("episode") else [])


def paired_difference(first: pd.Series, second: pd.Series) -> Interval:
    """First − second over the worlds that both have."""
    return estimate((first - second).dropna())


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
    association, relocation = of_associators(results.frame), of_relocators(results.frame)
    size, found = results.conditions, []
    about = f"{size['worlds']} worlds a level, up to {size['problems']} scans in each"
    if len(association):
        columns = score_columns(association)
        found.append(Table(f"association suite, {about}", "associator", columns, scores(association)))
        found += promise_tables(association) + reliability_tables(association)
    if len(relocation):
        title = f"kidnapped: searches without a prior, {about}"
        found.append(Table(title, "search", RELOCATION_COLUMNS, relocation_rows(relocation)))
    return found
