"""Images of floors as files: PGM and PNG, numpy arrays, gzipped or not. Sizes are checked before anything is decoded.

Raises FloorPlanError without the file, which `floor_plan_file` adds.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_gym._files import array_of, content_of, gunzipped
from slam_gym.world.contours import import_cv2
from slam_gym.world.floor_plan import MAX_PIXELS, FloorPlanError

_MAX_BYTES = 8 * MAX_PIXELS + 1024  # what the largest image takes with labels of 64 bits and a header
_PNG = b"\x89PNG\r\n\x1a\n"
_PNM = re.compile(rb"P[1-6]((?:\s|#[^\n]*\n)+)(\d{1,9})((?:\s|#[^\n]*\n)+)(\d{1,9})\s")
"""The header of a PGM file, and of its relatives, with width and height as groups 2 and 4."""


def require_image(path: Path) -> None:
    """FloorPlanError for a file that is, by its name, nothing that is read here."""
    if not path.name.lower().endswith((".pgm", ".png", ".npy", ".npy.gz")):
        raise FloorPlanError("file", f"unknown suffix {path.suffix!r}; known: .json .yaml .pgm .png .npy .npy.gz")


def read_image(path: Path) -> NDArray[Any]:
    """The pixels (h, w) of an image: uint8 of PGM and PNG, integers or bools of arrays, read-only."""
    if path.name.endswith((".npy", ".npy.gz")):
        return _read_array(path)
    require_image(path)
    cv2 = import_cv2()
    content = _content(path)
    height, width = _declared(content)
    _refuse_large((height, width))
    try:
        image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE)
    except cv2.error as error:
        raise FloorPlanError("image", f"cannot be read ({error.err})") from None
    if image is None or image.shape != (height, width):
        raise FloorPlanError("image", "is not a PGM or PNG image, or not all of it is there")
    return np.asarray(image)


def _content(path: Path) -> bytes:
    try:
        return content_of(path)
    except (ValueError, OSError) as error:
        raise FloorPlanError("image", str(error)) from None


def _declared(content: bytes) -> tuple[int, int]:
    """Height and width that the header of a PNG or PGM file declares."""
    if content.startswith(_PNG) and content[12:16] == b"IHDR" and len(content) > 24:
        return int.from_bytes(content[20:24], "big"), int.from_bytes(content[16:20], "big")
    if found := _PNM.match(content[:4096]):
        return int(found[4]), int(found[2])
    raise FloorPlanError("image", "is not a PGM or PNG image")


def _refuse_large(shape: tuple[int, ...]) -> None:
    if np.prod(np.array(shape, np.float64)) > MAX_PIXELS:
        sides = " × ".join(map(str, shape))
        raise FloorPlanError("image", f"has {sides} pixels, more than {MAX_PIXELS >> 20} million: scale it down")


def _read_array(path: Path) -> NDArray[Any]:
    content = _content(path)
    try:
        array = array_of(gunzipped(content, _MAX_BYTES) if path.suffix == ".gz" else content, "biuf", _MAX_BYTES)
    except ValueError as error:
        told = str(error)
        raise FloorPlanError("image", told if "numpy array" in told else f"is not a numpy array ({told})") from None
    _refuse_large(array.shape)
    return array
