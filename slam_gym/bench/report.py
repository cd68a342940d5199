"""Where a benchmark leaves what it finds: tables on the screen, CSV files and pictures in a folder."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from slam_gym.bench import figures
from slam_gym.bench.records import Record
from slam_gym.metrics.statistics import Interval

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Report:
    """Prints at once; writes files into `folder` unless that is None."""

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder

    def say(self, text: str) -> None:
        """A line for whoever is watching."""
        print(text, flush=True)

    def table(self, title: str, rows: Sequence[Record], file: str = "") -> None:
        """Print rows as a table and, under the name of a `file`, write them."""
        self.say(f"\n{title}\n{as_text(rows)}")
        if file:
            self.rows(file, rows)

    def rows(self, file: str, rows: Sequence[Record]) -> None:
        """Write rows as FILE.csv, unrounded."""
        if self._folder is not None and rows:
            self._folder.mkdir(parents=True, exist_ok=True)
            write_csv(self._folder / f"{file}.csv", rows)

    def pictures(self, drawings: Mapping[str, Callable[[], Figure]]) -> None:
        """Write each figure as NAME.png."""
        if self._folder is not None and not figures.save(self._folder, drawings):
            self.say("no pictures: matplotlib is not installed")

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Say how long a part took, once it is done."""
        start = perf_counter()
        yield
        self.say(f"{name}: {perf_counter() - start:.0f} s")


def as_text(rows: Sequence[Record]) -> str:
    """Columns as wide as they need to be, numbers to the right, words to the left; blank where a row has nothing."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    lines = [names, *([as_cell(row.get(name)) for name in names] for row in rows)]
    widths = [max(map(len, cells)) for cells in zip(*lines)]
    words = [all(isinstance(row.get(name, ""), str) for row in rows) for name in names]
    shown = ([c.ljust(w) if word else c.rjust(w) for c, w, word in zip(line, widths, words)] for line in lines)
    return "\n".join("  ".join(cells).rstrip() for cells in shown)


def as_cell(value: object) -> str:
    """One value as text: numbers to four digits, an interval as `estimate [low, high]`, a flag as yes or no."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Interval):
        return "{} [{}, {}]".format(*(_number(v, 3) for v in (value.estimate, value.low, value.high)))
    return _number(value, 4) if isinstance(value, float) else str(value)


def _number(value: float, digits: int) -> str:
    return f"{value:.0f}" if 10.0**digits <= abs(value) < 1e7 else f"{value:.{digits}g}"


def write_csv(path: Path, rows: Sequence[Record]) -> None:
    """Write rows to a file; an interval takes three columns."""
    flat = [_without_intervals(row) for row in rows]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(dict.fromkeys(name for row in flat for name in row)), restval="")
        writer.writeheader()
        writer.writerows(flat)


def _without_intervals(row: Record) -> Record:
    flat: Record = {}
    for name, value in row.items():
        if isinstance(value, Interval):
            flat |= {name: value.estimate, f"{name}, low": value.low, f"{name}, high": value.high}
        else:
            flat[name] = value
    return flat
