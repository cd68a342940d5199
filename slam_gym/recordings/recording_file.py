"""The file that holds a recording: an .npz archive without pickles, as `recordings/FORMAT.md` describes it."""

from __future__ import annotations

import os
import zipfile
import zlib
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from slam_gym.recordings.reading import RecordingError
from slam_gym.recordings.recording import Recording

FORMAT, VERSION = "slam_gym recording", 1
_TEXTS = ("name", "source", "terms")
_INTEGERS = ("starts", "sources", "landmark_ids")


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
    try:
        with np.load(path, allow_pickle=False) as file:
            content = {name: file[name] for name in file.files}
    except FileNotFoundError:
        raise
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error, KeyError) as error:
        raise RecordingError(f"{path}: no readable .npz file without pickles: {error}") from error
    _check_version(path, content)
    known = {field.name for field in fields(Recording)}
    if missing := sorted(known - set(content)):
        raise RecordingError(f"{path}: field {missing[0]!r} is missing")
    if unknown := sorted(set(content) - known - {"format", "version"}):
        raise RecordingError(f"{path}: unknown field {unknown[0]!r}")
    try:
        return Recording(**{name: _native(name, content[name]) for name in known})
    except RecordingError as error:
        raise RecordingError(f"{path}: {error}") from None


def _check_version(path: str | Path, content: dict[str, np.ndarray]) -> None:
    if str(content.get("format", "")) != FORMAT:
        raise RecordingError(f"{path}: field 'format' does not say {FORMAT!r}")
    version = content.get("version")
    if version is None or version.shape != () or version != VERSION:
        raise RecordingError(f"{path}: field 'version' is {version}; this release reads version {VERSION}")


def _native(name: str, value: np.ndarray) -> Any:
    """A field as the dataclass has it."""
    if name in _TEXTS:
        if value.shape != () or value.dtype.kind != "U":
            raise RecordingError(f"field {name!r} is no text")
        return str(value)
    if name in ("range", "field_of_view"):
        if value.shape != () or value.dtype.kind not in "fiu":
            raise RecordingError(f"field {name!r} is no number")
        return float(value)
    wanted = "iu" if name in _INTEGERS else "fiu"
    if value.dtype.kind not in wanted:
        raise RecordingError(f"field {name!r} has entries of type {value.dtype}")
    return np.ascontiguousarray(value, dtype=np.int64 if name in _INTEGERS else np.float64)
