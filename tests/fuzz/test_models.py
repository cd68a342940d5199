"""Models, hyperparameters and overrides from strangers: read, or refused by an error that names the file."""

import io
import json
import zipfile
from dataclasses import asdict

import torch

from agents.learning.models import About, load_policy
from agents.learning.ppo import HYPERPARAMETERS, load_hyperparameters
from slam_gym.envs.goal_observation import GOAL_FIELDS
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


def test_models(tmp_path, inputs, count) -> None:
    torch.set_num_threads(1)
    observation = {"budget": [1], "image": [3, 48, 48], "goals": [16 * len(GOAL_FIELDS)]}
    about = About("goal", observation, 16, 8, 8, True, {"scenario": "office"})
    weights = io.BytesIO()
    torch.save(about.policy().state_dict(), weights)

    def described(document) -> bytes:
        content = io.BytesIO()
        with zipfile.ZipFile(content, "w") as archive:
            archive.writestr("data", json.dumps({"about": document, "num_timesteps": 3}))
            archive.writestr("policy.pth", weights.getvalue())
        return content.getvalue()

    path = tmp_path / "model.zip"
    path.write_bytes(described(asdict(about)))
    read(path)
    count(attack(read, path, damaged(path.read_bytes()), inputs // 2))
    count(attack(read, path, documents(asdict(about)).map(described), inputs - inputs // 2))


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
