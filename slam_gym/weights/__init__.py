"""Learned weights that ship with the package: plain arrays in a `.npz`, and beside each a card that says what they are.

The card is a JSON table: which inputs the weights expect (`version`, `inputs`), the shape of each array, and where they
come from (scenarios, seeds, command, metrics of their training). Weights are read like any file from a stranger: within
1 MB, nothing pickled, of the shapes that the card declares and that the caller expects, all of them finite.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_gym._files import array_of, content_of, json_of, zip_members

MAX_BYTES = 1 << 20  # of an archive, and of what it unpacks to
_FOLDER = Path(__file__).parent
_FIELDS = {
    "version": int, "inputs": list, "shapes": dict, "scenarios": list, "seeds": list, "command": str, "note": str,
}  # fmt: skip


class Card(NamedTuple):
    """What weights are, and where they come from."""

    version: int  # of the inputs: whoever computes others refuses the weights
    inputs: tuple[str, ...]  # what each input is, in their order
    shapes: dict[str, tuple[int, ...]]  # of each array
    scenarios: tuple[str, ...]  # that they were trained on
    seeds: tuple[int, ...]
    command: str  # that trains them from nothing
    metrics: dict[str, Any]  # of the training, as the command printed them
    note: str = ""  # where the arrays are not those of the command: which they are, and why


class Weights(NamedTuple):
    """Arrays by name, read-only, in the order of the card's shapes."""

    card: Card
    arrays: dict[str, NDArray[Any]]


def names() -> list[str]:
    """The weights that ship."""
    return sorted(path.stem for path in _FOLDER.glob("*.npz"))


def card_of(name: str) -> Card:
    """The card of weights that ship. Raises ValueError as `load`."""
    return _read_card(_path(name))


def load(name: str | Path, version: int, inputs: tuple[str, ...], shapes: Mapping[str, tuple[int, ...]]) -> Weights:
    """Weights that ship, by name, or of one's own, by the path of the `.npz`, its card beside it as `.json`.

    `version`, `inputs` and `shapes` are what the caller computes and needs; −1 stands for any length. Raises
    ValueError, naming the file, where there are none such, they are damaged, or were trained for something else.
    """
    path = _path(name)
    card = _read_card(path)
    try:
        _check_fit(card, version, inputs, shapes)
        arrays = _arrays(content_of(path, MAX_BYTES), card)
    except (OSError, ValueError) as error:
        raise ValueError(f"weights {path.name}: {error}") from None
    return Weights(card, arrays)


def write(path: Path, weights: Weights) -> None:
    """The `.npz` at `path` and its card beside it; the same weights give the same bytes."""
    card = weights.card._replace(shapes={name: array.shape for name, array in weights.arrays.items()})
    file = io.BytesIO()
    np.savez(file, **weights.arrays)  # type: ignore[arg-type]  # numpy takes names for its own option
    content = file.getvalue()
    if len(content) > MAX_BYTES:
        raise ValueError(f"weights {path.name}: {len(content)} bytes, more than {MAX_BYTES}")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    path.with_suffix(".json").write_text(_text(card), encoding="utf-8")


def _path(name: str | Path) -> Path:
    path = Path(name)
    if path.suffix == ".npz":
        return path
    if str(name) not in names():
        raise ValueError(f"weights {str(name)[:60]!r}: unknown; known: {', '.join(names())}, or the path of a .npz")
    return _FOLDER / f"{name}.npz"


def _read_card(path: Path) -> Card:
    try:
        return _card(json_of(content_of(path.with_suffix(".json"), MAX_BYTES)))
    except (OSError, ValueError) as error:
        raise ValueError(f"weights {path.name}: {error}") from None


def _text(card: Card) -> str:
    return json.dumps(card._asdict(), indent=1, ensure_ascii=False) + "\n"


def _card(found: Any) -> Card:
    if not isinstance(found, dict) or set(found) | {"note"} != set(Card._fields):
        raise ValueError(f"its card has not the fields {', '.join(Card._fields)}")
    found = {"note": "", **found}
    for name, kind in _FIELDS.items():
        if not isinstance(found[name], kind) or isinstance(found[name], bool):
            raise ValueError(f"its card: {name} is no {kind.__name__}")
    for name, kind in (("inputs", str), ("scenarios", str), ("seeds", int)):
        if not all(isinstance(entry, kind) for entry in found[name]):
            raise ValueError(f"its card: {name} holds other than {kind.__name__}")
    shapes = found["shapes"]
    if not all(isinstance(s, list) and all(isinstance(n, int) and n >= 0 for n in s) for s in shapes.values()):
        raise ValueError("its card: shapes holds what is no shape")
    given = {name: tuple(found[name]) for name in ("inputs", "scenarios", "seeds")}
    return Card(**{**found, **given, "shapes": {name: tuple(shape) for name, shape in shapes.items()}})


def _check_fit(card: Card, version: int, inputs: tuple[str, ...], shapes: Mapping[str, tuple[int, ...]]) -> None:
    if card.version != version:
        raise ValueError(f"made for version {card.version} of the inputs, these are version {version}")
    if card.inputs != inputs:
        other = sorted(set(card.inputs) ^ set(inputs))
        raise ValueError(f"made for other inputs: {', '.join(other) or 'the same in another order'}")
    if card.shapes.keys() != shapes.keys():
        raise ValueError(f"holds {', '.join(card.shapes)}; expected {', '.join(shapes)}")
    for name, shape in shapes.items():
        found = card.shapes[name]
        if len(found) != len(shape) or any(n not in (-1, there) for n, there in zip(shape, found)):
            raise ValueError(f"{name}: shape {found}, expected {shape}")


def _arrays(content: bytes, card: Card) -> dict[str, NDArray[Any]]:
    members = zip_members(content, MAX_BYTES)
    if members.keys() != {f"{name}.npy" for name in card.shapes}:
        raise ValueError(f"holds {', '.join(members)}, its card says {', '.join(card.shapes)}")
    arrays = {name: array_of(members[f"{name}.npy"], "fiu", MAX_BYTES) for name in card.shapes}
    for name, array in arrays.items():
        if array.shape != card.shapes[name]:
            raise ValueError(f"{name}: shape {array.shape}, its card says {card.shapes[name]}")
        if not np.isfinite(array).all():
            raise ValueError(f"{name}: not all of it is finite")
    return arrays
