"""Reinforcement learning end to end, as short as it can be: files, resumption, refusals, and who decides by them."""

import csv
import json
import os
import pickle
import re
import zipfile
from dataclasses import replace

import numpy as np
import pytest
import torch
from sb3_contrib import MaskablePPO
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import DummyVecEnv
from typer.testing import CliRunner

from agents import train as train_command
from agents.drivers.base import make_agent
from agents.evaluation.episodes import AssociateArguments, ExploreArguments, run_episode
from agents.learning.cloning import clone
from agents.learning.policies import HYPERPARAMETERS, load_hyperparameters, load_policy, make_algorithm, read_about
from agents.learning.training import ASTRAY, WEIGHTS, HeldOutWorlds, make, train
from agents.options import Training
from agents.record_decisions import decisions
from slam_gym.association.tracking.ppo import walk_by
from slam_gym.envs.explore import ExploreEnv
from slam_gym.envs.observation import GOAL_FIELDS
from slam_gym.geometry import compose

DRIVE = ExploreArguments("office-small", split="train", overrides=(("budget", 60),))
BRANCHES = AssociateArguments("corridor", candidates=3, order="fewest_candidates")


def run(out, action="goal", timesteps=32, seed=3, resumed=False, arguments=DRIVE):
    quick = out.parent / "quick.toml"
    text = re.sub(r"(n_steps|batch_size) = \d+", r"\1 = 16", HYPERPARAMETERS.read_text())
    quick.write_text(re.sub(r"n_epochs = \d+", "n_epochs = 1", text))
    how = Training(timesteps, seed, out, resumed, quick, envs=1, eval_every=16, eval_episodes=1)
    return train(action, [arguments], how, "nowhere")


@pytest.fixture(scope="module")
def driver(tmp_path_factory):
    torch.set_num_threads(1)
    return run(tmp_path_factory.mktemp("driver") / "run")


@pytest.fixture(scope="module")
def associator(tmp_path_factory):
    return run(tmp_path_factory.mktemp("associator") / "run", "branch", arguments=BRANCHES)


def test_a_training_leaves_models_and_logs(driver):
    about, folder = read_about(driver), driver.parent
    assert about.timesteps == 32 and about.training["seed"] == 3
    assert about.training["scenario"] == ["office-small"] and about.training["split"] == "train"
    assert read_about(folder / "best_model.zip").timesteps in (16, 32)
    assert [read_about(path).timesteps for path in sorted(folder.glob("checkpoints/*"))] == [16, 32]
    with (folder / "progress.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert sum(bool(row["eval/mean_reward"]) for row in rows) == 2 and "rollout/map_error" in rows[0]
    assert list(folder.glob("events.out.tfevents.*"))


def test_the_trained_agent_drives_an_episode_the_same_each_time(driver):
    agent = make_agent("ppo", driver)
    one, other = (run_episode(DRIVE.make("goal"), agent, 0) for _ in range(2))
    assert one["map_error"] == other["map_error"] and one["ticks"] == 60


def test_scores_follow_the_goals_wherever_they_are_listed_and_illegal_ones_are_never_chosen(driver):
    _, policy = load_policy(driver)
    rng, goals = np.random.default_rng(0), np.zeros((16, len(GOAL_FIELDS)), np.float32)
    goals[:9] = rng.random((9, len(GOAL_FIELDS)))
    goals[:9, GOAL_FIELDS.index("legal")] = 1.0
    space, order = policy.observation_space, rng.permutation(16)

    def logits(rows):
        parts = {name: torch.zeros(1, *part.shape) for name, part in space.spaces.items()}
        features = policy.extract_features(parts | {"goals": torch.as_tensor(rows.ravel())[None]})
        return policy.action_net(features)[0].detach()

    torch.testing.assert_close(logits(goals)[torch.as_tensor(order)], logits(goals[order]))
    noisy = goals.copy()
    noisy[9:, : GOAL_FIELDS.index("legal")] = noisy[9:, GOAL_FIELDS.index("legal") + 1 :] = 0.7
    torch.testing.assert_close(logits(noisy)[:9], logits(goals)[:9])  # whatever the illegal ones say
    shown = {name: part.sample() for name, part in space.spaces.items()} | {"goals": goals.ravel()}
    agent = make_agent("ppo", driver)
    for k in range(9):
        assert agent.act(shown, {"action_mask": np.arange(16) == k}) == k


def test_a_resumed_training_goes_on_from_its_weights_and_count(driver):
    with pytest.raises(ValueError, match="--resume"):
        run(driver.parent)
    with pytest.raises(ValueError, match="seed 3, not 4"):
        run(driver.parent, seed=4, timesteps=48, resumed=True)
    with zipfile.ZipFile(driver) as archive, archive.open("policy.optimizer.pth") as file:
        before = [int(state["step"]) for state in torch.load(file, weights_only=True)["state"].values()]
    quick, faster = driver.parent.parent / "quick.toml", driver.parent.parent / "faster.toml"
    how = {"seed": 3, "output": driver.parent, "resume": True, "envs": 1, "eval_every": 16, "eval_episodes": 1}
    for was, now in (("gamma = 0.98", "gamma = 0.5"), ("reward_scale = ", "reward_scale = 7")):
        faster.write_text(quick.read_text().replace(was, now))
        with pytest.raises(ValueError, match="with other hyperparameters"):
            train("goal", [DRIVE], Training(48, hyperparameters=faster, **how), "nowhere")
    for early in driver.parent.glob("checkpoints/*.zip"):
        os.utime(early)  # as in a folder that was copied
    (driver.parent / "checkpoints" / "model_99_steps.zip").write_bytes(driver.read_bytes()[:3000])  # a killed training
    assert read_about(run(driver.parent, timesteps=48, resumed=True)).timesteps == 48
    with zipfile.ZipFile(driver) as archive, archive.open("policy.optimizer.pth") as file:
        after = [int(state["step"]) for state in torch.load(file, weights_only=True)["state"].values()]
    assert max(after) == max(before) + 1  # the optimiser's moments were kept
    assert (driver.parent / "progress_from_32.csv").exists()


def test_every_evaluation_is_in_the_same_held_out_worlds(tmp_path, monkeypatch):
    reset, watched = ExploreEnv.reset, DummyVecEnv([lambda: HeldOutWorlds("goal", DRIVE, 2)])
    for _ in range(3):
        worlds = []
        note = lambda env, **how: worlds.append(how["options"]["world"]) or reset(env, **how)  # noqa: B023, E731
        monkeypatch.setattr(ExploreEnv, "reset", note)
        evaluate_policy(PPO("MultiInputPolicy", watched), watched, n_eval_episodes=2, warn=False)
        assert set(worlds[:2]) == {5000, 5001}
    with pytest.raises(ValueError, match="2 scenarios need as many --envs"):
        train("goal", [DRIVE, DRIVE], Training(output=tmp_path, envs=1), "nowhere")
    with pytest.raises(ValueError, match="no training to resume"):
        run(tmp_path, resumed=True)


def test_twist_is_trained_by_ppo(tmp_path):
    agent = make_agent("ppo", run(tmp_path / "run", action="twist", timesteps=16))
    assert agent.action == "twist"
    one, other = (run_episode(DRIVE.make("twist"), agent, 0)["map_error"] for _ in range(2))
    assert one == other  # drawn from the policy, by the seed of the episode


def test_an_associator_decides_elsewhere_as_in_the_environment(associator):
    about, associate = read_about(associator), walk_by(associator.parent / WEIGHTS)
    assert about.training["candidates"] == 3 and about.training["order"] == "fewest_candidates"
    (_, policy), decide = load_policy(associator), associate.keywords["policy"]
    env = BRANCHES.make().unwrapped
    observation, info = env.reset(seed=0)
    over, look = False, 0
    while not over:
        if env.walk is not None and info["look"] != look:
            look, expected = info["look"], associate(env.run.scan, env.run.prediction)
        action = decide(observation, info["action_mask"])
        assert env.walk is None or action == env.action_of(expected)
        seen = {name: observation[name] for name in policy.observation_space.spaces}
        assert action == int(policy.predict(seen, deterministic=True, action_masks=info["action_mask"])[0])
        observation, _, over, _, info = env.step(action)
    again = pickle.loads(pickle.dumps(associate))
    observation, info = env.reset(seed=4)
    mask = info["action_mask"]
    assert again.keywords["policy"](observation, mask) == decide(observation, mask)


def test_in_training_an_episode_of_association_ends_where_the_robot_is_astray():
    env, over, errors = make("branch", AssociateArguments("drift-3", split="train"), 1.0), False, [0.0]
    env.reset(seed=1)
    while not over:
        legal = np.flatnonzero(env.unwrapped.action_masks())
        _, _, terminated, truncated, _ = env.step(legal[max(len(legal) - 2, 0)])  # the farthest feature on offer
        run = env.unwrapped.run
        errors += [np.hypot(*(compose(run.base, run.estimates[-1]) - run.poses[-1])[:2])] if run.poses else []
        over = terminated or truncated
    assert truncated and not terminated
    assert errors[-1] > ASTRAY >= max(errors[:-1])


def test_rewards_of_branches_are_scaled_by_the_scans_of_an_episode():
    envs = [make("branch", BRANCHES), make("branch", BRANCHES, 2.0)]
    masks = [env.reset(seed=0)[1]["action_mask"] for env in envs]
    plain, scaled = (env.step(int(mask.argmax()))[1] for env, mask in zip(envs, masks))
    assert scaled == pytest.approx(2.0 * envs[0].unwrapped.run.length * plain) != 0.0


def test_a_clone_decides_as_its_associator():
    env, hyper = make("branch", replace(BRANCHES, compatibility="individual")), load_hyperparameters("branch")
    policy = make_algorithm("branch", DummyVecEnv([lambda: env]), hyper, 0).policy
    losses = clone(policy, [env], "jcbb", seed=0)
    assert losses[-1] < 0.1 * losses[0]
    (own,) = decisions(env, "jcbb", range(1))
    seen = {name: part[:-1] for name, part in own.observations.items()}
    actions, _ = policy.predict(seen, deterministic=True, action_masks=own.masks)
    assert np.mean(actions == own.actions) > 0.95


def test_an_associator_is_no_driver(associator, tmp_path):
    with pytest.raises(ValueError, match="not a driver"):
        make_agent("ppo", associator)
    with pytest.raises(ValueError, match=r"none\.npz"):
        walk_by(tmp_path / "none.npz")


@pytest.mark.parametrize("action", ["goal", "twist"])
def test_somebody_elses_zip_is_read_only_where_it_is_trusted(tmp_path, action):
    learner = MaskablePPO if action == "goal" else PPO
    learner("MultiInputPolicy", DRIVE.make(action), n_steps=16).save(tmp_path / "model.zip")
    with pytest.raises(ValueError, match=r"model.zip: refused.*--trust"):
        make_agent("ppo", tmp_path / "model.zip")
    agent, env = make_agent("ppo", tmp_path / "model.zip", trust=True), DRIVE.make(action)
    observation, info = env.reset(seed=0)
    assert agent.action == action and env.action_space.contains(agent.act(observation, info))
    PPO("MultiInputPolicy", DRIVE.make("goal"), n_steps=16).save(tmp_path / "model.zip")
    with pytest.raises(ValueError, match=r"model.zip: goals need MaskablePPO"):
        make_agent("ppo", tmp_path / "model.zip", trust=True)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width": 10**9}, "width is 1000000000"), ({"actions": -1}, "no positive numbers"), ({"format": "x"}, "not a"),
        ({"observation": {"image": [3, 4000, 4000]}}, "larger than any"), ({"width": 32}, "state_dict"),
    ],
)  # fmt: skip
def test_a_description_that_does_not_fit_is_refused_by_name(driver, tmp_path, change, message):
    with zipfile.ZipFile(driver) as whole, zipfile.ZipFile(tmp_path / "other.zip", "w") as other:
        for name in whole.namelist():
            content = whole.read(name)
            if name == "data":
                table = json.loads(content)
                about = table["about"] | {name: value for name, value in change.items() if name != "width"}
                about["hyperparameters"] |= {name: value for name, value in change.items() if name == "width"}
                content = json.dumps(table | {"about": about})
            other.writestr(name, content)
    with pytest.raises(ValueError, match=f"other.zip: refused.*{message}"):
        load_policy(tmp_path / "other.zip")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("envs = 4", "envs = 0", "envs is 0"), ("envs = 4", 'envs = "4"', "envs is '4'"), ("n_steps", "steps", "ppo"),
        ("gamma = 0.98", "gamma = 5", "gamma is 5"), ("[goal]", "[gaol]", "missing"), ("[goal]", "[", "mine.toml"),
        ("annealed = false", 'annealed = "no"', "annealed is 'no'"), ("ent_coef = 0.005", "", "and ent_coef"),
    ],
)  # fmt: skip
def test_hyperparameters_that_cannot_be_are_refused_by_name(tmp_path, old, new, message):
    (tmp_path / "mine.toml").write_text(HYPERPARAMETERS.read_text().replace(old, new, 1))
    with pytest.raises(ValueError, match=rf"mine\.toml: .*{message}" if message != "mine.toml" else message):
        load_hyperparameters("goal", tmp_path / "mine.toml")


@pytest.mark.parametrize(
    ("app", "line", "said"),
    [
        (train_command.app, ["drive", "--timesteps", "0"], "timesteps"),
        (train_command.app, ["drive", "--scenario", "offic"], "office-small"),
        (train_command.app, ["associate", "--hyperparameters", "nowhere.toml"], "nowhere.toml"),
    ],
)
def test_bad_input_of_the_commands_is_told_and_nothing_is_written(tmp_path, app, line, said):
    done = CliRunner().invoke(app, [*line, "--output", str(tmp_path / "out")])
    assert done.exit_code == 2 and said in done.output
    assert not (tmp_path / "out").exists()
