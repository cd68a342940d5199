"""Files from strangers: read up to a limit, and nothing believed that they declare before it is checked.

Everything here raises ValueError with a reason; readers add the file and the field.
"""

from __future__ import annotations

import io
import json
import math
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAX_BYTES = 1 << 26  # of a file, or of what it unpacks to, where a reader says nothing else
MAX_LINES = 300_000
MAX_LINE = 10_000  # characters
_MAX_DIRECTORY = 1 << 20  # bytes of a zip file's directory, some 10 000 entries
_END, _END_64 = b"PK\x05\x06", b"PK\x06\x06"  # of a zip file: its last record, and one for files above 4 GB


def content_of(path: Path, limit: int = MAX_BYTES) -> bytes:
    """The bytes of a file. ValueError for more than `limit`, OSError as `open`."""
    with path.open("rb") as file:
        content = file.read(limit + 1)
    if len(content) > limit:
        raise ValueError(f"is larger than {limit >> 20} MB")
    return content


def gunzipped(content: bytes, limit: int = MAX_BYTES) -> bytes:
    """What gzip packed. ValueError where it is damaged, or unpacks to more than `limit`."""
    parts, left = [], limit + 1
    while content and left > 0:  # a file may be made of several members
        member = zlib.decompressobj(wbits=31)
        try:
            part = member.decompress(content, left)
        except zlib.error as error:
            raise ValueError(f"is no readable gzip file: {error}") from None
        left -= len(part)
        if left > 0 and not member.eof:
            raise ValueError("is no readable gzip file: it is cut off")
        parts.append(part)
        content = member.unused_data.lstrip(b"\0")  # padding
    if left <= 0:
        raise ValueError(f"unpacks to more than {limit >> 20} MB")
    return b"".join(parts)


def lines_of(content: bytes) -> Iterator[tuple[int, str]]:
    """Number and text of each line that is not empty. ValueError for too many of them, or one that is too long."""
    if content.count(b"\n") > MAX_LINES:
        raise ValueError(f"has more than {MAX_LINES} lines")
    for number, line in enumerate(content.split(b"\n"), 1):
        if len(line) > MAX_LINE:
            raise ValueError(f"line {number}: has more than {MAX_LINE} characters")
        if line:
            yield number, line.decode("utf-8", errors="replace")


def whole_number(word: str, limit: int = 1 << 63) -> int:
    """A number below `limit` and not negative, exactly: 2⁵³ + 1 is not 2⁵³. ValueError for any other word."""
    try:
        value = int(word)
    except ValueError:
        number = float(word)
        if not number.is_integer() or abs(number) >= 1 << 53:  # beyond, digits would be lost
            raise ValueError(f"{word[:40]} is no index") from None
        value = int(number)
    if not 0 <= value < limit:
        raise ValueError(f"{word[:40]} is no index")
    return value


def array_of(content: bytes, kinds: str, limit: int = MAX_BYTES) -> NDArray[Any]:
    """The array of a `.npy` file, of one of the `kinds` of dtype, read-only; it has to be as large as its header says.

    ValueError where it is not, is larger than `limit` bytes, or is pickled.
    """
    file = io.BytesIO(content)
    try:
        version = np.lib.format.read_magic(file)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = read(file)
    except Exception as error:  # the header is Python's syntax, and numpy raises whatever the damage leads to
        raise ValueError(f"is not a numpy array ({error})") from None
    if dtype.kind not in kinds or dtype.itemsize == 0:
        raise ValueError(f"has entries of type {dtype}")
    there, declared = len(content) - file.tell(), math.prod(shape) * dtype.itemsize
    if min(shape, default=0) < 0 or declared != there:
        raise ValueError(f"is not a numpy array (shape {shape} of {dtype} takes {declared} bytes, there are {there})")
    if declared > limit:
        raise ValueError(f"is larger than {limit >> 20} MB")
    flat = np.frombuffer(content, dtype, offset=file.tell())
    return flat.reshape(shape, order="F" if fortran else "C")


def zip_members(content: bytes, limit: int = MAX_BYTES, stored: bool = False) -> dict[str, bytes]:
    """The members of a zip file by name. ValueError where it is damaged, or they declare more than `limit` bytes.

    A member gives what it declares or an error. With `stored`, none may be compressed.
    """
    end = content.rfind(_END, max(0, len(content) - (1 << 16) - 22))
    size = int.from_bytes(content[end + 12 : end + 16], "little")
    wide = content[max(0, end - 76) : end]  # which torch writes for small files too
    if wide.startswith(_END_64):
        size = int.from_bytes(wide[40:48], "little")
    if end < 0 or size > _MAX_DIRECTORY:
        raise ValueError("is no zip file, or has a directory that is too long")
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            entries = archive.infolist()
            if len({entry.filename for entry in entries}) < len(entries):
                raise ValueError("has two members of one name")
            if sum(entry.file_size for entry in entries) > limit:
                raise ValueError(f"unpacks to more than {limit >> 20} MB")
            known = {zipfile.ZIP_STORED} if stored else {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}
            if not {entry.compress_type for entry in entries} <= known:
                raise ValueError("is compressed in a way that is not known")
            return {entry.filename: archive.read(entry) for entry in entries}
    except ValueError:
        raise
    except Exception as error:  # zipfile raises whatever the damage leads to
        raise ValueError(f"is no readable zip file: {error}") from None


def json_of(content: bytes | str) -> Any:
    """A JSON document without names given twice, NaN and infinities. ValueError with the reason for any other."""

    def refuse(name: str) -> None:
        raise ValueError(f"it holds the number {name}, which is not finite")

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        record = dict(pairs)
        if len(record) < len(pairs):
            names = [name for name, _ in pairs]
            twice = next(name for i, name in enumerate(names) if name in names[:i])
            raise ValueError(f"the key {twice[:40]!r} is there twice")
        return record

    try:
        text = content.decode("utf-8") if isinstance(content, bytes) else content
        return json.loads(text, parse_constant=refuse, object_pairs_hook=unique)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
