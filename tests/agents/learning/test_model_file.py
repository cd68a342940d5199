"""A model file from a stranger: refused by name, and never a way to run code."""

import pickle
import zipfile
from dataclasses import replace

import pytest
import torch

from agents.drivers.base import make_agent
from agents.learning.model_file import FORMAT, ModelSpec, build_policy, read_model, save_model
from agents.learning.ppo import load_hyperparameters


class Payload:
    """Unpickling this creates a file."""

    def __init__(self, path):
        self._path = path

    def __reduce__(self):
        return (open, (str(self._path), "w"))


@pytest.fixture
def spec():
    hyper = vars(load_hyperparameters("goal")).copy()
    return ModelSpec("goal", {"budget": [1], "image": [3, 48, 48], "goals": [128]}, 16, hyper, {})


@pytest.mark.parametrize("write", ["torch", "pickle"])
def test_code_in_a_model_file_is_refused_and_not_run(tmp_path, write):
    path, traces = tmp_path / "model.pt", tmp_path / "traces"
    content = {"format": FORMAT, "spec": "{}", "policy": Payload(traces)}
    if write == "torch":
        torch.save(content, path)
    else:
        path.write_bytes(pickle.dumps(content))
    with pytest.raises(ValueError, match=r"model\.pt.*refused"):
        make_agent("ppo", path)
    assert not traces.exists()


def test_a_pickled_zip_needs_trust_and_says_so(tmp_path):
    path, traces = tmp_path / "stranger.zip", tmp_path / "traces"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("data", pickle.dumps(Payload(traces)))
    with pytest.raises(ValueError, match=r"stranger\.zip.*--trust"):
        make_agent("ppo", path)
    assert not traces.exists()


@pytest.mark.parametrize("damage", ["missing", "empty", "cut", "text", "other"])
def test_a_file_that_is_no_model_is_refused_by_name(tmp_path, spec, damage):
    path = tmp_path / "model.pt"
    save_model(path, spec, build_policy(spec))
    if damage == "missing":
        path.unlink()
    elif damage == "other":
        torch.save({"weights": torch.zeros(3)}, path)
    else:
        path.write_bytes({"empty": b"", "text": b"hello", "cut": path.read_bytes()[:2000]}[damage])
    with pytest.raises(ValueError, match=r"model\.pt"):
        read_model(path)


def test_weights_that_do_not_fit_their_description_are_refused(tmp_path, spec):
    narrow = replace(spec, hyperparameters=spec.hyperparameters | {"hidden": 32})
    save_model(tmp_path / "model.pt", narrow, build_policy(spec))
    with pytest.raises(ValueError, match="do not fit"):
        make_agent("ppo", tmp_path / "model.pt")


def test_an_interrupted_save_leaves_the_file_before_it(tmp_path, spec):
    path, policy = tmp_path / "model.pt", build_policy(spec)
    save_model(path, spec, policy)
    before = path.read_bytes()

    class Unsavable:
        optimizer = policy.optimizer

        def state_dict(self):
            return {"weights": (number for number in range(3))}

    with pytest.raises((TypeError, pickle.PicklingError)):
        save_model(path, spec, Unsavable())
    assert path.read_bytes() == before


def test_a_small_file_makes_no_large_network(tmp_path, spec):
    wide = replace(spec, hyperparameters=spec.hyperparameters | {"width": 50_000})
    save_model(tmp_path / "model.pt", wide, build_policy(spec))
    with pytest.raises(ValueError, match=r"model\.pt: refused, width is 50000"):
        make_agent("ppo", tmp_path / "model.pt")


def test_weights_that_are_not_finite_are_refused(tmp_path, spec):
    policy = build_policy(spec)
    with torch.no_grad():
        next(policy.parameters())[0] = float("nan")
    save_model(tmp_path / "model.pt", spec, policy)
    with pytest.raises(ValueError, match=r"model\.pt: refused, weights .* are not finite"):
        read_model(tmp_path / "model.pt")
