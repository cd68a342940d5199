"""Entries as files, one JSON each, and who is ahead: by paired differences over the worlds that they share."""

from __future__ import annotations

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
"""The entries that ship."""

RESAMPLES = 4000


@dataclass(frozen=True)
class Ranked:
    """An entry that was put through the protocol. Only entries of the same protocol are compared.

    Raises ValueError for what no protocol and no evaluation makes: losses are finite and not below 0.
    """

    name: str
    protocol: dict[str, Any]  # version, role, quick, hash
    losses: dict[str, list[float | None]]  # setting → loss in each of its worlds, None: nothing was to be decided
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
        """Protocol, settings and worlds: what entries share that are compared."""
        return json.dumps([self.protocol["hash"], {setting: len(losses) for setting, losses in self.losses.items()}])

    @property
    def file(self) -> str:
        """What its file is called."""
        stem = re.sub(r"[^\w.-]+", "_", Path(self.name).stem if Path(self.name).is_file() else self.name)
        return f"{self.protocol['role']}-{stem}{'-quick' if self.protocol['quick'] else ''}.json"

    def by_column(self) -> pd.Series:
        """Losses, by column, setting and world; NaN where nothing was to be decided."""
        found = {(column_of(setting), setting): pd.Series(own, dtype=float) for setting, own in self.losses.items()}
        return pd.concat(found)


def ranked(name: str, chosen: Protocol, records: Sequence[Record], command: str) -> Ranked:
    """The entry that records of a whole evaluation make."""
    losses: dict[str, list[float | None]] = {setting: [None] * count for setting, count in chosen.parts.items()}
    for record in records:
        if not math.isnan(loss := float(record["loss"])):
            losses[record["setting"]][record["episode"] - FIRST] = round(loss, 6)
    return Ranked(name, chosen.about, losses, {"command": command, "versions": versions()})


def write_entry(folder: Path, entry: Ranked) -> Path:
    """Write an entry into a folder, and return its file."""
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / entry.file, vars(entry))
    return folder / entry.file


def read_entries(folders: Sequence[Path]) -> tuple[list[Ranked], list[str]]:
    """All entries of some folders, and a line about each file that holds none. Of two in files of the same name it is
    the one in the last folder."""
    files = {path.name: path for folder in folders for path in sorted(folder.glob("*.json"))}
    entries, refused = [], []
    for path in files.values():
        try:
            with undamaged(f"{path}: the entry"):
                entries.append(Ranked(**json_of(content_of(path))))
        except (ValueError, OSError) as error:
            refused.append(" ".join(str(error).split()))
    return entries, refused


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
    losses = pd.DataFrame({entry.name: entry.by_column() for entry in entries})
    means = losses.groupby(level=0, sort=False).mean()
    rivals = [name for name in losses if name != CEILING]
    first = means.mean()[rivals or list(losses)].idxmin()
    found = []
    for name, own in losses.items():
        better = sum(_mean_of_means(own - losses[other]).low > 0.0 for other in rivals if other != name)
        place = 0 if name == CEILING else 1 + better
        behind = _mean_of_means(own - losses[first])
        found.append(Row(place, str(name), _mean_of_means(own), behind, means[name].to_dict()))
    return sorted(found, key=lambda row: (row.place, row.loss.estimate))


def _mean_of_means(losses: pd.Series) -> Interval:
    """Mean over columns of their means, and its 95 % bootstrap interval: worlds are drawn within each column."""
    rng = np.random.default_rng(0)
    known = [own.to_numpy() for _, own in losses.dropna().groupby(level=0, sort=False)]
    drawn = [values[rng.integers(len(values), size=(RESAMPLES, len(values)))].mean(axis=1) for values in known]
    low, high = np.percentile(np.mean(drawn, axis=0), [2.5, 97.5])
    return Interval(float(np.mean([values.mean() for values in known])), float(low), float(high))


def markdown(entries: Sequence[Ranked]) -> str:
    """A table for every protocol among the entries."""
    groups: dict[str, list[Ranked]] = {}
    for entry in entries:
        groups.setdefault(entry.shape, []).append(entry)
    return "\n\n".join(_table(own[0].protocol, rows(own)) for own in groups.values())


def _table(protocol: dict[str, Any], found: Sequence[Row]) -> str:
    heads = ["", "entry", "loss", "behind the first", *map(_escaped, found[0].columns)]
    quick = ", quick (for tests)" if protocol["quick"] else ""
    lines = [f"### {protocol['role'].capitalize()}s", ""]
    lines += [f"Protocol {protocol['version']}{quick}, hash `{protocol['hash']}`.", ""]
    lines += ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for row in found:
        behind = "–" if row.behind.estimate == 0.0 else _interval(row.behind, signed=True)
        cells = [str(row.place or ""), _escaped(display_name(row.name)), _interval(row.loss), behind]
        lines.append("| " + " | ".join([*cells, *(number(mean, 3) for mean in row.columns.values())]) + " |")
    return "\n".join(lines)


def _escaped(text: str) -> str:
    """Text that Markdown and HTML show as it is, on one line."""
    return re.sub(r"([\\`*_\[\]|])", r"\\\1", html.escape(" ".join(text.split())))


def _interval(value: Interval, signed: bool = False) -> str:
    return f"{number(value.estimate, 3, signed)} [{number(value.low, 3)}, {number(value.high, 3)}]"
