"""Reading of untrusted files: up to a size limit, without unpickling, and with a reason where a file is refused.

Functions that read raise ValueError; readers add the file and the field. Files are written whole or not at all.
"""

import gzip
import io
import json
import os
import shutil
import threading
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

MAX_BYTES = 1 << 26  # of a file, or of its unpacked content, unless a reader sets another limit


def content_of(path: Path, limit: int = MAX_BYTES) -> bytes:
    """The bytes of a file, unpacked if its name ends in `.gz`.

    Raises ValueError for more than `limit` bytes, packed or unpacked, and for a damaged gzip file; OSError as `open`.
    """
    with path.open("rb") as file:
        content = file.read(limit + 1)
    if len(content) > limit:
        raise ValueError(f"is larger than {limit >> 20} MB")
    if path.suffix != ".gz":
        return content
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(content)) as packed:
            content = packed.read(limit + 1)
    except Exception as error:  # gzip raises OSError, EOFError or zlib.error
        raise ValueError(f"is not a readable gzip file: {error}") from None
    if len(content) > limit:
        raise ValueError(f"unpacks to more than {limit >> 20} MB")
    return content


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """A file that takes the place of `path` once it is written completely; else `path` stays as it is.

    Raises OSError, naming `path`.
    """
    is_special = path.exists() and not path.is_file()  # a device or a pipe, which is written to
    target = path if is_special else Path(os.path.realpath(path))  # a link remains one
    scratch = target if is_special else target.with_name(f".{target.name[:50]}.{os.getpid()}-{threading.get_ident()}")
    try:
        with scratch.open("wb") as file:
            yield file
        if not is_special:
            if target.exists():
                shutil.copymode(target, scratch)
            scratch.replace(target)
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
    finally:
        if not is_special:
            scratch.unlink(missing_ok=True)


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


def zip_members(path: Path, limit: int = MAX_BYTES) -> dict[str, bytes]:
    """The members of a zip file by name; those of a `.npz` file by the names of their arrays.

    Raises ValueError for damage, and for more than `limit` bytes, packed or unpacked; OSError as `open`.
    """
    content = content_of(path, limit)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            entries = archive.infolist()
            too_large = sum(entry.file_size for entry in entries) > limit
            members = {entry.filename: _member(archive, entry) for entry in entries if not too_large}
    except Exception as error:  # zipfile raises various errors
        raise ValueError(f"is not a readable zip file: {error}") from None
    if too_large:
        raise ValueError(f"unpacks to more than {limit >> 20} MB")
    return {name.removesuffix(".npy"): member for name, member in members.items()}


def _member(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> bytes:
    """A member of an archive, of which no more is unpacked than it declares. Only deflate can be stopped there."""
    if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(f"{entry.filename} is packed otherwise than by deflate")
    with archive.open(entry) as file:
        return file.read(entry.file_size + 1)


def json_of(content: bytes | str) -> Any:
    """The value of a JSON document. Raises ValueError with the reason, also for NaN and infinities."""

    def refuse(name: str) -> None:
        raise ValueError(f"it holds the number {name}, which is not finite")

    try:
        return json.loads(content, parse_constant=refuse)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
