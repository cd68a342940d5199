"""Whatever is evaluated: interrupted and resumed is the same as uninterrupted, and nothing is overwritten."""

import csv
import json

import pytest
from filelock import FileLock
from rich.console import Console

from agents.evaluation import pipeline
from agents.evaluation.associators import associator_evaluation
from agents.evaluation.drivers import Driver, driver_evaluation
from agents.evaluation.episodes import ExploreArguments
from agents.evaluation.pipeline import SUITE, Evaluation, Execution, carry_out, read_results
from agents.evaluation.records import Key
from agents.suite.worlds import SuiteSize, suite_evaluation
from tests.agents.evaluation import timeless

QUIET = Console(quiet=True)
SMALL = ExploreArguments("office-small")


def drivers() -> Evaluation:
    return driver_evaluation([Driver("random"), Driver("nearest_frontier")], SMALL, range(2))


def associators() -> Evaluation:
    return associator_evaluation(["nearest_neighbour", "true_association"], [SMALL], "nearest_frontier", range(2))


def suite() -> Evaluation:
    return suite_evaluation(["jcbb", "singles"], [], ["closure"], SuiteSize(worlds=1, problems=3, quick=True))


class Counting:
    """A task that yields one record for each name, and counts nothing but its own runs."""

    def __init__(self, episode, names=("a", "b")):
        self.episode, self.names = episode, names

    @property
    def keys(self):
        return tuple(Key(name, "here", self.episode) for name in self.names)

    def run(self, wanted):
        return [
            {"associator": key.name, "setting": "here", "episode": self.episode, "asked": len(wanted)} for key in wanted
        ]


def counting(tasks, **conditions) -> Evaluation:
    return Evaluation(SUITE, tasks, conditions, lambda records: {"count": len(records)})


def interrupt(monkeypatch, after):
    """The next evaluation is interrupted after so many tasks."""
    run_all = pipeline.run_all

    def interrupted(*arguments):
        for done, records in enumerate(run_all(*arguments), 1):
            yield records
            if done == after:
                raise KeyboardInterrupt

    monkeypatch.setattr(pipeline, "run_all", interrupted)


@pytest.mark.parametrize("kind", [drivers, associators, suite])
def test_interrupted_and_resumed_is_the_same_as_uninterrupted(tmp_path, monkeypatch, kind):
    evaluation, out = kind(), tmp_path / "cut"
    whole = carry_out(evaluation, tmp_path / "whole", Execution(console=QUIET))
    interrupt(monkeypatch, 2)
    with pytest.raises(KeyboardInterrupt):
        carry_out(evaluation, out, Execution(console=QUIET))
    monkeypatch.undo()
    journal = out / f"{evaluation.kind.stem}.jsonl"
    kept = json.loads((out / "results.json").read_text())
    assert not kept["complete"] and 0 < len(read_results(out).records) < len(whole.records)
    with journal.open("a") as file:
        file.write('{"agent": "random", "epis')  # as a crash would leave it
    resumed = carry_out(evaluation, out, Execution(resume=True, console=QUIET))
    assert timeless(resumed.records) == timeless(whole.records)
    assert resumed.content["complete"] and len(resumed.content["commands"]) == 2
    for name in ("table", "numbers"):
        ours, theirs = (json.dumps(results.content.get(name)) for results in (resumed, whole))
        drop = ("seconds", "microseconds", "ticks_per_second")
        assert any(word in theirs for word in drop) or ours == theirs


def test_what_is_done_is_left_out_of_a_task_and_more_can_be_added(tmp_path):
    carry_out(counting([Counting(0, ("a",))]), tmp_path, Execution(console=QUIET))
    grown = carry_out(counting([Counting(0), Counting(1)]), tmp_path, Execution(resume=True, console=QUIET))
    found = {(record["associator"], record["episode"]): record["asked"] for record in grown.records}
    assert found == {("a", 0): 1, ("b", 0): 1, ("a", 1): 2, ("b", 1): 2}
    assert grown.names == ["a", "b"] and grown.content["count"] == 4
    shrunk = carry_out(counting([Counting(0)]), tmp_path, Execution(resume=True, console=QUIET))
    assert len(shrunk.records) == 2 and shrunk.content["complete"]


def test_other_worlds_are_added_beside_those_that_are_there(tmp_path):
    carry_out(counting([Counting(0), Counting(1)]), tmp_path, Execution(console=QUIET))
    later = carry_out(counting([Counting(201), Counting(200)]), tmp_path, Execution(resume=True, console=QUIET))
    assert later.content["asked"]["first"] == 200 and later.content["asked"]["episodes"] == 2
    assert sorted({record["episode"] for record in later.records}) == [200, 201] and later.content["complete"]
    again = carry_out(counting([Counting(1), Counting(0)]), tmp_path, Execution(resume=True, console=QUIET))
    assert sorted({record["episode"] for record in again.records}) == [0, 1]


def test_two_processes_find_the_same_as_one(tmp_path):
    one, two = (carry_out(suite(), tmp_path / str(jobs), Execution(jobs, console=QUIET)) for jobs in (1, 2))
    assert timeless(one.records) == timeless(two.records)


def test_another_evaluation_is_not_overwritten(tmp_path):
    out, tasks = tmp_path / "out", [Counting(0)]
    carry_out(counting(tasks, driver="random"), out, Execution(console=QUIET))
    before = (out / "records.jsonl").read_bytes()
    with pytest.raises(ValueError, match="--resume"):
        carry_out(counting(tasks, driver="random"), out, Execution(console=QUIET))
    with pytest.raises(ValueError, match="driver 'random', not 'lawnmower'"):
        carry_out(counting(tasks, driver="lawnmower"), out, Execution(resume=True, console=QUIET))
    with pytest.raises(ValueError, match="an evaluation of suite, not of drivers"):
        carry_out(Evaluation(pipeline.DRIVERS, [], {}, dict), out, Execution(resume=True, console=QUIET))
    with pytest.raises(ValueError, match=r"elsewhere holds no evaluation to resume"):
        carry_out(counting(tasks), tmp_path / "elsewhere", Execution(resume=True, console=QUIET))
    assert (out / "records.jsonl").read_bytes() == before


def test_one_evaluation_at_a_time_writes_to_a_folder(tmp_path):
    with FileLock(tmp_path / ".lock"), pytest.raises(ValueError, match=r"another evaluation is being written to"):
        carry_out(counting([Counting(0)]), tmp_path, Execution(console=QUIET))
    assert not (tmp_path / "records.jsonl").exists()
    assert carry_out(counting([Counting(0)]), tmp_path, Execution(console=QUIET)).content["complete"]


def test_csv_and_json_say_what_was_run(tmp_path):
    results = carry_out(counting([Counting(0)], split="test"), tmp_path, Execution(command="as typed", console=QUIET))
    with (tmp_path / "records.csv").open() as file:
        assert [row["associator"] for row in csv.DictReader(file)] == ["a", "b"]
    told = json.loads((tmp_path / "results.json").read_text(), parse_constant=lambda name: pytest.fail(name))
    assert told == results.content
    assert (told["kind"], told["conditions"], told["count"]) == ("suite", {"split": "test"}, 2)
    assert told["commands"][0]["command"] == "as typed" and {"slam_gym", "commit"} <= set(told["versions"])


def test_a_folder_without_evaluation_is_refused_by_name(tmp_path):
    with pytest.raises(ValueError, match=str(tmp_path)):
        read_results(tmp_path)
    with pytest.raises(ValueError, match="no finished episode yet"):
        carry_out(counting([]), tmp_path, Execution(console=QUIET))
