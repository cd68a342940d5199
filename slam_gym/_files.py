"""Files from strangers: read up to a size limit, never unpickled, and refused with a reason.

Everything here raises ValueError; readers add the file and the field.
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

MAX_BYTES = 1 << 26  # of a file, or of what it unpacks to, where a reader says nothing else


def content_of(path: Path, limit: int = MAX_BYTES) -> bytes:
    """The bytes of a file. ValueError for more than `limit`, OSError as `open`."""
    with path.open("rb") as file:
        content = file.read(limit + 1)
    if len(content) > limit:
        raise ValueError(f"is larger than {limit >> 20} MB")
    return content


def gunzipped(content: bytes, limit: int = MAX_BYTES) -> bytes:
    """What gzip packed. ValueError where it is damaged, or unpacks to more than `limit`."""
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(content)) as file:
            unpacked = file.read(limit + 1)
    except Exception as error:  # gzip raises OSError, EOFError or zlib.error
        raise ValueError(f"is no readable gzip file: {error}") from None
    if len(unpacked) > limit:
        raise ValueError(f"unpacks to more than {limit >> 20} MB")
    return unpacked


def array_of(content: bytes, kinds: str, limit: int = MAX_BYTES) -> NDArray[Any]:
    """The array of a `.npy` file, of one of the `kinds` of dtype, read-only. ValueError for others or a pickled one."""
    try:
        array: NDArray[Any] = np.lib.format.read_array(io.BytesIO(content), allow_pickle=False)
    except Exception as error:  # numpy raises whatever the damage leads to
        raise ValueError(f"is not a numpy array ({error})") from None
    if array.dtype.kind not in kinds:
        raise ValueError(f"has entries of type {array.dtype}")
    if array.nbytes > limit:
        raise ValueError(f"is larger than {limit >> 20} MB")
    array.flags.writeable = False
    return array


def zip_members(content: bytes, limit: int = MAX_BYTES) -> dict[str, bytes]:
    """The members of a zip file by name. ValueError where it is damaged, or they declare more than `limit` bytes."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            entries = archive.infolist()
            declared = sum(entry.file_size for entry in entries)
            members = {entry.filename: archive.read(entry) for entry in entries} if declared <= limit else None
    except Exception as error:  # zipfile raises whatever the damage leads to
        raise ValueError(f"is no readable zip file: {error}") from None
    if members is None:
        raise ValueError(f"unpacks to more than {limit >> 20} MB")
    return members


def json_of(content: bytes | str) -> Any:
    """A JSON document without NaN and infinities. ValueError with the reason for any other."""

    def refuse(name: str) -> None:
        raise ValueError(f"it holds the number {name}, which is not finite")

    try:
        return json.loads(content, parse_constant=refuse)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
