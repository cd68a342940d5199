"""The levels of the association suite: frozen settings, each sweep turning one knob."""

import pytest

from slam_gym.envs.associate import AssociateEnv
from slam_gym.envs.explore import ExploreEnv
from slam_gym.scenarios import get_scenario
from slam_gym.scenarios.suite import EXPERIMENTS, get_level
from tests.scenarios.test_scenario import assert_frozen


def test_every_level_is_found_by_its_id_and_frozen_to_the_bottom():
    for level in (level for experiment in EXPERIMENTS.values() for level in experiment.levels):
        assert get_level(level.id) is level and level.scenario.name == level.id
        assert get_scenario(level.id) is level.scenario
        assert_frozen(level)


def test_a_sweep_turns_one_knob_and_nothing_else():
    for name, experiment in EXPERIMENTS.items():
        knobs = [level.knob for level in experiment.levels]
        assert len(set(knobs)) == len(knobs) >= 3 and knobs in (sorted(knobs), sorted(knobs, reverse=True))
        assert [level.number for level in experiment.levels] == list(range(len(knobs)))
        assert {level.experiment for level in experiment.levels} == {name}
    blind = {name: {level.blind for level in EXPERIMENTS[name].levels} for name in EXPERIMENTS}
    assert all((len(found) > 1) == (name in ("closure", "drift")) for name, found in blind.items())


@pytest.mark.parametrize(
    ("id", "said"),
    [
        ("closures/1", r"experiment='closures'; did you mean 'closure'\? known: closure, drift"),
        ("closure", "'closure': expected closure/0 … closure/4"),
        ("closure/5", "expected closure/0 … closure/4"),
        ("closure/-1", "expected closure/0"),
        ("closure/1/2", "expected closure/0"),
    ],
)
def test_an_id_that_is_none_is_refused_with_those_that_are(id, said):
    with pytest.raises(ValueError, match=said):
        get_level(id)


@pytest.mark.parametrize("environment", [ExploreEnv, AssociateEnv])
def test_environments_take_a_level_by_its_id(environment):
    environment(scenario="closure/0").reset(seed=0)
    with pytest.raises(ValueError, match=r"'closure/9': expected closure/0 … closure/4"):
        environment(scenario="closure/9")
