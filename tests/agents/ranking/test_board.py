"""The protocol is frozen, entries survive their files, and places follow paired differences."""

import hashlib
import json

import numpy as np
import pytest
from typer.testing import CliRunner

from agents.leaderboard import MARKS, app, with_tables
from agents.ranking.board import BASELINES, Ranked, markdown, ranked, read_entries, rows, write_entry
from agents.ranking.protocol import FIRST, PARTS, SPLIT, VERSION, EntryTask, Protocol
from slam_gym.scenarios import get_scenario, world_generator

MINE = "tests.agents.ranking.strangers:mine"
FROZEN = {"agent": "1b2ec0b77459f658", "associator": "8e23668ef0b1332c", "relocator": "fa5f642552504756"}
"""Hashes of version 3. Another protocol is another version, and old entries are then ranked apart."""
FLOORS = "97253a68358beb1b"
"""Of the floors of version 3."""


def test_the_protocol_is_what_it_was():
    assert VERSION == 3 and {role: Protocol(role).about["hash"] for role in PARTS} == FROZEN
    assert len({Protocol(role, quick).about["hash"] for role in PARTS for quick in (False, True)}) == 6


def test_the_floors_are_what_they_were():
    digest = hashlib.sha256()
    for setting in sorted({setting for parts in PARTS.values() for setting in parts}):
        plan = get_scenario(setting).generator(world_generator(SPLIT, FIRST))
        for part in (plan.walls, plan.features.positions, plan.features.sizes, plan.furniture):
            digest.update(np.round(np.asarray(part, np.float64) * 1e6).astype(np.int64).tobytes())
    assert digest.hexdigest()[:16] == FLOORS


def test_what_ships_can_be_read_and_is_of_this_protocol():
    entries = read_entries([BASELINES])
    assert {entry.protocol["role"] for entry in entries} == set(PARTS)
    for entry in entries:
        chosen = Protocol(entry.protocol["role"])
        assert entry.protocol == chosen.about
        assert {setting: len(losses) for setting, losses in entry.losses.items()} == chosen.parts


@pytest.mark.parametrize(
    ("role", "entry", "setting"),
    [("associator", "true_association", "closure/0"), ("relocator", "gcbb", "kidnapped/0")],
)
def test_losses_lie_between_none_and_all(role, entry, setting):
    (record,) = EntryTask(entry, role, setting, FIRST).run(())
    assert 0.0 <= record["loss"] <= 1.0 and (entry != "true_association" or record["loss"] == 0.0)


def an_entry(name, shift, seed=0, noise=0.001):
    """Losses of worlds that differ much from each other, shifted by little."""
    hard, own = np.random.default_rng(1), np.random.default_rng(seed)
    losses = {
        setting: (hard.uniform(0.1, 0.9, count) + shift + noise * own.standard_normal(count)).tolist()
        for setting, count in PARTS["agent"].items()
    }
    return Ranked(name, Protocol("agent").about, losses, {})


def test_small_differences_on_the_same_worlds_are_told_apart_and_noise_is_not():
    found = rows([an_entry("worse", 0.02, 1), an_entry("best", 0.0, 2), an_entry("tied", 0.0, 3, noise=0.03)])
    assert {row.name: row.place for row in found} == {"best": 1, "tied": 1, "worse": 3}  # two are better
    worse = found[-1]
    assert worse.behind.low > 0.0 and worse.behind.high - worse.behind.low < 0.03 < worse.loss.high - worse.loss.low
    assert found[0].loss.estimate == pytest.approx(np.mean(list(found[0].columns.values())), abs=1e-9)


def test_the_ceiling_takes_nobodys_place_and_nobody_is_behind_it():
    found = rows([an_entry("true_association", -0.1), an_entry("jcbb", 0.0)])
    assert [(row.place, row.name) for row in found] == [(0, "true_association"), (1, "jcbb")]
    assert found[1].behind.estimate == 0.0 and found[0].behind.high < 0.0


def test_columns_weigh_alike_and_what_could_not_be_decided_is_left_out():
    one = an_entry("a", 0.0)
    losses = {setting: [float(k == 0)] * len(own) for k, (setting, own) in enumerate(one.losses.items())}
    losses["office-small"][3] = None
    (row,) = rows([Ranked("a", one.protocol, losses, {})])
    assert row.loss.estimate == pytest.approx(1.0 / len(losses)) and row.loss.low == row.loss.high


def test_entries_come_back_from_their_files_and_others_are_refused_by_name(tmp_path):
    chosen = Protocol("associator", quick=True)
    records = [{"setting": "clutter/1", "episode": FIRST, "loss": None},
               {"setting": "office-small", "episode": FIRST, "loss": 0.25}]  # fmt: skip
    entry = ranked("jcbb", chosen, records, "python -m …")
    path = write_entry(tmp_path, entry)
    assert path.name == "associator-jcbb-quick.json" and read_entries([tmp_path]) == [entry]
    assert entry.losses == {"clutter/1": [None], "office-small": [0.25]}
    for content in ("", "[]", json.dumps({"name": 3}), json.dumps(vars(entry) | {"losses": {"a": ["b"]}})):
        path.write_text(content)
        with pytest.raises(ValueError, match=r"associator-jcbb-quick\.json: no entry"):
            read_entries([tmp_path])


def test_entries_of_other_protocols_are_ranked_apart():
    one = an_entry("a", 0.0)
    other = Ranked("b", one.protocol | {"hash": "other"}, one.losses, {})
    shown = markdown([one, other])
    assert shown.count("### Agents") == 2 and "| 1 | a |" in shown and "| 1 | b |" in shown


def test_an_entry_is_ranked_among_those_that_were_there_and_goes_on_where_it_was(tmp_path):
    board, page = tmp_path / "board", tmp_path / "page.md"
    page.write_text(f"before\n{MARKS[0]}\nold\n{MARKS[1]}\nafter\n")

    def leaderboard(*line):
        done = CliRunner().invoke(app, [*line, "--quick", "--jobs", "1", "--board", str(board), "--no-baselines"])
        assert done.exit_code == 0, done.output

    leaderboard("--entry", "true_association")
    leaderboard("--entry", MINE, "--role", "associator", "--page", str(page))
    shown = page.read_text()
    assert shown.startswith("before") and shown.endswith("after\n") and "old" not in shown
    assert "| 1 | mine |" in shown and "|  | true association |" in shown and "| clutter | office-small |" in shown
    before = read_entries([board])
    leaderboard("--entry", MINE, "--role", "associator")
    assert [entry.losses for entry in read_entries([board])] == [entry.losses for entry in before]


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (["--entry", "nobody"], "give --role"),
        (["--entry", "learned"], "agent and associator"),
        (["--entry", "nobody", "--role", "agent"], "unknown agent"),
        (["--no-baselines"], "there is no entry in"),
    ],
)
def test_bad_input_is_told_and_nothing_is_written(tmp_path, monkeypatch, line, said):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, line)
    assert done.exit_code == 2 and said in " ".join(done.output.split()) and not list(tmp_path.iterdir())


def test_a_page_without_marks_is_refused():
    with pytest.raises(ValueError, match="the page lacks"):
        with_tables("# A page\n", "| |")
