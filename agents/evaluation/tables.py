"""Numbers of an evaluation: estimates with their intervals over episodes, and the tables that show them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.measure import Measurement
from rich.table import Table as RichTable

from agents.evaluation.records import Record
from slam_gym.metrics.statistics import Interval, Statistic, bootstrap_interval, interquartile_mean, mean
from slam_gym.simulation.judged import CEILING
from slam_gym.types import Array, IntArray

Value = Interval | float | int
Rows = dict[str, dict[str, Value]]
"""Name of an agent or associator → key of a column → value."""


def counted(count: int, what: str) -> str:
    """Such as `1 episode`, or `30 episodes`."""
    return f"{count} {what}{'' if count == 1 else 's'}"


@dataclass(frozen=True)
class Column:
    """A column of a table."""

    key: str  # in a record
    title: str
    digits: int
    better: str = ""  # "lower", "higher", or neither
    optional: bool = False  # left out where the terminal is narrow
    rare: bool = False  # happens so seldom that it takes the mean: an interquartile mean does not see it


@dataclass(frozen=True)
class Table:
    """What is shown on the terminal and in the report."""

    title: str
    corner: str  # title of the first column, that of the names
    columns: Sequence[Column]
    rows: Rows
    caption: str = "interquartile mean, 95 % bootstrap interval"
    differences: bool = False  # of two each: told with their signs


# -- estimates -----------------------------------------------------------------------------------------------------


def by_name(records: Sequence[Record], subject: str) -> dict[str, list[Record]]:
    """The records of each agent or associator, whichever field `subject` says, in the order of their first records."""
    groups: dict[str, list[Record]] = {}
    for record in records:
        groups.setdefault(record[subject], []).append(record)
    return groups


def by_setting(records: Sequence[Record]) -> dict[str, list[Record]]:
    """The records of each scenario, level or log."""
    return by_name(records, "setting")


def estimate(
    values: Array, strata: IntArray | None = None, resamples: int = 5000, statistic: Statistic = interquartile_mean
) -> Interval:
    """The statistic of values (n,) and its 95 % bootstrap interval, resampled within each of the strata (n,).

    Values that are not finite are left out; all NaN where none is left. The same values always give the same interval.
    Where each stratum has but one value, nothing tells how they vary, and there is no interval.
    """
    finite = np.isfinite(values)
    if not finite.any():
        return Interval(math.nan, math.nan, math.nan)
    strata = None if strata is None else strata[finite]
    if finite.sum() == (1 if strata is None else len(np.unique(strata))):
        return Interval(float(statistic(values[finite])), math.nan, math.nan)
    return bootstrap_interval(
        values[finite], np.random.default_rng(0), strata=strata, resamples=resamples, statistic=statistic
    )


class Sample(NamedTuple):
    """A number over episodes."""

    values: Array  # (n,)
    strata: IntArray  # (n,) number of the setting and model behind each

    @property
    def estimate(self) -> Interval:
        return self.summary(interquartile_mean)

    def summary(self, statistic: Statistic) -> Interval:
        """Some statistic of it, with its interval."""
        return estimate(self.values, self.strata, statistic=statistic)


def sample(records: Sequence[Record], key: str) -> Sample:
    """A number of all records. Settings and models are strata: what differs between them is no noise."""
    groups = [(record.get("setting") or "", record.get("model") or "") for record in records]
    number = {group: k for k, group in enumerate(sorted(set(groups)))}
    values = np.array([record[key] for record in records], dtype=float)
    return Sample(values, np.array([number[group] for group in groups], dtype=np.int64))


def estimates(records: Sequence[Record], columns: Sequence[Column]) -> dict[str, Value]:
    """Column key → estimate over the records."""
    return {c.key: sample(records, c.key).summary(mean if c.rare else interquartile_mean) for c in columns}


def difference(
    first: Sequence[Record], second: Sequence[Record], key: str, statistic: Statistic = interquartile_mean
) -> Interval:
    """First − second on the episodes that both have (means over models), with its interval: paired."""
    found: tuple[dict[tuple[str, int], list[float]], ...] = ({}, {})
    for side, records in zip(found, (first, second)):
        for record in records:
            side.setdefault((record.get("setting") or "", record["episode"]), []).append(record[key])
    common = sorted(found[0].keys() & found[1].keys())
    settings = sorted({setting for setting, _ in common})
    differences = np.array([np.mean(found[0][k]) - np.mean(found[1][k]) for k in common], dtype=float)
    strata = np.array([settings.index(setting) for setting, _ in common], dtype=np.int64)
    return estimate(differences, strata, statistic=statistic)


def mean_difference(first: Sequence[Record], second: Sequence[Record], key: str) -> Interval:
    """`difference` of means, in which catastrophes count."""
    return difference(first, second, key, mean)


def best_names(values: Mapping[str, Value], column: Column) -> set[str]:
    """The names with the best value and those that cannot be told from it; none where that is all. No ceiling.

    Numbers without an interval are compared as they are shown.
    """
    known_best = tuple(name for name in values if name.startswith(CEILING))
    found = {name: _as_interval(value, column.digits) for name, value in values.items() if name not in known_best}
    known = {name: value for name, value in found.items() if math.isfinite(value.estimate)}
    if not column.better or len(known) < 2:
        return set()
    sign = 1.0 if column.better == "lower" else -1.0
    first = min(known.values(), key=lambda value: sign * value.estimate)
    tied = {name for name, value in known.items() if value.low <= first.high and value.high >= first.low}
    return tied if len(tied) < len(known) else set()


def _as_interval(value: Value, digits: int) -> Interval:
    return value if isinstance(value, Interval) else Interval(*[round(float(value), digits)] * 3)


_NAMES = 12  # characters that names have in any case; longer ones are wrapped where the terminal is narrow

# -- as text -------------------------------------------------------------------------------------------------------


def display_name(name: str) -> str:
    """What to call it in a table: the function of `module:function`, the name of a file, words instead of `_`."""
    return (Path(name).name if ":" not in name else name.rpartition(":")[2]).replace("_", " ")


class Cell(NamedTuple):
    """A value as text."""

    value: str  # a dash where nothing was measured
    interval: str = ""  # `low, high`; empty where there is none


def cell(value: Value, digits: int, signed: bool = False) -> Cell:
    """A value as tables have it; `signed` tells a plus as well."""
    if not isinstance(value, Interval):
        return Cell(number(value, digits, signed))
    if not math.isfinite(value.estimate):
        return Cell("–")
    middle, low, high = (number(v, digits, signed) for v in (value.estimate, value.low, value.high))
    return Cell(middle, f"{low}, {high}" if math.isfinite(value.low) else "")


def number(value: float, digits: int, signed: bool = False) -> str:
    """Fixed digits, a real minus, no negative zero; large numbers that have fractions as powers of ten."""
    if not math.isfinite(value):
        return "–" if math.isnan(value) else "∞"
    form = f"{'+' if signed else ''}.{digits}f" if abs(value) < 1e4 or digits == 0 else ".0e"
    return f"{round(value, digits) + 0.0:{form}}".replace("-", "−") if "e" not in form else f"{value:{form}}"


def print_table(table: Table, console: Console) -> None:
    """The table on the terminal, each interval under its estimate; where the terminal is narrow less of it, and where
    that is still too wide in pieces, one below the other."""
    columns, narrow = list(table.columns), False
    if _width(table, columns, narrow, console) > console.width:
        columns, narrow = [column for column in columns if not column.optional], True
    console.print(table.title, style="bold", markup=False, highlight=False, soft_wrap=True)
    while columns:
        count = len(columns)
        while count > 1 and _width(table, columns[:count], narrow, console) > console.width:
            count -= 1
        console.print(_terminal_table(table, columns[:count], narrow))
        columns = columns[count:]
    console.print(table.caption, style="dim", markup=False, highlight=False)


def _width(table: Table, columns: Sequence[Column], narrow: bool, console: Console) -> int:
    """What some of the columns would take; `narrow` with the names wrapped as far as they may be."""
    unlimited, names = console.options.update(max_width=10_000), _NAMES if narrow else None
    return Measurement.get(console, unlimited, _terminal_table(table, columns, narrow, names)).maximum


def _terminal_table(table: Table, columns: Sequence[Column], narrow: bool, names: int | None = None) -> RichTable:
    """`narrow`: intervals only of what has three digits, and then one digit less, as `.12–.34`; `names`: their width
    at most, else as there is room."""
    shown = RichTable(box=box.SIMPLE_HEAD, padding=(0, 0 if narrow else 1), show_edge=False)
    shown.add_column(table.corner, min_width=_NAMES, max_width=names)
    for column in columns:
        shown.add_column(column.title, justify="right", no_wrap=True)
    for name, row in table.rows.items():
        shown.add_row(escape(display_name(name)), *(_two_lines(row[c.key], c.digits, narrow) for c in columns))
    return shown


def _two_lines(value: Value, digits: int, narrow: bool) -> str:
    with_interval = isinstance(value, Interval) and not (narrow and digits < 3)
    middle, interval = cell(value, digits - (narrow and with_interval))
    low, _, high = interval.partition(", ")
    if low == high == middle or not interval or not with_interval:
        return middle
    return f"{middle}\n{f'{low}–{high}'.replace('0.', '.') if narrow else f'{low}–{high}'}"
