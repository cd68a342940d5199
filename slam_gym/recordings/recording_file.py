"""The file that holds a recording: an .npz archive without pickles, as `recordings/FORMAT.md` describes it."""

from __future__ import annotations

import os
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from slam_gym._files import array_of, content_of, zip_members
from slam_gym.recordings.reading import RecordingError, naming
from slam_gym.recordings.recording import Recording

FORMAT, VERSION = "slam_gym recording", 1
_TEXTS = ("name", "source", "terms")
_INTEGERS = ("starts", "sources", "landmark_ids")
_NUMBERS = ("range", "field_of_view")


def save(recording: Recording, path: str | Path) -> None:
    """Write a recording to `path` (.npz, no pickles), atomically."""
    target = Path(path)
    arrays: dict[str, Any] = {field.name: np.asarray(getattr(recording, field.name)) for field in fields(recording)}
    scratch = target.with_name(f".{target.name}.{os.getpid()}")
    with scratch.open("wb") as file:
        np.savez_compressed(file, format=np.array(FORMAT), version=np.array(VERSION), **arrays)
    scratch.replace(target)


def load(path: str | Path) -> Recording:
    """Read a recording that `save`, or anybody who follows the format, has written.

    Raises FileNotFoundError, or RecordingError that names the file and what is wrong with it. Nothing is unpickled.
    """
    known = {field.name for field in fields(Recording)}
    with naming(path):
        members = zip_members(content_of(Path(path)))
        content = {name.removesuffix(".npy"): _array(name, members[name], known) for name in members}
        _check_version(content)
        if missing := sorted(known - set(content)):
            raise RecordingError(f"field {missing[0]!r} is missing")
        return Recording(**{name: _native(name, content[name]) for name in known})


def _array(member: str, content: bytes, known: set[str]) -> np.ndarray:
    """A member of the file as an array, once name, type and size are right."""
    name = member.removesuffix(".npy")
    if name not in known | {"format", "version"}:
        raise RecordingError(f"unknown field {name[:40]!r}")
    try:
        return array_of(content, "fiuU")
    except ValueError as error:
        raise RecordingError(f"field {name!r} {error}") from None


def _check_version(content: dict[str, np.ndarray]) -> None:
    if "format" not in content or str(content["format"]) != FORMAT:
        raise RecordingError(f"field 'format' does not say {FORMAT!r}")
    version = content.get("version")
    if version is None or version.shape != () or version != VERSION:
        said = version if version is None or version.size == 1 else f"an array {version.shape}"
        raise RecordingError(f"field 'version' is {said}; this release reads version {VERSION}")


def _native(name: str, value: np.ndarray) -> Any:
    """A field as the dataclass has it."""
    if name in _TEXTS:
        if value.shape != () or value.dtype.kind != "U":
            raise RecordingError(f"field {name!r} is no text")
        return str(value)
    if name in _NUMBERS:
        if value.shape != () or value.dtype.kind not in "fiu":
            raise RecordingError(f"field {name!r} is no number")
        return float(value)
    if value.dtype.kind not in ("iu" if name in _INTEGERS else "fiu"):
        raise RecordingError(f"field {name!r} has entries of type {value.dtype}")
    if name in _INTEGERS and value.dtype == np.uint64 and value.size and value.max() > np.iinfo(np.int64).max:
        raise RecordingError(f"field {name!r} holds {value.max()}, which is above 2⁶³ − 1")
    return np.ascontiguousarray(value, dtype=np.int64 if name in _INTEGERS else np.float64)
