"""Models, hyperparameters and overrides from strangers: read, or refused by an error that names the file."""

import json
from dataclasses import asdict, replace

import pytest
import torch

from agents.learning.model_file import ModelSpec, build_policy, load_policy, save_model
from agents.learning.ppo import HYPERPARAMETERS, load_hyperparameters
from slam_gym.scenarios import get_scenario, overridden, parse_override
from tests.fuzz.attack import attack
from tests.fuzz.inputs import damaged, documents, respelt


def read(path):
    """Errors of models begin with the word."""
    try:
        return load_policy(path)
    except ValueError as error:
        assert str(error).startswith(f"model {path}: ")
        raise ValueError(str(error).removeprefix("model ")) from None


@pytest.fixture
def spec():
    torch.set_num_threads(1)
    hyper = vars(load_hyperparameters("branch")).copy() | {"width": 8, "hidden": 8}
    observation = {"measurement": [4], "candidates": [12], "pairings": [3], "path": [5], "budget": [1]}
    return ModelSpec(
        "branch", observation, 3, hyper, {"candidates": 2, "order": "as_scanned", "compatibility": "joint"}
    )


def saved(spec, policy, path):
    save_model(path, spec, policy)
    return path.read_bytes()


def test_models(tmp_path, spec, inputs, count) -> None:
    goal = replace(spec, action="goal", observation={"budget": [1], "image": [3, 48, 48], "goals": [128]}, actions=16)
    whole = saved(goal, build_policy(goal), tmp_path / "model.pt")
    count(attack(read, tmp_path / "model.pt", damaged(whole), inputs // 2))
    policy = build_policy(goal)

    def described(document) -> bytes:
        content = {"format": "slam_gym policy 1", "spec": json.dumps(document), "policy": policy.state_dict()}
        torch.save(content, tmp_path / "other.pt")
        return (tmp_path / "other.pt").read_bytes()

    changed = documents(asdict(goal)).map(described)
    count(attack(read, tmp_path / "model.pt", changed, inputs - inputs // 2))


def test_hyperparameters(tmp_path, inputs, count) -> None:
    text, path = HYPERPARAMETERS.read_text(), tmp_path / "mine.toml"
    text = "\n".join(line.split("#")[0] for line in text.splitlines())
    count(attack(lambda file: load_hyperparameters("goal", file), path, damaged(text.encode()), inputs // 2))
    count(attack(lambda file: load_hyperparameters("goal", file), path, respelt(text), inputs - inputs // 2))


def test_overrides(tmp_path, inputs, count) -> None:
    """A file of a command's `--set` options, a line each."""

    def apply(path):
        try:
            options = [parse_override(line) for line in path.read_text("utf-8", "replace").split("\n") if line]
            return overridden(get_scenario("office-small"), dict(options))
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None

    text = (
        "sensor.range=4\ndynamics.people=3\ngenerator.rooms=4\nslam.map.confidence=0.9\nkidnapping.at=0.3\nbudget=100\n"
    )
    count(attack(apply, tmp_path / "options", damaged(text.encode()), inputs // 2))
    count(attack(apply, tmp_path / "options", respelt(text.replace("=", " ")).map(lambda t: t.replace(b" ", b"=")),
                 inputs - inputs // 2))  # fmt: skip
