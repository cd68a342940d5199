"""Who is ahead: entries ranked by paired differences over the worlds that they share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from agents.evaluation.tables import display_name, number
from agents.ranking.entries import Ranked
from agents.ranking.protocol import PARTS, QUICK, Part
from slam_gym.metrics.statistics import Interval
from slam_gym.simulation.judged import CEILING
from slam_gym.types import Array

RESAMPLES = 4000


class Row(NamedTuple):
    """An entry's place."""

    place: int  # one more than the number of entries that are better beyond doubt
    entry: Ranked
    loss: Interval  # mean over the columns that need no data
    behind: Interval  # loss − that of the entry with the lowest, paired
    columns: dict[str, float]  # mean loss; those that need data come last


def rows(entries: Sequence[Ranked]) -> list[Row]:
    """The entries, all of one role, protocol and worlds, by their places and then by their losses.

    The ceiling, which is told the truth, has place 0 and takes none from others. Raises ValueError for entries that
    cannot be compared.
    """
    if len({entry.key for entry in entries}) > 1:
        raise ValueError("entries of other roles, protocols or worlds are not ranked together")
    groups = {entry.name: _by_column(entry) for entry in entries}
    losses = {name: _mean_of_means(columns) for name, columns in groups.items()}
    rivals = [entry.name for entry in entries if entry.name != CEILING]
    first = min(rivals or groups, key=lambda name: losses[name].estimate)
    found = []
    for entry in entries:
        own = groups[entry.name]
        better = sum(_difference(own, groups[other]).low > 0.0 for other in rivals if other != entry.name)
        place = 0 if entry.name == CEILING else 1 + better
        found.append(Row(place, entry, losses[entry.name], _difference(own, groups[first]), _means(entry)))
    return sorted(found, key=lambda row: (row.place, row.loss.estimate))


def _parts(entry: Ranked) -> list[Part]:
    known = (QUICK if entry.protocol["quick"] else PARTS)[entry.role]
    return [part for part in known if part.setting in entry.losses]


def _means(entry: Ranked) -> dict[str, float]:
    columns = _by_column(entry, with_data=True)
    return {
        name: float(np.nanmean(values)) if np.isfinite(values).any() else np.nan for name, values in columns.items()
    }


def _by_column(entry: Ranked, with_data: bool = False) -> dict[str, Array]:
    """Column → losses in its episodes; of the columns that need no data, unless `with_data`."""
    found: dict[str, list[float]] = {}
    for part in _parts(entry):
        if with_data or not part.needs_data:
            found.setdefault(part.column, []).extend(entry.losses[part.setting])
    return {name: np.array(values, np.float64) for name, values in found.items()}


def _difference(first: dict[str, Array], second: dict[str, Array]) -> Interval:
    return _mean_of_means({name: first[name] - second[name] for name in first})


def _mean_of_means(columns: dict[str, Array]) -> Interval:
    """Mean over columns of their means, and its 95 % bootstrap interval: worlds are drawn within each column."""
    rng, totals, estimates = np.random.default_rng(0), np.zeros(RESAMPLES), []
    for values in columns.values():
        known = values[np.isfinite(values)]
        if len(known):
            estimates.append(float(known.mean()))
            totals += known[rng.integers(len(known), size=(RESAMPLES, len(known)))].mean(axis=1)
    if not estimates:
        return Interval(np.nan, np.nan, np.nan)
    low, high = np.percentile(totals / len(estimates), [2.5, 97.5])
    return Interval(float(np.mean(estimates)), float(low), float(high))


def markdown(entries: Sequence[Ranked]) -> str:
    """A table for every role and protocol among the entries."""
    groups: dict[tuple[str, str, str], list[Ranked]] = {}
    for entry in entries:
        groups.setdefault(entry.key, []).append(entry)
    return "\n\n".join(_table(own) for own in groups.values())


def _table(entries: Sequence[Ranked]) -> str:
    found = rows(entries)
    columns = list(dict.fromkeys(name for row in found for name in row.columns))
    about = entries[0].protocol
    quick = ", quick (for tests)" if about["quick"] else ""
    hashes = f"hash `{about['hash']}`, worlds `{entries[0].worlds}`"
    title = f"### {entries[0].role.capitalize()}s\n\nProtocol {about['version']}{quick}, {hashes}."
    lines = [
        "| | entry | loss | behind the first | " + " | ".join(columns) + " |",
        "|" + "---|" * (4 + len(columns)),
    ]
    for row in found:
        cells = ["" if name not in row.columns else number(row.columns[name], 3) for name in columns]
        place = "" if row.place == 0 else str(row.place)
        behind = "–" if row.behind.estimate == 0.0 else _interval(row.behind, signed=True)
        name = display_name(row.entry.name)
        lines.append(f"| {place} | {name} | {_interval(row.loss)} | {behind} | " + " | ".join(cells) + " |")
    return title + "\n\n" + "\n".join(lines)


def _interval(value: Interval, signed: bool = False) -> str:
    return f"{number(value.estimate, 3, signed)} [{number(value.low, 3)}, {number(value.high, 3)}]"
