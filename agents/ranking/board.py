"""Entries as files, one JSON each, and who is ahead: by paired differences over the worlds that they share."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agents.evaluation.records import Record, versions, write_json
from agents.evaluation.tables import display_name, number
from agents.ranking.protocol import FIRST, Protocol, column_of
from slam_gym.metrics.statistics import Interval
from slam_gym.simulation.judged import CEILING
from slam_gym.types import Array

BASELINES = Path(__file__).with_name("baselines")
"""The entries that ship."""

RESAMPLES = 4000


@dataclass(frozen=True)
class Ranked:
    """An entry that was put through the protocol. Only entries of the same protocol are compared."""

    name: str
    protocol: dict[str, Any]  # version, role, quick, hash
    losses: dict[str, list[float | None]]  # setting → loss in each of its worlds, None: nothing was to be decided
    about: dict[str, Any]  # command and versions

    @property
    def file(self) -> str:
        """What its file is called."""
        stem = re.sub(r"[^\w.-]+", "_", Path(self.name).stem if Path(self.name).is_file() else self.name)
        return f"{self.protocol['role']}-{stem}{'-quick' if self.protocol['quick'] else ''}.json"

    @property
    def columns(self) -> dict[str, Array]:
        """Column → losses in its episodes, NaN where nothing was to be decided."""
        found: dict[str, list[Any]] = {}
        for setting, losses in self.losses.items():
            found.setdefault(column_of(setting), []).extend(losses)
        return {name: np.array(losses, np.float64) for name, losses in found.items()}


def ranked(name: str, chosen: Protocol, records: Sequence[Record], command: str) -> Ranked:
    """The entry that records of a whole evaluation make."""
    losses: dict[str, list[float | None]] = {setting: [None] * count for setting, count in chosen.parts.items()}
    for record in records:
        loss = record["loss"]
        if loss is not None and math.isfinite(loss):
            losses[record["setting"]][record["episode"] - FIRST] = round(float(loss), 6)
    return Ranked(name, chosen.about, losses, {"command": command, "versions": versions()})


def write_entry(folder: Path, entry: Ranked) -> Path:
    """Write an entry into a folder, and return its file."""
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / entry.file, vars(entry))
    return folder / entry.file


def read_entries(folders: Sequence[Path]) -> list[Ranked]:
    """All entries of some folders; of two in files of the same name the one in the last folder. ValueError names a file
    that holds none."""
    files = {path.name: path for folder in folders for path in sorted(folder.glob("*.json"))}
    return [_read_entry(path) for path in files.values()]


def _read_entry(path: Path) -> Ranked:
    try:
        entry = Ranked(**json.loads(path.read_text(encoding="utf-8")))
        _ = entry.columns, entry.protocol["hash"], entry.file
        return entry
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise ValueError(f"{path}: no entry of the leaderboard ({type(error).__name__}: {error})") from None


class Row(NamedTuple):
    """An entry's place."""

    place: int  # one more than the number of entries that are better beyond doubt
    name: str
    loss: Interval  # mean over columns
    behind: Interval  # loss − that of the entry with the lowest, paired
    columns: dict[str, float]  # mean losses


def rows(entries: Sequence[Ranked]) -> list[Row]:
    """The entries, all of one protocol, by their places and then by their losses.

    The ceiling, which is told the truth, has place 0 and takes none from others.
    """
    columns = {entry.name: entry.columns for entry in entries}
    losses = {name: _mean_of_means(own) for name, own in columns.items()}
    rivals = [name for name in columns if name != CEILING]
    first = min(rivals or columns, key=lambda name: losses[name].estimate)

    def behind(name: str, other: str) -> Interval:
        return _mean_of_means({column: own - columns[other][column] for column, own in columns[name].items()})

    found = []
    for name, own in columns.items():
        better = sum(behind(name, other).low > 0.0 for other in rivals if other != name)
        means = {column: float(np.nanmean(values)) for column, values in own.items()}
        found.append(Row(0 if name == CEILING else 1 + better, name, losses[name], behind(name, first), means))
    return sorted(found, key=lambda row: (row.place, row.loss.estimate))


def _mean_of_means(columns: dict[str, Array]) -> Interval:
    """Mean over columns of their means, and its 95 % bootstrap interval: worlds are drawn within each column."""
    rng, known = np.random.default_rng(0), [values[np.isfinite(values)] for values in columns.values()]
    drawn = [values[rng.integers(len(values), size=(RESAMPLES, len(values)))].mean(axis=1) for values in known]
    low, high = np.percentile(np.mean(drawn, axis=0), [2.5, 97.5])
    return Interval(float(np.mean([values.mean() for values in known])), float(low), float(high))


def markdown(entries: Sequence[Ranked]) -> str:
    """A table for every protocol among the entries."""
    groups: dict[str, list[Ranked]] = {}
    for entry in entries:
        groups.setdefault(entry.protocol["hash"], []).append(entry)
    return "\n\n".join(_table(own[0].protocol, rows(own)) for own in groups.values())


def _table(protocol: dict[str, Any], found: Sequence[Row]) -> str:
    heads = ["", "entry", "loss", "behind the first", *found[0].columns]
    quick = ", quick (for tests)" if protocol["quick"] else ""
    lines = [f"### {protocol['role'].capitalize()}s", ""]
    lines += [f"Protocol {protocol['version']}{quick}, hash `{protocol['hash']}`.", ""]
    lines += ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for row in found:
        behind = "–" if row.behind.estimate == 0.0 else _interval(row.behind, signed=True)
        cells = [str(row.place or ""), display_name(row.name), _interval(row.loss), behind]
        lines.append("| " + " | ".join([*cells, *(number(mean, 3) for mean in row.columns.values())]) + " |")
    return "\n".join(lines)


def _interval(value: Interval, signed: bool = False) -> str:
    return f"{number(value.estimate, 3, signed)} [{number(value.low, 3)}, {number(value.high, 3)}]"
