"""Messages between an evaluation and an entry in another process: plain values and arrays, never code.

A message is a header in JSON and the bytes of its arrays. Of classes there are only those that associators and
relocators deal in, so that whatever an entry sends ends in one of these or in an error.
"""

from __future__ import annotations

import json
import math
import struct
from dataclasses import fields, is_dataclass
from typing import Any, BinaryIO

import numpy as np

from slam_gym.types import Effort, Experience, Hypothesis, Landmarks, Locality, Posterior, Relocation, Scan

CLASSES: dict[str, type[Any]] = {
    cls.__name__: cls for cls in (Effort, Experience, Hypothesis, Landmarks, Locality, Posterior, Relocation, Scan)
}
MAX_BYTES = 1 << 28  # of a message
_LENGTHS = struct.Struct("<II")  # of the header, and of the arrays together
_KINDS = "biuf"  # of arrays: booleans, integers and floats


def send(file: BinaryIO, value: Any) -> None:
    """Write a message. Raises ValueError for what no message can hold."""
    arrays: list[np.ndarray[Any, Any]] = []
    tree = _tree(value, arrays)
    header = json.dumps({"tree": tree, "arrays": [[a.dtype.str, a.shape] for a in arrays]}).encode()
    body = b"".join(array.tobytes() for array in arrays)
    file.write(_LENGTHS.pack(len(header), len(body)) + header + body)
    file.flush()


def receive(file: BinaryIO) -> Any:
    """The next message. Raises EOFError at the end, and ValueError for what is none."""
    lengths = _LENGTHS.unpack(_exactly(file, _LENGTHS.size))
    if sum(lengths) > MAX_BYTES:
        raise ValueError(f"a message of {sum(lengths)} bytes")
    header, body = (_exactly(file, length) for length in lengths)
    try:
        content = json.loads(header)
        arrays, start = [], 0
        for dtype, shape in content["arrays"]:
            array = _array(np.dtype(dtype), tuple(shape), body, start)
            arrays.append(array)
            start += array.nbytes
        return _value(content["tree"], arrays)
    except (KeyError, IndexError, TypeError, AttributeError, RecursionError, OverflowError) as error:
        raise ValueError(f"a message that cannot be read ({type(error).__name__}: {error})") from None


def _exactly(file: BinaryIO, count: int) -> bytes:
    found = file.read(count)
    if len(found) < count:
        raise EOFError
    return found


def _array(dtype: np.dtype[Any], shape: tuple[int, ...], body: bytes, start: int) -> np.ndarray[Any, Any]:
    if dtype.kind not in _KINDS or not all(isinstance(n, int) and n >= 0 for n in shape):
        raise ValueError(f"an array of {dtype} and shape {shape}")
    count = math.prod(shape)
    if start + count * dtype.itemsize > len(body):
        raise ValueError(f"an array of shape {shape} in {len(body)} bytes")
    return np.frombuffer(body, dtype, count, start).reshape(shape).copy()


def _tree(value: Any, arrays: list[np.ndarray[Any, Any]]) -> Any:
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.generic):
        return _tree(value.item(), arrays)
    if isinstance(value, np.ndarray) and value.dtype.kind in _KINDS:
        arrays.append(np.ascontiguousarray(value))
        return {"array": len(arrays) - 1}
    if isinstance(value, list | tuple):
        return [_tree(item, arrays) for item in value]
    if isinstance(value, dict) and all(isinstance(key, str) for key in value):
        return {"dict": {key: _tree(item, arrays) for key, item in value.items()}}
    if is_dataclass(value) and CLASSES.get(type(value).__name__) is type(value):
        parts = {f.name: _tree(getattr(value, f.name), arrays) for f in fields(value)}
        return {"class": type(value).__name__, "fields": parts}
    raise ValueError(f"{type(value).__name__} cannot be sent")


def _value(tree: Any, arrays: list[np.ndarray[Any, Any]]) -> Any:
    if isinstance(tree, list):
        return [_value(item, arrays) for item in tree]
    if not isinstance(tree, dict):
        return tree
    if "array" in tree:
        return arrays[tree["array"]]
    if "dict" in tree:
        return {key: _value(item, arrays) for key, item in tree["dict"].items()}
    return CLASSES[tree["class"]](**{name: _value(item, arrays) for name, item in tree["fields"].items()})
