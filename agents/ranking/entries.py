"""Entries of the leaderboard as files: one JSON each, with what it was run on, and a checksum."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import math
import os
import platform
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agents.evaluation.records import Record, plain, versions, write_json
from agents.ranking.protocol import FIRST, Protocol

BASELINES = Path(__file__).with_name("baselines")
"""The entries that ship."""

_MAX_BYTES = 1 << 22


@dataclass(frozen=True)
class Ranked:
    """An entry that was put through the protocol."""

    role: str
    name: str
    protocol: dict[str, Any]  # version, role, quick, hash
    worlds: str  # hash of the floors
    losses: dict[str, list[float]]  # setting → loss in each of its worlds, NaN where there was nothing to decide
    about: dict[str, Any]  # machine, versions, command, seconds, source

    @property
    def key(self) -> tuple[str, str, str]:
        """Only entries that share it are compared."""
        return self.role, str(self.protocol["hash"]), self.worlds


def ranked(name: str, chosen: Protocol, records: Sequence[Record], command: str, seconds: float) -> Ranked:
    """The entry that records of a whole evaluation make."""
    losses = {part.setting: [math.nan] * part.count for part in chosen.parts}
    for record in records:
        loss = record["loss"]
        losses[record["setting"]][record["episode"] - FIRST] = math.nan if loss is None else float(loss)
    about = {
        "machine": f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores",
        "versions": versions(),
        "command": command,
        "seconds": round(seconds),
        "source": source_hash(name),
    }
    return Ranked(chosen.role, name, chosen.about, chosen.worlds_hash(), losses, about)


def source_hash(name: str) -> str:
    """Of the model file or the module behind an entry; empty for those of the package, whose version says it."""
    path = Path(name) if Path(name).is_file() else None
    if path is None and ":" in name:
        found = importlib.util.find_spec(name.partition(":")[0])
        path = Path(found.origin) if found is not None and found.origin else None
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16] if path is not None else ""


def write_entry(folder: Path, entry: Ranked) -> Path:
    """Write an entry into a folder, and return its file."""
    folder.mkdir(parents=True, exist_ok=True)
    stem = re.sub(r"[^\w.-]+", "_", Path(entry.name).stem if Path(entry.name).is_file() else entry.name)
    path = folder / f"{entry.role}-{stem}{'-quick' if entry.protocol['quick'] else ''}.json"
    losses = {setting: [round(x, 6) for x in values] for setting, values in entry.losses.items()}
    content = plain(vars(entry) | {"losses": losses})
    write_json(path, content | {"checksum": _checksum(content)})
    return path


def read_entry(path: Path) -> Ranked:
    """An entry from its file. Raises ValueError that names the file for what is none, or was edited."""
    if path.stat().st_size > _MAX_BYTES:
        raise ValueError(f"{path}: larger than {_MAX_BYTES} bytes")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        checksum = content.pop("checksum")
        found = Ranked(**content)
        losses = {
            setting: [math.nan if x is None else float(x) for x in values] for setting, values in found.losses.items()
        }
        _ = found.key, found.protocol["quick"], found.about["seconds"]
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise ValueError(f"{path}: no entry of the leaderboard ({type(error).__name__}: {error})") from None
    if checksum != _checksum(content):
        raise ValueError(f"{path}: was changed since it was written")
    return Ranked(**(content | {"losses": losses}))


def read_entries(folders: Sequence[Path]) -> list[Ranked]:
    """All entries of some folders; of two of the same name the one in the last folder."""
    found: dict[tuple[str, str, bool], Ranked] = {}
    for folder in folders:
        for path in sorted(folder.glob("*.json")) if folder.is_dir() else ():
            entry = read_entry(path)
            found[entry.role, entry.name, bool(entry.protocol["quick"])] = entry
    return list(found.values())


def _checksum(content: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]
