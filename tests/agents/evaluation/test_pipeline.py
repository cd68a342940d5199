"""Whatever is evaluated: interrupted and resumed is the same as uninterrupted, and nothing is overwritten."""

import hashlib
import json
import os
import sys
import threading
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import pytest

from agents.evaluation.episodes import Driver, ExploreArguments, associator_evaluation, driver_evaluation
from agents.evaluation.pipeline import Evaluation, Key, Task, carry_out, read_results
from agents.options import Suite
from agents.suite import suite_evaluation
from slam_gym.association.tracking.ppo import INPUTS, SHAPES, VERSION
from slam_gym.weights import load, write
from slam_gym.world.floor_plan_file import save_floor_plan
from slam_gym.world.generators import OfficeGenerator
from tests.agents.evaluation import timeless

NEW, RESUMED = ({"jobs": 1, "resume": resume} for resume in (False, True))
SMALL = ExploreArguments("office-small", (("budget", 60),))


def count(episode, names, fails):
    if fails:
        raise KeyboardInterrupt
    return [{"value": 0.1 + 0.2 * episode, "curve": [1, 2]} for _ in names]


def task(episode, names=("a", "b"), fails=False) -> Task:
    """With one record for each name; some fail, for they are not asked for."""
    return Task([Key(name, "only", episode) for name in names], partial(count, episode, names, fails))


def counting(tasks, **conditions) -> Evaluation:
    return Evaluation("suite", tasks, conditions)


@pytest.mark.parametrize(
    "evaluation",
    [
        lambda: driver_evaluation([Driver("random"), Driver("nearest_frontier")], [SMALL], range(2)),
        lambda: associator_evaluation(["nearest_neighbour", "true_association"], [SMALL], "random", range(2), [None]),
        lambda: suite_evaluation(Suite(True, ["closure"], worlds=1, problems=3), ["jcbb", "singles"], [], "test"),
    ],
)
def test_resumed_is_the_same_as_uninterrupted(tmp_path, evaluation):
    whole = carry_out(evaluation(), tmp_path / "whole", **NEW)
    carry_out(evaluation(), tmp_path / "cut", **NEW)
    frame = pd.read_csv(tmp_path / "cut" / "results.csv")
    frame[:2].to_csv(tmp_path / "cut" / "results.csv", index=False)  # as if it had been interrupted
    resumed = carry_out(evaluation(), tmp_path / "cut", **RESUMED)
    assert resumed.metadata["complete"] and len(resumed.metadata["commands"]) == 2
    assert timeless(resumed.frame) == timeless(whole.frame)


def test_an_interruption_keeps_what_is_finished(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        carry_out(counting([task(0), task(1, fails=True)]), tmp_path, **NEW)
    found = read_results(tmp_path)
    assert list(found.frame["episode"]) == [0, 0] and not found.metadata["complete"]
    again = carry_out(counting([task(0, fails=True), task(1)]), tmp_path, **RESUMED)
    assert list(again.frame["episode"]) == [0, 0, 1, 1] and again.metadata["complete"]


def test_what_was_asked_for_last_comes_first_in_that_order_and_nothing_is_thrown_away(tmp_path):
    carry_out(counting([task(k, ("b", "a")) for k in range(3)]), tmp_path, **NEW)
    again = carry_out(counting([task(1, ("a", "b", "c")), task(3, ("a",))]), tmp_path, **RESUMED)
    first = [("a", 1), ("b", 1), ("c", 1), ("a", 3)]
    assert list(zip(again.frame["name"], again.frame["episode"]))[:4] == first and len(again.frame) == 8
    assert again.names == ["a", "b", "c"] and again.metadata["complete"]


def test_scenarios_on_one_floor_plan_are_told_apart_and_names_stay_what_they_are(tmp_path):
    save_floor_plan(OfficeGenerator(rooms=2)(np.random.default_rng(1)), tmp_path / "two.json")
    loops = [replace(SMALL, scenario=name, floor_plan=str(tmp_path / "two.json")) for name in ("building", "drift-1")]
    keys = [task.keys[0].setting for task in driver_evaluation([Driver("random")], loops, range(1)).tasks]
    assert keys == ["two.json", "two.json as drift-1"]
    named = counting([Task([Key("NA", "null", 0)], partial(count, 0, "a", False))])
    carry_out(named, tmp_path / "out", **NEW)
    frame = carry_out(named, tmp_path / "out", **RESUMED).frame
    assert frame[["name", "setting", "model"]].to_numpy().tolist() == [["NA", "null", ""]]


@pytest.mark.parametrize("program", [["slam-gym", "evaluate"], ["agents/evaluate.py"]])
def test_csv_and_json_say_what_was_run(tmp_path, monkeypatch, program):
    monkeypatch.setattr(sys, "argv", [*program, "--episodes", "2"])
    results = carry_out(counting([task(0)], split="test"), tmp_path, **NEW)
    frame = pd.read_csv(tmp_path / "results.csv")
    assert list(frame.columns) == ["name", "setting", "episode", "model", "value", "curve"]
    assert list(frame["value"]) == [0.1, 0.1] and json.loads(frame["curve"][0]) == [1, 2]
    told = json.loads((tmp_path / "results.json").read_text(), parse_constant=lambda name: pytest.fail(name))
    assert told == results.metadata and told["conditions"]["split"] == "test"
    assert told["commands"][0]["command"] == "slam-gym evaluate --episodes 2"
    assert {"slam_gym", "commit"} <= set(told["versions"])


def test_a_folder_belongs_to_one_evaluation(tmp_path):
    carry_out(counting([task(0)], split="test"), tmp_path / "own", **NEW)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").write_text("mine")
    for folder, changed, how, said in (
        ("own", {"split": "test"}, NEW, "give --resume"),
        ("own", {"split": "train"}, RESUMED, r"another command \(split 'test', not 'train'\)"),
        ("other", {"split": "test"}, NEW, "is not empty"),
        ("new", {"split": "test"}, RESUMED, "no evaluation to resume"),
    ):
        with pytest.raises(ValueError, match=said):
            carry_out(counting([task(1)], **changed), tmp_path / folder, **how)
    assert not (tmp_path / "new").exists() and len(list((tmp_path / "other").iterdir())) == 1


PACKAGE = "own_rule/__init__.py"


@pytest.mark.parametrize("file", ["own.npz", PACKAGE])
def test_a_model_or_module_that_has_changed_is_not_resumed(tmp_path, monkeypatch, file):
    monkeypatch.syspath_prepend(tmp_path)
    write(tmp_path / "own.npz", load("ppo", VERSION, INPUTS, SHAPES))
    (tmp_path / "own_rule").mkdir()
    (tmp_path / "own_rule" / "__init__.py").write_text("from slam_gym.association import jcbb")
    names = ["own_rule:jcbb" if file == PACKAGE else str(tmp_path / file)]
    carry_out(associator_evaluation(names, [SMALL], "random", range(1), [None]), tmp_path / "out", **NEW)
    carry_out(associator_evaluation(["jcbb"], [SMALL], "random", range(1), [None]), tmp_path / "out", **RESUMED)
    (tmp_path / file).open("ab").write(b"  # more")
    with pytest.raises(ValueError, match=r"own.* is not the file of which .*out holds results"):
        carry_out(associator_evaluation(names, [SMALL], "random", range(2), [None]), tmp_path / "out", **RESUMED)
    driven = driver_evaluation([Driver("random")], [replace(SMALL, associator=names[0])], range(1))
    assert driven.about["models"][names[0]]["sha256"] == hashlib.sha256((tmp_path / file).read_bytes()).hexdigest()


def test_a_folder_without_results_is_refused_by_name(tmp_path):
    with pytest.raises(ValueError, match=str(tmp_path)):
        read_results(tmp_path)
    with pytest.raises(ValueError, match="no finished episode yet"):
        carry_out(counting([]), tmp_path, **NEW)


WRONG = {
    "results.json": (
        "", "[]", "3", "{}", "[" * 100_000, "\xff", '{"kind": NaN}', {"kind": "others"}, {"kind": ["suite"]},
        {"commands": 3}, {"conditions": None}, {"versions": []}, {"models": []}, {"models": {"a": {}}},
    ),
    "results.csv": ("", "\x00\xff", "a,b\n1,2\n", "name,setting,episode,model\na,only,x,\n", 'name,"\n',
                    "name,setting,episode,model\na,only,1,\na,only,1,\n"),
}  # fmt: skip


@pytest.mark.parametrize(("file", "content"), [(file, content) for file in WRONG for content in WRONG[file]])
def test_damaged_results_are_refused_by_the_name_of_their_file(tmp_path, file, content):
    told = carry_out(counting([task(0)]), tmp_path, **NEW).metadata
    content = json.dumps(told | content) if isinstance(content, dict) else content
    (tmp_path / file).write_bytes(content.encode("latin-1"))
    with pytest.raises(ValueError, match=file):
        read_results(tmp_path)
    with pytest.raises(ValueError, match=file):
        carry_out(counting([task(0)]), tmp_path, **RESUMED)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs a disk that is full")
@pytest.mark.parametrize("file", WRONG)
def test_a_full_disk_is_told_with_the_file_and_leaves_the_old_one_whole(tmp_path, file):
    carry_out(counting([task(0)]), tmp_path, **NEW)
    before = (tmp_path / file).read_bytes()
    (tmp_path / f".{file}.{os.getpid()}-{threading.get_ident()}").symlink_to("/dev/full")
    with pytest.raises(OSError, match=rf"No space left on device: .*{file}'"):
        carry_out(counting([task(0), task(1)]), tmp_path, **RESUMED)
    assert (tmp_path / file).read_bytes() == before
