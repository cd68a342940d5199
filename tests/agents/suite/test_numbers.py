"""Numbers of the suite: means over levels, then over worlds; paired where two are compared."""

import math

import pytest

from agents.suite.numbers import SuiteRecords, interval, numbers, paired_difference, split_records
from agents.suite.relocation_problems import OUTCOMES


def records_of(scores: dict[str, dict[str, list[list[float]]]]) -> list[dict]:
    """name → experiment → (levels, worlds) of scores, as records."""
    return [
        {"associator": name, "experiment": e, "setting": f"{e}/{i}", "knob": float(i), "episode": w, "score": score}
        for name, experiments in scores.items()
        for e, levels in experiments.items()
        for i, row in enumerate(levels)
        for w, score in enumerate(row)
    ]


def test_numbers_are_means_over_levels_then_over_worlds():
    records = records_of({
        "b": {"closure": [[0.9, 0.7], [0.5, 0.3]], "clutter": [[0.4, 0.4], [0.0, 0.2]]},
        "a": {"closure": [[1.0, 0.8], [0.6, 0.4]], "clutter": [[0.5, 0.5], [0.1, 0.3]]},
    })  # fmt: skip
    suite = SuiteRecords(records)
    assert suite.experiments == ["closure", "clutter"]
    assert suite.by_world("a", "closure") == pytest.approx({0: 0.8, 1: 0.6})
    assert suite.overall("a") == pytest.approx({0: 0.55, 1: 0.5})
    assert numbers(records)["numbers"]["a"]["all"].estimate == pytest.approx(0.525)
    assert suite.ranked == ["a", "b"]
    gap = paired_difference(suite.by_world("a", "clutter"), suite.by_world("b", "clutter"))
    assert (gap.estimate, gap.low, gap.high) == pytest.approx((0.1, 0.1, 0.1))  # paired: worlds do not blur it
    assert math.isnan(interval({}).estimate)


def test_a_world_that_has_not_been_through_all_levels_does_not_count():
    records = records_of({"a": {"closure": [[1.0, 0.8], [0.6, 0.4]]}})[:-1]
    assert SuiteRecords(records).by_world("a", "closure") == pytest.approx({0: 0.8})


def test_a_curve_has_an_estimate_a_level():
    curve = SuiteRecords(records_of({"a": {"closure": [[1.0, 0.8], [0.6, 0.4]]}})).level_curve("a", "closure")
    assert curve.knobs.tolist() == [0.0, 1.0]
    assert [found.estimate for found in curve.estimates] == pytest.approx([0.9, 0.5])


def test_relocators_have_numbers_of_their_own():
    records = records_of(
        {"jcbb": {"closure": [[0.7]]}, "worse": {"kidnapped": [[0.2]]}, "gcbb": {"kidnapped": [[0.4]]}}
    )
    records = [record | dict.fromkeys(OUTCOMES, 2) for record in records]
    association, relocation = split_records(records)
    assert (association.names, relocation.names) == (["jcbb"], ["worse", "gcbb"])
    told = numbers(records)
    assert list(told["numbers"]) == ["jcbb"] and list(told["relocation"]) == ["gcbb", "worse"]
    assert told["relocation"]["gcbb"]["correct"] == 2 and told["relocation"]["gcbb"]["kidnapped"].estimate == 0.4
