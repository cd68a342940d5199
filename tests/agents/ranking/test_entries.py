"""Entries survive their files, and files that were edited are refused by name."""

import json
import math

import pytest

from agents.ranking.entries import BASELINES, ranked, read_entries, read_entry, source_hash, write_entry
from agents.ranking.protocol import FIRST, Part, protocol
from tests.agents.ranking.strangers import mine

RECORDS = [
    {"setting": "office-small", "episode": FIRST, "loss": 0.25},
    {"setting": "office-small", "episode": FIRST + 1, "loss": None},
]
TWO = protocol("agent", quick=True)._replace(parts=(Part("drive", "office-small", 2),))


def an_entry(name="random"):
    return ranked(name, TWO, RECORDS, "python -m …", 12.3)


def test_entries_come_back_as_they_were_written(tmp_path):
    path = write_entry(tmp_path, an_entry())
    found = read_entry(path)
    assert path.name == "agent-random-quick.json" and found.key == an_entry().key
    assert found.losses["office-small"][0] == 0.25 and math.isnan(found.losses["office-small"][1])
    assert found.about["seconds"] == 12 and "numpy" in found.about["versions"] and found.about["source"] == ""


@pytest.mark.parametrize("edit", [lambda c: c["losses"].update({"office-small": [0.0, 0.0]}), lambda c: c.pop("role"),
                                  lambda c: c.update(worlds="other"), lambda c: c.update(losses=3)])  # fmt: skip
def test_files_that_were_edited_are_refused_by_name(tmp_path, edit):
    path = write_entry(tmp_path, an_entry())
    content = json.loads(path.read_text())
    edit(content)
    path.write_text(json.dumps(content))
    with pytest.raises(ValueError, match=r"agent-random-quick\.json: (was changed|no entry)"):
        read_entry(path)


def test_later_folders_replace_entries_of_the_same_name(tmp_path):
    write_entry(tmp_path / "a", an_entry())
    write_entry(tmp_path / "b", an_entry())
    write_entry(tmp_path / "b", an_entry("lawnmower"))
    assert [entry.name for entry in read_entries([tmp_path / "a", tmp_path / "b"])] == ["random", "lawnmower"]


def test_the_source_of_strangers_is_hashed():
    assert len(source_hash(f"{mine.__module__}:mine")) == 16 and source_hash("jcbb") == ""


def test_what_ships_can_be_read_and_is_of_this_protocol():
    for entry in read_entries([BASELINES]):
        assert entry.protocol == protocol(entry.role).about
