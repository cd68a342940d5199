"""Learned weights that ship with the package: plain arrays in a `.npz`, and beside each a card that says what they are.

The card is a JSON table: which inputs the weights expect (`version`, `inputs`), the shape of each array, and where they
come from (scenarios, seeds, command, metrics of their training). Weights of strangers are read like any file: up to
1 MB, nothing pickled, of the shapes that the caller expects, all of them finite.
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_gym._files import array_of, content_of, json_of, zip_members

MAX_BYTES = 1 << 20  # of an archive, and of what it unpacks to
_FOLDER = Path(__file__).parent


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
        if card.version != version:
            raise ValueError(f"made for version {card.version} of the inputs, these are version {version}")
        if card.inputs != inputs:
            other = sorted(set(card.inputs) ^ set(inputs))
            raise ValueError(f"made for other inputs: {', '.join(other) or 'the same in another order'}")
        members = zip_members(content_of(path, MAX_BYTES), MAX_BYTES)
        found = {name.removesuffix(".npy"): content for name, content in members.items()}
        if found.keys() != shapes.keys():
            raise ValueError(f"holds {', '.join(found)}; expected {', '.join(shapes)}")
        arrays = {name: _array(name, found[name], shape) for name, shape in shapes.items()}
    except (OSError, ValueError) as error:
        raise ValueError(f"weights {path.name}: {error}") from None
    return Weights(card, arrays)


def write(path: Path, weights: Weights) -> None:
    """The `.npz` at `path` and its card beside it; the same weights give the same bytes."""
    card = weights.card._replace(shapes={name: array.shape for name, array in weights.arrays.items()})
    file = io.BytesIO()
    np.savez(file, **weights.arrays)  # type: ignore[arg-type]  # numpy takes names for its own option
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(file.getvalue())
    text = json.dumps(card._asdict(), indent=1, ensure_ascii=False)
    path.with_suffix(".json").write_text(f"{text}\n", encoding="utf-8")


def _path(name: str | Path) -> Path:
    path = Path(name)
    if path.suffix == ".npz":
        return path
    if str(name) not in names():
        raise ValueError(f"weights {str(name)[:60]!r}: unknown; known: {', '.join(names())}, or the path of a .npz")
    return _FOLDER / f"{name}.npz"


def _read_card(path: Path) -> Card:
    try:
        card = Card(**json_of(content_of(path.with_suffix(".json"), MAX_BYTES)))
        shapes = {name: tuple(shape) for name, shape in card.shapes.items()}
        return card._replace(
            inputs=tuple(card.inputs), shapes=shapes, scenarios=tuple(card.scenarios), seeds=tuple(card.seeds)
        )
    except (OSError, ValueError) as error:
        raise ValueError(f"weights {path.name}: {error}") from None
    except (TypeError, AttributeError) as error:
        raise ValueError(f"weights {path.name}: its card is none ({error})") from None


def _array(name: str, content: bytes, shape: tuple[int, ...]) -> NDArray[Any]:
    array = array_of(content, "fiu", MAX_BYTES)
    if array.ndim != len(shape) or any(n not in (-1, there) for n, there in zip(shape, array.shape)):
        raise ValueError(f"{name}: shape {array.shape}, expected {shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: not all of it is finite")
    return array


def figure(values: Sequence[float]) -> dict[str, float]:
    """A figure of a card: the mean over seeds, and three standard deviations of one seed, at least 2 % of it, to either
    side."""
    mean = math.fsum(values) / len(values)
    spread = math.sqrt(math.fsum((v - mean) ** 2 for v in values) / max(len(values) - 1, 1))
    margin = max(3.0 * spread, 0.02 * abs(mean))  # machines round differently
    return {"estimate": mean, "low": mean - margin, "high": mean + margin}
