"""Recorded decisions are those of the associator, in the episodes that seeds tell; a data set where Minari is there."""

import numpy as np
import pytest

from agents.evaluation.episodes import AssociateArguments
from agents.record_decisions import app, decisions
from tests.agents import typed

SHORT = AssociateArguments(overrides=(("budget", 30),))


def test_decisions_are_legal_and_can_be_played_again():
    env = SHORT.make()
    (own, other) = decisions(env, "jcbb", range(3, 5))
    t = len(own.actions)
    assert (own.world, other.world) == (3, 4) and t > 10
    assert own.masks.shape == (t, env.action_space.n) and own.masks[np.arange(t), own.actions].all()
    assert all(len(part) == t + 1 for part in own.observations.values())
    assert np.mean(own.actions == own.right) > 0.9
    observation, _ = env.reset(seed=3, options={"world": 3})
    for step, action in enumerate(own.actions):
        assert all(np.array_equal(part[step], observation[name]) for name, part in own.observations.items())
        observation, reward, over, _, _ = env.step(action)
        assert reward == own.rewards[step]
    assert over


def test_another_associator_decides_otherwise():
    (good,), (bad,) = (list(decisions(SHORT.make(), name, range(1))) for name in ("true_association", "singles"))
    assert (good.actions == good.right)[good.right >= 0].all() and (bad.actions != bad.right).any()
    blind = AssociateArguments("office-small", overrides=(("budget", 5), ("sensor.range", 0.5))).make()
    assert [own.actions.tolist() for own in decisions(blind, "jcbb", range(1, 3))] == [[5], [5]]  # there is no choice


def test_some_decisions_are_mistakes_where_they_are_asked_for():
    (own,) = decisions(SHORT.make(), "true_association", range(1), mistakes=0.3)
    known = own.right >= 0
    assert own.masks[np.arange(len(own.actions)), own.actions].all()
    assert own.masks[known, own.right[known]].all() and 0.5 < (own.actions == own.right)[known].mean() < 1.0


def test_they_become_a_data_set(tmp_path, monkeypatch):
    minari = pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    names = ("--scenario", "office-small", "hall", "--seed", 5, "--set", "budget=20", "--associator", "singles")
    result = typed(app, *names, "--episodes", 1)
    assert result.exit_code == 0, result.output
    assert "a data set of its own" in typed(app, *names, "--dataset", "mine-v0").stderr
    for data in (minari.load_dataset(f"slam_gym/{scenario}/singles-v0") for scenario in ("office-small", "hall")):
        (episode,), (how,) = data.iterate_episodes(), data.storage.get_episode_metadata([0])
        assert episode.terminations[-1] and len(episode.infos["right"]) > 5
        observation, _ = data.recover_environment().reset(seed=how["seed"], options={"world": how["options"]["world"]})
        assert all(np.array_equal(part[0], observation[name]) for name, part in episode.observations.items())


@pytest.mark.parametrize("name", ["mine", "mine_v0", "my data-v0", "../mine-v0"])
def test_a_name_that_minari_could_not_store_is_refused_first(tmp_path, monkeypatch, name):
    pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    result = typed(app, "--dataset", name, "--scenario", "office-small")
    assert result.exit_code == 2 and f"--dataset {name}: is neither" in result.stderr
    assert not list(tmp_path.iterdir())
