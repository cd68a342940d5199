"""The command trains an associator, resumes, and refuses to do otherwise."""

import dataclasses
import json

import pytest

from agents import train_associate
from agents.learning.model_file import read_model
from agents.learning.ppo import load_hyperparameters


def test_the_command_trains_resumes_and_refuses(tmp_path):
    small = tmp_path / "small.toml"
    table = dataclasses.asdict(load_hyperparameters("branch")) | {"steps": 32, "batch_size": 32, "epochs": 1}
    lines = [f"{key} = {json.dumps(value)}" for key, value in table.items()]
    small.write_text("[branch]\n" + "\n".join(lines))
    out = tmp_path / "run"
    common = ["--scenario", "corridor", "--out", str(out), "--hyperparameters", str(small), "--eval-episodes", "1"]
    assert train_associate.main([*common, "--timesteps", "32"]) == 0
    with pytest.raises(ValueError, match="--resume"):
        train_associate.main([*common, "--timesteps", "64"])
    with pytest.raises(ValueError, match="candidates 5, not 2"):
        train_associate.main([*common, "--timesteps", "64", "--resume", "--candidates", "2"])
    assert train_associate.main([*common, "--timesteps", "64", "--resume"]) == 0
    assert read_model(out / "model.pt")[0].training["timesteps"] == 64
    with pytest.raises(ValueError, match="--timesteps"):
        train_associate.main([*common, "--timesteps", "0"])
