"""Training end to end, as short as it can be: files, resumption, refusals. Whether it learns is for the README."""

import csv
import dataclasses
import json

import numpy as np
import pytest
import torch
from stable_baselines3.common.vec_env import DummyVecEnv

from agents.drivers.base import make_agent
from agents.evaluation.episodes import AssociateArguments, ExploreArguments, run_episode
from agents.learning import training
from agents.learning.model_file import read_model
from agents.learning.ppo import load_hyperparameters, make_algorithm
from agents.learning.training import HELD_OUT, TrainingPlan, train
from slam_gym.scenarios import SPLITS
from tests.rollouts import differences

TRAINING = ExploreArguments("office-small", split="train")


def short(action):
    return dataclasses.replace(load_hyperparameters(action), envs=1, steps=16, batch_size=16, epochs=1)


def run(out, action="goal", timesteps=32, seed=3, resumed=False):
    plan = TrainingPlan(action, TRAINING, short(action), seed, timesteps, eval_every=16, eval_episodes=1)
    return train(out, plan, resumed)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    torch.set_num_threads(1)
    out = tmp_path_factory.mktemp("training") / "run"
    run(out)
    return out


def test_a_training_leaves_models_and_logs(trained):
    spec, content = read_model(trained / "model.pt")
    assert spec.training["timesteps"] == 32 and spec.training["seed"] == 3
    assert spec.training["scenario"] == "office-small" and spec.training["split"] == "train"
    assert all(torch.isfinite(weights).all() for weights in content["policy"].values())
    assert (trained / "progress.csv").read_text().count("held_out/map_error") == 1
    assert list(trained.glob("events.out.tfevents.*"))
    with (trained / "progress.csv").open() as file:
        scores = [float(row["held_out/map_error"]) for row in csv.DictReader(file) if row["held_out/map_error"]]
    assert len(scores) == 2
    assert read_model(trained / "best.pt")[0].training["best"] == pytest.approx(min(scores), rel=1e-4)


def test_training_changes_the_weights(trained):
    one, two = (read_model(trained / name)[1]["policy"] for name in ("model.pt", "checkpoint.pt"))
    assert all(torch.equal(one[key], two[key]) for key in one)
    assert any((weights != 0).any() for key, weights in one.items() if key.endswith("score.2.bias"))


def test_tensorboard_reads_the_logs(trained):
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    events = accumulator.EventAccumulator(str(trained))
    events.Reload()
    tags = events.Tags()["scalars"]
    assert {"held_out/map_error", "held_out/coverage", "train/value_loss"} <= set(tags)
    assert [event.step for event in events.Scalars("held_out/map_error")] == [16, 32]


def test_the_trained_agent_drives_an_episode(trained):
    agent = make_agent("ppo", trained / "model.pt")
    records = [run_episode(ExploreArguments("office-small").make("goal"), agent, 0) for _ in range(2)]
    assert records[0]["map_error"] == records[1]["map_error"]
    assert records[0]["ticks"] == 300


def test_a_resumed_training_goes_on_from_its_weights_and_count(trained, tmp_path):
    out = tmp_path / "run"
    out.mkdir()
    (out / "checkpoint.pt").write_bytes((trained / "checkpoint.pt").read_bytes())
    run(out, timesteps=48, resumed=True)
    before, after = (read_model(folder / "model.pt") for folder in (trained, out))
    assert after[0].training["timesteps"] == 48
    steps = [
        int(state["step"]) for content in (before[1], after[1]) for state in content["optimizer"]["state"].values()
    ]
    half = len(steps) // 2
    assert steps[:half] == [2] * half and steps[half:] == [3] * half  # the optimiser's moments were kept
    assert (out / "progress_from_32.csv").exists()


def test_a_resumed_training_is_the_one_that_was_not_interrupted(tmp_path):
    whole, parts, action = tmp_path / "whole", tmp_path / "parts", "twist"
    run(whole, action, timesteps=64)
    run(parts, action, timesteps=32)
    torch.rand(7), np.random.rand(7)  # noqa: NPY002 (somebody else draws in between)
    run(parts, action, timesteps=64, resumed=True)
    one, two = (read_model(folder / "checkpoint.pt") for folder in (whole, parts))
    for part in ("policy", "state"):
        assert not differences(one[1][part], two[1][part]), part
    assert one[0].training["timesteps"] == two[0].training["timesteps"] == 64


def test_a_training_that_is_interrupted_in_a_rollout_goes_on_from_the_last_one(tmp_path, monkeypatch):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    run(whole, timesteps=48)

    def interrupt(self):
        if self.num_timesteps == 24:
            raise KeyboardInterrupt
        return True

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(training.Watch, "_on_step", interrupt)
        run(parts, timesteps=48)
    assert read_model(parts / "checkpoint.pt")[0].training["timesteps"] == 16
    run(parts, timesteps=48, resumed=True)
    one, two = (read_model(folder / "model.pt")[1]["policy"] for folder in (whole, parts))
    assert not differences(one, two)


def test_another_number_of_environments_goes_on_to_new_worlds(trained, tmp_path):
    (tmp_path / "checkpoint.pt").write_bytes((trained / "checkpoint.pt").read_bytes())
    hyper = dataclasses.replace(short("goal"), envs=2)
    plan = TrainingPlan("goal", TRAINING, hyper, 3, 64, eval_every=64, eval_episodes=1, workers=0)
    train(tmp_path, plan, resumed=True)
    assert read_model(tmp_path / "model.pt")[0].training["timesteps"] == 64


def test_a_state_that_does_not_fit_is_refused(trained, tmp_path):
    spec, content = read_model(trained / "checkpoint.pt")
    content["state"] = torch.frombuffer(bytearray(b'{"worlds": []}'), dtype=torch.uint8)
    content["spec"] = json.dumps(dataclasses.asdict(spec))
    torch.save(content, tmp_path / "checkpoint.pt")
    with pytest.raises(ValueError, match=r"checkpoint.pt: the state of the training does not fit"):
        run(tmp_path, timesteps=48, resumed=True)


def test_resuming_something_else_is_refused(trained):
    with pytest.raises(ValueError, match="seed 3, not 4"):
        run(trained, seed=4, timesteps=48, resumed=True)


def test_twist_is_trained_by_ppo(tmp_path):
    agent = make_agent("ppo", run(tmp_path / "run", action="twist", timesteps=16))
    assert agent.action == "twist"
    assert np.isfinite(run_episode(ExploreArguments("office-small").make("twist"), agent, 0)["map_error"])


@pytest.mark.parametrize("action", ["goal", "twist"])
def test_a_trusted_zip_of_stable_baselines3_is_read(tmp_path, action):
    envs = DummyVecEnv([lambda: ExploreArguments("office-small", split="train").make(action)])
    make_algorithm(action, envs, short(action), seed=0).save(tmp_path / "model.zip")
    agent = make_agent("ppo", tmp_path / "model.zip", trust=True)
    assert agent.action == action
    observation = {key: value[0] for key, value in envs.reset().items()}
    assert envs.action_space.contains(agent.act(observation, {"action_mask": np.ones(16, bool)}))
    with pytest.raises(ValueError, match=r"--trust"):
        make_agent("ppo", tmp_path / "model.zip")


def test_worlds_watched_in_training_are_neither_trained_nor_reported_on():
    first, count = SPLITS["test"]
    assert SPLITS["train"][0] + SPLITS["train"][1] <= first
    assert 1_000 < HELD_OUT < count - 1_000


def test_an_associator_is_trained_and_its_file_says_on_what(tmp_path):
    arguments = AssociateArguments("corridor", candidates=3, order="fewest_candidates")
    hyper = dataclasses.replace(load_hyperparameters("branch"), steps=64, batch_size=32, epochs=1)
    plan = TrainingPlan("branch", arguments, hyper, 3, 128, eval_every=64, eval_episodes=1, workers=0)
    spec, content = read_model(train(tmp_path / "run", plan))
    assert spec.action == "branch"
    assert spec.training["timesteps"] == 128
    assert {name: spec.training[name] for name in ("scenario", "candidates", "order", "split")} == {
        "scenario": "corridor", "candidates": 3, "order": "fewest_candidates", "split": "train",
    }  # fmt: skip
    assert all(torch.isfinite(weights).all() for weights in content["policy"].values())
    header = (tmp_path / "run" / "progress.csv").read_text()
    assert "held_out/score" in header
    assert "held_out/map_error" in header
    assert (tmp_path / "run" / "best.pt").exists()


@pytest.mark.parametrize(("start", "expected"), [(0, 128), (128, 128), (100, 164)])
def test_the_bar_ends_with_the_last_rollout(start, expected):
    plan = TrainingPlan("goal", TRAINING, dataclasses.replace(short("goal"), steps=32, envs=2), timesteps=101)
    assert plan.decisions_from(start) == expected
