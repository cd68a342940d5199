"""The report of associators in the loop: a section a scenario, and all against one of them."""

import pytest

from agents.evaluation.pipeline import ASSOCIATORS, Results
from agents.reports.associators import report
from tests.agents.reports import Page

NAMES = ["singles", "jcbb", "true_association"]


def results(**more):
    """Three associators in two scenarios; each is a little better than the one before."""
    base = {"f1": 0.7, "exact": 0.5, "precision": 0.8, "recall": 0.6, "map_error": 0.4, "local_error": 0.02,
            "map_lost": 0.1, "duplicates": 1.0, "nodes": 20.0, "microseconds": 50.0, "anees": 1.2, "limits": 0.0,
            "recovered": 1.0, "relocations_wrong": 0.0, "ticks_astray": 9.0}  # fmt: skip
    records = [
        {"associator": name, "setting": setting, "episode": k}
        | {key: value * (1.0 + 0.05 * rank + 0.001 * k) for key, value in base.items()} | more
        for setting in ("office-small", "hall") for rank, name in enumerate(NAMES) for k in range(6)
    ]  # fmt: skip
    conditions = {"driver": "random", "relocation": None, "split": "test", "overrides": {}}
    return Results(ASSOCIATORS, {"conditions": conditions, "asked": {"names": NAMES, "episodes": 6}}, records)


def test_there_is_a_table_and_a_picture_a_scenario_and_a_comparison(tmp_path):
    told = report(results(), tmp_path)
    page = Page("\n".join(told.sections))
    assert len(page.pictures) == 2 and "driven by random: 6 episodes a scenario" in told.subtitle
    for expected in ("office-small", "hall", "Against jcbb", "… minus jcbb", "−0.0", "+0.0"):
        assert expected in page.text
    assert "Node limit met" not in page.text and "recovered" not in page.text


@pytest.mark.parametrize(
    ("more", "said"), [({"limits": 2.0}, "Node limit met: singles in 12 scans"), ({"kidnapped": 1.0}, "recovered")]
)
def test_what_went_wrong_is_said(more, said, tmp_path):
    assert said in Page("\n".join(report(results(**more), tmp_path).sections)).text
