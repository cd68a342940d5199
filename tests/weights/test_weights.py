"""Weights come back as they were written, and whatever is damaged or made for something else is refused by name."""

import json
from pathlib import Path

import numpy as np
import pytest

from slam_gym import weights
from slam_gym.weights import Card, Weights, load, write

SHAPES = {"first": (-1, 2), "bias": (3,)}


def some() -> Weights:
    arrays = {"first": np.arange(8.0, dtype=np.float32).reshape(4, 2), "bias": np.zeros(3)}
    return Weights(Card(2, ("range", "age"), {}, ("office",), (0, 1), "python -m …", {"loss": 0.5}), arrays)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    write(tmp_path / "own.npz", some())
    return tmp_path / "own.npz"


def test_they_come_back_and_the_same_weights_are_the_same_bytes(path: Path, tmp_path: Path) -> None:
    found = load(path, 2, ("range", "age"), SHAPES)
    for name, array in some().arrays.items():
        np.testing.assert_array_equal(found.arrays[name], array)
        assert not found.arrays[name].flags.writeable
    assert found.card == some().card._replace(shapes={"first": (4, 2), "bias": (3,)})
    write(tmp_path / "again.npz", found)
    assert (tmp_path / "again.npz").read_bytes() == path.read_bytes()


@pytest.mark.parametrize(
    ("version", "inputs", "shapes", "message"),
    [
        (3, ("range", "age"), SHAPES, "own.npz: made for version 2 of the inputs, these are version 3"),
        (2, ("range", "size"), SHAPES, "made for other inputs: age, size"),
        (2, ("age", "range"), SHAPES, "the same in another order"),
        (2, ("range", "age"), {"first": (-1, 2)}, "holds first, bias; expected first"),
        (2, ("range", "age"), {**SHAPES, "bias": (4,)}, r"bias: shape \(3,\), expected \(4,\)"),
        (2, ("range", "age"), {**SHAPES, "first": (8,)}, r"first: shape \(4, 2\), expected \(8,\)"),
    ],
)
def test_weights_for_something_else_are_refused(path, version, inputs, shapes, message) -> None:
    with pytest.raises(ValueError, match=message):
        load(path, version, inputs, shapes)


def test_writing_through_a_link_leaves_it_one_and_keeps_the_permissions(path, tmp_path) -> None:
    path.chmod(0o600)
    (tmp_path / "link.npz").symlink_to(path)
    write(tmp_path / "link.npz", some())
    assert (tmp_path / "link.npz").is_symlink() and path.stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize("wrong", [{"inputs": [[1], {}]}, {"inputs": [1, "a"]}, {"version": "2"}])
def test_a_card_with_other_types_is_refused(path, wrong) -> None:
    card = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
    path.with_suffix(".json").write_text(json.dumps(card | wrong), encoding="utf-8")
    with pytest.raises(ValueError, match="its card is invalid"):
        load(path, 2, ("range", "age"), SHAPES)


def test_what_is_not_there_says_what_is() -> None:
    with pytest.raises(ValueError, match="weights 'nonsense': unknown; known: "):
        load("nonsense", 1, (), {})
    with pytest.raises(ValueError, match=r"weights nowhere.npz: .*No such file"):
        load("nowhere.npz", 1, (), {})


def test_damage_numbers_that_are_not_finite_and_objects_are_refused(path: Path) -> None:
    whole, card = path.read_bytes(), json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
    for content in (whole[:-30], b"", bytes(2 << 20)):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"own.npz: is (no|larger)"):
            load(path, 2, ("range", "age"), SHAPES)
    for array, message in ((np.array([0, np.nan, 0]), "bias: not all"), (np.array([None] * 3), "allow_pickle")):
        write(path, some()._replace(arrays={**some().arrays, "bias": array}))
        with pytest.raises(ValueError, match=message):
            load(path, 2, ("range", "age"), SHAPES)
    for changed in ({**card, "shapes": {"first": 4}}, {"version": 2}, [card]):
        path.with_suffix(".json").write_text(json.dumps(changed), encoding="utf-8")
        with pytest.raises(ValueError, match=r"weights own\.npz: "):
            load(path, 2, ("range", "age"), SHAPES)


@pytest.mark.parametrize("name", weights.names())
def test_every_archive_that_ships_has_a_card_that_fits(name: str) -> None:
    card = weights.card_of(name)
    found = load(name, card.version, card.inputs, card.shapes)
    assert found.card.command.startswith(("slam-gym reproduce", "slam-gym train"))
    assert found.card.scenarios and found.card.seeds
