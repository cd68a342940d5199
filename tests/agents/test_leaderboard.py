"""The command: entries through the quick protocol, resumed, ranked on a page."""

import json

import pytest

from agents.leaderboard import MARKS, main, with_tables
from tests.agents.ranking.strangers import mine

MINE = f"{mine.__module__}:mine"


def test_an_entry_is_ranked_among_those_that_were_there_and_goes_on_where_it_was(tmp_path, capsys):
    board, page = tmp_path / "board", tmp_path / "page.md"
    page.write_text(f"before\n{MARKS[0]}\nold\n{MARKS[1]}\nafter\n")
    line = ["--quick", "--jobs", "1", "--board", str(board), "--no-baselines"]
    assert main(["--entry", "true_association", *line]) == 0
    assert main(["--entry", MINE, "--role", "associator", *line, "--page", str(page)]) == 0
    shown = page.read_text()
    assert shown.startswith("before") and shown.endswith("after\n") and "old" not in shown
    assert "| 1 | mine |" in shown and "|  | true association |" in shown and "| clutter | office-small |" in shown
    assert (board / "leaderboard.md").read_text().count("### Associators") == 1
    (journal,) = board.glob("runs/*mine*/records.jsonl")
    lines = journal.read_text().splitlines()
    journal.write_text("\n".join(lines[:-1]) + "\n")
    before = json.loads((board / next(board.glob("*mine*.json")).name).read_text())["losses"]
    assert main(["--entry", MINE, "--role", "associator", *line]) == 0
    assert len(journal.read_text().splitlines()) == len(lines)
    assert json.loads(next(board.glob("*mine*.json")).read_text())["losses"] == before


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (["--entry", "nobody"], "give --role"),
        (["--entry", "nobody", "--role", "agent"], "unknown agent 'nobody'"),
        (["--no-baselines"], "there is no entry in"),
    ],
)
def test_bad_input_is_told_in_one_line(tmp_path, monkeypatch, line, said):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=said) as caught:
        main(line)
    assert "\n" not in str(caught.value) and not list(tmp_path.iterdir())


def test_a_page_without_marks_is_refused():
    with pytest.raises(ValueError, match="the page lacks"):
        with_tables("# A page\n", "| |")
