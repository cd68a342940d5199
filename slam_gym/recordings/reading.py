"""Tools that the readers of logs share: their error, checks of fields, MATLAB variables, spans of commands."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.io import loadmat

from slam_gym._files import content_of
from slam_gym.types import Array, IntArray


class RecordingError(ValueError):
    """A recording, or a file that should contain one, is invalid. The message names the file, field or line."""


@contextlib.contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """Turn errors into RecordingErrors that name the file or folder `path`. Floating-point warnings are suppressed."""
    try:
        with np.errstate(all="ignore"):  # the checks of fields reject numbers that overflow
            yield
    except (ValueError, ArithmeticError) as error:
        message = str(error)
        raise RecordingError(message if message.startswith(str(path)) else f"{path}: {message}") from None


def read_matlab(path: Path, names: Sequence[str], source: str) -> dict[str, Any]:
    """The variables `names` of a MATLAB file; `source` tells where to get the file and what to cite.

    Raises FileNotFoundError, or RecordingError for a file that is too large, unreadable or lacks a variable.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: not there. {source}")
    try:
        read: dict[str, Any] = loadmat(io.BytesIO(content_of(path)), variable_names=list(names))
    except Exception as error:  # scipy raises whatever the damage leads to
        raise RecordingError(f"{path}: no readable MATLAB file: {error}") from error
    for name in names:
        if name not in read:
            raise RecordingError(f"{path}: variable {name!r} is missing")
    return {name: read[name] for name in names}


def numbers_of(path: Path, name: str, value: Any, columns: int | None = None) -> Array:
    """A variable of a MATLAB file as finite float64: a table of `columns` columns, or a flat array if that is None.

    Raises RecordingError that names file, variable and row.
    """
    array = np.asarray(value)
    if array.dtype.kind not in "fiu" or array.size == 0:
        raise RecordingError(f"{path}: variable {name!r}: expected numbers, found {array.dtype} {array.shape}")
    if columns is None:
        array = array.ravel()
    elif array.ndim != 2 or array.shape[1] != columns:
        raise RecordingError(f"{path}: variable {name!r}: expected a table of {columns} columns, found {array.shape}")
    table = np.ascontiguousarray(array, np.float64)
    bad = ~np.isfinite(table.reshape(len(table), -1)).all(axis=1)
    if bad.any():
        raise RecordingError(f"{path}: variable {name!r}: row {int(bad.argmax()) + 1} is not finite")
    return table


def refuse_rows(path: Path, name: str, bad: Any, what: str) -> None:
    """Raise RecordingError, naming file, variable and row, at the first row where `bad` (n,) is True."""
    if bad.any():
        raise RecordingError(f"{path}: variable {name!r}: row {int(bad.argmax()) + 1} {what}")


def starts_of(counts: ArrayLike) -> IntArray:
    """(T + 1,) rows at which the measurements of each step start, and the end; `counts` (T,) are their numbers."""
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


class Spans(NamedTuple):
    """The time between the scans of a log, divided into spans of constant command."""

    step: IntArray  # (s,) the scan that each span leads to
    command: IntArray  # (s,) the command during each span, −1 before the first command
    seconds: Array  # (s,) duration

    @classmethod
    def between(cls, looks: Array, commands: Array) -> Spans:
        """Spans for scans at the times `looks` (T,) and commands from the times `commands` (n,), both ascending [s]."""
        within = commands[(commands > looks[0]) & (commands < looks[-1])]
        edges = np.unique(np.concatenate([looks, within]))
        after = np.searchsorted(looks, edges[:-1], side="right")
        return cls(after, np.searchsorted(commands, edges[:-1], side="right") - 1, np.diff(edges))

    def headings(self, turns: Array) -> Array:
        """(s,) [rad] heading at the start of each span, relative to the scan before it; `turns` (s,) [rad]."""
        before = np.cumsum(turns) - turns
        return before - before[np.searchsorted(self.step, self.step)]

    def sums(self, values: Array, looks: int) -> Array:
        """(T,) sum of the `values` (s,) of the spans that lead to each of the T = `looks` scans."""
        return np.asarray(np.bincount(self.step, values, looks), np.float64)
