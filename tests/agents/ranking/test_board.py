"""The protocol is frozen, entries survive their files, and places follow paired differences."""

import hashlib
import json
import math
import re

import numpy as np
import pytest
from typer.testing import CliRunner

from agents.leaderboard import MARKS, app, with_tables
from agents.ranking.board import BASELINES, Ranked, markdown, ranked, read_entries, rows, write_entry
from agents.ranking.protocol import FIRST, PARTS, SPLIT, VERSION, Protocol
from slam_gym.scenarios import get_scenario, world_generator
from tests.agents import typed

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
    entries, refused = read_entries([BASELINES])
    assert not refused
    assert {entry.protocol["role"] for entry in entries} == set(PARTS)
    for entry in entries:
        chosen = Protocol(entry.protocol["role"])
        assert entry.protocol == chosen.about
        assert {setting: len(losses) for setting, losses in entry.losses.items()} == chosen.parts


def an_entry(name, shift, seed=0, noise=0.001):
    """Losses of worlds that differ much from each other, shifted by little."""
    hard, own = np.random.default_rng(1), np.random.default_rng(seed)
    losses = {
        setting: (hard.uniform(0.2, 0.9, count) + shift + noise * own.standard_normal(count)).tolist()
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


def test_entries_come_back_from_their_files(tmp_path):
    chosen = Protocol("associator", quick=True)
    records = [{"setting": setting, "episode": FIRST, "loss": 0.25} for setting in chosen.parts]
    entry = ranked("jcbb", chosen, records, "python -m …")
    path = write_entry(tmp_path, entry)
    assert path.name == "associator-jcbb-quick.json" and read_entries([tmp_path]) == ([entry], [])
    assert entry.losses == {"clutter/1": [0.25], "drift-2": [0.25]}


def test_a_world_in_which_nothing_was_to_be_decided_has_no_loss_and_none_is_infinite():
    chosen = Protocol("agent")
    records = [{"setting": s, "episode": FIRST + k, "loss": 0.5} for s, n in chosen.parts.items() for k in range(n)]
    assert ranked("a", chosen, [records[0] | {"loss": math.nan}, *records[1:]], "").losses["office-small"][0] is None
    with pytest.raises(ValueError, match="the loss inf in office-small"):
        ranked("a", chosen, [records[0] | {"loss": math.inf}, *records[1:]], "")


GOOD = vars(an_entry("good", 0.0))
NO_ENTRIES = [
    "", "[]", "null", "[" * 100_000, "\xff", '{"name": 3}', GOOD | {"name": 3}, GOOD | {"losses": {"a": ["b"]}},
    GOOD | {"more": 1}, GOOD | {"protocol": None}, GOOD | {"protocol": GOOD["protocol"] | {"role": "judge"}},
    GOOD | {"protocol": GOOD["protocol"] | {"hash": "` | `"}},
    *(GOOD | {"losses": GOOD["losses"] | {"hall": [loss] * 8}}
      for loss in (-0.1, math.nan, math.inf, "0.1", None, 10**400, [0.1])),
    json.dumps(GOOD).replace('"hall": [', '"hall": [1e999, '),
]  # fmt: skip


def test_what_is_no_entry_is_named_and_the_rest_of_the_board_is_drawn(tmp_path):
    write_entry(tmp_path, Ranked(**GOOD))
    for number, content in enumerate(NO_ENTRIES):
        text = json.dumps(content) if isinstance(content, dict) else content
        (tmp_path / f"agent-damaged-{number:02}.json").write_text(text, encoding="latin-1")
    done = typed(app, "--board", tmp_path)
    assert done.exit_code == 0 and "| good |" in (tmp_path / "leaderboard.md").read_text()
    told = [line.partition("left out: ")[2] for line in done.stderr.splitlines()]
    for number, content in enumerate(NO_ENTRIES):
        path = str(tmp_path / f"agent-damaged-{number:02}.json")
        assert sum(line.startswith(path) for line in told) == 1, content
    assert len(told) == len(NO_ENTRIES)


def test_names_cannot_break_the_page():
    one = an_entry("<img src=x> | [a](b) `c` *d*\n# e \\", 0.0)
    other = Ranked(one.name, one.protocol | {"hash": "other"}, {"<b>|x": [0.5]}, {})
    shown = markdown([one, other])
    assert r"| &lt;img src=x&gt; \| \[a\](b) \`c\` \*d\* # e \\ |" in shown and r"| &lt;b&gt;\|x |" in shown
    table = shown.split("### Agents")[1].strip().splitlines()[2:]
    assert len({len(re.findall(r"(?<!\\)\|", line)) for line in table}) == 1


def test_an_entry_is_ranked_among_those_that_were_there_and_goes_on_where_it_was(tmp_path):
    board, page = tmp_path / "board", tmp_path / "page.md"
    page.write_text(f"before\n{MARKS[0]}\nold\n{MARKS[1]}\nafter\n")

    def leaderboard(*line):
        done = CliRunner().invoke(app, [*line, "--quick", "--jobs", "1", "--board", str(board)])
        assert done.exit_code == 0, done.output

    leaderboard("--entry", "true_association")
    leaderboard("--entry", MINE, "--role", "associator", "--page", str(page))
    shown = page.read_text()
    assert shown.startswith("before") and shown.endswith("after\n") and "old" not in shown
    assert ":mine |" in shown and "|  | true association |" in shown and "| clutter | drift-2 |" in shown
    assert "|  | jcbb |" in shown, "what ships is ranked beside it, in the same worlds"
    before, _ = read_entries([board])
    leaderboard("--entry", MINE, "--role", "associator")
    assert [entry.losses for entry in read_entries([board])[0]] == [entry.losses for entry in before]


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (["--entry", "nobody"], "unknown agent"),
        (["--entry", MINE], "give --role"),
        (["--entry", "nowhere.zip"], "no such file"),
        (["--entry", "learned"], "agent and associator"),
        (["--entry", "nobody", "--role", "agent"], "unknown agent"),
    ],
)
def test_bad_input_is_told_and_nothing_is_written(tmp_path, monkeypatch, line, said):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, line)
    assert done.exit_code == 2 and said in " ".join(done.output.split()) and not list(tmp_path.iterdir())


def test_a_page_without_marks_is_refused():
    with pytest.raises(ValueError, match="the page lacks"):
        with_tables("# A page\n", "| |")
