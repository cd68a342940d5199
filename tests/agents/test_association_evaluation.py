"""Evaluating associators end to end: paired episodes, resumable, and table, files and report that agree."""

import base64
import csv
import json
import math
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from rich.console import Console

from agents.drivers.base import make_agent
from agents.evaluate_association import main, show
from agents.evaluation import associators as module
from agents.evaluation.associators import carry_out, gated, paired, row, shipped, short
from agents.evaluation.drives import COLUMNS, Course, Drive, Metered, drives
from agents.evaluation.drives import tables as drive_tables
from agents.evaluation.results import Journal
from agents.evaluation.rollout import Setting, reset_arguments, run_episode
from agents.reports.associators import best_of
from agents.suite.run import World
from agents.suite.run import tables as suite_tables
from slam_gym.association import ASSOCIATORS, jcbb, nearest_neighbour
from slam_gym.envs.explore import ExploreEnv
from slam_gym.metrics.statistics import Interval, interquartile_mean
from slam_gym.types import Effort, Hypothesis

QUIET = Console(quiet=True)
NAMES = ("nearest_neighbour", "true_association")
COURSE = Course("office-small")
FIXED = {"driver": "nearest_frontier"}
TIMES = ("seconds", "ticks_per_second", "microseconds", "microseconds_p99")


def timeless(records) -> str:
    """Records without what depends on how busy the machine is, NaN made comparable."""
    return json.dumps([{key: value for key, value in record.items() if key not in TIMES} for record in records])


def driven(out, tasks=None, **options):
    tasks = drives(NAMES, [COURSE], 2) if tasks is None else tasks
    return carry_out(
        tasks, out, FIXED, lambda records: {"table": drive_tables(records, NAMES, ["office-small"])}, jobs=1,
        console=QUIET, **options,
    )  # fmt: skip


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    out = tmp_path_factory.mktemp("association") / "whole"
    return out, driven(out, command="python -m agents.evaluate_association")


def test_every_associator_meets_the_same_episodes(finished):
    _, records = finished
    assert [(r["associator"], r["episode"]) for r in records] == [(name, k) for k in range(2) for name in NAMES]
    assert {record["setting"] for record in records} == {"office-small"}
    assert {record["ticks"] for record in records} == {300.0}


def test_true_association_makes_no_mistake_in_the_loop(finished):
    for record in finished[1]:
        truth = record["associator"] == "true_association"
        for key in ("precision", "recall", "f1", "exact"):
            assert record[key] == 1.0 if truth else 0.3 < record[key] < 1.0
        assert math.isnan(record["nodes"]) == truth and math.isnan(record["microseconds"]) == truth
        assert record["tp"] + record["fn"] <= record["in_map"]
        assert record["precision"] == record["tp"] / (
            record["tp"] + record["fp_wrong"] + record["fp_spurious"] + record["fp_duplicate"]
        )


def test_the_meter_changes_nothing_and_counts_every_scan(finished):
    _, records = finished
    env = Setting("office-small", "nearest_neighbour").make("goal")
    plain = run_episode(env, make_agent("nearest_frontier"), 1)
    metered = next(r for r in records if r["associator"] == "nearest_neighbour" and r["episode"] == 1)
    for key in ("map_error", "precision", "recall", "anees", "duplicates", "ate", "decisions"):
        assert plain[key] == metered[key]
    calls = []

    def associate(scan, prediction):
        calls.append(len(scan))
        return Hypothesis(*nearest_neighbour(scan, prediction).features[None], 0.0, 0, Effort(nodes=7, limit_hit=True))

    meter = Metered(associate)
    env = ExploreEnv("office-small", associator=meter, action="twist")
    env.reset(**reset_arguments(0))
    for _ in range(3):
        env.step(np.zeros(2, np.float32))
    assert meter.nodes == [7] * len(calls) and meter.limits == len(meter.seconds) == len(calls) == 4
    meter.reset()
    assert not meter.nodes and not meter.limits


def test_associators_that_ship_are_told_the_gates_and_others_are_left_alone():
    assert gated("jcbb", 0.9).keywords == {"confidence": 0.9} and gated("jcbb", 0.9).func is jcbb
    assert gated("slam_gym.association.tracking.jcbb:jcbb", 0.9).func is jcbb
    assert gated("true_association", 0.9) is ASSOCIATORS["true_association"]
    assert gated(f"{__name__}:mine", 0.9) is mine
    assert set(shipped()) == set(ASSOCIATORS) and shipped()[0] == "nearest_neighbour"
    assert shipped()[-1] == "true_association"


def mine(scan, prediction):
    """An associator of a user: nearest neighbour with a narrow gate."""
    return nearest_neighbour(scan, prediction, confidence=0.5)


@pytest.mark.parametrize("kind", ["drives", "suite"])
def test_interrupted_and_resumed_is_the_same_as_uninterrupted(finished, tmp_path, monkeypatch, kind):
    suite = [World("closure/1", k, ("jcbb", "singles"), 3) for k in range(3)]
    run = driven if kind == "drives" else suite_run
    whole = finished[1] if kind == "drives" else run(tmp_path / "whole", suite)
    out, run_all = tmp_path / "cut", module.run_all

    def interrupted(*arguments):
        for done, records in enumerate(run_all(*arguments)):
            yield records
            if done == 1:
                raise KeyboardInterrupt

    monkeypatch.setattr(module, "run_all", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run(out, None if kind == "drives" else suite)
    monkeypatch.undo()
    kept = json.loads((out / "results.json").read_text())
    assert not kept["complete"] and 0 < len(Journal(out / "records.jsonl").read()) < len(whole)
    with (out / "records.jsonl").open("a") as file:
        file.write('{"associator": "jcb')  # as a crash would leave it
    assert timeless(run(out, None if kind == "drives" else suite, resume=True)) == timeless(whole)
    results = json.loads((out / "results.json").read_text())
    assert results["complete"] and len(results["commands"]) == 2


def suite_run(out, tasks, **options):
    return carry_out(tasks, out, {"suite": True}, suite_tables, jobs=1, console=QUIET, **options)


def test_more_associators_can_be_added_to_an_evaluation(tmp_path):
    first = suite_run(tmp_path / "grown", [World("density/1", 0, ("singles",), 3)])
    grown = suite_run(tmp_path / "grown", [World("density/1", 0, ("singles", "jcbb"), 3)], resume=True)
    assert [record["associator"] for record in grown] == ["singles", "jcbb"] and grown[0] == first[0]


def test_two_processes_find_the_same_as_one(tmp_path):
    tasks = [World("clutter/1", k, NAMES, 3) for k in range(2)]
    one = suite_run(tmp_path / "one", tasks)
    two = carry_out(tasks, tmp_path / "two", {"suite": True}, suite_tables, jobs=2, console=QUIET)
    assert timeless(one) == timeless(two)


def test_table_csv_and_json_agree(finished, capsys):
    out, records = finished
    with (out / "records.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(line["map_error"]) for line in rows] == [record["map_error"] for record in records]
    results = json.loads((out / "results.json").read_text(), parse_constant=lambda name: pytest.fail(name))
    assert results["complete"] and {"slam_gym", "numpy", "commit"} <= set(results["versions"])
    for name in NAMES:
        own = [record for record in records if record["associator"] == name]
        for key in ("precision", "f1", "duplicates", "map_error", "anees"):
            told = results["table"]["office-small"][name][key]
            assert told["estimate"] == pytest.approx(interquartile_mean(np.array([r[key] for r in own])))
            assert told["low"] <= told["estimate"] <= told["high"]
    assert results["table"]["office-small"]["true_association"]["nodes"]["estimate"] is None
    found = row(records, "nearest_neighbour", None, COLUMNS)
    columns = [(column.title, column.digits) for column in COLUMNS]
    for width in (80, 160):
        console = Console(width=width)
        show({"nearest_neighbour": [found[c.key] for c in COLUMNS]}, columns, "office-small", console)
        text = capsys.readouterr().out
        told = results["table"]["office-small"]["nearest_neighbour"]
        assert max(map(len, text.splitlines())) <= width and "neighbour" in text
        for key in ("precision", "recall", "map_error"):
            assert f"{told[key]['estimate']:.{2 if width == 80 else 3}f}" in text


def test_differences_are_paired_over_episodes_and_settings():
    records = [
        {"associator": name, "setting": setting, "episode": k, "f1": base + 0.1 * k + (0.05 if name == "a" else 0.0)}
        for name in ("a", "b") for setting, base in (("x", 0.0), ("y", 0.5)) for k in range(4)
    ]  # fmt: skip
    gap = paired(records, "a", "b", "f1")
    assert (gap.estimate, gap.low, gap.high) == pytest.approx((0.05, 0.05, 0.05))
    assert paired(records[:-1], "a", "b", "f1", "y").estimate == pytest.approx(0.05)
    assert math.isnan(paired(records, "a", "c", "f1").estimate)


def test_the_ceiling_is_never_the_best():
    found = {"a": Interval(0.5, 0.4, 0.6), "b": Interval(0.9, 0.8, 0.95), "true_association": Interval(1.0, 1.0, 1.0)}
    assert best_of(found, "higher") == {"b"} and best_of(found, "lower") == {"a"} and best_of(found, "") == set()
    assert best_of(found | {"c": Interval(0.85, 0.7, 0.9)}, "higher") == {"b", "c"}


def test_another_evaluation_is_not_overwritten(finished):
    out, _ = finished
    before = (out / "records.jsonl").read_bytes()
    with pytest.raises(ValueError, match="--resume"):
        driven(out)
    with pytest.raises(ValueError, match="driver 'nearest_frontier', not 'lawnmower'"):
        carry_out([], out, {"driver": "lawnmower"}, dict, jobs=1, resume=True, console=QUIET)
    with pytest.raises(ValueError, match=r"elsewhere holds no evaluation to resume"):
        driven(out.parent / "elsewhere", resume=True)
    assert (out / "records.jsonl").read_bytes() == before


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (["--associators", "nn"], r"nn.*jcbb.*nearest_neighbour"),
        (["--associators", "nowhere.pt"], r"nowhere\.pt"),
        (["--scenarios", "offic"], r"unknown scenario 'offic'.*office-small.*closure/…"),
        (["--scenarios", "closure/9"], r"closure/9.*closure/0 … closure/4"),
        (["--driver", "nobody"], r"nobody.*nearest_frontier"),
        (["--driver", "ppo"], r"ppo"),
        (["--relocation", "gps"], r"gps.*gcbb"),
        (["--episodes", "0"], r"--episodes.*at least 1"),
        (["--suite", "--worlds", "0"], r"--worlds.*at least 1"),
        (["--suite", "--experiments", "fog"], r"fog.*closure"),
        (["--suite", "--relocators", "gps"], r"gps.*gcbb"),
        (["--resume", "--out", "nowhere"], r"nowhere.*resume"),
    ],
)
def test_bad_input_is_told_in_one_line_that_names_it(tmp_path, monkeypatch, line, said):
    monkeypatch.chdir(tmp_path)
    with pytest.raises((ValueError, FileNotFoundError)) as caught:
        main(line + ([] if "--out" in line else ["--out", "out"]))
    assert re.search(said, str(caught.value)) and "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


class Checker(HTMLParser):
    """Collects links and text, and fails where tags do not match."""

    def __init__(self):
        super().__init__()
        self.open, self.links, self.text = [], [], []

    def handle_starttag(self, tag, attributes):
        self.links += [value for name, value in attributes if name in ("src", "href", "poster")]
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def checked(path) -> tuple[str, int]:
    """Text and number of pictures of a page that is well-formed and needs nothing from outside."""
    page = Checker()
    page.feed(path.read_text(encoding="utf-8"))
    assert not page.open
    for link in page.links:
        assert base64.b64decode(link.removeprefix("data:image/png;base64,")).startswith(b"\x89PNG")
    return " ".join(" ".join(page.text).split()), len(page.links)


def test_the_command_in_the_loop(tmp_path, capsys):
    own = f"{__name__}:mine"
    line = ["--associators", own, "true_association", "--scenarios", "office-small", "--episodes", "2", "--jobs", "1"]
    assert main([*line, "--out", str(tmp_path / "out")]) == 0
    text, pictures = checked(tmp_path / "out" / "report.html")
    assert pictures == 1
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    told = results["table"]["office-small"][own]
    for expected in ("mine", "true association", "Against mine", f"{told['recall']['estimate']:.3f}", "--episodes 2"):
        assert expected in text
    assert told["precision"]["estimate"] > 0.5 and "mine" in capsys.readouterr().out


def test_the_command_of_the_suite_ranks_with_reasons_from_its_own_numbers(tmp_path, capsys):
    out = tmp_path / "out"
    line = [
        "--suite",
        "--quick",
        "--experiments",
        "closure",
        "density",
        "kidnapped",
        "--worlds",
        "2",
        "--problems",
        "4",
    ]
    line += ["--associators", "nearest_neighbour", "jcbb", "true_association", "--jobs", "1", "--out", str(out)]
    assert main([*line, "--relocators", "gcbb"]) == 0
    text, pictures = checked(out / "report.html")
    assert pictures >= 5 and (out / "suite.png").read_bytes().startswith(b"\x89PNG")
    results = json.loads((out / "results.json").read_text())
    numbers, relocation = results["numbers"], results["relocation"]
    for of in (*numbers.values(), {"kidnapped": relocation["gcbb"]["kidnapped"]}):
        assert all(0.0 <= value["low"] <= value["estimate"] <= value["high"] <= 1.0 for value in of.values())
    assert [value["estimate"] for value in numbers["true_association"].values()] == [1.0] * 3
    assert numbers["jcbb"]["all"]["estimate"] > numbers["nearest_neighbour"]["all"]["estimate"]
    order = [text.index(f"{name} (") for name in ("true association", "jcbb", "nearest neighbour")]
    assert order == sorted(order)
    assert f"jcbb ({numbers['jcbb']['all']['estimate']:.2f})" in text.replace(" )", ")")
    assert re.search(r"It spoils \d+% of the scans with a wrong pairing, and refuses \d+% of what is mapped", text)
    assert "Ahead of nearest neighbour by" in text or "Not told apart from nearest neighbour" in text
    shown = capsys.readouterr().out
    assert f"{numbers['jcbb']['closure']['estimate']:.2f}"[:4] in shown and "kidnapped" in shown


def test_names_in_tables_are_short():
    assert short("a.b:my_way") == "my way" and short("/x/y/branches.pt") == "branches.pt" and short("jcbb") == "jcbb"


def test_a_level_of_the_suite_can_be_driven_too():
    record = Drive("jcbb", Course("clutter/1", "random"), 0)
    assert record.course.scenario.sensor.clutter == 3.0 and record.keys == (("jcbb", "clutter/1", 0),)
