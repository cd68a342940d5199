"""Many worlds are the single environment, many times: bit for bit, in every mode, in this process and in others."""

import gc
import os
import pickle
import signal
import subprocess
import sys
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ClosedEnvironmentError
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import vector as wrappers

from slam_gym.association import nearest_neighbour
from slam_gym.envs.vector import WorldError
from slam_gym.scenarios import SCENARIOS
from tests.envs.test_base import CASES, ENVIRONMENTS, SMALL
from tests.rollouts import bare, differences, in_any_process, short, vector_rollout


def many(name, num_envs=2, workers=0, **options):
    """The environment `slam_gym/<name>`, many times."""
    return gym.make_vec(
        f"slam_gym/{name}", num_envs=num_envs, vectorization_mode="vector_entry_point", workers=workers, **options
    )


def small(name, **options):
    return many(name, **{"scenario": SMALL if name == "Relocate-v0" else short(12)} | options)


def legal(envs, rng):
    """A legal action for each world."""
    if isinstance(envs.single_action_space, gym.spaces.Discrete):
        return np.array([rng.choice(np.flatnonzero(mask)) for mask in envs.action_masks()])
    return rng.uniform(-1.0, 1.0, (envs.num_envs, 2)).astype(np.float32)


def in_order(value):
    """With its keys sorted, and its numbers as Python has them."""
    if isinstance(value, dict):
        return {key: in_order(part) for key, part in sorted(value.items())}
    if isinstance(value, np.ndarray) and value.dtype == object:
        return [in_order(part) for part in value]
    return value.item() if isinstance(value, np.generic) else value


@pytest.mark.parametrize(
    ("case", "mode"),
    [*((case, AutoresetMode.NEXT_STEP) for case in CASES), ("explore, twists", AutoresetMode.SAME_STEP),
     ("relocate", AutoresetMode.SAME_STEP)],
)  # fmt: skip
def test_worlds_are_those_of_gymnasium_s_own_vector_over_autoresets(case, mode) -> None:
    name, options = CASES[case]
    steps = 80 if case == "associate" else 24
    sync = gym.vector.SyncVectorEnv([partial(in_any_process, name, **options)] * 2, autoreset_mode=mode)
    theirs = vector_rollout(sync, steps)
    ours = vector_rollout(many(name, autoreset_mode=mode, **options), steps)
    assert case == "associate, log" or sum(step[2].any() for step in theirs[1:]) >= 1, "no autoreset was tried"
    for one, other in zip(ours, theirs, strict=True):
        assert not differences([in_order(part) for part in one], [in_order(part) for part in other])


@pytest.fixture(scope="module")
def spread():
    """Three worlds in two processes."""
    name, options = CASES["explore, goals"]
    envs = many(name, 3, workers=2, **options)
    yield envs
    envs.close()


def test_worlds_in_other_processes_are_those_of_this_one(spread) -> None:
    name, options = CASES["explore, goals"]
    here, rng, ended = many(name, 3, workers=0, **options), np.random.default_rng(0), 0
    one, other = here.reset(seed=5), spread.reset(seed=5)
    for _ in range(24):
        assert not differences(one, other)
        actions = legal(here, rng)
        np.testing.assert_array_equal(here.action_masks(), spread.action_masks())
        one, other = here.step(actions), spread.step(actions)
        ended += int(one[2].any())
    assert ended, "no autoreset was tried"
    assert not differences(here.call("snapshot"), spread.call("snapshot"))


def test_worlds_can_be_asked_for_and_are_numbered_in_errors(spread) -> None:
    spread.reset(seed=5, options={"world": [1, 2, 3]})
    assert [snapshot.options for snapshot in spread.call("snapshot")] == [{"world": k} for k in (1, 2, 3)]
    spread.set_attr("nickname", ["a", "b", "c"])
    assert spread.get_attr("nickname") == ("a", "b", "c")
    spread.set_attr("nickname", 7)
    assert spread.get_attr("nickname") == (7, 7, 7)
    assert spread.get_attr("np_random_seed") == (5, 6, 7)
    for wrong in (partial(spread.set_attr, "nickname", [1, 2]), partial(spread.reset, options={"world": [1]})):
        with pytest.raises(ValueError, match=r"values for 3 worlds"):
            wrong()
    for wrong in (partial(spread.call, "no_such_thing"), partial(spread.reset, options={"world": [0, -1, 0]})):
        with pytest.raises(WorldError, match="world"):
            wrong()
    spread.reset(seed=5)  # none of these did any harm
    spread.step(legal(spread, np.random.default_rng(0)))
    masks, _ = spread.action_masks(), spread.call("restore", spread.call("snapshot")[0])
    assert (masks != masks[0]).any() and (spread.action_masks() == masks[0]).all()


def test_without_autoreset_an_ended_world_is_reset_by_hand_and_alone() -> None:
    envs = many("Explore-v0", scenario=short(12), action="twist", autoreset_mode=AutoresetMode.DISABLED)
    alone = bare("Explore-v0", scenario=short(12), action="twist")
    envs.reset(seed=3)
    alone.reset(seed=4)
    for _ in range(2):
        envs.step(np.zeros((2, 2)))
        alone.step(np.zeros(2))
    mask = np.array([False, True])
    with pytest.raises(ValueError, match="the first reset is of all worlds"):
        small("Explore-v0", scenario=short(10)).reset(options={"reset_mask": mask})
    observations, infos = envs.reset(seed=np.int64(9), options={"reset_mask": mask})
    assert infos["_ticks"].tolist() == [False, True]
    assert not differences({key: part[1] for key, part in observations.items()}, in_order(alone.reset(seed=10)[0]))
    for _ in range(10):
        *_, terminated, _, infos = envs.step(np.zeros((2, 2)))
    assert terminated.tolist() == [True, False]
    with pytest.raises(RuntimeError, match=r"world 0: the episode is over: call reset\(options="):
        envs.step(np.zeros((2, 2)))
    for wrong in (np.zeros(2, bool), np.ones(3, bool), np.ones(2)):
        with pytest.raises(ValueError, match="reset_mask"):
            envs.reset(options={"reset_mask": wrong})
    envs.reset(options={"reset_mask": ~mask})
    assert not envs.step(np.zeros((2, 2)))[2].any()


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_an_episode_that_is_too_long_is_truncated(mode) -> None:
    envs = small("Explore-v0", scenario=short(30), action="twist", max_episode_steps=3, autoreset_mode=mode)
    envs.reset(seed=0)
    for step in range(3):
        *_, terminated, truncated, infos = envs.step(np.zeros((2, 2)))
        assert not terminated.any() and truncated.all() == (step == 2)
    assert ("final_obs" in infos) == (mode is AutoresetMode.SAME_STEP)


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_a_bad_action_is_refused_with_its_world_and_no_world_moves(name) -> None:
    envs, twin = small(name), small(name)
    with pytest.raises(RuntimeError, match=r"call reset\(\) first"):
        envs.step(np.zeros(2, int))
    envs.reset(seed=0), twin.reset(seed=0)
    count = int(envs.single_action_space.n)
    for wrong in ([0, count], [0, -1]):
        with pytest.raises(ValueError, match="world 1: action"):
            envs.step(np.array(wrong))
    for wrong in (0, [0], [0.5, 1.0], [[0], [1]], ["a", "b"]):
        with pytest.raises(ValueError, match="actions"):
            envs.step(wrong)
    with pytest.raises(RuntimeError, match="world 1: Error: Seed"):
        envs.reset(seed=[5, -1])
    actions = legal(envs, np.random.default_rng(0))
    assert not differences(envs.step(actions), twin.step(actions))


def test_a_twist_outside_the_box_is_refused_with_its_world() -> None:
    envs = small("Explore-v0", action="twist")
    envs.reset(seed=0)
    with pytest.raises(ValueError, match="world 1: action"):
        envs.step(np.array([[0.0, 0.0], [np.nan, 0.0]]))
    before = envs.call("snapshot")
    with pytest.raises(WorldError, match=r"world 1: .*-1"):
        envs.reset(options={"world": [5, -1]})
    assert [after.options for after in envs.call("snapshot")] == [own.options for own in before]


@pytest.mark.parametrize("raised", [ZeroDivisionError, KeyboardInterrupt])
@pytest.mark.parametrize("workers", [0, 2])
def test_a_step_that_fails_or_is_interrupted_closes_all_worlds_for_good(workers, raised) -> None:
    parent = os.getpid()

    def failing(scan, prediction):
        failing.calls = getattr(failing, "calls", 0) + 1
        if failing.calls == 4 and (raised is ZeroDivisionError or os.getpid() == parent):
            raise raised("an associator's own mistake")
        return nearest_neighbour(scan, prediction)

    envs = many("Explore-v0", 2, workers, scenario=short(30), action="twist", associator=failing)
    envs.reset(seed=0)
    expected = WorldError if raised is ZeroDivisionError else raised
    with pytest.raises(expected, match="an associator's own mistake"):
        for _ in range(4):
            envs.step(np.full((2, 2), 0.5))
    for call in (partial(envs.step, np.zeros((2, 2))), envs.reset, partial(envs.call, "split")):
        with pytest.raises(ClosedEnvironmentError, match="closed since a step failed"):
            call()
    envs.close()


def test_workers_end_when_they_are_killed_or_their_parent_is(tmp_path) -> None:
    script = tmp_path / "script.py"  # without a guard around its main module, and with an associator of its own
    script.write_text(
        "import os, gymnasium as gym, numpy as np, slam_gym\n"
        "from slam_gym.association import jcbb\n"
        "def mine(scan, prediction):\n"
        "    print('printed by a world')\n"
        "    return jcbb(scan, prediction)\n"
        "envs = gym.make_vec('slam_gym/Explore-v0', num_envs=3, workers=3, scenario='office-small', action='twist',\n"
        "                    associator=mine)\n"
        "envs.reset(seed=0)\n"
        "envs.step(np.zeros((3, 2)))\n"
        "workers = [worker.process for worker in envs._groups[1:]]\n"
        "print('PID', workers[0].pid, flush=True)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    env = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=120, env=env)
    assert done.returncode == -signal.SIGKILL, done.stderr  # its output has ended, so the workers have
    assert "PID" in done.stdout


def test_a_vector_that_is_forgotten_takes_its_workers_along() -> None:
    envs = small("Explore-v0", workers=2)
    worker = envs._groups[1].process
    del envs
    gc.collect()
    assert worker.returncode == 0


def test_a_copy_goes_on_by_itself() -> None:
    envs = small("Explore-v0", action="twist")
    envs.reset(seed=0)
    again = pickle.loads(pickle.dumps(envs))
    for _ in range(3):
        assert not differences(again.step(np.ones((2, 2))), envs.step(np.ones((2, 2))))


def test_workers_know_scenarios_that_were_registered_here(monkeypatch) -> None:
    monkeypatch.setitem(SCENARIOS, "mine", replace(SCENARIOS["hall"], name="mine"))
    assert many("Explore-v0", workers=2, scenario="mine").reset(seed=0)[1]["map_error"].shape == (2,)


def test_a_worker_that_is_killed_is_told_of() -> None:
    envs = small("Explore-v0", action="twist", workers=2)
    envs.reset(seed=0)
    envs._groups[1].process.kill()
    with pytest.raises(RuntimeError, match="a worker process has ended"):
        envs.step(np.zeros((2, 2)))
    with pytest.raises(ClosedEnvironmentError):
        envs.step(np.zeros((2, 2)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"num_envs": 0}, "num_envs: expected a whole number"),
        ({"workers": -1}, "workers: expected a whole number"),
        ({"scenario": "atlantis"}, "atlantis.*office-small"),
        ({"autoreset_mode": "Sometimes"}, "Sometimes"),
    ],
)
def test_bad_arguments_are_refused(options, message) -> None:
    with pytest.raises(ValueError, match=message):
        many("Explore-v0", **{"num_envs": 2} | options)


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_what_is_handed_out_lies_in_its_space_and_may_be_kept(name) -> None:
    envs, twin = small(name), small(name)
    rng, over = np.random.default_rng(0), []
    one, other = envs.reset(seed=0), twin.reset(seed=0)
    for _ in range(6):
        assert envs.observation_space.contains(one[0])
        assert not differences(one, other)
        over.append(one[0])
        actions = legal(twin, rng)
        for array in one[0].values():
            array.fill(1)
        envs.action_masks().fill(False)
        one, other = envs.step(actions), twin.step(actions)
    assert not any(np.shares_memory(a[key], b[key]) for a, b in pairwise(over) for key in a)


def test_pictures_of_all_worlds() -> None:
    pytest.importorskip("pygame")
    envs = small("Explore-v0", render_mode="rgb_array")
    envs.reset(seed=0)
    assert not np.array_equal(*envs.render())


@pytest.mark.parametrize("wrapper", [wrappers.NormalizeReward, wrappers.DictInfoToList, wrappers.FlattenObservation])
def test_wrappers_of_gymnasium_work_on_it(wrapper) -> None:
    sync = gym.vector.SyncVectorEnv([partial(in_any_process, "Explore-v0", scenario=short(4), action="twist")] * 2)
    results = []
    for envs in (wrapper(small("Explore-v0", scenario=short(4), action="twist")), wrapper(sync)):
        results.append([envs.reset(seed=0), *(envs.step(np.full((2, 2), 0.25, np.float32)) for _ in range(6))])
        envs.close()
    for one, other in zip(*results):
        assert not differences([in_order(part) for part in one[:-1]], [in_order(part) for part in other[:-1]])
