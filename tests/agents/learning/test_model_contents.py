"""What a model file may hold is bounded before it is read, and before a network is built."""

import io
import pickle
import zipfile

import pytest
import torch

from agents.learning.model_contents import check_archive, check_description, check_weights
from agents.learning.ppo import load_hyperparameters


def archive(content) -> bytes:
    file = io.BytesIO()
    torch.save(content, file)
    return file.getvalue()


def description(**changes):
    whole = {
        "action": "goal", "observation": {"budget": [1], "image": [3, 48, 48], "goals": [128]}, "actions": 16,
        "hyperparameters": dict(vars(load_hyperparameters("goal"))), "training": {},
    }  # fmt: skip
    return whole | changes


def test_tensors_and_tables_pass() -> None:
    content = {"policy": {"a": torch.ones(3), "b": torch.nn.Parameter(torch.ones(2, 2))}, "spec": "text", "n": [1, 2.0]}
    check_archive(archive(content))
    check_weights(content)
    check_description(**description())


@pytest.mark.parametrize("value", [bytearray(3), {1, 2}, torch.Size([1]), 1j, torch.device("cpu")])
def test_other_objects_are_refused_by_name(value) -> None:
    with pytest.raises(ValueError, match="holds code beside weights and text"):
        check_archive(archive({"policy": value}))


def test_archives_that_torch_does_not_write_are_refused() -> None:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as out:
        out.writestr("archive/data.pkl", pickle.dumps({}, 2))
    with pytest.raises(ValueError, match="compressed in a way"):
        check_archive(file.getvalue())
    with pytest.raises(ValueError, match="no zip file"):
        check_archive(pickle.dumps({}))


@pytest.mark.parametrize(
    ("tensor", "message"),
    [
        (torch.tensor([1.0, float("nan")]), r"weights of shape \(2,\) are not finite"),
        (torch.tensor([[float("inf")]]), r"weights of shape \(1, 1\) are not finite"),
        (torch.zeros(1).expand(50_000, 50_000), r"weights of shape \(50000, 50000\) are larger than what is there"),
        (torch.eye(3).to_sparse(), "no plain tensors"),
    ],
)
def test_weights_are_finite_and_all_there(tensor, message) -> None:
    with pytest.raises(ValueError, match=message):
        check_weights({"policy": {"layers": [{"weight": tensor}]}})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"action": "fly"}, "action is 'fly'"),
        ({"actions": 10**9}, "actions is 1000000000"),
        ({"actions": True}, "actions is True"),
        ({"observation": []}, "not all of them tables"),
        ({"observation": {"goals": [10**9]}}, "observation 'goals' has the shape"),
        ({"observation": {"goals": [8000], "map": [8000]}}, "has 16000 values, more than"),
        ({"observation": {"image": [3, 4000, 4000]}}, "the image has the shape"),
        ({"hyperparameters": {}}, "missing"),
    ],
)
def test_descriptions_of_no_training_are_refused(changes, message) -> None:
    with pytest.raises((ValueError, TypeError), match=message):
        check_description(**description(**changes))


@pytest.mark.parametrize("name", ["width", "hidden"])
def test_a_network_of_any_width_is_not_built(name) -> None:
    hyper = description()["hyperparameters"] | {name: 50_000}
    with pytest.raises(ValueError, match=f"{name} is 50000, expected a whole number in 1"):
        check_description(**description(hyperparameters=hyper))
