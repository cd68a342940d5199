"""The report of the suite ranks with reasons from its own numbers."""

import re

import pytest

from agents.evaluation.pipeline import SUITE, Results
from agents.reports.suite import report
from agents.suite.relocation_problems import OUTCOMES
from slam_gym.scenarios.suite import RELOCATION
from tests.agents.reports import PNG, Page

NAMES = ["singles", "jcbb", "true_association", "gcbb"]
SCORES = {"singles": 0.5, "jcbb": 0.8, "true_association": 1.0, "gcbb": 0.7}


def record(name: str, experiment: str, level: int, world: int) -> dict:
    found = {"associator": name, "experiment": experiment, "setting": f"{experiment}/{level}", "episode": world}
    shares = dict.fromkeys(("exact", "precision", "recall", "spoiled", "refused"), 0.5)
    found |= dict.fromkeys(OUTCOMES, 2) if experiment == RELOCATION else shares
    score = SCORES[name] - 0.1 * level + 0.01 * world if name != "true_association" else 1.0
    return found | {"knob": float(level), "score": score, "nodes": 10.0, "microseconds": 5.0, "limits": 1}


@pytest.fixture
def results():
    experiments = {"closure": NAMES[:3], "clutter": NAMES[:3], "density": NAMES[:3], RELOCATION: NAMES[3:]}
    records = [record(name, experiment, level, world) for experiment, names in experiments.items() for name in names
               for level in range(2) for world in range(5)]  # fmt: skip
    conditions = {"worlds": 5, "problems": 4, "quick": True, "split": "test"}
    return Results(SUITE, {"conditions": conditions, "asked": {"names": NAMES, "episodes": 5}}, records)


def test_the_order_has_reasons(results, tmp_path):
    told = report(results, tmp_path)
    page = Page("\n".join(told.sections))
    assert "5 test worlds a level, up to 4 scans in each" in told.subtitle
    order = [page.text.index(f"{name} (") for name in ("true association", "jcbb", "singles")]
    assert order == sorted(order)
    assert "jcbb (0.77)" in page.text.replace(" )", ")")
    assert re.search(r"It spoils 50% of the scans with a wrong pairing, and refuses 50% of what is mapped", page.text)
    assert "Ahead of singles by +0.300" in page.text and "above all in closure (+0.30)" in page.text


def test_there_is_a_section_a_capability_and_the_pictures_lie_beside(results, tmp_path):
    page = Page("\n".join(report(results, tmp_path).sections))
    for expected in ("Closure", "Clutter", "Density", "Kidnapped", "limit met"):
        assert expected in page.text
    assert len(page.pictures) == 7
    assert all((tmp_path / name).read_bytes().startswith(PNG) for name in ("suite.png", "radar.png"))


def test_associators_or_relocators_may_be_alone(results, tmp_path):
    for asked, said in ((NAMES[:3], "Capabilities"), (NAMES[3:], "Kidnapped")):
        own = results._replace(records=[r for r in results.records if r["associator"] in asked])
        text = Page("\n".join(report(own, tmp_path).sections)).text
        assert [word for word in ("Capabilities", "Kidnapped") if word in text] == [said]
