"""The entries of the leaderboard, which are evaluations by the protocol, and their ranking by paired differences over
common worlds."""

import html
import math
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import t as student_t

from agents.evaluation.pipeline import METADATA, Results, read_results
from agents.evaluation.records import undamaged
from agents.evaluation.tables import display_name, number
from agents.ranking.protocol import FIRST, PARTS, Protocol, column_of
from slam_gym.metrics.statistics import Interval
from slam_gym.simulation.judged import CEILING

BASELINES = Path(__file__).with_name("baselines")
"""The folder of the shipped entries."""


class Entry(NamedTuple):
    """The losses of an entry. Only entries of the same protocol are compared."""

    name: str
    protocol: dict[str, Any]  # version, role, quick, hash
    losses: pd.Series  # by column, setting and world

    @property
    def shape(self) -> tuple[Any, ...]:
        """Protocol, settings and worlds, which are equal for entries that are compared."""
        return (self.protocol["hash"], *sorted(self.losses.index))

    def quick(self) -> "Entry":
        """The same entry by the short protocol, whose worlds are among those of the whole one."""
        chosen = Protocol(self.protocol["role"], quick=True)
        among = [world - FIRST < chosen.parts.get(setting, 0) for _, setting, world in self.losses.index]
        return Entry(self.name, chosen.about, self.losses[among])


def entry_of(results: Results) -> Entry:
    """The entry of a complete evaluation. Raises ValueError for results that no evaluation by the protocol has: losses
    are finite and not below 0, one for each world."""
    protocol = results.conditions
    name, role, code = protocol.pop("entry"), protocol["role"], protocol["hash"]
    numbered = isinstance(protocol["version"], int) and isinstance(protocol["quick"], bool)
    if role not in PARTS or not numbered or not code.isalnum() or not isinstance(name, str):
        raise ValueError("its protocol or its name is none")
    if not results.metadata["complete"]:
        raise ValueError("its evaluation is not complete")
    frame = results.frame.assign(column=results.frame["setting"].map(column_of))
    losses = frame.set_index(["column", "setting", "episode"])["loss"].astype(float)
    if not (losses.index.is_unique and losses.between(0.0, math.inf, inclusive="left").all()):
        raise ValueError("its losses are not one number from 0 on for each world")
    chosen = Protocol(role, protocol["quick"])
    worlds = {(setting, FIRST + k) for setting, count in chosen.parts.items() for k in range(count)}
    if code == chosen.about["hash"] and set(losses.index.droplevel("column")) != worlds:
        raise ValueError("its worlds are not those of the protocol")
    return Entry(name, protocol, losses.round(6))


def read_entries(folders: Iterable[Path]) -> tuple[list[Entry], list[str]]:
    """The entries in the folders of evaluations, by time, and a line for each that does not count."""
    entries, invalid = list[tuple[str, Entry]](), []
    for folder in sorted(folders):
        try:
            with undamaged(f"{folder}: the entry"):
                results = read_results(folder)
                began = max((str(command["started"]) for command in results.metadata["commands"]), default="")
                entries.append((began, entry_of(results)))
        except (ValueError, OSError) as error:
            invalid.append(" ".join(str(error).split()))
    ordered = [entry for _, entry in sorted(entries, key=itemgetter(0))]
    for (name, _), count in Counter((entry.name, entry.shape) for entry in ordered).items():
        if count > 1:
            invalid.append(f"{name}: {count - 1} of its {count} evaluations, since only the last counts")
    return ordered, invalid


def folders_in(board: Path) -> set[Path]:
    """The folders of evaluations in the folder of a board."""
    return {path.parent for path in board.glob(f"*/{METADATA}")}


class Row(NamedTuple):
    """A row of the ranking."""

    place: int  # 1 + the number of entries that are better with an interval that excludes 0
    name: str
    loss: Interval  # mean over columns
    behind: Interval  # paired difference to the entry with the lowest loss
    columns: dict[str, float]  # mean losses


def rows(entries: Sequence[Entry]) -> list[Row]:
    """The ranking of entries of one protocol, by place and then by loss.

    Of entries with the same name, the last counts. The ceiling, which uses the truth, has place 0 and does not change
    the places of others.
    """
    losses = pd.DataFrame({entry.name: entry.losses for entry in entries}).reindex(entries[0].losses.index)
    means = losses.groupby(level=0, sort=False).mean()
    rivals = [name for name in losses if name != CEILING]
    first = means.mean()[rivals or list(losses)].idxmin()
    ranking = []
    for name, column in losses.items():
        better = sum(_mean_of_means(column - losses[other]).low > 0.0 for other in rivals if other != name)
        place = 0 if name == CEILING else 1 + better
        behind = _mean_of_means(column - losses[first])
        ranking.append(Row(place, str(name), _mean_of_means(column), behind, means[name].to_dict()))
    return sorted(ranking, key=lambda row: (row.place, row.loss.estimate))


def _mean_of_means(losses: pd.Series) -> Interval:
    """The mean over columns of their means, and its 95 % interval.

    World k may be the same building in several settings, so worlds are the clusters of the variance, with a t
    distribution (Cameron and Miller, J. Human Resources 2015). Differences between settings are not noise.
    """
    columns, settings = losses.groupby(level=0), losses.groupby(level=1)
    weights, sizes = 1.0 / (columns.ngroups * columns.transform("size")), settings.transform("size")
    deviations = (losses - settings.transform("mean")) * np.sqrt(sizes / (sizes - 1.0))
    of_worlds = (weights * deviations).groupby(level=2).sum(min_count=1)
    mean = float((weights * losses).sum())
    half = student_t.ppf(0.975, len(of_worlds) - 1) * math.sqrt((of_worlds**2).sum())
    return Interval(mean, mean - half, mean + half)


def markdown(entries: Sequence[Entry]) -> str:
    """Markdown tables, one for every protocol among the entries, in the order of their roles."""
    groups: dict[tuple[Any, ...], list[Entry]] = {}
    for entry in sorted(entries, key=lambda entry: list(PARTS).index(entry.protocol["role"])):
        groups.setdefault(entry.shape, []).append(entry)
    return "\n\n".join(_table(group[0].protocol, rows(group)) for group in groups.values())


def _table(protocol: dict[str, Any], ranking: Sequence[Row]) -> str:
    quick = protocol["quick"]  # so few worlds tell no places and no intervals
    heads = ["", "entry", "loss"] if quick else ["place", "entry", "loss", "behind the first"]
    heads += map(_escaped, ranking[0].columns)
    lines = [f"### {protocol['role'].capitalize()}s", ""]
    tried = ", a few worlds to try an entry" if quick else ""
    lines += [f"Protocol {protocol['version']}{tried}, hash `{protocol['hash']}`.", ""]
    lines += ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for row in sorted(ranking, key=lambda row: row.loss.estimate) if quick else ranking:
        behind = "–" if row.behind.estimate == 0.0 else _interval(row.behind, signed=True)
        found = ["", number(row.loss.estimate, 3)] if quick else [str(row.place or ""), _interval(row.loss), behind]
        cells = [found[0], _escaped(display_name(row.name)), *found[1:]]
        lines.append("| " + " | ".join([*cells, *(number(mean, 3) for mean in row.columns.values())]) + " |")
    return "\n".join(lines)


def _escaped(text: str) -> str:
    """Text escaped for Markdown and HTML, on one line."""
    return re.sub(r"([\\`*_\[\]|])", r"\\\1", html.escape(" ".join(text.split())))


def _interval(value: Interval, signed: bool = False) -> str:
    return f"{number(value.estimate, 3, signed)} [{number(value.low, 3)}, {number(value.high, 3)}]"
