"""Entries as JSON files, and their ranking by paired differences over common worlds."""

import html
import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from agents.evaluation.records import Record, undamaged, versions, write_json
from agents.evaluation.tables import display_name, number
from agents.ranking.protocol import FIRST, PARTS, Protocol, column_of
from slam_gym._files import content_of, json_of
from slam_gym.metrics.statistics import Interval
from slam_gym.simulation.judged import CEILING

BASELINES = Path(__file__).with_name("baselines")
"""The folder of the shipped entries."""

RESAMPLES = 4000


@dataclass(frozen=True)
class Ranked:
    """An entry that was evaluated by the protocol. Only entries of the same protocol are compared.

    Raises ValueError for contents that no evaluation writes; losses are finite and not below 0.
    """

    name: str
    protocol: dict[str, Any]  # version, role, quick, hash
    losses: dict[str, list[float | None]]  # setting → loss in each of its worlds; None: a world without problems
    about: dict[str, Any]  # command and versions

    def __post_init__(self) -> None:
        role, code = self.protocol["role"], self.protocol["hash"]
        numbered = isinstance(self.protocol["version"], int) and isinstance(self.protocol["quick"], bool)
        if role not in PARTS or not numbered or not code.isalnum() or not isinstance(self.name, str):
            raise ValueError("its protocol or its name is none")
        for setting, losses in self.losses.items():
            for loss in losses:
                if loss is not None and not (isinstance(loss, int | float) and 0.0 <= loss < math.inf):
                    raise ValueError(f"the loss {loss!r} in {setting}, expected a number from 0 on")
        known = self.by_column().groupby(level=0).count()
        if known.empty or (known == 0).any():
            raise ValueError("there is a column without a loss, or no column")

    @property
    def shape(self) -> str:
        """Protocol, settings and worlds, which are equal for entries that are compared."""
        return json.dumps([self.protocol["hash"], {setting: len(losses) for setting, losses in self.losses.items()}])

    @property
    def file(self) -> str:
        """The name of its file."""
        stem = re.sub(r"[^\w.-]+", "_", Path(self.name).stem if Path(self.name).is_file() else self.name)
        return f"{self.protocol['role']}-{stem}{'-quick' if self.protocol['quick'] else ''}.json"

    def quick(self) -> "Ranked":
        """The same entry by the short protocol, whose worlds are among those of the whole one."""
        chosen = Protocol(self.protocol["role"], quick=True)
        losses = {setting: self.losses[setting][:count] for setting, count in chosen.parts.items()}
        return Ranked(self.name, chosen.about, losses, self.about)

    def by_column(self) -> pd.Series:
        """Losses by column, setting and world; NaN for a world without problems."""
        series = {(column_of(name), name): pd.Series(losses, dtype=float) for name, losses in self.losses.items()}
        return pd.concat(series)


def ranked(name: str, chosen: Protocol, records: Sequence[Record], command: str) -> Ranked:
    """The entry for the records of a whole evaluation."""
    losses: dict[str, list[float | None]] = {setting: [None] * count for setting, count in chosen.parts.items()}
    for record in records:
        if not math.isnan(loss := float(record["loss"])):
            losses[record["setting"]][record["episode"] - FIRST] = round(loss, 6)
    return Ranked(name, chosen.about, losses, {"command": command, "versions": versions()})


def write_entry(folder: Path, entry: Ranked) -> Path:
    """Write an entry to a folder, and return its file."""
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / entry.file, vars(entry))
    return folder / entry.file


def read_entries(folders: Sequence[Path]) -> tuple[list[Ranked], list[str]]:
    """All entries of `folders`, and a line for each file without a valid entry. Of files with the same name, the one in
    the last folder counts."""
    files = {path.name: path for folder in folders for path in sorted(folder.glob("*.json"))}
    entries, invalid = [], []
    for path in files.values():
        try:
            with undamaged(f"{path}: the entry"):
                entries.append(Ranked(**json_of(content_of(path))))
        except (ValueError, OSError) as error:
            invalid.append(" ".join(str(error).split()))
    return entries, invalid


class Row(NamedTuple):
    """A row of the ranking."""

    place: int  # 1 + the number of entries that are better with an interval that excludes 0
    name: str
    loss: Interval  # mean over columns
    behind: Interval  # paired difference to the entry with the lowest loss
    columns: dict[str, float]  # mean losses


def rows(entries: Sequence[Ranked]) -> list[Row]:
    """The ranking of entries of one protocol, by place and then by loss.

    The ceiling, which uses the truth, has place 0 and does not change the places of others.
    """
    losses = pd.DataFrame({entry.name: entry.by_column() for entry in entries})
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
    """The mean over columns of their means, and its 95 % bootstrap interval, resampling worlds within each column."""
    rng = np.random.default_rng(0)
    known = [column.to_numpy() for _, column in losses.dropna().groupby(level=0, sort=False)]
    drawn = [values[rng.integers(len(values), size=(RESAMPLES, len(values)))].mean(axis=1) for values in known]
    low, high = np.percentile(np.mean(drawn, axis=0), [2.5, 97.5])
    return Interval(float(np.mean([values.mean() for values in known])), float(low), float(high))


def markdown(entries: Sequence[Ranked]) -> str:
    """Markdown tables, one for every protocol among the entries."""
    groups: dict[str, list[Ranked]] = {}
    for entry in entries:
        groups.setdefault(entry.shape, []).append(entry)
    return "\n\n".join(_table(group[0].protocol, rows(group)) for group in groups.values())


def _table(protocol: dict[str, Any], ranking: Sequence[Row]) -> str:
    quick = protocol["quick"]  # so few worlds tell no places and no intervals
    heads = ["", "entry", "loss", *([] if quick else ["behind the first"]), *map(_escaped, ranking[0].columns)]
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
