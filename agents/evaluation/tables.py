"""Estimates with intervals over the episodes of an evaluation, and tables of them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich import box
from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text
from scipy.stats import beta

from slam_gym.metrics.statistics import Interval, Statistic, bootstrap_interval, interquartile_mean, mean
from slam_gym.simulation.judged import CEILING
from slam_gym.types import Array

Value = Interval | float | int
FEWEST = 10  # least number of worlds for an interval
INTERVALS = ", 95 % interval"
Rows = dict[str, dict[str, Value]]
"""Name of an agent or associator → key of a column → value."""


def counted(count: int, what: str) -> str:
    """A number with its noun, such as `1 episode` or `30 episodes`."""
    return f"{count} {what}{'' if count == 1 else 's'}"


@dataclass(frozen=True)
class Column:
    """A column of a table."""

    key: str  # in the results
    title: str
    digits: int = 3
    better: str = ""  # "lower", "higher", or neither
    rare: bool = False  # a rare event, of which the mean is taken, since an interquartile mean ignores it


_ALL = (
    # of a drive
    Column("map_error", "map error", 3, "lower"), Column("map_error_aligned", "aligned error", 3, "lower"),
    Column("coverage", "coverage", 3, "higher"), Column("anees", "ANEES", 2),
    Column("map_lost", "lost", 3, "lower", rare=True), Column("duplicates", "dupl.", 1, "lower"),
    Column("ticks", "ticks", 0), Column("ticks_per_second", "ticks/s", 0),
    Column("recovered", "recovered", 2, "higher", rare=True),
    Column("relocations_wrong", "wrong reloc.", 1, "lower", rare=True),
    Column("ticks_astray", "ticks astray", 0, "lower"),
    # of associations and searches
    Column("precision", "precision", 3, "higher"), Column("recall", "recall", 3, "higher"),
    Column("f1", "F1", 3, "higher"), Column("exact", "exact", 3, "higher"), Column("nodes", "nodes", 0),
    Column("microseconds", "µs/scan", 0, "lower"), Column("limits", "limit met", 1, "lower", rare=True),
    # of the suite
    Column("score", "score", 3, "higher"),
    Column("spoiled", "spoiled", 3, "lower"), Column("refused", "refused", 3, "lower"),
    Column("promised", "promised", 3), Column("kept", "kept", 3),
    # of a log
    Column("features", "feat.", 0), Column("found", "found", 0, "higher"), Column("wrong", "wrong", 0, "lower"),
    Column("clutter_features", "clut.", 0, "lower"), Column("clutter_share", "clutter accepted", 3, "lower"),
    Column("clutter_on_landmarks", "onto landmarks", 0, "lower"), Column("ate", "ATE", 2, "lower"),
    Column("ate_batch", "ATE batch", 2, "lower"), Column("landmark_rmse_batch", "lm. batch", 2, "lower"),
    Column("ate_unaligned", "ATE₀", 2, "lower"), Column("ate_median", "median error", 2, "lower"),
    Column("landmark_rmse", "lm.", 2, "lower"), Column("landmarks_compared", "of lm.", 0),
    Column("landmark_rmse_unaligned", "landmarks₀", 2, "lower"),
    Column("seconds", "s", 1, "lower"), Column("step_microseconds", "µs/step", 0, "lower"),
)  # fmt: skip


def columns(*keys: str) -> list[Column]:
    """The columns with these keys."""
    known = {column.key: column for column in _ALL}
    return [known[key] for key in keys]


@dataclass(frozen=True)
class Table:
    """A table on the terminal and in the report."""

    title: str
    corner: str  # title of the first column, which contains the names
    columns: Sequence[Column]
    rows: Rows
    caption: str = f"interquartile mean{INTERVALS}"
    differences: bool = False  # values are differences, shown with their signs
    detail: bool = False  # only in the report

    @property
    def note(self) -> str:
        """The caption, without the mention of intervals where no value has one."""
        values = [value for row in self.rows.values() for value in row.values()]
        shown = any(isinstance(value, Interval) and math.isfinite(value.low) for value in values)
        return self.caption if shown else self.caption.replace(INTERVALS, "")

    @property
    def bold(self) -> dict[str, set[str]]:
        """Column key → the names with the best values or, in a table of differences, with intervals that exclude 0."""
        bold = {}
        for column in self.columns:
            values = {name: v for name, row in self.rows.items() if isinstance(v := row.get(column.key), Interval)}
            significant = {name for name, value in values.items() if value.low > 0.0 or value.high < 0.0}
            bold[column.key] = significant if self.differences else best_names(values, column)
        return bold


# -- estimates -----------------------------------------------------------------------------------------------------


def share(values: Array) -> Array:
    """The mean of a rare event, of which an interquartile mean would leave out a quarter."""
    return mean(values)


def estimate(values: Any, *, statistic: Statistic = interquartile_mean, resamples: int = 5000) -> Interval:
    """The statistic of values (n,) and its 95 % bootstrap interval; of a `share`, the exact one.

    Values that are not finite are left out; all three are NaN if none is left. The same values always give the same
    interval. It is NaN for fewer than `FEWEST` values.
    """
    values = np.asarray(values, np.float64)
    values = values[np.isfinite(values)]
    if len(values) < FEWEST:
        return Interval(float(statistic(values)) if len(values) else math.nan, math.nan, math.nan)
    # Clopper–Pearson, also for means over settings: a bootstrap of no event has no width
    if statistic is share and (values >= 0.0).all() and (values <= 1.0).all():
        n, k = len(values), float(values.sum())
        low, high = beta.ppf(0.025, k, n - k + 1.0), beta.ppf(0.975, k + 1.0, n - k)
        return Interval(k / n, float(low) if k > 0.0 else 0.0, float(high) if k < n else 1.0)
    return bootstrap_interval(values, np.random.default_rng(0), statistic=statistic, resamples=resamples)


def estimate_of(
    frame: pd.DataFrame, key: Any, statistic: Statistic = interquartile_mean, resamples: int = 5000
) -> Interval:
    """The estimate of a number over worlds."""
    return estimate(_over_settings(_over_models(frame, key)), statistic=statistic, resamples=resamples)


def _over_models(frame: pd.DataFrame, key: Any) -> pd.Series:
    """A number by setting and episode, the mean over models of one name, which share the worlds."""
    return frame.groupby(["setting", "episode"])[key].mean()


def _over_settings(numbers: pd.Series) -> pd.Series:
    """The means over settings of each world, NaN for a world that lacks the number in one of them.

    World k may be the same building in several settings, so that these are not independent.
    """
    return numbers.unstack("setting").mean(axis=1, skipna=False)


def estimates(frame: pd.DataFrame, columns: Sequence[Column]) -> dict[str, Value]:
    """Column key → estimate over the worlds of `frame`."""
    return {c.key: estimate_of(frame, c.key, share if c.rare else interquartile_mean) for c in columns}


def grouped(frame: pd.DataFrame, by: str) -> dict[str, pd.DataFrame]:
    """The episodes of each `name` or `setting`, in the order of the frame."""
    return dict(iter(frame.groupby(by, sort=False)))


def difference(
    first: pd.DataFrame, second: pd.DataFrame, key: str, statistic: Statistic = interquartile_mean
) -> Interval:
    """The paired difference first − second over common worlds, with its interval."""
    paired = (_over_models(first, key) - _over_models(second, key)).dropna()
    return estimate(_over_settings(paired), statistic=statistic)


def best_names(values: Mapping[str, Interval], column: Column) -> set[str]:
    """The names with the best value or with an interval that overlaps the best one's; none if these are all names.

    The ceiling is left out, and so are values without an interval.
    """
    known = {name: v for name, v in values.items() if math.isfinite(v.low) and not name.startswith(CEILING)}
    if not column.better or len(known) < 2:
        return set()
    best = min if column.better == "lower" else max
    first = best(known.values(), key=lambda value: value.estimate)
    tied = {name for name, value in known.items() if value.low <= first.high and value.high >= first.low}
    return tied if len(tied) < len(known) else set()


# -- as text -------------------------------------------------------------------------------------------------------


def display_name(name: str) -> str:
    """A name for tables: `module:function` as it is, a file with its folder, others with spaces for `_`."""
    if ":" in name:
        return name
    return "/".join(Path(name).parts[-2:]) if Path(name).suffix else name.replace("_", " ")


def number(value: float, digits: int, signed: bool = False) -> str:
    """A number as text: fixed digits, a real minus, no negative zero; large numbers with fractions as powers of ten."""
    if not math.isfinite(value):
        return "–" if math.isnan(value) else "∞"
    if abs(value) >= 1e4 and digits > 0:
        return f"{value:.0e}"
    return f"{round(value, digits) + 0.0:{'+' if signed else ''}.{digits}f}".replace("-", "−")


def cell(value: Value | None, digits: int, signed: bool = False) -> tuple[str, str]:
    """A value and its interval, `low, high`, as text: a dash for NaN, an empty text for a missing interval."""
    if value is None:
        return "", ""
    if not isinstance(value, Interval):
        return number(value, digits, signed), ""
    ends = [number(end, digits, signed) for end in (value.low, value.high)]
    return number(value.estimate, digits, signed), ", ".join(ends) if math.isfinite(value.low) else ""


def print_table(table: Table, console: Console) -> None:
    """Print a table, with each interval below its estimate. A table that is too wide is cut into several, one below the
    other."""
    console.print(table.title, style="bold", markup=False, highlight=False, soft_wrap=True)
    unlimited, rest = console.options.update(max_width=10_000), list(table.columns)
    while rest:
        count = len(rest)
        while count > 1 and console.measure(_grid(table, rest[:count]), options=unlimited).maximum > console.width:
            count -= 1
        console.print(_grid(table, rest[:count]))
        rest = rest[count:]
    if table.note:
        console.print(table.note, style="dim", markup=False, highlight=False)


def _grid(table: Table, columns: Sequence[Column]) -> RichTable:
    grid = RichTable(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    grid.add_column(Text(table.corner), max_width=40)
    for column in columns:
        grid.add_column(Text(column.title), justify="right", no_wrap=True)
    for name, row in table.rows.items():
        cells = []
        for column in columns:
            value, interval = cell(row.get(column.key), column.digits, table.differences)
            low, _, high = interval.partition(", ")
            cells.append(Text(value) if low == high else Text.assemble(value, "\n", (f"{low}–{high}", "dim")))
        grid.add_row(Text(display_name(name)), *cells)
    return grid
