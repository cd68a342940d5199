"""What strangers may send: files with damaged bytes, text with strange words, tables and documents of a wrong kind."""

import io
import json
from typing import Any

import numpy as np
from hypothesis import strategies as st

CHUNKS = (
    b"\0\0\0\0", b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\x7f\xff\xff\xff", b"\0\0\0\x80", b"nan", b"-1", b"1e308",
    b"9" * 20, b"[" * 50, b"\n", b" ", b"inf", b"(1000000000,)", b"65535 65535", b"\xe2\x88\x9e", b"'", b"0",
)  # fmt: skip
WORDS = (
    "0", "1", "-1", "2", "3", "0.5", "1e3", "1e-320", "1e154", "1e308", "1e400", "nan", "inf", "-inf",
    "9007199254740993",
    "7782220156096217089", "18446744073709551616", "9" * 400, "9" * 5000, "1_0", "0x10", "word", "#", "∞", "\x00", "",
)  # fmt: skip


@st.composite
def damaged(draw: st.DrawFn, *wholes: bytes) -> bytes:
    """One of the files with one to four of its places changed, cut off, taken out, or repeated."""
    out = bytearray(draw(st.sampled_from(wholes)))
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, max(len(out) - 1, 0)))
        length = draw(st.integers(1, 64))
        match draw(st.sampled_from(("flip", "set", "insert", "cut", "delete", "repeat"))):
            case "flip" if out:
                out[at] ^= 1 << draw(st.integers(0, 7))
            case "set":
                chunk = draw(st.sampled_from(CHUNKS))
                out[at : at + len(chunk)] = chunk
            case "insert":
                out[at:at] = draw(st.sampled_from(CHUNKS))
            case "cut":
                del out[at:]
            case "delete":
                del out[at : at + length]
            case "repeat":
                out[at:at] = out[at : at + length]
    return bytes(out)


@st.composite
def respelt(draw: st.DrawFn, text: str) -> bytes:
    """The text with one to six of its words replaced, and perhaps a line repeated or left out."""
    lines = [line.split() for line in text.splitlines()]
    for _ in range(draw(st.integers(1, 6))):
        words = lines[draw(st.integers(0, len(lines) - 1))]
        if words:
            words[draw(st.integers(0, len(words) - 1))] = draw(st.sampled_from(WORDS) | st.text(max_size=5))
    k = draw(st.integers(0, len(lines) - 1))
    lines[k : k + 1] = [lines[k]] * draw(st.integers(0, 2))
    return "\n".join(" ".join(words) for words in lines).encode("utf-8", errors="surrogatepass")


@st.composite
def arrays(draw: st.DrawFn, like: np.ndarray) -> np.ndarray:
    """An array of perhaps another type or shape, with perhaps an odd entry."""
    kind = draw(
        st.sampled_from(("same", "same", "same", "<f4", ">f8", "<i8", "<u8", "|u1", "|b1", "<c16", "<U3", "<M8[s]"))
    )
    array = np.array(like)
    if kind != "same":
        with np.errstate(all="ignore"):
            array = np.resize(np.zeros(1), array.shape).astype(kind) if array.dtype.kind == "U" else _as(array, kind)
    array = np.array(array)
    if draw(st.booleans()) and array.size and array.dtype.kind in "fiu":
        odd = (np.nan, np.inf, -np.inf, 1e300, -1e300, 1e9, -3.0) if array.dtype.kind == "f" else (-3, -1, 10**9, 2**62)
        value = draw(st.sampled_from(odd))
        with np.errstate(all="ignore"):
            array.reshape(-1)[draw(st.integers(0, array.size - 1))] = np.array(value).astype(array.dtype)
    match draw(st.sampled_from(("same", "same", "longer", "empty", "scalar", "deeper", "turned"))):
        case "longer" if array.ndim:
            return np.concatenate([array, array[:1]])
        case "empty":
            return array[:0] if array.ndim else array
        case "scalar":
            return array.reshape(-1)[:1].reshape(()) if array.size else array
        case "deeper":
            return array[None]
        case "turned":
            return array.T
    return array


def _as(array: np.ndarray, kind: str) -> np.ndarray:
    finite = np.nan_to_num(array.astype(np.float64))
    return np.abs(finite).astype(np.int64).astype(kind) if kind[1] in "MUu" else finite.astype(kind)


@st.composite
def archives(draw: st.DrawFn, content: dict[str, Any], compressed: bool = False) -> bytes:
    """An .npz file with one to three of the members of `content` changed, left out, or added."""
    members = {name: np.asarray(value) for name, value in content.items()}
    for _ in range(draw(st.integers(1, 3))):
        name = draw(st.sampled_from(sorted(content)))
        match draw(st.sampled_from(("change", "change", "change", "change", "drop", "add", "swap"))):
            case "change":
                members[name] = draw(arrays(np.asarray(content[name])))
            case "drop":
                members.pop(name, None)
            case "add":
                members[draw(st.sampled_from(("x", "../x", "points.npy", "é")))] = np.zeros(3)
            case "swap":
                members[name] = np.asarray(content[draw(st.sampled_from(sorted(content)))])
    file = io.BytesIO()
    np.savez(file, **members)
    return file.getvalue()


PLAIN = (
    st.none() | st.booleans() | st.integers(-3, 3) | st.sampled_from((10**19, 10**400, -(2**63), 2**62))
    | st.floats() | st.text(max_size=6) | st.sampled_from(("corner", "2001-01-01", "9" * 300))
)  # fmt: skip
VALUES = st.recursive(
    PLAIN,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=8,
)


@st.composite
def documents(draw: st.DrawFn, whole: Any) -> Any:
    """A document of lists and objects with one to three of its places replaced, left out, or repeated."""
    out = json.loads(json.dumps(whole))
    for _ in range(draw(st.integers(1, 3))):
        place, key = None, None
        value = out
        while isinstance(value, list | dict) and value and (place is None or draw(st.integers(0, 3))):
            place, key = value, draw(st.sampled_from(sorted(value) if isinstance(value, dict) else range(len(value))))
            value = place[key]
        if place is None:
            break
        match draw(st.sampled_from(("replace", "replace", "replace", "drop", "repeat"))):
            case "replace":
                place[key] = draw(VALUES)
            case "drop":
                del place[key]
            case "repeat":
                place.append(value) if isinstance(place, list) else place.update({draw(st.text(max_size=4)): value})
    return out


def as_json(document: Any) -> bytes:
    """With NaN, infinities and numbers of many digits as they come."""
    return json.dumps(document).encode()
