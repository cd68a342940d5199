"""The protocol is frozen, entries survive their files, and places follow paired differences."""

import hashlib
import json
import math
import re

import numpy as np
import pandas as pd
import pytest
from scipy.stats import ttest_1samp
from typer.testing import CliRunner

from agents.leaderboard import MARKS, app, with_tables
from agents.ranking.board import BASELINES, Entry, folders_in, markdown, read_entries, rows
from agents.ranking.protocol import FIRST, PARTS, SPLIT, VERSION, Protocol, column_of, leaderboard_evaluation
from slam_gym.scenarios import get_scenario, world_generator
from tests.agents import typed

MINE = "tests.agents.ranking.strangers:mine"
FROZEN = {"agent": "8d7e246f36be9f5d", "associator": "335f4d3d3a417522", "relocator": "0e34cebb3bb0b98a"}
"""Hashes of version 4. Another protocol is another version, and old entries are then ranked apart."""
FLOORS = "97253a68358beb1b"
"""Of the floors of version 4."""


def test_the_protocol_is_what_it_was():
    assert VERSION == 4 and {role: Protocol(role).about["hash"] for role in PARTS} == FROZEN
    assert len({Protocol(role, quick).about["hash"] for role in PARTS for quick in (False, True)}) == 6


def test_the_floors_are_what_they_were():
    digest = hashlib.sha256()
    for setting in sorted({setting for parts in PARTS.values() for setting in parts}):
        plan = get_scenario(setting).generator(world_generator(SPLIT, FIRST))
        for part in (plan.walls, plan.features.positions, plan.features.sizes, plan.furniture):
            digest.update(np.round(np.asarray(part, np.float64) * 1e6).astype(np.int64).tobytes())
    assert digest.hexdigest()[:16] == FLOORS


def test_what_ships_can_be_read_and_is_of_this_protocol():
    entries, refused = read_entries(folders_in(BASELINES))
    assert not refused
    assert {entry.protocol["role"] for entry in entries} == set(PARTS)
    for entry in entries:
        chosen = Protocol(entry.protocol["role"])
        assert entry.protocol == chosen.about
        assert entry.losses.groupby(level="setting").size().to_dict() == chosen.parts


def an_entry(name, shift, seed=0, noise=0.001):
    """Losses of worlds that differ much from each other, shifted by little."""
    hard, own, losses = np.random.default_rng(1), np.random.default_rng(seed), {}
    for setting, count in PARTS["agent"].items():
        drawn = hard.uniform(0.2, 0.9, count) + shift + noise * own.standard_normal(count)
        losses |= {(column_of(setting), setting, FIRST + k): loss for k, loss in enumerate(drawn.tolist())}
    return Entry(name, Protocol("agent").about, pd.Series(losses))


def test_of_two_evaluations_of_one_entry_the_later_counts(tmp_path):
    for folder, shift, day in (("b", 0.1, 1), ("a", 0.0, 2)):
        write(tmp_path / folder, an_entry("one", shift), commands=[{"command": "", "started": f"2026-01-0{day}"}])
    entries, told = read_entries(folders_in(tmp_path))
    (row,) = rows(entries)
    assert row.loss.estimate == pytest.approx(rows([an_entry("one", 0.0)])[0].loss.estimate)
    assert told == ["one: 1 of its 2 evaluations, since only the last counts"]


def write(folder, entry, **changes):
    """Write an entry as an evaluation does, but for `changes` of its results.json."""
    folder.mkdir(parents=True)
    rows = [{"name": "a", "setting": s, "episode": k, "model": "", "loss": x} for (_, s, k), x in entry.losses.items()]
    pd.DataFrame(rows).to_csv(folder / "results.csv", index=False)
    told = {"kind": "leaderboard", "commands": [], "complete": True, "versions": {}}
    told |= {"conditions": {"entry": entry.name} | entry.protocol}
    (folder / "results.json").write_text(json.dumps(told | changes))
    return folder


def test_small_differences_on_the_same_worlds_are_told_apart_and_noise_is_not():
    found = rows([an_entry("worse", 0.02, 1), an_entry("best", 0.0, 2), an_entry("tied", 0.0, 3, noise=0.03)])
    assert {row.name: row.place for row in found} == {"best": 1, "tied": 1, "worse": 3}  # two are better
    worse = found[-1]
    assert found[0].loss.estimate <= found[1].loss.estimate  # of one place
    assert worse.behind.low > 0.0 and worse.behind.high - worse.behind.low < 0.03 < worse.loss.high - worse.loss.low
    assert found[0].loss.estimate == pytest.approx(np.mean(list(found[0].columns.values())), abs=1e-9)


def test_an_interval_covers_the_loss_as_often_as_it_says_where_columns_share_their_worlds():
    rng, keys, covered = np.random.default_rng(0), an_entry("a", 0.0).losses.index, 0
    for _ in range(200):
        of_world = rng.normal(0.0, 0.1, 8)[keys.get_level_values(2) - FIRST]
        (row,) = rows([an_entry("a", 0.0)._replace(losses=pd.Series(rng.normal(0.5, 0.1, len(keys)) + of_world, keys))])
        covered += row.loss.low <= 0.5 <= row.loss.high
    assert 0.9 <= covered / 200 < 0.99
    values = rng.normal(0.5, 0.1, 8)
    alone = pd.Series(np.tile(values, 8), pd.MultiIndex.from_tuples(sorted(keys)))  # alike in all columns
    (row,) = rows([an_entry("a", 0.0)._replace(losses=alone)])
    t_interval = ttest_1samp(values, 0.0).confidence_interval()
    assert (row.loss.low, row.loss.high) == pytest.approx((t_interval.low, t_interval.high))


def test_the_ceiling_takes_nobodys_place_and_nobody_is_behind_it():
    found = rows([an_entry("true_association", -0.1), an_entry("jcbb", 0.0)])
    assert [(row.place, row.name) for row in found] == [(0, "true_association"), (1, "jcbb")]
    assert found[1].behind.estimate == 0.0 and found[0].behind.high < 0.0


def test_columns_weigh_alike_in_the_order_of_the_first_entry():
    one, settings = an_entry("a", 0.0), list(PARTS["agent"])
    losses = pd.Series({key: float(key[1] == settings[0]) for key in one.losses.index})
    (row, other) = rows([one._replace(losses=losses), an_entry("b", 0.0)._replace(losses=losses.sort_index() + 0.1)])
    assert row.loss.estimate == pytest.approx(1.0 / len(settings)) and row.loss.low == row.loss.high
    assert list(row.columns) == list(other.columns) == list(dict.fromkeys(map(column_of, settings)))


def test_entries_come_back_from_their_folders(tmp_path):
    one = an_entry("a", 0.0)
    ((found,), refused) = read_entries([write(tmp_path / "one", one)])
    assert (found.name, found.protocol, refused) == (one.name, one.protocol, [])
    pd.testing.assert_series_equal(found.losses, one.losses, check_names=False, atol=1e-6)
    assert dict.fromkeys(found.quick().losses.index) == {("office-small", "office-small", FIRST): None}


GOOD = an_entry("good", 0.0)
KNOWN = {"entry": GOOD.name} | GOOD.protocol
NO_ENTRIES = [
    {"complete": False}, {"kind": "suite", "conditions": {}}, {"conditions": KNOWN | {"entry": 3}}, {"versions": 3},
    *({"conditions": KNOWN | {name: value}}
      for name, value in (("role", "judge"), ("hash", "` | `"), ("hash", None), ("version", "3"), ("quick", None))),
]  # fmt: skip
NO_LOSSES = (-0.1, math.inf, math.nan, "b", "1e400", "[0.1]")


def test_what_is_no_entry_is_named_and_the_rest_of_the_board_is_drawn(tmp_path):
    write(tmp_path / "good", GOOD)
    no_entries = [write(tmp_path / f"damaged-{k:02}", GOOD, **changes) for k, changes in enumerate(NO_ENTRIES)]
    for k, loss in enumerate(NO_LOSSES):
        losses = GOOD.losses.astype(object)
        losses["hall", "hall", FIRST] = loss
        no_entries.append(write(tmp_path / f"loss-{k:02}", GOOD._replace(losses=losses)))
    twice = pd.concat([GOOD.losses, GOOD.losses[:1]])
    for name, losses in (("short", GOOD.losses[1:]), ("twice", twice)):
        no_entries.append(write(tmp_path / name, GOOD._replace(losses=losses)))
    no_entries.append(tmp_path / "text")
    write(tmp_path / "text", GOOD)
    (tmp_path / "text" / "results.json").write_text("[" * 100_000)
    done = typed(app, "--board", tmp_path)
    assert done.exit_code == 0 and "| good |" in (tmp_path / "leaderboard.md").read_text()
    told = [line.partition("left out: ")[2] for line in done.stderr.splitlines()]
    for folder in no_entries:
        assert sum(line.startswith(f"{folder}: ") for line in told) == 1, folder
    assert len(told) == len(no_entries)


def test_tables_come_in_the_order_of_roles_whoever_was_evaluated_first():
    agent, losses = an_entry("driver", 0.0), pd.Series({("clutter", "clutter/1", FIRST): 0.5})
    associator = Entry("associator", Protocol("associator").about, losses)
    shown = markdown([agent, associator])
    assert shown == markdown([associator, agent]) and shown.startswith("### Associators")


def test_names_cannot_break_the_page():
    one = an_entry("<img src=x> | [a](b) `c` *d*\n# e \\", 0.0)
    other = Entry(one.name, one.protocol | {"hash": "other"}, pd.Series({("<b>|x", "<b>|x", FIRST): 0.5}))
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
    before, _ = read_entries(folders_in(board))
    assert {entry.name for entry in before} == {MINE, "true_association"}
    again = CliRunner().invoke(app, ["--entry", MINE, "--role", "associator", "--quick", "--board", str(board)])
    assert again.exit_code == 2 and "--resume" in again.output, "its code may be another one by now"
    leaderboard("--entry", MINE, "--role", "associator", "--resume")
    after = {entry.name: entry.losses for entry in read_entries(folders_in(board))[0]}
    for entry in before:
        pd.testing.assert_series_equal(entry.losses, after[entry.name])


def test_the_file_of_an_entry_is_part_of_it(tmp_path):
    (tmp_path / "mine.npz").write_bytes(b"weights")
    (models,) = leaderboard_evaluation(str(tmp_path / "mine.npz"), Protocol("associator")).about["models"].values()
    assert models["sha256"] == hashlib.sha256(b"weights").hexdigest()


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
