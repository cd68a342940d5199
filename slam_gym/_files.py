"""Reading of untrusted files: up to a size limit, without unpickling, and with a reason where a file is refused.

All functions raise ValueError; readers add the file and the field.
"""

from __future__ import annotations

import gzip
import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAX_BYTES = 1 << 26  # of a file, or of its unpacked content, unless a reader sets another limit


def content_of(path: Path, limit: int = MAX_BYTES) -> bytes:
    """The bytes of a file. Raises ValueError for more than `limit` bytes, and OSError as `open`."""
    with path.open("rb") as file:
        content = file.read(limit + 1)
    if len(content) > limit:
        raise ValueError(f"is larger than {limit >> 20} MB")
    return content


def gunzipped(content: bytes, limit: int = MAX_BYTES) -> bytes:
    """The unpacked content of gzip data. Raises ValueError for damage, and for more than `limit` unpacked bytes."""
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(content)) as file:
            unpacked = file.read(limit + 1)
    except Exception as error:  # gzip raises OSError, EOFError or zlib.error
        raise ValueError(f"is not a readable gzip file: {error}") from None
    if len(unpacked) > limit:
        raise ValueError(f"unpacks to more than {limit >> 20} MB")
    return unpacked


def array_of(content: bytes, kinds: str, limit: int = MAX_BYTES) -> NDArray[Any]:
    """The array of a `.npy` file, read-only. Raises ValueError for pickles and for a dtype kind not among `kinds`."""
    try:
        array: NDArray[Any] = np.lib.format.read_array(io.BytesIO(content), allow_pickle=False)
    except Exception as error:  # numpy raises various errors
        raise ValueError(f"is not a numpy array ({error})") from None
    if array.dtype.kind not in kinds:
        raise ValueError(f"has entries of type {array.dtype}")
    if array.nbytes > limit:
        raise ValueError(f"is larger than {limit >> 20} MB")
    array.flags.writeable = False
    return array


def zip_members(content: bytes, limit: int = MAX_BYTES) -> dict[str, bytes]:
    """The members of a zip file by name. Raises ValueError for damage, and for more than `limit` bytes declared."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            entries = archive.infolist()
            declared = sum(entry.file_size for entry in entries)
            members = {entry.filename: archive.read(entry) for entry in entries} if declared <= limit else None
    except Exception as error:  # zipfile raises various errors
        raise ValueError(f"is not a readable zip file: {error}") from None
    if members is None:
        raise ValueError(f"unpacks to more than {limit >> 20} MB")
    return members


def json_of(content: bytes | str) -> Any:
    """The value of a JSON document. Raises ValueError with the reason, also for NaN and infinities."""

    def refuse(name: str) -> None:
        raise ValueError(f"it holds the number {name}, which is not finite")

    try:
        return json.loads(content, parse_constant=refuse)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
