"""What an evaluation leaves behind: a journal of episodes that survives interruption, the table, CSV and JSON."""

from __future__ import annotations

import csv
import json
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_gym.metrics.statistics import Interval, bootstrap_interval

Record = dict[str, Any]
"""One episode: agent, model, episode, the numbers of `run_episode`, and its `curve`."""


@dataclass(frozen=True)
class Column:
    """A column of the table."""

    key: str  # in a record
    title: str
    digits: int
    better: str = ""  # "lower", "higher", or neither


TABLE = (
    Column("map_error", "map error", 3, "lower"),
    Column("coverage", "coverage", 3, "higher"),
    Column("precision", "precision", 3, "higher"),
    Column("recall", "recall", 3, "higher"),
    Column("anees", "ANEES", 2),
    Column("ticks", "ticks", 0),
    Column("ticks_per_second", "ticks/s", 0),
)


class Journal:
    """episodes.jsonl: one line per finished episode, appended as it finishes. A line cut short is ignored."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def read(self) -> list[Record]:
        """The episodes so far."""
        if not self._path.exists():
            return []
        records = []
        for line in self._path.read_text(encoding="utf-8").splitlines():
            try:
                records.append(json.loads(line))
            except json.JSONDecodeError:
                continue
        return records

    def append(self, record: Record) -> None:
        with self._path.open("a", encoding="utf-8") as file:
            if file.tell() and not self._ends_with_newline():
                file.write("\n")
            file.write(json.dumps(record) + "\n")

    def _ends_with_newline(self) -> bool:
        with self._path.open("rb") as file:
            file.seek(-1, os.SEEK_END)
            return file.read(1) == b"\n"


def in_order(records: Sequence[Record], agents: Sequence[str]) -> list[Record]:
    """Sorted by agent (in the order given), model and episode: the same however the work was shared out."""
    known = [record for record in records if record["agent"] in agents]
    return sorted(known, key=lambda r: (agents.index(r["agent"]), r["model"] or "", r["episode"]))


def values_of(records: Sequence[Record], agent: str, key: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Values (e,) of an agent's episodes, and the model (e,) that drove each, by number."""
    own = [record for record in records if record["agent"] == agent]
    models = sorted({record["model"] or "" for record in own})
    strata = np.array([models.index(record["model"] or "") for record in own], dtype=np.int64)
    return np.array([record[key] for record in own], dtype=float), strata


def estimate(values: NDArray[np.float64], strata: NDArray[np.int64] | None = None, resamples: int = 5000) -> Interval:
    """Interquartile mean over episodes and its 95 % bootstrap interval, resampled within each model (strata).

    All NaN where there is no finite value; the same values always give the same interval.
    """
    finite = np.isfinite(values)
    if not finite.any():
        return Interval(math.nan, math.nan, math.nan)
    strata = None if strata is None else strata[finite]
    return bootstrap_interval(values[finite], np.random.default_rng(0), strata=strata, resamples=resamples)


def paired(records: Sequence[Record], first: str, second: str, key: str) -> Interval:
    """Difference first − second on the episodes that both have (means over models), with its bootstrap interval."""
    by_episode: dict[str, dict[int, list[float]]] = {first: {}, second: {}}
    for record in records:
        if record["agent"] in by_episode:
            by_episode[record["agent"]].setdefault(record["episode"], []).append(record[key])
    common = sorted(by_episode[first].keys() & by_episode[second].keys())
    differences = [np.mean(by_episode[first][k]) - np.mean(by_episode[second][k]) for k in common]
    return estimate(np.array(differences, dtype=float))


def table(records: Sequence[Record], agents: Sequence[str]) -> dict[str, dict[str, Interval]]:
    """agent → column key → estimate."""
    return {agent: {c.key: estimate(*values_of(records, agent, c.key)) for c in TABLE} for agent in agents}


def kidnappings(records: Sequence[Record], agent: str) -> str:
    """What became of an agent's robots that were carried away, in one line; empty where none was."""
    own = [record for record in records if record["agent"] == agent and record.get("kidnapped")]
    if not own:
        return ""
    found = [record["ticks_astray"] for record in own if record["recovered"]]
    line = f"{agent}: carried away {len(own)}, recovered {len(found)}, never {len(own) - len(found)}"
    line += f", wrong relocations {sum(record['relocations_wrong'] for record in own):.0f}"
    return line + (f"; ticks astray {np.median(found):.0f} (median of the recovered)" if found else "")


def cell(value: Interval, digits: int) -> str:
    """`estimate [low, high]`; a dash where nothing was measured."""
    if not math.isfinite(value.estimate):
        return "–"
    return f"{value.estimate:.{digits}f} [{value.low:.{digits}f}, {value.high:.{digits}f}]"


def film_path(out: Path, agent: str) -> Path:
    """Where an agent's film lies; its last picture has the same name with .png."""
    return out / "films" / f"{agent.replace(':', '.')}.mp4"


def write_csv(path: Path, records: Sequence[Record]) -> None:
    """One row per episode, curves left out."""
    names = list(dict.fromkeys(key for record in records for key in record if key != "curve"))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(records)


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Standard JSON: what is not finite becomes null. Written in one piece."""
    partial = path.with_name(path.name + ".partial")
    partial.write_text(json.dumps(_finite(content), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    os.replace(partial, path)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
