"""Associators in the loop: metered without a change, the truth for the one known by name alone; the headline."""

import math

import numpy as np
import pandas as pd
import pytest

from agents.drivers.base import make_agent
from agents.evaluation.associators import Metered
from agents.evaluation.episodes import ExploreArguments, associator_evaluation, reset_arguments, run_episode
from agents.evaluation.pipeline import carry_out
from agents.evaluation.tables import grouped
from agents.reports.pages import headline
from slam_gym.association import nearest_neighbour
from slam_gym.envs.explore import ExploreEnv
from slam_gym.types import Effort, Hypothesis

NAMES = ["nearest_neighbour", "true_association"]
SMALL = ExploreArguments("office-small")


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    evaluation = associator_evaluation(NAMES, [SMALL], "nearest_frontier", range(2), [None])
    return carry_out(evaluation, tmp_path_factory.mktemp("associators"), jobs=1)


def test_every_associator_meets_the_same_episodes_and_the_truth_makes_no_mistake(finished):
    frame = finished.frame
    assert list(zip(frame["name"], frame["episode"])) == [(name, k) for k in range(2) for name in NAMES]
    assert set(frame["setting"]) == {"office-small"} and set(frame["ticks"]) == {300}
    for row in frame.to_dict("records"):
        truth = row["name"] == "true_association"
        for key in ("precision", "recall", "f1", "exact"):
            assert row[key] == 1.0 if truth else 0.3 < row[key] < 1.0
        assert math.isnan(row["nodes"]) == truth and math.isnan(row["microseconds"]) == truth
        pairings = row["tp"] + row["fp_wrong"] + row["fp_spurious"] + row["fp_duplicate"]
        assert row["precision"] == row["tp"] / pairings and row["tp"] + row["fn"] <= row["in_map"]


def test_the_meter_changes_nothing_and_counts_every_scan(finished):
    plain = run_episode(
        ExploreArguments("office-small", associator="nearest_neighbour", relocation=None).make("goal"),
        make_agent("nearest_frontier"),
        1,
    )
    own = grouped(finished.frame, "name")["nearest_neighbour"].iloc[1]
    for key in ("map_error", "precision", "recall", "anees", "duplicates", "ate", "decisions"):
        assert plain[key] == own[key]

    def associate(scan, prediction):
        return Hypothesis(nearest_neighbour(scan, prediction).features, 0.0, 0, Effort(nodes=7, limit_hit=True))

    meter = Metered(associate)
    env = ExploreEnv("office-small", associator=meter, action="twist")
    env.reset(**reset_arguments(0))
    for _ in range(3):
        env.step(np.zeros(2, np.float32))
    assert [(nodes, limit) for nodes, _, limit in meter.calls] == [(7, True)] * 4
    assert meter.effort()["nodes"] == 7.0 and meter.effort()["limits"] == 4.0
    meter.reset()
    assert math.isnan(meter.effort()["nodes"])


# -- the headline ------------------------------------------------------------------------------------------------------

GAP = {"jcbb": 0.3, "jcbb + gcbb": 0.1, "true_association": 0.0, "true_association + gcbb": 0.05}


@pytest.fixture(scope="module")
def frame():
    """Worlds differ more than associators do; jcbb without relocation loses the last of ten."""
    rng = np.random.default_rng(0)
    rows = []
    for setting in ("drift-1", "loop"):
        worlds = rng.uniform(0.1, 0.4, 10)
        for name, gap in GAP.items():
            for episode, base in enumerate(worlds):
                lost = float(name == "jcbb" and episode == 9)
                about = {"name": name, "setting": setting, "model": "", "episode": episode}
                rows.append(about | {"map_lost": lost, "map_error_aligned": base + gap, "map_error": 2.0 * base})
    return pd.DataFrame(rows)


def test_means_and_lost_maps_are_those_of_the_episodes(frame):
    _, errors = headline(frame)
    assert [column.key for column in errors.columns] == ["drift-1", "loop", "mean", "map_error", "map_lost"]
    for name, row in errors.rows.items():
        own = grouped(frame, "name")[name]
        assert row["drift-1"].estimate == pytest.approx(grouped(own, "setting")["drift-1"]["map_error_aligned"].mean())
        assert row["mean"].estimate == pytest.approx(own["map_error_aligned"].mean())
        assert row["map_error"].estimate == pytest.approx(own["map_error"].mean())
        assert row["mean"].low < row["mean"].estimate < row["mean"].high
        assert row["map_lost"].estimate == (2 / 20 if name == "jcbb" else 0.0)
    assert not errors.bold["mean"] & {"true_association", "true_association + gcbb"}


def test_gaps_are_paired_with_the_truth_of_the_same_relocation(frame):
    gaps, _ = headline(frame)
    assert list(gaps.rows) == ["jcbb", "jcbb + gcbb"] and gaps.differences
    for name, expected in (("jcbb", 0.3), ("jcbb + gcbb", 0.05)):
        for value in gaps.rows[name].values():  # worlds cancel: no interval is left
            assert (value.low, value.estimate, value.high) == pytest.approx((expected,) * 3)
    assert len(headline(frame[frame["name"] == "jcbb"])) == 1  # without the truth there are no gaps
