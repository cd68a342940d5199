"""Rollouts collected elsewhere are those of the policy, entered once; lost actors are replaced (where there is Ray)."""

import dataclasses

import numpy as np
import pytest
import torch

from agents.evaluation.episodes import ExploreArguments
from agents.learning.distributed import Collector, RayCollection, Stages, connect, enter
from agents.learning.many_worlds import WorldsForLearning
from agents.learning.model_file import read_model
from agents.learning.ppo import load_hyperparameters, make_algorithm
from agents.learning.training import TrainingPlan, train
from tests.rollouts import differences

HYPER = dataclasses.replace(load_hyperparameters("goal"), envs=3, steps=8, batch_size=24, epochs=1)


def worlds(count):
    """So many worlds in this process."""
    return WorldsForLearning(ExploreArguments("office-small", split="train").make_many("goal", count, 0))


def learner():
    model = make_algorithm("goal", worlds(3), HYPER, seed=0)
    model._setup_learn(1)
    return model


def weights_of(model):
    return {name: tensor.detach().numpy() for name, tensor in model.policy.state_dict().items()}


def test_a_rollout_is_that_of_the_weights_handed_out() -> None:
    model = learner()
    collector = Collector("goal", worlds, HYPER, 2, seed=5)
    rollout = collector.collect(weights_of(model))
    assert rollout.parts["rewards"].shape == (8, 2) and rollout.parts["action_masks"].shape == (8, 2, 16)
    assert rollout.bytes > 0 and rollout.seconds > 0.0
    states = {key: torch.from_numpy(part[3]) for key, part in rollout.observations.items()}
    with torch.no_grad():
        values = model.policy.predict_values(states)
    np.testing.assert_allclose(values[:, 0].numpy(), rollout.parts["values"][3], rtol=1e-5)
    chosen = rollout.parts["actions"][..., 0].astype(int)
    assert np.take_along_axis(rollout.parts["action_masks"], chosen[..., None], axis=2).all()


def test_parts_are_entered_side_by_side_and_learned_from_as_a_whole() -> None:
    model = learner()
    parts = [Collector("goal", worlds, HYPER, n, seed=n).collect(weights_of(model)) for n in (1, 2)]
    buffer = model.rollout_buffer
    for rollout, rows in zip(parts, (range(0, 1), range(1, 3))):
        enter(buffer, rollout, rows)
    for name, array in parts[1].parts.items():
        assert not differences(np.asarray(getattr(buffer, name)[:, 1:]).reshape(array.shape), array), name
    assert not differences(buffer.observations["goals"][:, :1], parts[0].observations["goals"])
    buffer.pos, buffer.full = 8, True
    before = {name: array.copy() for name, array in weights_of(model).items()}
    model.set_logger(_silent())
    model.train()
    assert any((array != before[name]).any() for name, array in weights_of(model).items())


def _silent():
    from stable_baselines3.common.logger import Logger

    return Logger(None, [])


def test_stages_are_told_with_their_throughput() -> None:
    stages = Stages(1000, 2, 1, 3.5, collecting=10.0, waiting=6.0, learning=2.0, actors=2)
    assert "1 lost" in stages.told() and "100 decisions/s and actor, 167 together" in stages.told()
    assert "3.5 MB, 1.0 s of 6.0 s" in stages.told() and "learning: 500 decisions/s" in stages.told()


@pytest.mark.slow
def test_ray_actors_collect_and_the_lost_are_replaced(tmp_path) -> None:
    ray = pytest.importorskip("ray")
    connect()
    model = learner()
    collection = RayCollection(model, "goal", worlds, HYPER, 2, seed=0)
    ray.kill(collection.actors[1])
    model.num_timesteps = 0
    model.collect_rollouts = collection
    model.set_logger(_silent())
    model.learn(48)
    assert model.num_timesteps == 48 == collection.stages.decisions
    assert collection.stages.lost == 1 and collection.stages.rollouts == 2
    collection.close()
    plan = TrainingPlan("goal", ExploreArguments("office-small", split="train"), HYPER, 0, 24, 24, 1, workers=2)
    train(tmp_path, dataclasses.replace(plan, backend="ray"))
    assert read_model(tmp_path / "model.pt")[0].training["timesteps"] == 24
    ray.shutdown()
