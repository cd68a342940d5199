"""What the readers of logs share: one error, checks of fields, MATLAB variables, spans of commands."""

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
    """A recording, or a file that should hold one, is not what it should be. Names the file, field or line."""


@contextlib.contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """Errors of what is read from a file or folder as RecordingErrors that name it. No number overflows aloud."""
    try:
        with np.errstate(all="ignore"):  # what overflows is refused by the checks of fields
            yield
    except (ValueError, ArithmeticError) as error:
        message = str(error)
        raise RecordingError(message if message.startswith(str(path)) else f"{path}: {message}") from None


def read_matlab(path: Path, names: Sequence[str], source: str) -> dict[str, Any]:
    """The variables of a MATLAB file from a `source` to be cited.

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
    """A variable of a MATLAB file as finite float64: a table of so many `columns`, or with None its entries in a row.

    RecordingError names file, variable and row.
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
    """RecordingError naming file, variable and the first row at which `bad` (n,) holds."""
    if bad.any():
        raise RecordingError(f"{path}: variable {name!r}: row {int(bad.argmax()) + 1} {what}")


def starts_of(counts: ArrayLike) -> IntArray:
    """(T + 1,) rows at which the measurements of each step start, and their end, from their numbers (T,)."""
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


class Spans(NamedTuple):
    """The time between the looks of a log, cut where another command takes over."""

    step: IntArray  # (s,) the look that each span leads to
    command: IntArray  # (s,) the command that holds in it, −1 before the first one
    seconds: Array  # (s,)

    @classmethod
    def between(cls, looks: Array, commands: Array) -> Spans:
        """From the instants (T,) of the looks and those (n,) at which the commands begin, both ascending [s]."""
        within = commands[(commands > looks[0]) & (commands < looks[-1])]
        edges = np.unique(np.concatenate([looks, within]))
        after = np.searchsorted(looks, edges[:-1], side="right")
        return cls(after, np.searchsorted(commands, edges[:-1], side="right") - 1, np.diff(edges))

    def headings(self, turns: Array) -> Array:
        """(s,) [rad] at the start of each span since the look before it, from how much each turns (s,) [rad]."""
        before = np.cumsum(turns) - turns
        return before - before[np.searchsorted(self.step, self.step)]

    def sums(self, values: Array, looks: int) -> Array:
        """(T,) of the values (s,) in the spans that lead to each of so many looks."""
        return np.asarray(np.bincount(self.step, values, looks), np.float64)
