"""The report is one file that reads without the network, and says what the records say."""

import base64
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from agents.reports.evaluation import write_report

AGENTS = ["random", "nearest_frontier", "mine:Agent<b>"]


class Checker(HTMLParser):
    """Collects links, and fails where tags do not match."""

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


@pytest.fixture
def folder(tmp_path):
    rng = np.random.default_rng(0)
    ticks = np.arange(0, 301, 20)
    with (tmp_path / "episodes.jsonl").open("w") as file:
        for rank, agent in enumerate(AGENTS):
            for k in range(8):
                error = 1.0 - (0.2 + 0.2 * rank) * ticks / 300 + rng.normal(0.0, 0.001)
                record = {"agent": agent, "model": None, "episode": k, "map_error": error[-1], "coverage": 0.8}
                record |= {
                    "precision": float("nan"),
                    "recall": 0.9,
                    "anees": 1.0,
                    "ticks": 300,
                    "ticks_per_second": 3e3,
                }
                record["curve"] = {
                    "ticks": ticks.tolist(),
                    "map_error": error.tolist(),
                    "coverage": (ticks / 400).tolist(),
                }
                file.write(json.dumps(record) + "\n")
    setting = {"scenario": "office", "associator": "jcbb", "split": "test", "floor_plan": None}
    results = {"commands": [{"command": "python -m agents.evaluate --x '<&>'", "started": "now"}], "complete": True}
    results |= {"setting": setting, "agents": AGENTS, "models": {}, "episodes": 8, "versions": {"slam_gym": "0.1.0"}}
    (tmp_path / "results.json").write_text(json.dumps(results))
    return tmp_path


def checked(folder):
    page = Checker()
    page.feed(write_report(folder).read_text(encoding="utf-8"))
    assert not page.open
    return page


def test_the_page_is_well_formed_and_needs_nothing_from_outside(folder):
    page = checked(folder)
    assert len(page.links) == 2
    for link in page.links:
        assert base64.b64decode(link.removeprefix("data:image/png;base64,")).startswith(b"\x89PNG")


def test_the_page_says_what_was_run_and_measured(folder):
    text = " ".join(checked(folder).text)
    for expected in (*AGENTS, "--x '<&>'", "0.800", "0.600", "0.400", "–"):
        assert expected in text
    assert re.search(r"−0\.[12]\d\d.*−0\.[34]\d\d", text)


def test_only_agents_that_can_be_told_apart_are_bold(folder):
    html = write_report(folder).read_text()
    rows = re.findall(r"<tr><td><span.*?</tr>", html)[: len(AGENTS)]
    first = [re.findall(r"<td( class=\"best\")?>", row)[1] for row in rows]
    assert first == ["", "", ' class="best"']  # map error: the last agent alone
    assert all(re.findall(r"<td( class=\"best\")?>", row)[2] == "" for row in rows)  # coverage: all the same


def test_films_are_linked_where_they_are_there(folder):
    (folder / "films").mkdir()
    (folder / "films" / "random.mp4").write_bytes(b"film")
    (folder / "films" / "random.png").write_bytes(b"\x89PNG picture")
    page = checked(folder)
    assert page.links.count("films/random.mp4") == 2  # played in the page, and linked


def test_an_unfinished_evaluation_says_so(folder):
    results = json.loads((folder / "results.json").read_text())
    (folder / "results.json").write_text(json.dumps(results | {"complete": False}))
    assert "unfinished" in " ".join(checked(folder).text)


def test_a_folder_without_evaluation_is_refused_by_name(tmp_path):
    with pytest.raises(ValueError, match=str(tmp_path)):
        write_report(tmp_path)
