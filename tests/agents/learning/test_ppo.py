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
