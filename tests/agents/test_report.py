"""The report of an evaluation is made again from its folder."""

import pytest
from rich.console import Console

from agents.evaluation.drivers import Driver, driver_evaluation
from agents.evaluation.episodes import ExploreArguments
from agents.evaluation.pipeline import KINDS, Execution, carry_out
from agents.report import REPORTS, main


def test_every_kind_of_evaluation_has_a_report():
    """But the leaderboard's, whose page has all entries on it."""
    assert {*REPORTS, "leaderboard"} == set(KINDS)


def test_the_report_is_made_again(tmp_path, capsys):
    evaluation = driver_evaluation([Driver("random")], ExploreArguments("office-small", (("budget", 40),)), range(2))
    carry_out(evaluation, tmp_path, Execution(console=Console(quiet=True)))
    assert main([str(tmp_path)]) == 0
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert str(tmp_path / "report.html") in capsys.readouterr().out and "overrides.budget 40" in page
    (tmp_path / "report.html").unlink()
    assert main([str(tmp_path)]) == 0 and (tmp_path / "report.html").read_text(encoding="utf-8") == page


def test_a_folder_without_evaluation_is_refused_by_name(tmp_path):
    with pytest.raises(ValueError, match=str(tmp_path)):
        main([str(tmp_path)])
