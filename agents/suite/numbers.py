"""The one number per capability that the association suite is about, made from records of worlds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from agents.evaluation.pipeline import Results
from agents.evaluation.records import Record
from agents.evaluation.tables import Column, Rows, Table, Value, by_name, estimate
from agents.suite import reliability
from agents.suite.relocation_problems import OUTCOMES
from slam_gym.metrics.statistics import Interval
from slam_gym.scenarios.suite import EXPERIMENTS, RELOCATION
from slam_gym.types import Array

ByWorld = dict[int, float]
"""World → a number."""


@dataclass(frozen=True)
class SuiteRecords:
    """The records of associators, or of relocators, and what they come to."""

    records: Sequence[Record]

    @property
    def experiments(self) -> list[str]:
        """Those among the records, in the order of the suite."""
        found = {record["experiment"] for record in self.records}
        return [name for name in EXPERIMENTS if name in found]

    @property
    def names(self) -> list[str]:
        """Who was asked, in the order of the records."""
        return list(by_name(self.records, "associator"))

    @property
    def ranked(self) -> list[str]:
        """Who was asked, by their mean over all experiments, best first."""
        scores = {name: interval(self.overall(name)).estimate for name in self.names}
        return sorted(scores, key=lambda name: -scores[name] if math.isfinite(scores[name]) else math.inf)

    def select(self, name: str, experiment: str) -> list[Record]:
        """The records of one who was asked in one experiment."""
        return [r for r in self.records if r["associator"] == name and r["experiment"] == experiment]

    def by_world(self, name: str, experiment: str, key: str = "score") -> ByWorld:
        """Mean over the levels of an experiment, for the worlds that have been through all of its levels."""
        found: dict[int, dict[str, float]] = {}
        for record in self.select(name, experiment):
            if math.isfinite(record[key]):
                found.setdefault(record["episode"], {})[record["setting"]] = record[key]
        levels = {record["setting"] for record in self.records if record["experiment"] == experiment}
        return {w: float(np.mean(list(own.values()))) for w, own in found.items() if len(own) == len(levels)}

    def overall(self, name: str, key: str = "score") -> ByWorld:
        """Mean over all experiments."""
        each = [self.by_world(name, experiment, key) for experiment in self.experiments]
        common = set.intersection(*map(set, each)) if each else set()
        return {world: float(np.mean([found[world] for found in each])) for world in sorted(common)}

    def level_curve(self, name: str, experiment: str, key: str = "score") -> LevelCurve:
        """A number level by level."""
        own = self.select(name, experiment)
        knobs = list(dict.fromkeys(record["knob"] for record in own))
        found = [estimate(np.array([r[key] for r in own if r["knob"] == knob], dtype=float)) for knob in knobs]
        return LevelCurve(np.array(knobs, dtype=float), found)

    def scores(self) -> Rows:
        """Name → experiment → score; `all` is their mean."""
        return {
            name: {
                **{experiment: interval(self.by_world(name, experiment)) for experiment in self.experiments},
                "all": interval(self.overall(name)),
            }
            for name in self.names
        }


class LevelCurve(NamedTuple):
    """A number against the knob of an experiment."""

    knobs: Array  # (l,)
    estimates: list[Interval]


def split_records(records: Sequence[Record]) -> tuple[SuiteRecords, SuiteRecords]:
    """Those of associators, and those of relocators."""
    kidnapped = [record for record in records if record["experiment"] == RELOCATION]
    return SuiteRecords([r for r in records if r["experiment"] != RELOCATION]), SuiteRecords(kidnapped)


def interval(by_world: ByWorld) -> Interval:
    """Interquartile mean over worlds, with its interval."""
    return estimate(np.array([by_world[world] for world in sorted(by_world)], dtype=float))


def paired_difference(first: ByWorld, second: ByWorld) -> Interval:
    """First − second over the worlds that both have."""
    common = sorted(first.keys() & second.keys())
    return estimate(np.array([first[world] - second[world] for world in common], dtype=float))


def relocation_rows(relocation: SuiteRecords) -> Rows:
    """Search → `kidnapped`, its score, and the number of each outcome; the best score first."""
    found: dict[str, dict[str, Value]] = {}
    for name in relocation.ranked:
        own = relocation.select(name, RELOCATION)
        found[name] = {RELOCATION: interval(relocation.by_world(name, RELOCATION))}
        found[name] |= {outcome: sum(record[outcome] for record in own) for outcome in OUTCOMES}
    return found


def numbers(records: Sequence[Record]) -> dict[str, Any]:
    """For results.json."""
    association, relocation = split_records(records)
    return {"numbers": association.scores(), "relocation": relocation_rows(relocation)}


def score_columns(association: SuiteRecords) -> list[Column]:
    """One an experiment, and their mean."""
    return [Column(name, name, 3, "higher") for name in (*association.experiments, "all")]


RELOCATION_COLUMNS = (
    Column(RELOCATION, "score", 3, "higher"), *(Column(outcome, outcome, 0) for outcome in OUTCOMES),
)  # fmt: skip


def tables(results: Results) -> list[Table]:
    """The numbers of associators, best first, and those of searches without a prior."""
    association, relocation = split_records(results.records)
    size, found = results.content["conditions"], []
    about = f"{size['worlds']} worlds a level, up to {size['problems']} scans in each"
    if association.records:
        scores = association.scores()
        rows = {name: scores[name] for name in association.ranked}
        found.append(Table(f"association suite, {about}", "associator", score_columns(association), rows))
        found += reliability.promise_tables(association.records)
        found += reliability.tables(association.records)
    if relocation.records:
        title = f"kidnapped: searches without a prior, {about}"
        found.append(Table(title, "search", RELOCATION_COLUMNS, relocation_rows(relocation)))
    return found
