"""The command trains, refuses to overwrite, and its model is evaluated beside the baselines."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from agents.evaluate import main as evaluate_main
from agents.learning.ppo import HYPERPARAMETERS
from agents.train import main

ROOT = Path(__file__).parents[2]


def test_training_over_an_earlier_one_is_refused(tmp_path):
    (tmp_path / "checkpoint.pt").touch()
    with pytest.raises(ValueError, match="--resume"):
        main(["--out", str(tmp_path), "--scenario", "office-small"])


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (["--timesteps", "0"], "--timesteps must be at least 1"),
        (["--eval-every", "0"], "--eval-every must be at least 1"),
        (["--scenario", "offic"], "offic.*office-small"),
        (["--set", "sensor.rang=4"], "sensor.rang.*range"),
        (["--hyperparameters", "nowhere.toml"], "nowhere.toml"),
    ],
)
def test_bad_input_is_told_in_one_line_that_names_it(tmp_path, line, said):
    with pytest.raises(ValueError, match=said):
        main([*line, "--out", str(tmp_path / "out")])
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_command_trains_in_processes_and_evaluate_reads_its_model(tmp_path):
    toml = HYPERPARAMETERS.read_text()
    toml = re.sub(r"^steps = \d+", "steps = 16", toml, flags=re.MULTILINE)
    (tmp_path / "short.toml").write_text(toml)
    line = ["--scenario", "office-small", "--timesteps", "32", "--envs", "2", "--eval-episodes", "1"]
    line += ["--hyperparameters", str(tmp_path / "short.toml"), "--out", str(tmp_path / "run")]
    done = subprocess.run(
        [sys.executable, "-m", "agents.train", *line], cwd=ROOT, capture_output=True, text=True, timeout=200
    )
    assert done.returncode == 0, done.stderr
    model = tmp_path / "run" / "model.pt"
    assert str(model) in done.stdout
    evaluate_line = ["--agents", "ppo", "--model", str(model), "--scenario", "office-small", "--episodes", "2"]
    assert evaluate_main([*evaluate_line, "--jobs", "1", "--no-films", "--out", str(tmp_path / "evaluation")]) == 0
    results = json.loads((tmp_path / "evaluation" / "results.json").read_text())
    assert results["models"][str(model)]["training"]["timesteps"] == 32
