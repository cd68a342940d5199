"""Numbers of the suite: means over levels, then over worlds."""

import math

import numpy as np
import pandas as pd
import pytest

from agents.reports.pages import by_world, leads, relocations, scores
from agents.suite import OUTCOMES, promised
from slam_gym.types import UNPAIRED, Effort, Hypothesis, Posterior


def results(numbers: dict[str, dict[str, list[list[float]]]], **more) -> pd.DataFrame:
    """name → experiment → (levels, worlds) of scores."""
    return pd.DataFrame([
        {"name": name, "experiment": e, "setting": f"{e}/{i}", "knob": float(i), "episode": w, "score": score, **more}
        for name, experiments in numbers.items()
        for e, levels in experiments.items()
        for i, row in enumerate(levels)
        for w, score in enumerate(row)
    ])  # fmt: skip


def test_numbers_are_means_over_levels_then_over_worlds():
    frame = results({
        "b": {"closure": [[0.9, 0.7], [0.5, 0.3]], "clutter": [[0.4, 0.4], [0.0, 0.2]]},
        "a": {"closure": [[1.0, 0.8], [0.6, 0.4]], "clutter": [[0.5, 0.5], [0.1, 0.3]]},
    })  # fmt: skip
    worlds = by_world(frame)
    assert worlds.loc["a", "closure"].to_dict() == pytest.approx({0: 0.8, 1: 0.6})
    assert worlds.loc["a", "all"].to_dict() == pytest.approx({0: 0.55, 1: 0.5})
    found = scores(frame)
    assert list(found) == ["a", "b"] and list(found["a"]) == ["closure", "clutter", "all"]
    assert found["a"]["all"].estimate == pytest.approx(0.525)
    many = pd.concat(frame.assign(episode=frame["episode"] + 2 * k) for k in range(5))
    gap = leads(many)["a"]["clutter"]
    assert (gap.estimate, gap.low, gap.high) == pytest.approx((0.1, 0.1, 0.1))  # paired: worlds do not blur it


def test_a_world_that_has_not_been_through_all_levels_does_not_count():
    frame = results({"a": {"closure": [[1.0, 0.8], [0.6, 0.4]]}, "b": {"closure": [[math.nan, 0.8]]}})
    assert by_world(frame[frame["name"] == "a"][:-1])["closure"].dropna().to_list() == pytest.approx([0.8])
    assert math.isnan(scores(frame)["b"]["all"].estimate) and list(scores(frame)) == ["a", "b"]


def test_relocators_have_numbers_of_their_own():
    found = {"worse": {"kidnapped": [[0.2]]}, "gcbb": {"kidnapped": [[0.4]]}}
    rows = relocations(results(found, **dict.fromkeys((*OUTCOMES, "nodes", "microseconds", "limits"), 2))).rows
    assert list(rows) == ["gcbb", "worse"] and rows["gcbb"]["correct"] == 2
    assert rows["gcbb"]["score"].estimate == 0.4


def test_the_best_hypothesis_is_held_to_its_probability():
    """The best one may not be the one decided for: then it is the runner-up."""

    def answer(features, probability, runner_up, its_probability):
        posterior = Posterior(0.0, probability, np.array(runner_up), its_probability)
        return Hypothesis(np.array(features), 0.0, 0, Effort(), posterior)

    nothing, right = [UNPAIRED, UNPAIRED], [3, UNPAIRED]
    answers = answer(right, 0.5, nothing, 0.1), answer(nothing, 0.2, right, 0.7)
    assert promised(answers, [np.array(right)] * 2) == {"promised": pytest.approx(0.6), "kept": 1.0}
    assert promised(answers, [np.array([4, UNPAIRED]), np.array(right)])["kept"] == 0.5
    silent = Hypothesis(np.array(right), 0.0, 2, Effort())
    assert all(map(math.isnan, promised([silent], [np.array(right)]).values()))
