"""Associators learned and taught: the export of decisions, training on Associate-v0, its model as an associator."""

import dataclasses
import json
import pickle

import numpy as np
import pytest
import torch
from gymnasium import spaces

from agents import export_decisions, train_associate
from agents.drivers.base import make_agent
from agents.learning.association_models import BestBranch, associate_episode, load
from agents.learning.association_networks import BranchPolicy
from agents.learning.association_setting import AssociationSetting
from agents.learning.ppo import load_hyperparameters, read_model
from agents.train import train
from slam_gym.association.tracking.observation import lengths
from slam_gym.simulation.association_runs import CORRIDOR
from slam_gym.slam.slam import Slam
from slam_gym.types import NONE

SETTING = AssociationSetting("corridor", candidates=3, order="fewest_candidates")


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    torch.set_num_threads(1)
    out = tmp_path_factory.mktemp("training") / "run"
    hyper = dataclasses.replace(load_hyperparameters("branch"), steps=64, batch_size=32, epochs=1)
    train(out, SETTING, "branch", hyper, seed=3, timesteps=128, command="", eval_every=64, eval_episodes=1)
    return out


# -- export --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    file = tmp_path_factory.mktemp("export") / "decisions.npz"
    assert export_decisions.main([str(file), "--scenario", "corridor", "--episodes", "2", "--candidates", "4"]) == 0
    return file


def test_an_export_holds_states_masks_and_right_answers(exported):
    with np.load(exported, allow_pickle=False) as file:
        content = {name: file[name] for name in file.files}
    count = len(content["right"])
    assert str(content["format"]) == export_decisions.FORMAT
    assert json.loads(str(content["setting"]))["scenario"] == "corridor"
    for name, length in (lengths(4) | {"budget": 1}).items():
        assert content[name].shape == (count, length)
        assert content[name].dtype == np.float32
    assert content["mask"].shape == (count, 5)
    assert content["mask"].dtype == bool
    rows = np.arange(count)
    known = content["right"] != NONE
    assert content["mask"][rows[known], content["right"][known]].all()
    assert content["mask"][rows, content["taken"]].all()
    assert set(content["episode"].tolist()) == {0, 1}
    assert (content["right"] == content["taken"]).mean() > 0.8
    assert (content["right"] != content["taken"]).sum() > 20
    assert (known & (content["right"] < 4)).mean() > 0.8


def test_an_export_is_the_same_to_the_last_byte(exported, tmp_path):
    again = tmp_path / "again.npz"
    export_decisions.main([str(again), "--scenario", "corridor", "--episodes", "2", "--candidates", "4"])
    assert again.read_bytes() == exported.read_bytes()


def test_without_mistakes_the_map_is_that_of_right_decisions(tmp_path):
    arrays = export_decisions.decisions(AssociationSetting("corridor"), 5, 1, 0.0)
    assert (arrays["taken"] == np.where(arrays["right"] == NONE, 5, arrays["right"])).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--episodes", "0"], "--episodes"),
        (["--mistakes", "2"], "--mistakes"),
        (["--scenario", "atlantis"], "corridor"),
        (["--order", "any"], "as_scanned"),
    ],
)
def test_bad_exports_are_refused_and_leave_no_file(arguments, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        export_decisions.main([str(tmp_path / "file.npz"), *arguments])
    assert not list(tmp_path.iterdir())


def test_an_export_into_nowhere_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="folder"):
        export_decisions.main([str(tmp_path / "none" / "file.npz")])


# -- the network ---------------------------------------------------------------------------------------------------


def network(candidates):
    space = {name: spaces.Box(-1.0, 1.0, (length,), np.float32) for name, length in lengths(candidates).items()}
    space["budget"] = spaces.Box(0.0, 1.0, (1,), np.float32)
    torch.manual_seed(0)
    return BranchPolicy(spaces.Dict(space), spaces.Discrete(candidates + 1), lambda _: 1e-3, width=16, hidden=16)


def batch(candidates, rng):
    out = {
        name: torch.as_tensor(rng.uniform(-1, 1, (2, n)), dtype=torch.float32)
        for name, n in lengths(candidates).items()
    }
    rows = out["candidates"].reshape(2, candidates, -1)
    rows[:, :, 0] = 1.0
    return out | {"budget": torch.ones(2, 1)}


def test_permuted_candidates_have_permuted_scores_and_the_refusal_keeps_its_own():
    rng, policy, order = np.random.default_rng(0), network(4), [2, 0, 3, 1]
    seen = batch(4, rng)
    permuted = seen | {"candidates": seen["candidates"].reshape(2, 4, -1)[:, order].reshape(2, -1)}
    with torch.no_grad():
        scores, other = policy.branch_scores(seen), policy.branch_scores(permuted)
    assert scores.shape == (2, 5)
    torch.testing.assert_close(scores[:, [*order, 4]], other)
    assert not torch.allclose(scores[:, 0], scores[:, 1])


def test_weights_fit_any_number_of_candidates_and_ignore_the_budget():
    few, many = network(2), network(7)
    many.load_state_dict(few.state_dict())
    seen = batch(7, np.random.default_rng(1))
    with torch.no_grad():
        scores = many.branch_scores(seen)
        torch.testing.assert_close(scores, many.branch_scores(seen | {"budget": torch.zeros(2, 1)}))
    assert scores.shape == (2, 8)


# -- training ------------------------------------------------------------------------------------------------------


def test_a_training_leaves_a_model_and_logs(trained):
    spec, content = read_model(trained / "model.pt")
    assert spec.action == "branch"
    assert spec.training["timesteps"] == 128
    assert {name: spec.training[name] for name in ("scenario", "candidates", "order", "split")} == {
        "scenario": "corridor", "candidates": 3, "order": "fewest_candidates", "split": "train",
    }  # fmt: skip
    assert all(torch.isfinite(weights).all() for weights in content["policy"].values())
    header = (trained / "progress.csv").read_text()
    assert "held_out/score" in header
    assert "held_out/map_error" in header
    assert (trained / "best.pt").exists()


def test_the_model_is_an_associator_that_decides_as_in_the_environment(trained):
    associate = load(trained / "model.pt")
    env = SETTING.make().unwrapped
    observation, info = env.reset(seed=0)
    over, look = False, 0
    while not over:
        if env.walk is not None and info["look"] != look:
            look, expected = info["look"], associate(env.run.scan, env.run.prediction)
        action = associate.policy(observation, info["action_mask"])
        assert env.walk is None or action == env.action_of(expected)
        observation, _, over, _, info = env.step(action)
    again = pickle.loads(pickle.dumps(associate))
    slam = Slam(CORRIDOR.slam, again)
    for odometry, scan, _ in CORRIDOR.scans(np.random.default_rng(0)):
        slam.step(odometry, scan)
    assert slam.map.n > 50


def test_episodes_of_a_policy_are_reproduced(trained):
    associate, env = load(trained / "model.pt"), SETTING.make()
    one, other = (associate_episode(env, associate.policy, 4) for _ in range(2))
    assert one == other
    assert one["decisions"] > 100
    assert isinstance(associate.policy, BestBranch)


def test_a_driver_is_no_associator_and_an_associator_no_driver(trained):
    with pytest.raises(ValueError, match="not a driver"):
        make_agent("ppo", trained / "model.pt")
    with pytest.raises(ValueError, match="no such file"):
        load(trained / "none.pt")


def test_the_command_trains_resumes_and_refuses(trained, tmp_path):
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
