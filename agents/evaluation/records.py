"""Records of episodes, and their files: a journal that survives interruption, CSV, JSON with what they depend on."""

from __future__ import annotations

import csv
import json
import math
import os
import platform
import subprocess
from collections.abc import Sequence
from dataclasses import asdict, is_dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple

import slam_gym

Record = dict[str, Any]
"""One episode: who was evaluated (`agent` or `associator`), `episode`, `setting` or `model` where there are several,
and its numbers; `curve` holds lists over the time of the episode."""

PACKAGES = ("numpy", "scipy", "numba", "gymnasium", "pymunk", "torch", "stable-baselines3", "sb3-contrib", "joblib")


class Key(NamedTuple):
    """What tells one record of an evaluation from another."""

    name: str  # of the agent or associator
    setting: str | None  # scenario, level of the suite or log, where there are several
    episode: int
    model: str | None = None  # file of a learned agent

    @classmethod
    def of_record(cls, record: Record, subject: str) -> Key:
        """`subject` is the field that says who was evaluated."""
        return cls(record[subject], record.get("setting"), record["episode"], record.get("model"))


class Journal:
    """One JSON line per finished episode, appended as it finishes. A line cut short is ignored."""

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
        """Write a record down. Whatever was cut short before stays a line of its own."""
        with self._path.open("a", encoding="utf-8") as file:
            if file.tell() and not self._ends_with_newline():
                file.write("\n")
            file.write(json.dumps(record) + "\n")

    def _ends_with_newline(self) -> bool:
        with self._path.open("rb") as file:
            file.seek(-1, os.SEEK_END)
            return file.read(1) == b"\n"


def write_csv(path: Path, records: Sequence[Record]) -> None:
    """One row per episode; curves and other lists are left out."""
    names = list(dict.fromkeys(key for record in records for key, value in record.items() if not _is_list(value)))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(records)


def _is_list(value: Any) -> bool:
    return isinstance(value, list | dict)


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Standard JSON: what is not finite becomes null, a dataclass an object. Written in one piece."""
    partial = path.with_name(path.name + ".partial")
    partial.write_text(json.dumps(plain(content), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    os.replace(partial, path)


def plain(value: Any) -> Any:
    """The value as standard JSON would give it back."""
    if is_dataclass(value) and not isinstance(value, type):
        value = asdict(value)
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def versions() -> dict[str, str]:
    """Versions of everything that results depend on; the commit of the checkout where it is one."""
    found = {"slam_gym": slam_gym.__version__, "python": platform.python_version(), "machine": platform.platform()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    try:
        git = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty", "--abbrev=12"]
        found["commit"] = subprocess.run(git, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        found["commit"] = "unknown"
    return found
