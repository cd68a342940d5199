"""Records of episodes, and their files: a journal that survives interruption, CSV, JSON with what they depend on."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
import os
import platform
import re
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
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


PROTOCOL = 1
"""Raised when episodes are run or judged in another way: records of another protocol are not mixed with these."""


def setting_of(kind: str, conditions: dict[str, Any]) -> str:
    """What every record of an evaluation carries: a hash of what may not differ between them."""
    about = {"kind": kind, "conditions": plain(conditions), "protocol": PROTOCOL, "slam_gym": slam_gym.__version__}
    return _digest(json.dumps(about, sort_keys=True))


class Journal:
    """One JSON line per finished episode, appended as it finishes, with its setting and a checksum.

    A line cut short is ignored: its episode is run again. `setting`, where it is given, is that of all records.
    """

    def __init__(self, path: Path, setting: str | None = None) -> None:
        self._path, self._setting = path, setting

    def read(self) -> list[Record]:
        """The episodes so far. ValueError names the line that was changed by hand, or belongs elsewhere."""
        if not self._path.exists():
            return []
        lines = self._path.read_text(encoding="utf-8", errors="replace").splitlines()
        found = (self._record(line, f"{self._path}, line {number}") for number, line in enumerate(lines, 1))
        return [record for record in found if record is not None]

    def append(self, record: Record) -> None:
        """Write a record down. Whatever was cut short before stays a line of its own."""
        with self._path.open("a", encoding="utf-8") as file:
            if file.tell() and not self._ends_with_newline():
                file.write("\n")
            kept = record | {"setting_hash": self._setting}
            file.write(json.dumps(kept | {"checksum": _digest(json.dumps(kept))}) + "\n")

    def _record(self, line: str, where: str) -> Record | None:
        """The record of a line; None where the line is not whole."""
        try:
            record = json.loads(line)
        except (ValueError, RecursionError):
            return None
        if not isinstance(record, dict) or record.pop("checksum", None) != _digest(json.dumps(record)):
            raise ValueError(f"{where}: was changed since it was written; delete the line to run its episode again")
        setting = record.pop("setting_hash")
        if self._setting is not None and setting != self._setting:
            raise ValueError(f"{where}: a record of another setting, or of another version of this package")
        return record

    def _ends_with_newline(self) -> bool:
        with self._path.open("rb") as file:
            file.seek(-1, os.SEEK_END)
            return file.read(1) == b"\n"


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def stem(*names: str) -> str:
    """A file's name for things whose names may be paths, levels of the suite, or `module:name`."""
    return ".".join(re.sub(r"[^\w\-]+", "-", name).strip("-") for name in names)


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Where to write what is then put in its place: interrupted, or on a full disk, the old file stays whole."""
    partial = path.with_name(path.name + ".partial")
    try:
        yield partial
        os.replace(partial, path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def write_whole(path: Path, text: str) -> None:
    """Write a text in one piece."""
    with written_whole(path) as partial:
        partial.write_text(text, encoding="utf-8", newline="")


def write_csv(path: Path, records: Sequence[Record]) -> None:
    """One row per episode; curves and other lists are left out."""
    names = list(dict.fromkeys(key for record in records for key, value in record.items() if not _is_list(value)))
    file = io.StringIO()
    writer = csv.DictWriter(file, names, extrasaction="ignore")
    writer.writeheader()
    writer.writerows(records)
    write_whole(path, file.getvalue())


def _is_list(value: Any) -> bool:
    return isinstance(value, list | dict)


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Standard JSON: what is not finite becomes null, a dataclass an object. Written in one piece."""
    write_whole(path, json.dumps(plain(content), indent=1, ensure_ascii=False) + "\n")


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
