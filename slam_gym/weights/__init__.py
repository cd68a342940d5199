"""Learned weights that ship with the package: plain arrays in a `.npz` file, each with a card that describes them.

The card is a JSON table: the inputs that the weights expect (`version`, `inputs`), the shape of each array, and their
origin (scenarios, seeds, command, metrics of their training). Other weights are read like any untrusted file: up to 1
MB, without unpickling; arrays must be finite and have the shapes that the caller expects.
"""

import functools
import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from slam_gym._files import array_of, content_of, json_of, replacing, zip_members

T = TypeVar("T")

MAX_BYTES = 1 << 20  # of an archive, and of its unpacked content
_FOLDER = Path(__file__).parent


class Card(NamedTuple):
    """The description of weights and of their origin."""

    version: int  # of the inputs; code that computes another version refuses the weights
    inputs: tuple[str, ...]  # name of each input, in order
    shapes: dict[str, tuple[int, ...]]  # of each array
    scenarios: tuple[str, ...]  # they were trained on
    seeds: tuple[int, ...]
    command: str  # trains them from scratch
    metrics: dict[str, Any]  # of the training, as printed by the command
    note: str = ""  # if the arrays differ from what the command yields: how and why


class Weights(NamedTuple):
    """Arrays by name, read-only, in the order of the card's shapes."""

    card: Card
    arrays: dict[str, NDArray[Any]]


def names() -> list[str]:
    """Names of the weights that ship."""
    return sorted(path.stem for path in _FOLDER.glob("*.npz"))


def card_of(name: str) -> Card:
    """The card of shipped weights. Raises ValueError as `load`."""
    return _read_card(_path(name))


def load(name: str | Path, version: int, inputs: tuple[str, ...], shapes: Mapping[str, tuple[int, ...]]) -> Weights:
    """Load shipped weights by name, or others by the path of their `.npz` file, whose card is the `.json` beside it.

    `version` and `inputs` are those that the caller computes, `shapes` the arrays that it needs; −1 stands for any
    length. Raises ValueError, naming the file, for weights that are missing or damaged, or were trained for something
    else.
    """
    path = _path(name)
    card = _read_card(path)
    try:
        if card.version != version:
            raise ValueError(f"made for version {card.version} of the inputs, these are version {version}")
        if card.inputs != inputs:
            differing = sorted(set(card.inputs) ^ set(inputs))
            raise ValueError(f"made for other inputs: {', '.join(differing) or 'the same in another order'}")
        contents = zip_members(path, MAX_BYTES)
        if contents.keys() != shapes.keys():
            raise ValueError(f"holds {', '.join(contents)}; expected {', '.join(shapes)}")
        arrays = {name: _array(name, contents[name], shape) for name, shape in shapes.items()}
    except (OSError, ValueError) as error:
        raise ValueError(f"weights {path.name}: {error}") from None
    return Weights(card, arrays)


def cached(read: Callable[..., T]) -> Callable[..., T]:
    """`read(weights, …)`, called again for the same arguments only where the file of the weights has changed."""
    remembered = functools.cache(lambda _changed, *arguments: read(*arguments))

    @functools.wraps(read)
    def call(weights: str | Path, *arguments: Any) -> T:
        is_file = str(weights).endswith(".npz") and os.path.exists(weights)
        found: T = remembered(os.stat(weights).st_mtime_ns if is_file else 0, weights, *arguments)
        return found

    return call


def write(path: Path, weights: Weights) -> None:
    """Write the `.npz` file at `path` and its card beside it. The same weights give the same bytes."""
    card = weights.card._replace(shapes={name: array.shape for name, array in weights.arrays.items()})
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as file:
        np.savez(file, **weights.arrays)  # type: ignore[arg-type]  # a name could be an option of numpy's
    with replacing(path.with_suffix(".json")) as file:
        file.write(f"{json.dumps(card._asdict(), indent=1, ensure_ascii=False)}\n".encode())


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
        if type(card.version) is not int or not all(isinstance(name, str) for name in card.inputs):
            raise TypeError("a version is an integer, inputs are names")
        return card._replace(
            inputs=tuple(card.inputs), shapes=shapes, scenarios=tuple(card.scenarios), seeds=tuple(card.seeds)
        )
    except (OSError, ValueError) as error:
        raise ValueError(f"weights {path.name}: {error}") from None
    except (TypeError, AttributeError) as error:
        raise ValueError(f"weights {path.name}: its card is invalid ({error})") from None


def _array(name: str, content: bytes, shape: tuple[int, ...]) -> NDArray[Any]:
    array = array_of(content, "fiu", MAX_BYTES)
    if array.ndim != len(shape) or any(n not in (-1, there) for n, there in zip(shape, array.shape)):
        raise ValueError(f"{name}: shape {array.shape}, expected {shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: not all of it is finite")
    return array
