"""Hyperparameters come from a file that is refused where it says anything else."""

import numpy as np
import pytest

from agents.learning.ppo import HYPERPARAMETERS, load_hyperparameters


@pytest.mark.parametrize("action", ["goal", "twist", "branch"])
def test_the_shipped_hyperparameters_are_read(action):
    hyper = load_hyperparameters(action)
    assert hyper.envs >= 1 and 0.0 < hyper.discount <= 1.0 and np.isfinite(hyper.learning_rate)
    assert (hyper.envs * hyper.steps) % hyper.batch_size == 0


@pytest.mark.parametrize("text", ["[goal]\nenvs = 4\n", "[goal\n", "[twist]\n", ""])
def test_wrong_hyperparameters_are_refused_by_file_and_name(tmp_path, text):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"mine\.toml"):
        load_hyperparameters("goal", path)


def test_a_misspelt_hyperparameter_is_named(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(HYPERPARAMETERS.read_text().replace("epochs", "epoch"))
    with pytest.raises(ValueError, match="'epoch'"):
        load_hyperparameters("goal", path)


@pytest.mark.parametrize(
    ("line", "changed", "message"),
    [
        ("envs = 4", "envs = true", "envs is True"),
        ("envs = 4", "envs = 4.0", "envs is 4.0, expected a whole number in 1"),
        ("steps = 128", "steps = 0", "steps is 0"),
        ("learning_rate = 7e-4", "learning_rate = nan", "learning_rate is nan"),
        ("learning_rate = 7e-4", "learning_rate = -inf", "learning_rate is -inf"),
        ("learning_rate = 7e-4", "learning_rate = 2001-01-01", "learning_rate is datetime.date"),
        ("discount = 0.98", 'discount = "high"', "discount is 'high', expected a number in 0"),
        ("width = 64", "width = 50000", "width is 50000, expected a whole number in 1"),
        ("deterministic = true", "deterministic = 1", "deterministic is 1"),
        ("width = 64", f"width = {'9' * 5000}", "digits"),
        ("width = 64", f"width = {'[' * 20000}", "nested|Invalid"),
        ("width = 64", "#" * 70_000, "is larger than"),
    ],
)
def test_hyperparameters_have_types_and_ranges(tmp_path, line, changed, message):
    path = tmp_path / "mine.toml"
    path.write_text(HYPERPARAMETERS.read_text().replace(line, changed, 1))
    with pytest.raises(ValueError, match=rf"mine\.toml: .*({message})"):
        load_hyperparameters("goal", path)
