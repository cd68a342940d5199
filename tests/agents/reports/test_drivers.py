"""The report of drivers says what the records say."""

import re

import numpy as np
import pytest

from agents.evaluation.pipeline import DRIVERS, Results
from agents.reports.drivers import report
from tests.agents.reports import PNG, Page

AGENTS = ["random", "nearest_frontier", "mine:Agent<b>"]


@pytest.fixture
def results():
    rng, records = np.random.default_rng(0), []
    ticks = np.arange(0, 301, 20)
    for rank, agent in enumerate(AGENTS):
        for k in range(8):
            error = 1.0 - (0.2 + 0.2 * rank) * ticks / 300 + rng.normal(0.0, 0.001)
            record = {
                "agent": agent,
                "model": None,
                "episode": k,
                "map_error": error[-1],
                "local_error": 0.02,
                "map_lost": 0.0,
            }
            record |= {
                "coverage": 0.8,
                "precision": np.nan,
                "recall": 0.9,
                "anees": 1.0,
                "ticks": 300,
                "ticks_per_second": 3e3,
            }
            curve = {"ticks": ticks, "map_error": error, "coverage": ticks / 400}
            records.append(record | {"curve": curve})
    conditions = {"scenario": "office", "associator": "jcbb", "split": "test", "floor_plan": None}
    return Results(DRIVERS, {"conditions": conditions, "asked": {"names": AGENTS, "episodes": 8}}, records)


def test_the_page_says_what_was_run_and_measured(results, tmp_path):
    told = report(results, tmp_path)
    page = Page("\n".join(told.sections))
    assert told.title == "Exploring office" and "8 episodes per agent on the same test worlds" in told.subtitle
    assert len(page.pictures) == 2 and all(picture.startswith(PNG) for picture in page.pictures)
    for expected in ("random", "nearest frontier", "Agent<b>", "0.800", "0.600", "0.400", "–"):
        assert expected in page.text
    assert re.search(r"−0\.[12]\d\d.*−0\.[34]\d\d", page.text)


def test_only_agents_that_can_be_told_apart_are_bold(results, tmp_path):
    markup = "\n".join(report(results, tmp_path).sections)
    rows = re.findall(r"<tr><td><span.*?</tr>", markup)[: len(AGENTS)]
    bold = [re.findall(r"<td( class=best)?>", row) for row in rows]
    assert [found[1] for found in bold] == ["", "", " class=best"]  # map error: the last agent alone
    assert [found[2] for found in bold] == [found[3] for found in bold] == [""] * 3  # local error, coverage: all alike


def test_films_are_linked_where_they_are_there(results, tmp_path):
    (tmp_path / "films").mkdir()
    (tmp_path / "films" / "random.mp4").write_bytes(b"film")
    (tmp_path / "films" / "random.png").write_bytes(PNG + b" picture")
    page = Page("\n".join(report(results, tmp_path).sections))
    assert page.links.count("films/random.mp4") == 2  # played in the page, and linked
    assert len(page.pictures) == 3


def test_one_agent_alone_is_compared_with_nobody(results, tmp_path):
    alone = results._replace(records=results.records[:8])
    assert "Agent against agent" in "".join(report(results, tmp_path).sections)
    assert "Agent against agent" not in "".join(report(alone, tmp_path).sections)
